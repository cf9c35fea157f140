import math
from functools import cache
from itertools import combinations

import numpy as np
import oracle
import pytest
import torch
from scipy.spatial import ConvexHull

import torcharm as ta

BELLOWS = oracle.Actuator(oracle.bellows_force, reference=50.0)
MUSCLE = oracle.Actuator(oracle.mckibben_force, reference=100.0)
WAVY_TERMS = ((0, 1, 6.0), (0, 2, -0.5), (0, 3, 0.008), (1, 1, -3.0), (1, 0, -40.0))
LINEAR_TERMS = ((0, 1, 1.5), (1, 0, -30.0), (1, 1, -0.4))


def polynomial(terms, **fields):
    return ta.PolynomialActuator(terms, (-1.0, 1.0), (0.0, 40.0), 40.0, **fields)


def oracle_polynomial(terms, stiffness=oracle.PAPER_STIFFNESS):
    return oracle.Actuator(oracle.polynomial_force(terms), stiffness, 40.0)


PAIRS = {
    "bellows": (ta.Bellows(), BELLOWS),
    "muscle": (ta.McKibben(), MUSCLE),
    "wavy": (polynomial(WAVY_TERMS), oracle_polynomial(WAVY_TERMS)),
    "linear": (polynomial(LINEAR_TERMS), oracle_polynomial(LINEAR_TERMS)),
    "unbending": (
        polynomial(WAVY_TERMS, bending_stiffness=0.0),
        oracle_polynomial(WAVY_TERMS, stiffness=0.0),
    ),
    "stiffening": (
        polynomial(WAVY_TERMS, bending_stiffness=-0.5),
        oracle_polynomial(WAVY_TERMS, stiffness=-0.5),
    ),
    "spring": (polynomial(((1, 0, -200.0),)), oracle_polynomial(((1, 0, -200.0),))),
}
CURVED = [[0.5, 0.0, 0.9], [0.47, 0.01, -0.4], [0.52, 0.0, 0.0]]
STRAIGHT = [[0.5, 0.0, 0.0], [0.45, 0.0, 0.0]]
SQUEEZED = [[0.365, 0.0, 0.0], [0.37, 0.0, 0.02]]  # a muscle here is slack up to some 20 kPa

# name: kinds, radii, lengths, limits (None: the models' own), twists
CASES = {
    "paper's antagonistic": (["bellows", "muscle", "muscle", "bellows"], [-0.08, -0.015, 0.015, 0.08], 0.5, None),
    "bellows only": (["bellows"] * 4, [-0.08, -0.015, 0.015, 0.08], 0.5, None),
    "identical": (["bellows"] * 4, [0.03] * 4, 0.5, None),
    "identical pairs": (["wavy", "muscle", "wavy", "muscle"], [-0.03, 0.02, -0.03, 0.02], 0.5, None),
    "all at the centre": (["bellows", "muscle", "wavy"], [0.0, 0.0, 0.0], 0.5, None),
    "no pressure": (["bellows", "muscle"], [-0.03, 0.03], 0.5, [0.0, 0.0]),
    "one without pressure": (["bellows", "muscle", "wavy"], [-0.03, 0.03, 0.01], 0.5, [50.0, 0.0, 20.0]),
    "one bellows": (["bellows"], [0.02], 0.5, None),
    "one muscle": (["muscle"], [-0.02], 0.5, None),
    "muscles": (["muscle", "muscle"], [-0.02, 0.03], 0.5, None),
    "wavy": (["wavy", "wavy", "stiffening"], [-0.05, 0.01, 0.04], 0.5, None),
    "K = 0": (["unbending", "unbending"], [-0.05, 0.04], 0.5, None),
    "K > 0": (["stiffening", "bellows"], [-0.05, 0.04], [0.45, 0.5], None),
    "linear": (["linear", "linear", "linear"], [-0.05, 0.01, 0.04], [0.5, 0.55, 0.6], [40.0, 30.0, 20.0]),
    "springs": (["spring", "bellows"], [-0.05, 0.04], 0.5, None),
    "spring only": (["spring"], [-0.05], 0.5, None),
}
SHAPES = {"curved": CURVED, "straight": STRAIGHT, "squeezed": SQUEEZED}


