"""`evaluate` on sets given by vertices: published values, agreement of all distances, and what is refused."""

import importlib.util
import sys
from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import oracle
import pytest
import torch
from hull_cases import PAPER_ARMS, SIZES, paper_scene, random_scene, unchecked
from oracle.spatial import SCENES, arm_and_task

import torcharm as ta
from torcharm.statics.cross_section import cross_sections
from torcharm.wrench_sets.vertex_sets import edge_pressures, edge_vertices, find_solver

METRICS = ("absolute", "relative")
needs_qpth = pytest.mark.skipif(importlib.util.find_spec("qpth") is None, reason="qpth is not installed")
QPTH = pytest.param("qpth", marks=needs_qpth)
ENVELOPE = pytest.param(partial(ta.qp_distance, gradient="envelope"), marks=needs_qpth, id="envelope")
each_arm = pytest.mark.parametrize("name", PAPER_ARMS)
each_hull = pytest.mark.parametrize("hull", ["edges", "exact"])
each_distance = pytest.mark.parametrize("distance", ["gjk", "scipy", QPTH])
each_solver = pytest.mark.parametrize("distance", ["scipy", QPTH])


def spatial_arm_and_task(*, grad=False, loads=3):
    """Three bellows and a muscle about a bent arm in space, under some loads."""
    rng = np.random.default_rng(4)
    offsets = torch.tensor([[0.05, 0.0], [-0.03, 0.04], [-0.02, -0.05], [0.01, 0.02]], dtype=torch.float64)
    offsets.requires_grad_(grad)
    actuators = (ta.Bellows(), ta.Bellows(), ta.Bellows(), ta.McKibben())
    arm = ta.ArmDesign(offsets=offsets, length=0.5, actuators=actuators)
    twists = torch.from_numpy(
        np.column_stack((np.full(5, 0.52), np.zeros((5, 2)), rng.normal(size=(5, 3)) * [0.1, 1.0, 1.0]))
    )
    load = torch.from_numpy(rng.normal(size=(loads, 6)) * [8.0, 8.0, 8.0, 0.5, 0.5, 0.5])
    return arm, ta.Task(twists, load), offsets


# --- the paper's numbers ---


@each_distance
@pytest.mark.parametrize(
    ("moment", "published"),
    [
        (2.0, [44.4031, 116.7625, 16.6250, 9.2688, 47.7773]),
        (5.0, [45.3737, 120.3011, 12.8572, 4.3175, 55.0741]),
    ],
)
def test_the_published_validation(moment, published, distance):
    loads = ta.sample_loads(5, scale=(20.0, 20.0, moment))
    task = ta.Task(ta.affine_curvature(-3.0, 3.0, nodes=10), loads, wrench_at="start")
    found = ta.evaluate(ta.bellows_arm(), task, ("absolute",), hull="edges", samples=3, distance=distance)
    np.testing.assert_allclose(found.absolute, published, rtol=0, atol=1e-3)
    assert found.converged.all()


# --- vertices ---


@pytest.mark.parametrize(("actuators", "samples"), [(1, 2), (3, 2), (3, 4), (4, 3)])
def test_edges_are_those_of_the_box_each_point_once(actuators, samples):
    table = edge_pressures(actuators, samples)
    grades = np.linspace(0, 1, samples)
    inner = [row for row in product(grades, repeat=actuators) if sum(0 < u < 1 for u in row) <= 1]
    assert {tuple(row) for row in table.round(12)} == {tuple(np.round(row, 12)) for row in inner}
    assert len(table) == len(inner)


@pytest.mark.parametrize("relative", [False, True])
def test_edge_vertices_are_reactions(relative):
    arm, task, _ = spatial_arm_and_task()
    sections = cross_sections(arm, task.twists)
    found = edge_vertices(sections, 3, relative=relative)
    for own, grades in zip(found.unbind(-2), edge_pressures(4, 3), strict=True):
        expected = ta.reaction_wrench(arm, task.twists, torch.from_numpy(grades) * arm.max_pressure)
        expected = expected - expected[:1] if relative else expected
        torch.testing.assert_close(own, expected, rtol=1e-12, atol=1e-10)