def designs(case):
    """The same arm for torcharm and for the oracle."""
    kinds, radii, length, limits = CASES[case]
    models, twins = zip(*(PAIRS[kind] for kind in kinds), strict=True)
    lengths = length if isinstance(length, list) else [length] * len(kinds)
    limits = limits or [model.max_pressure for model in models]
    arm = ta.ArmDesign(radii, [*lengths], models, limits)
    return arm, oracle.Arm(tuple(radii), tuple(lengths), tuple(limits), twins)


def tables(case, shape, samples, *, relative):
    """(N, M, S, 2) curves of the oracle."""
    found = oracle_curves(case, shape, samples)
    return found - found[:1] if relative else found


@cache
def oracle_curves(case, shape, samples):
    """The same, of sets that are not relative: scalar arithmetic, which takes its time."""
    _, twin = designs(case)
    return np.array([oracle.curves(twin, twist, samples) for twist in SHAPES[shape]])


def double(values):
    return torch.tensor(values, dtype=torch.float64)


every_case = pytest.mark.parametrize("case", CASES)
every_shape = pytest.mark.parametrize("shape", SHAPES)
every_kind = pytest.mark.parametrize("kind", ["exact", "edges"])
both_sets = pytest.mark.parametrize("relative", [False, True], ids=["absolute", "relative"])


def miss(points, corners):
    """How far the furthest of some points is from the boundary of a hull, or outside it."""
    return max(abs(oracle.distance(point, corners)) for point in np.asarray(points))


@every_case
@every_shape
@every_kind
@both_sets
@pytest.mark.parametrize("samples", [2, 7])
def test_hull_is_the_oracles(case, shape, kind, relative, samples):
    """To exact hulls muscles add their kinks: these hold the oracle's, and lie in the hull of its finest samples."""
    arm, _ = designs(case)
    hulls = ta.wrench_hulls(arm, double(SHAPES[shape]), relative=relative, hull=kind, samples=samples)
    kinks = kind == "exact" and "muscle" in CASES[case][0]
    for node, table in enumerate(tables(case, shape, samples, relative=relative)):
        expected, found = oracle.attainable_hull(table, kind), oracle.hull(hulls.vertices[node])
        tolerance = 1e-11 * (1 + np.abs(table).sum(0).max())
        if not kinks:
            assert miss(hulls.vertices[node], expected) < tolerance
            assert miss(expected, found) < tolerance
            continue
        assert max(oracle.distance(corner, found) for corner in expected) < tolerance
        fine = tables(case, shape, 251, relative=relative)[node]
        step = np.abs(np.diff(fine, axis=1)).max(1).sum()  # a kink lies within one step of a sample
        whole = oracle.attainable_hull(fine, kind)
        assert max(oracle.distance(vertex, whole) for vertex in hulls.vertices[node].numpy()) < step + tolerance


@every_case
@every_shape
@every_kind
@both_sets
@pytest.mark.parametrize("samples", [2, 9, 33])
def test_every_vertex_is_the_reaction_to_its_own_pressure(case, shape, kind, relative, samples):
    arm, _ = designs(case)
    if kind == "edges" and samples == 33:
        samples = 5
    twists = double(SHAPES[shape])
    hulls = ta.wrench_hulls(arm, twists, relative=relative, hull=kind, samples=samples)
    assert hulls.pressure.min() >= 0
    assert (hulls.pressure - arm.max_pressure).max() <= 1e-12
    for node in range(len(twists)):
        reaction = ta.reaction_wrench(arm, twists, hulls.pressure[node])[..., [node], :].squeeze(-2)
        if relative:
            reaction = reaction - ta.reaction_wrench(arm, twists[:1], hulls.pressure[node]).squeeze(-2)
        torch.testing.assert_close(hulls.vertices[node], reaction, rtol=1e-11, atol=1e-10)


@every_case
@every_shape
@every_kind
@both_sets
def test_vertices_go_round_once_counter_clockwise(case, shape, kind, relative):
    arm, _ = designs(case)
    hulls = ta.wrench_hulls(arm, double(SHAPES[shape]), relative=relative, hull=kind, samples=5)
    for vertices in hulls.vertices.numpy():
        size = 1 + np.abs(vertices).max()
        edges = np.roll(vertices, -1, axis=0) - vertices
        edges = edges[np.linalg.norm(edges, axis=1) > 1e-9 * size]
        if len(edges) == 0:
            assert np.ptp(vertices, axis=0).max() < 1e-9 * size * len(vertices)
            continue
        heading = np.arctan2(edges[:, 1], edges[:, 0])
        turns = np.mod(np.roll(heading, -1) - heading + 1e-6, 2 * math.pi) - 1e-6
        assert turns.sum() == pytest.approx(2 * math.pi, abs=1e-6)
        assert np.all(turns < math.pi + 1e-6)