# --- agreement ---


@each_arm
@unchecked()
def test_edges_in_the_plane_are_the_oracle_s(name):
    kinds = {"bellows": "bbbb", "muscles": "mmmm", "antagonistic": "bmmb"}[name]
    models = {"b": oracle.Actuator(oracle.bellows_force), "m": oracle.Actuator(oracle.mckibben_force, reference=100.0)}
    if name == "muscles":
        models["m"] = replace(models["m"], force=oracle.scaled(oracle.mckibben_force, 2.0))
    arm, scene = PAPER_ARMS[name](), paper_scene(name, loads=1, nodes=4)
    task = ta.Task(scene.leaves["twists"], scene.leaves["tip_load"], wrench_at="start")
    found = ta.evaluate(arm, task, ("absolute", "relative"), hull="edges", samples=3)
    own = oracle.Arm(
        *(tuple(x.tolist()) for x in (arm.radii, arm.length.expand(4), arm.max_pressure.expand(4))),
        tuple(models[kind] for kind in kinds),
    )
    for shape in range(3):
        expected = oracle.node_distances(
            own, task.twists[shape, 0].numpy(), task.tip_load[0].numpy(), kind="edges", samples=3
        )
        for metric in METRICS:
            outside = np.maximum(getattr(expected, metric), 0.0)
            per_node = getattr(found, metric + "_per_node")[shape, 0]
            np.testing.assert_allclose(per_node, outside, rtol=0, atol=1e-9 * expected.size)


def largest(found, expected):
    return max(
        (getattr(found, name) - getattr(expected, name)).abs().max().item()
        for name in ("absolute_per_node", "relative_per_node")
    )


@each_hull
@each_solver
@each_arm
@unchecked()
def test_solvers_agree_in_the_plane(name, distance, hull):
    scene = paper_scene(name, nodes=4, loads=2, grad=True)
    reference = "gjk" if hull == "edges" else "scipy"
    expected, found = (scene.evaluate(hull=hull, samples=3, distance=one) for one in (reference, distance))
    assert found.converged.all()
    assert largest(found, expected) < 1e-5
    for metric in METRICS:
        exact, own = (
            torch.autograd.grad(getattr(one, metric).sum(), list(scene.leaves.values()), retain_graph=True)
            for one in (expected, found)
        )
        sizes = list(SIZES.values())
        size = sum((one * by).norm() for one, by in zip(exact, sizes, strict=True))
        for one, other, by in zip(own, exact, sizes, strict=True):
            assert ((one - other) * by).norm() < 2e-4 * size


@each_hull
@pytest.mark.parametrize("distance", ["scipy", QPTH, ENVELOPE])
@unchecked()
def test_solvers_agree_in_space(distance, hull):
    arm, task, offsets = spatial_arm_and_task(grad=True)
    reference = "gjk" if hull == "edges" else "scipy"
    expected, found = (
        ta.evaluate(arm, task, ("absolute", "relative"), hull=hull, samples=3, distance=one)
        for one in (reference, distance)
    )
    assert found.converged.all()
    assert (expected.absolute_per_node > 0).any()
    assert largest(found, expected) < 1e-5
    exact, own = (torch.autograd.grad((one.absolute + one.relative).sum(), offsets)[0] for one in (expected, found))
    assert (exact - own).norm() < 2e-4 * exact.norm()


@each_solver
def test_more_samples_of_curves_close_in_on_the_exact_sets(distance):
    arm, task, _ = spatial_arm_and_task()
    exact = ta.evaluate(arm, task, ("absolute", "relative"))
    errors = []
    for samples in (3, 9, 27):
        found = ta.evaluate(arm, task, ("absolute", "relative"), distance=distance, samples=samples)
        for metric in METRICS:  # sets from within
            assert (getattr(found, metric) >= getattr(exact, metric) - 1e-4).all()
        errors.append(largest(found, exact))
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 0.05