def test_exact_hull_is_the_hull_of_all_combinations_of_samples():
    arm, _ = designs("wavy")
    hulls = ta.wrench_hulls(arm, double(CURVED), samples=5)
    for vertices, table in zip(hulls.vertices, tables("wavy", "curved", 5, relative=False), strict=True):
        everything = oracle.box_points(table)
        corners = everything[ConvexHull(everything).vertices]
        found = oracle.hull(vertices)
        assert max(abs(oracle.distance(vertex, corners)) for vertex in found) < 1e-11
        assert max(abs(oracle.distance(corner, found)) for corner in corners) < 1e-11


@pytest.mark.parametrize("samples", [2, 3, 4])
def test_edges_hull_is_qhull_of_the_papers_samples(samples):
    arm, _ = designs("paper's antagonistic")
    bent = CURVED[:2]  # no collinear samples, of which Qhull keeps some by chance
    hulls = ta.wrench_hulls(arm, double(bent), hull="edges", samples=samples)
    curves = tables("paper's antagonistic", "curved", samples, relative=False)
    for vertices, table in zip(hulls.vertices, curves[:2], strict=True):
        points = oracle.edge_points(table)
        assert len(points) == samples * 4 * 2**3
        expected = points[ConvexHull(points).vertices]
        distinct = oracle.hull(vertices.numpy().round(9))
        assert len(distinct) == len(expected)
        gap = np.linalg.norm(distinct[:, None] - expected, axis=-1)
        assert gap.min(0).max() < 1e-8
        assert gap.min(1).max() < 1e-8


def test_node_one_has_a_single_point_as_relative_set():
    arm, _ = designs("paper's antagonistic")
    for kind in ("exact", "edges"):
        hulls = ta.wrench_hulls(arm, double(CURVED), relative=True, hull=kind)
        assert torch.equal(hulls.vertices[0], torch.zeros_like(hulls.vertices[0]))


def test_actuators_at_the_centre_of_a_straight_arm_span_a_segment():
    arm, _ = designs("all at the centre")
    hulls = ta.wrench_hulls(arm, double(STRAIGHT))
    assert torch.equal(hulls.vertices[..., 1], torch.zeros_like(hulls.vertices[..., 1]))
    assert torch.all(hulls.vertices[..., 0].amax(-1) > hulls.vertices[..., 0].amin(-1))


def test_without_pressure_the_set_is_the_passive_wrench():
    arm, _ = designs("no pressure")
    hulls = ta.wrench_hulls(arm, double(CURVED))
    passive = ta.reaction_wrench(arm, double(CURVED), torch.zeros(2, dtype=torch.float64))
    torch.testing.assert_close(hulls.vertices, passive[:, None].expand_as(hulls.vertices), rtol=0, atol=1e-12)


@every_kind
@both_sets
def test_batches_of_designs_and_shapes_are_an_outer_product(kind, relative):
    models = [ta.Bellows(), ta.McKibben(), polynomial(WAVY_TERMS)]
    rng = np.random.default_rng(0)
    radii, lengths = double(rng.uniform(-0.05, 0.05, (2, 3, 3))), double(rng.uniform(0.5, 0.6, (2, 1, 3)))
    twists = double(rng.uniform([0.45, -0.01, -1], [0.55, 0.01, 1], size=(4, 1, 5, 3)))
    arms = ta.ArmDesign(radii, lengths, models)
    hulls = ta.wrench_hulls(arms, twists, relative=relative, hull=kind, samples=4)
    slots = hulls.vertices.shape[-2]
    assert hulls.vertices.shape == (2, 3, 4, 1, 5, slots, 2)
    assert hulls.pressure.shape == (2, 3, 4, 1, 5, slots, 3)
    for design in np.ndindex(2, 3):
        for shape in np.ndindex(4, 1):
            one = ta.wrench_hulls(arms[design], twists[shape], relative=relative, hull=kind, samples=4)
            for found, expected in zip(hulls.vertices[(*design, *shape)], one.vertices, strict=True):
                expected = oracle.hull(expected)
                assert max(abs(oracle.distance(vertex, expected)) for vertex in found.numpy()) < 1e-11


# --- how many samples ---


def slots(arm, **options):
    return ta.wrench_hulls(arm, double(CURVED), **options).vertices.shape[-2]


def test_exact_has_vertices_for_the_sides_of_the_curves_hulls():
    arm, _ = designs("bellows only")
    assert slots(arm, samples=7) == 2 * 2 * 4 * 7


@every_kind
def test_default_sampling_is_17_a_curve_or_the_papers_three_an_edge(kind):
    arm, _ = designs("paper's antagonistic")
    default = ta.wrench_hulls(arm, double(CURVED), hull=kind)
    chosen = ta.wrench_hulls(arm, double(CURVED), hull=kind, samples={"exact": 17, "edges": 3}[kind])
    assert torch.equal(default.vertices, chosen.vertices)


@every_kind
def test_two_samples_serve_forces_linear_in_pressure(kind):
    arm, _ = designs("linear")
    assert slots(arm, hull=kind) == slots(arm, hull=kind, samples=2)
    hulls = ta.wrench_hulls(arm, double(CURVED), hull=kind)
    for vertices, table in zip(hulls.vertices, tables("linear", "curved", 33, relative=False), strict=True):
        expected = oracle.minkowski_hull(table)
        assert max(abs(oracle.distance(corner, oracle.hull(vertices))) for corner in expected) < 1e-11


def test_one_curved_force_among_linear_ones_needs_more_samples():
    arm = ta.ArmDesign([-0.01, 0.01], 0.5, [polynomial(LINEAR_TERMS), ta.Bellows()])
    assert slots(arm) == 2 * 2 * 2 * 17


@every_kind
@pytest.mark.parametrize("samples", [1, 0, -3])
def test_fewer_than_two_samples_are_an_error(kind, samples):
    arm, _ = designs("bellows only")
    with pytest.raises(ValueError, match=r"samples.*at least 2"):
        ta.wrench_hulls(arm, double(CURVED), hull=kind, samples=samples)


def test_an_unknown_hull_is_an_error_that_names_the_choices():
    arm, _ = designs("bellows only")
    with pytest.raises(ValueError, match=r"hull.*exact.*edges.*'round'"):
        ta.wrench_hulls(arm, double(CURVED), hull="round")


def test_edges_of_too_many_actuators_are_an_error_that_names_the_way_out():
    arm = ta.ArmDesign(torch.linspace(-0.1, 0.1, 13), 0.5, [ta.Bellows()] * 13)
    with pytest.raises(ValueError, match=r"12 actuators, got 13.*exact"):
        ta.wrench_hulls(arm, torch.tensor(CURVED), hull="edges")


@pytest.mark.parametrize("relative", [False, True])
def test_vertices_are_differentiable(relative):
    radius = torch.tensor(0.08, dtype=torch.float64, requires_grad=True)
    twists = ta.affine_curvature(-3.0, 3.0, length=0.5, nodes=4)

    def width(outer):
        vertices = ta.wrench_hulls(ta.antagonistic_arm(outer, 0.015, 0.5), twists, relative=relative).vertices
        return vertices[..., 1].amax() - vertices[..., 1].amin()

    (found,) = torch.autograd.grad(width(radius), radius)
    with torch.no_grad():
        wanted = (width(radius + 1e-6) - width(radius - 1e-6)) / 2e-6
    torch.testing.assert_close(found, wanted, rtol=1e-6, atol=0)


# --- space, segments in series ---


def spatial(**changes):
    models = [ta.Bellows(), ta.McKibben(), ta.Bellows(), ta.McKibben()]
    return ta.ArmDesign(**{"offsets": ta.ring(0.05, 4), "length": 0.4, "actuators": models, **changes})


BENT = torch.tensor([[0.4, 0.0, 0.0, 0.0, 0.3, -0.2], [0.39, 0.0, 0.0, 0.0, -0.1, 0.4]], dtype=torch.float64)


@both_sets
@every_kind
def test_spatial_vertices_are_reactions_and_corners(kind, relative):
    arm = spatial()
    hulls = ta.wrench_hulls(arm, BENT, relative=relative, hull=kind)
    for node in range(2):
        reaction = ta.reaction_wrench(arm, BENT, hulls.pressure[node])[..., node, :]
        if relative:
            reaction = reaction - ta.reaction_wrench(arm, BENT, hulls.pressure[node])[..., 0, :]
        torch.testing.assert_close(hulls.vertices[node], reaction, rtol=1e-11, atol=1e-11)
    if relative:
        assert not hulls.vertices[0].any()
        assert hulls.volume()[0] == 0