def test_a_planar_arm_in_space_gives_the_planar_values():
    arm = ta.antagonistic_arm()
    twists = ta.affine_curvature(1.0, 1.5, nodes=4)
    load = torch.tensor([6.0, -3.0, 0.4], dtype=torch.float64)
    spatial = ta.ArmDesign(
        offsets=torch.stack((arm.radii, torch.zeros_like(arm.radii)), -1),
        length=arm.length,
        actuators=arm.actuators,
        max_pressure=arm.max_pressure,
    )
    wide = torch.zeros(4, 6, dtype=torch.float64)
    wide[:, 0], wide[:, 5] = twists[:, 0], twists[:, 2]
    tip = torch.tensor([6.0, -3.0, 0, 0, 0, 0.4], dtype=torch.float64)
    for options in ({"hull": "edges"}, {"hull": "edges", "distance": "scipy"}, {"distance": "scipy"}):
        flat, turned = (
            ta.evaluate(arm, ta.Task(twists, load), ("absolute", "relative"), **options),
            ta.evaluate(spatial, ta.Task(wide, tip), ("absolute", "relative"), **options),
        )
        assert largest(turned, flat) < 1e-9


def test_segments_gravity_and_following_loads():
    """Scenes of several segments in space: scipy's distances to hulls of edges are the engine's."""
    scenes = [scene for scene in SCENES if len(scene.segments) > 1]
    assert scenes
    for scene in scenes[:2]:
        arm, task = arm_and_task(scene)
        expected, found = (
            ta.evaluate(arm, task, ("absolute", "relative"), hull="edges", distance=one) for one in ("gjk", "scipy")
        )
        assert largest(found, expected) < 1e-9


# --- gradients ---


@each_hull
@pytest.mark.parametrize("distance", ["gjk", "scipy"])
@unchecked()
def test_gradients_are_those_of_differences(distance, hull):
    if (hull, distance) == ("exact", "gjk"):
        pytest.skip("measures no vertices")
    arm, task, _ = spatial_arm_and_task(loads=1)
    inputs = (arm.offsets, arm.length, arm.max_pressure, task.twists, task.tip_load)
    inputs = tuple(value.detach().clone().requires_grad_() for value in inputs)

    def total(offsets, length, limit, twists, load):
        own = ta.ArmDesign(offsets=offsets, length=length, actuators=arm.actuators, max_pressure=limit)
        found = ta.evaluate(
            own, ta.Task(twists, load), ("absolute", "relative"), hull=hull, samples=3, distance=distance
        )
        return found.absolute + found.relative

    assert torch.autograd.gradcheck(total, inputs, eps=1e-6, rtol=1e-5, atol=1e-5, fast_mode=True)


# --- chunks and empty batches ---


@each_hull
@each_distance
@unchecked()
def test_chunks_change_neither_values_nor_gradients(distance, hull):
    if (hull, distance) == ("exact", "gjk"):
        pytest.skip("measures no vertices")
    scene = random_scene("antagonistic", designs=2, tasks=2, nodes=2, grad=True)

    def answers(chunk_size):
        found = scene.evaluate(hull=hull, samples=2, distance=distance, chunk_size=chunk_size)
        return found, torch.autograd.grad((found.absolute + found.relative).sum(), list(scene.leaves.values()))

    (whole, expected), (parts, found) = answers(None), answers(1)
    assert largest(parts, whole) < 1e-6
    for own, other in zip(found, expected, strict=True):
        torch.testing.assert_close(own, other, rtol=1e-4, atol=1e-4)


@each_distance
@pytest.mark.parametrize(("designs", "tasks"), [(0, 2), (2, 0), (0, 0)])
@unchecked()
def test_empty_batches_give_empty_results(distance, designs, tasks):
    scene = random_scene("antagonistic", designs=designs, tasks=tasks, nodes=3)
    found = scene.evaluate(hull="edges", distance=distance)
    assert found.absolute_per_node.shape == (designs, tasks, 3)
    assert found.converged.shape == (designs, tasks)


# --- what a solver says counts ---


@pytest.mark.parametrize("fault", [{"converged": False}, {"value": float("nan")}], ids=["not converged", "NaN"])
@pytest.mark.parametrize("wrong", METRICS)
@each_hull
def test_one_wrong_answer_is_marked_and_no_other(wrong, fault, hull):
    scene = paper_scene("bellows", loads=2, nodes=4)
    calls = []

    def solve(point, vertices, groups=1):
        found = ta.nnls_distance(point, vertices, groups=groups)
        calls.append(groups)
        if METRICS[len(calls) - 1] != wrong:
            return found
        field, bad = next(iter(fault.items()))
        value = getattr(found, field).clone()
        assert value.shape == (1, 3, 2, 4)  # designs, shapes, loads, nodes
        value[0, 1, 1, 2] = bad
        return replace(found, **{field: value})

    found = scene.evaluate(hull=hull, samples=3, distance=solve)
    expected = torch.ones(3, 2, dtype=torch.bool)
    expected[1, 1] = False
    assert calls == [4 if hull == "exact" else 1] * 2
    assert torch.equal(found.converged, expected)
    assert torch.equal(found.distances_converged, expected)


# --- what is refused ---


@each_distance
def test_vertices_know_no_margin(distance):
    with pytest.raises(ValueError, match=r"^signed: "):
        paper_scene("bellows").evaluate(signed=True, hull="edges", distance=distance)


@pytest.mark.parametrize("distance", ["closed_form", "", "QPTH", "nnls", 3])
@unchecked()
def test_an_unknown_distance_is_refused_with_those_there_are(distance):
    with pytest.raises(ValueError, match=r"^distance: .*gjk, qpth, scipy"):
        paper_scene("bellows").evaluate(distance=distance)


@pytest.mark.parametrize("name", ["gjk", "nnls", "qpht"])
def test_a_solver_that_there_is_not_is_refused_with_those_there_are(name):
    with pytest.raises(ValueError, match=rf"^distance: must be one of qpth, scipy, got '{name}'"):
        find_solver(name)


def test_a_function_without_groups_is_for_edges_only():
    scene = paper_scene("bellows", loads=1, nodes=2)

    def solve(point, vertices):
        return ta.nnls_distance(point, vertices)

    with pytest.raises(ValueError, match=r"^distance: .* keyword groups"):
        scene.evaluate(distance=solve)
    assert largest(scene.evaluate(hull="edges", distance=solve), scene.evaluate(hull="edges")) < 1e-9


def test_edges_of_many_actuators_are_refused():
    arm = ta.ArmDesign(offsets=ta.ring(radius=0.05, count=13), length=0.5, actuators=ta.Bellows())
    twists = torch.tensor([[0.5, 0, 0, 0, 0, 0.0]], dtype=torch.float64)
    task = ta.Task(twists, torch.zeros(6, dtype=torch.float64))
    with pytest.raises(ValueError, match=r"^hull: .* at most 12 actuators, got 13"):
        ta.evaluate(arm, task, ("absolute", "relative"), hull="edges")


def test_without_qpth_one_line_says_so_and_the_rest_works(monkeypatch):
    for module in ("qpth", "qpth.qp"):
        monkeypatch.setitem(sys.modules, module, None)
    scene = paper_scene("bellows", loads=1, nodes=2)
    with pytest.raises(ValueError, match=r"^distance: 'qpth' needs"):
        scene.evaluate(distance="qpth")
    assert scene.evaluate(distance="scipy").converged.all()