@both_sets
def test_spatial_hulls_hold_random_pressures_and_the_papers_edges(relative):
    arm, rng = spatial(), np.random.default_rng(2)
    exact = ta.wrench_hulls(arm, BENT, relative=relative)
    drawn = torch.from_numpy(rng.beta(0.3, 0.3, (2000, 4))) * arm.max_pressure
    wrench = ta.reaction_wrench(arm, BENT, drawn)
    wrench = wrench - wrench[:, :1] if relative else wrench
    edges = ta.wrench_hulls(arm, BENT, relative=relative, hull="edges", samples=9).vertices
    faces = ConvexHull(exact.vertices[1].numpy())
    for points in (wrench[:, 1].numpy(), edges[1].numpy()):
        outside = (points @ faces.equations[:, :3].T + faces.equations[:, 3]).max()
        assert outside < 2e-3 * np.abs(exact.vertices[1].numpy()).max()
    assert exact.volume()[1].item() == pytest.approx(faces.volume, rel=1e-9)


def test_forces_linear_in_pressure_make_a_zonotope_in_space():
    """Of 4 chords in general position: 14 corners, and the volume of all parallelepipeds of three."""
    model = polynomial(LINEAR_TERMS, bending_stiffness=0.0)
    offsets = [[0.05, 0.0], [0.0, 0.04], [-0.03, 0.01], [0.01, -0.06]]
    arm = ta.ArmDesign(offsets=offsets, length=0.4, actuators=model)
    hulls = ta.wrench_hulls(arm, BENT)
    for node in range(2):
        assert len(np.unique(hulls.vertices[node].numpy().round(9), axis=0)) == 14
        ends = [ta.reaction_wrench(arm, BENT, 40.0 * one)[node] for one in torch.eye(4, dtype=torch.float64)]
        base = ta.reaction_wrench(arm, BENT, torch.zeros(4, dtype=torch.float64))[node]
        chords = torch.stack(ends) - base
        boxes = [torch.linalg.det(chords[list(three)]).abs() for three in combinations(range(4), 3)]
        assert hulls.volume()[node].item() == pytest.approx(sum(boxes).item(), rel=1e-9)


def test_areas_and_volumes_are_differentiable():
    """In space of corners: which points of a smooth boundary are shown changes with the design."""
    model = polynomial(LINEAR_TERMS, bending_stiffness=0.0)
    for make in (
        lambda r: (ta.antagonistic_arm(0.08 + r), double(CURVED)),
        lambda r: (spatial(offsets=ta.ring(0.05 + r, 4, 0.1), actuators=model), BENT),
    ):
        radius = torch.zeros((), dtype=torch.float64, requires_grad=True)
        (found,) = torch.autograd.grad(ta.wrench_hulls(*make(radius)).volume().sum(), radius)
        with torch.no_grad():
            ends = [ta.wrench_hulls(*make(double(sign * 1e-6))).volume().sum() for sign in (1, -1)]
        assert found.item() == pytest.approx((ends[0] - ends[1]).item() / 2e-6, rel=1e-5)


def test_segments_in_series_are_the_segments():
    lower = ta.ArmDesign(radii=[-0.06, 0.0, 0.06], length=0.5, actuators=[ta.Bellows(), ta.McKibben(), ta.Bellows()])
    upper = ta.ArmDesign(radii=[-0.04, 0.04], length=0.5, actuators=ta.Bellows())
    twists = double(CURVED)
    hulls = ta.wrench_hulls(ta.series([lower, upper]), twists, relative=True, segment_nodes=[1, 2])
    assert hulls.pressure.shape[-1] == 5
    alone = ta.wrench_hulls(upper, twists[1:], relative=True)
    slots_alone = alone.vertices.shape[-2]
    torch.testing.assert_close(hulls.vertices[1:, :slots_alone], alone.vertices, rtol=0, atol=0)
    torch.testing.assert_close(hulls.pressure[1:, :slots_alone, 3:], alone.pressure, rtol=0, atol=0)
    assert not hulls.pressure[1:, :, :3].any()
    assert not hulls.vertices[0].any()
    with pytest.raises(ValueError, match="segment_nodes: must hold one number for each segment"):
        ta.wrench_hulls(ta.series([lower, upper]), twists)
