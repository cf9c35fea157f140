from dataclasses import replace

import numpy as np
import pytest
import torch
from hull_cases import PAPER_ARMS, PAPER_SHAPES, double, paper_scene, random_scene, unchecked
from scipy.optimize import linprog

import torcharm as ta
from experiments.reference import attainable_sets, enclosed_distance

ARMS = tuple(PAPER_ARMS)
REACHED = ta.Task(ta.affine_curvature(1.0, 1.5), 0.1 * ta.sample_loads(6))
"""Loads that the antagonistic arm can bear to some factor."""


def spring(stiffness=100.0):
    return ta.PolynomialActuator(((0, 1, 2.0), (1, 0, -stiffness)), (-0.3, 0.3), (0.0, 50.0), 50.0, 0.0)


def required(task, relative):
    wrench = ta.required_wrench(task.twists, task.tip_load)[..., [0, 2]]
    return wrench - wrench[..., :1, :] if relative else wrench


def by_linprog(vertices, wrench):
    """The least and the largest t for which t w is a mix of vertices; None where there is none."""
    count = len(vertices)
    equal = np.vstack((np.column_stack((vertices.T, -wrench)), np.append(np.ones(count), 0.0)))
    found = []
    for sign in (1.0, -1.0):
        cost = np.append(np.zeros(count), sign)
        answer = linprog(cost, A_eq=equal, b_eq=[0.0, 0.0, 1.0], bounds=[(0, None)] * count + [(None, None)])
        if answer.status == 2:
            return None
        assert answer.status == 0
        found.append(sign * answer.fun)
    return found


@pytest.mark.parametrize("metric", ["absolute", "relative"])
@pytest.mark.parametrize("name", ARMS)
def test_every_node_against_linear_programming(name, metric):
    """Of fine vertices, which lie on the sets' boundaries: their hulls are within the sets, and hardly smaller."""
    scene = random_scene(name, designs=2, tasks=4, nodes=4, seed=5)
    arm, task = scene.arm_and_task()
    with unchecked():
        found = ta.load_capacity(arm, task, metric)
        vertices, _ = scene.vertices_and_required(metric, samples=257)
    assert found.converged.all()
    wrench = required(task, metric == "relative")
    hits = 0
    for design, case, node in np.ndindex(2, 4, 4):
        own, w = vertices[design, case, node].numpy(), wrench[case, node].numpy()
        low, high = (value[design, case, node].item() for value in (found.t_min_per_node, found.t_max_per_node))
        if np.abs(w).max() < 1e-12:  # node 1 differs from itself by nothing
            assert (low, high) == (-np.inf, np.inf)
            continue
        expected = by_linprog(np.unique(own, axis=0), w)
        if expected is None:
            assert np.isnan([low, high]).all()
        else:
            hits += 1
            np.testing.assert_allclose([low, high], expected, rtol=2e-4, atol=2e-4)
            assert low <= expected[0] + 1e-7
            assert high >= expected[1] - 1e-7
    assert hits >= 4


@pytest.mark.parametrize("metric", ["absolute", "relative"])
def test_the_factor_is_where_unattainability_starts(metric):
    arm = ta.antagonistic_arm(outer_radius=double([0.06, 0.08]))
    task = REACHED if metric == "absolute" else ta.Task(ta.affine_curvature(1.0, -0.5), ta.sample_loads(12))
    found = ta.load_capacity(arm, task, metric)
    assert found.attainable.any()
    checked = 0
    for design, case in found.attainable.nonzero().tolist():
        if found.unbounded[design, case]:
            continue
        factor = found.factor[design, case]
        node = int(found.limiting_node[design, case])
        for share, outside in ((1 - 1e-8, False), (1 + 1e-8, True)):
            grown = ta.Task(task.twists, task.tip_load[case] * factor * share)
            distance = getattr(ta.evaluate(arm[design], grown, (metric,), signed=True), f"{metric}_per_node")
            assert bool(distance[node] > 0) == outside
            assert outside or not bool((distance > 0).any())
        checked += 1
    assert checked >= 2


@pytest.mark.parametrize("metric", ["absolute", "relative"])
@pytest.mark.parametrize("name", ARMS)
def test_ends_lie_on_the_sets_boundaries(name, metric):
    """Signed distances by an independent method, in numpy, of the wrenches at both ends of the intervals."""
    arm, loads, ends = PAPER_ARMS[name](), 0.3 * ta.sample_loads(2), 0
    for slope, intercept in PAPER_SHAPES:
        task = ta.Task(ta.affine_curvature(slope, intercept, nodes=5), loads)
        with unchecked():
            found = ta.load_capacity(arm, task, metric)
        assert found.converged.all()
        sets = attainable_sets(arm, task.twists.numpy(), relative=metric == "relative")
        wrench = required(task, metric == "relative").numpy()
        for case in range(len(loads)):
            for factor in (found.t_min_per_node[case].numpy(), found.t_max_per_node[case].numpy()):
                real = np.isfinite(factor)
                gap, _ = enclosed_distance(sets, np.where(real, factor, 0.0)[:, None] * wrench[case])
                assert np.abs(gap[real]).max(initial=0.0) < 1e-8
                ends += real.sum()
    assert ends >= 4


def test_a_bending_moment_that_no_pressure_changes():
    """It shifts the sets: a signed distance of 0 at both ends."""
    models = [ta.Bellows(bending_stiffness=ta.ConstantBending(-0.1)), ta.McKibben(), ta.McKibben(), ta.Bellows()]
    arm = ta.ArmDesign([-0.08, -0.015, 0.015, 0.08], 0.5, models)
    found, plain = (ta.load_capacity(a, REACHED) for a in (arm, ta.antagonistic_arm()))
    assert found.converged.all()
    assert found.attainable.any()
    assert ((found.t_max - plain.t_max).abs() > 1e-3)[found.attainable].all()
    for case in found.attainable.nonzero().squeeze(-1).tolist():
        for factor, node in ((found.t_min, found.t_min_per_node), (found.t_max, found.t_max_per_node)):
            grown = ta.Task(REACHED.twists, REACHED.tip_load[case] * factor[case])
            distance = ta.evaluate(arm, grown, ("absolute",), signed=True).absolute_per_node
            limiting = (node[case] - factor[case]).abs().argmin()
            assert abs(distance[limiting].item()) < 1e-8


def test_a_larger_load_has_a_smaller_factor_and_a_reversed_one_the_reversed_interval():
    arm = ta.antagonistic_arm()
    found = ta.load_capacity(arm, REACHED)
    for scale in (4.0, -1.0, -0.5):
        other = ta.load_capacity(arm, ta.Task(REACHED.twists, scale * REACHED.tip_load))
        ends = (found.t_min_per_node / scale, found.t_max_per_node / scale)
        low, high = ends if scale > 0 else ends[::-1]
        torch.testing.assert_close(other.t_min_per_node, low, equal_nan=True, rtol=1e-12, atol=1e-12)
        torch.testing.assert_close(other.t_max_per_node, high, equal_nan=True, rtol=1e-12, atol=1e-12)


def test_a_mirrored_arm_bears_the_mirrored_load():
    radii, models = double([-0.08, -0.015, 0.016, 0.079]), [ta.Bellows(), ta.McKibben(), ta.McKibben(), ta.Bellows()]
    arm, mirrored = ta.ArmDesign(radii, 0.5, models), ta.ArmDesign(-radii, 0.5, models)
    flipped = ta.Task(REACHED.twists * double([1, 1, -1]), REACHED.tip_load * double([-1, 1, -1]))
    found, other = (ta.load_capacity(a, t) for a, t in ((arm, REACHED), (mirrored, flipped)))
    assert found.attainable.any()
    torch.testing.assert_close(found.t_max_per_node, other.t_max_per_node, equal_nan=True, rtol=1e-9, atol=1e-9)
    assert found.limiting_node.equal(other.limiting_node)


def test_a_batch_is_a_loop_in_blocks_of_any_size():
    arm = ta.antagonistic_arm(outer_radius=double([0.05, 0.08, 0.09]))
    shapes = ta.affine_curvature(double([1.0, -1.0]), double([1.5, 1.0]), nodes=4)[:, None]
    task = ta.Task(shapes, 0.1 * ta.sample_loads(3))
    whole = ta.load_capacity(arm, task)
    for name in ("factor", "t_min", "t_max", "limiting_node", "attainable", "in_range", "converged", "unbounded"):
        assert getattr(whole, name).shape == (3, 2, 3)
    assert whole.t_max_per_node.shape == (3, 2, 3, 4)
    small = ta.load_capacity(arm, task, chunk_size=2)
    for design, shape, load in np.ndindex(3, 2, 3):
        one = ta.load_capacity(arm[design], ta.Task(shapes[shape, 0], task.tip_load[load]))
        for name, value in vars(one).items():
            for other in (whole, small) if isinstance(value, torch.Tensor) else ():
                torch.testing.assert_close(
                    getattr(other, name)[design, shape, load], value, equal_nan=True, rtol=1e-9, atol=1e-11
                )


@pytest.mark.parametrize("leaf", ["radii", "length", "max_pressure", "twists", "tip_load"])
def test_gradients_against_differences(leaf):
    arm = ta.antagonistic_arm()
    task = ta.Task(ta.affine_curvature(0.9, 1.5, nodes=4), double([-1.0, 2.0, 0.2]))
    leaves = {
        "radii": arm.radii + double([0.001, 0.0, 0.0005, 0.0]),
        "length": arm.length.clone(),
        "max_pressure": arm.max_pressure.clone(),
        "twists": task.twists,
        "tip_load": task.tip_load,
    }
    generator = torch.Generator().manual_seed(4)
    direction = torch.randn(leaves[leaf].shape, generator=generator, dtype=torch.float64)
    size = {"radii": 1e-2, "length": 1e-2, "max_pressure": 1.0, "twists": 1e-2, "tip_load": 1e-1}[leaf]

    def ends(step):
        values = leaves | {leaf: leaves[leaf] + step * size * direction}
        design = ta.ArmDesign(values["radii"], values["length"], arm.actuators, values["max_pressure"])
        found = ta.load_capacity(design, ta.Task(values["twists"], values["tip_load"]))
        assert found.converged
        assert found.attainable_unloaded
        return torch.stack((found.t_min, found.factor))

    step = torch.zeros((), dtype=torch.float64, requires_grad=True)
    slopes = [torch.autograd.grad(ends(step)[end], step)[0].item() for end in (0, 1)]
    h = 1e-5
    differences = (ends(double(h)) - ends(double(-h))) / (2 * h)
    np.testing.assert_allclose(slopes, differences.numpy(), rtol=2e-6, atol=2e-8)
    assert max(abs(slope) for slope in slopes) > 0.1  # limits that are not reached do not matter


def test_gradients_in_blocks_are_those_of_the_whole_and_finite_where_nothing_is_attainable():
    found = []
    for chunk in (None, 1):
        scene = paper_scene("antagonistic", loads=2, nodes=5, grad=True)
        arm, task = scene.arm_and_task()
        capacity = ta.load_capacity(arm, task, chunk_size=chunk)
        assert capacity.factor.isnan().any()
        used = torch.where(capacity.attainable, capacity.factor, torch.zeros_like(capacity.factor)).sum()
        ends = [value[value.isfinite()].sum() for value in (capacity.t_min_per_node, capacity.t_max_per_node)]
        gradients = torch.autograd.grad(used + ends[0] + ends[1], list(scene.leaves.values()))
        assert all(gradient.isfinite().all() for gradient in gradients)
        found.append(gradients)
    for whole, blocks in zip(*found, strict=True):
        torch.testing.assert_close(whole, blocks)


class TestFlags:
    shape = ta.affine_curvature(0.0, 0.0, length=0.5, nodes=3)

    def test_no_load_is_borne_to_any_factor_by_an_arm_that_can_hold_its_shape(self):
        arm = ta.ArmDesign([-0.02, 0.02], 0.5, [spring(), spring()])
        found = ta.load_capacity(arm, ta.Task(self.shape, [0.0, 0.0, 0.0]))
        assert found.unbounded
        assert found.attainable_unloaded
        assert found.factor == torch.inf
        assert found.limiting_node == -1

    def test_and_to_none_by_one_that_cannot(self):
        arm = ta.ArmDesign([-0.02, 0.02], 0.52, [spring(), spring()])  # shorter than it wants to be
        found = ta.load_capacity(arm, ta.Task(self.shape, [0.0, 0.0, 0.0]))
        assert found.factor.isnan()
        assert not found.attainable
        assert not found.unbounded

    @pytest.mark.parametrize("limit", [0.0, 1.0])
    def test_an_arm_that_needs_a_load(self, limit):
        """Two springs of 100 N, squeezed by 4 %, push 8 N, and 4 N more when driven at 1 kPa each."""
        arm = ta.ArmDesign([-0.02, 0.02], 0.5 / 0.96, [spring(), spring()], [limit, limit])
        found = ta.load_capacity(arm, ta.Task(self.shape, [0.0, 2.0, 0.0]))  # up, into the arm
        torch.testing.assert_close(found.t_min, double(4.0))
        torch.testing.assert_close(found.factor, double(4.0 + 2.0 * limit))
        assert found.attainable
        assert not found.attainable_unloaded

    def test_a_load_that_only_its_reverse_could_be_borne_for(self):
        arm = ta.ArmDesign([-0.02, 0.02], 0.5 / 0.96, [spring(), spring()], [1.0, 1.0])
        found = ta.load_capacity(arm, ta.Task(self.shape, [0.0, -2.0, 0.0]))
        torch.testing.assert_close(found.t_max, double(-4.0))
        assert found.factor.isnan()
        assert found.factor_per_node.isnan().all()
        assert not found.attainable
        assert found.limiting_node == -1

    def test_a_hull_without_area_ends_where_it_ends(self):
        """One actuator at radius r: wrenches (f, -r f) from 0 to 100 N, and a load in line with them."""
        arm = ta.ArmDesign([0.02], 0.5, [spring()])
        found = ta.load_capacity(arm, ta.Task(self.shape, [0.0, 5.0, 0.1]))
        torch.testing.assert_close(found.factor, double(20.0))
        torch.testing.assert_close(found.t_min, double(0.0), atol=1e-12, rtol=0)
        askew = ta.load_capacity(arm, ta.Task(self.shape, [0.0, 5.0, 0.2]))
        torch.testing.assert_close(askew.factor, double(0.0), atol=1e-12, rtol=0)

    def test_the_limiting_node_is_where_the_lever_is_longest(self):
        arm = ta.antagonistic_arm()
        found = ta.load_capacity(arm, ta.Task(ta.affine_curvature(0.0, 0.0), [1.0, 0.0, 0.0]))
        assert found.limiting_node == 0
        assert found.t_max == found.t_max_per_node[0]

    def test_strain_out_of_range_is_said(self):
        shapes = ta.affine_curvature(double([-3.0, 0.0]), double([3.0, 0.0]))
        found = ta.load_capacity(ta.antagonistic_arm(), ta.Task(shapes, [1.0, 0.0, 0.0]))
        assert found.in_range.tolist() == [False, True]


def test_float32():
    arm = ta.antagonistic_arm()
    single = ta.ArmDesign(arm.radii.float(), arm.length.float(), arm.actuators, arm.max_pressure.float())
    found, expected = ta.load_capacity(single, REACHED.to(torch.float32)), ta.load_capacity(arm, REACHED)
    assert found.factor.dtype == torch.float32
    torch.testing.assert_close(found.factor.double(), expected.factor, rtol=2e-4, atol=2e-4, equal_nan=True)


def test_empty_batches():
    found = ta.load_capacity(ta.antagonistic_arm(), ta.Task(REACHED.twists, REACHED.tip_load[:0]))
    assert found.factor.shape == (0,)
    assert found.t_max_per_node.shape == (0, 10)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"metric": "both"}, "metric: must be one of absolute, relative"),
        ({"chunk_size": 0}, "chunk_size: must be an integer of at least 1"),
    ],
)
def test_arguments_out_of_bounds(options, message):
    with unchecked(), pytest.raises(ValueError, match=message):
        ta.load_capacity(ta.antagonistic_arm(), REACHED, **options)


def test_arm_and_task_must_fit():
    with unchecked(), pytest.raises(ValueError, match="task: must be of type Task"):
        ta.load_capacity(ta.antagonistic_arm(), REACHED.twists)


def test_moments_at_no_pressure_move_the_hull():
    """A constant bending moment is as good as a load that the arm bears of itself."""
    shape = ta.affine_curvature(0.0, 1.0, length=0.48, nodes=3)
    bare = [replace(model, bending_stiffness=0.0) for model in (ta.Bellows(), ta.McKibben(), ta.Bellows())]
    stiff = [replace(model, bending_stiffness=ta.ConstantBending(-0.2)) for model in bare]
    arms = [ta.ArmDesign([-0.05, 0.0, 0.05], 0.5, models) for models in (bare, stiff)]
    task = ta.Task(shape, [0.0, 0.0, 1.0])
    lengths = 0.48 - torch.tensor([-0.05, 0.0, 0.05], dtype=torch.float64)
    own = (-0.2 / lengths).sum()  # κ = 1; a pure moment is required of every node alike
    alone, with_moment = (ta.load_capacity(arm, task) for arm in arms)
    torch.testing.assert_close(with_moment.t_max, alone.t_max - own, rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(with_moment.t_min, alone.t_min - own, rtol=1e-9, atol=1e-9)


# --- space, weight, segments in series ---


def assert_ends_lie_on_boundaries(arm, task, metric, with_payload):
    """Where factors end, the signed distance of the node is 0, and `with_payload(t)` is the task with so much of it."""
    found = ta.load_capacity(arm, task, metric)
    assert found.converged.all()
    checked = 0
    for ends in (found.t_min_per_node, found.t_max_per_node):
        for node in ends.isfinite().nonzero().squeeze(-1).tolist():
            here = ta.evaluate(arm, with_payload(ends[node]), (metric,), signed=True)
            assert abs(getattr(here, f"{metric}_per_node")[node].item()) < 1e-6
            checked += 1
    return found, checked


@pytest.mark.parametrize("metric", ["absolute", "relative"])
def test_the_payload_grows_and_the_arms_own_weight_does_not(metric):
    bends = [(0.395, -0.135, -0.574), (0.393, -0.249, -0.214), (0.394, -0.396, -0.536), (0.391, -0.196, -0.509)]
    twists = torch.tensor([[length, 0.0, 0.0, 0.0, *turn] for length, *turn in bends], dtype=torch.float64)
    arm = ta.ArmDesign(offsets=ta.ring(0.05, 4), length=0.4, actuators=[ta.Bellows(), ta.McKibben()] * 2, mass=0.4)
    point = double([0.0, -0.5, 0.2, 0.0, 0.0, 0.0])
    tip = double([0.4, -0.6, 0.3, 0.0, 0.01, 0.0])

    def with_payload(t):
        points = [ta.PointLoad(t * point, at=0.6)]
        return ta.Task(twists, load=ta.ExternalLoad(tip=t * tip, gravity=True, points=points))

    found, checked = assert_ends_lie_on_boundaries(arm, with_payload(1.0), metric, with_payload)
    assert checked >= (8 if metric == "absolute" else 4)
    # the weight alone is factor 0
    bare = ta.evaluate(arm, with_payload(0.0), (metric,), signed=True)
    margin = getattr(bare, f"{metric}_per_node")[1:]
    assert ((margin <= 0) == ((found.t_min_per_node <= 0) & (found.t_max_per_node >= 0))[1:]).all()


def test_segments_in_series_have_the_factors_of_their_nodes():
    """The upper segment alone, under the same tip load, has the same ends as within the series."""
    lower = ta.ArmDesign(radii=[-0.06, 0.0, 0.06], length=0.3, actuators=[ta.Bellows(), ta.McKibben(), ta.Bellows()])
    upper = ta.ArmDesign(radii=[-0.04, 0.04], length=0.2, actuators=ta.Bellows())
    shape = torch.cat((ta.affine_curvature(0.3, 0.2, 0.3, 3), ta.affine_curvature(-0.2, 0.3, 0.21, 2)))
    load = double([0.8, -1.0, 0.02])
    arm = ta.series([lower, ta.RigidLink(length=0.02), upper])
    task = ta.Task(shape, load, segment_nodes=(3, 2), wrench_at="start")
    found, checked = assert_ends_lie_on_boundaries(
        arm, task, "absolute", lambda t: ta.Task(shape, t * load, segment_nodes=(3, 2), wrench_at="start")
    )
    assert checked >= 6
    base = ta.poses(shape, segment_nodes=(3, 2), links=[double([0.02, 0.0, 0.0]), None])[3]
    alone = ta.load_capacity(upper, ta.Task(shape[3:], load, base, wrench_at="start"))
    torch.testing.assert_close(found.t_max_per_node[3:], alone.t_max_per_node, rtol=1e-9, atol=1e-9)
    relative = ta.load_capacity(arm, task, "relative")
    assert relative.t_max_per_node[[0, 3]].tolist() == [np.inf, np.inf]  # each segment's first node


def test_a_planar_arm_in_space_bears_the_same():
    arm = ta.antagonistic_arm()
    turned = ta.ArmDesign(arm.radii, arm.length, arm.actuators, out_of_plane=torch.zeros(4).double())
    zero = torch.zeros_like(REACHED.twists[..., 0])
    length, shear, curvature = REACHED.twists.unbind(-1)
    twists = torch.stack((length, shear, zero, zero, zero, curvature), -1)
    none = torch.zeros_like(REACHED.tip_load[..., 0])
    fx, fy, m = REACHED.tip_load.unbind(-1)
    task = ta.Task(twists, torch.stack((fx, fy, none, none, none, m), -1))
    flat, found = ta.load_capacity(arm, REACHED), ta.load_capacity(turned, task)
    torch.testing.assert_close(found.t_max, flat.t_max, rtol=1e-9, atol=1e-9, equal_nan=True)
    torch.testing.assert_close(found.t_min, flat.t_min, rtol=1e-9, atol=1e-9, equal_nan=True)
    assert flat.attainable.any()


@pytest.mark.parametrize("leaf", ["offsets", "mass", "twists", "tip"])
def test_gradients_in_space_against_differences(leaf):
    leaves = {
        "offsets": ta.ring(0.05, 4),
        "mass": double(0.3),
        "twists": torch.tensor([[0.4, 0.0, 0.0, 0.0, 0.25, -0.1]] * 3, dtype=torch.float64),
        "tip": double([0.4, -0.6, 0.3, 0.0, 0.01, 0.0]),
    }
    generator = torch.Generator().manual_seed(1)
    direction = torch.randn(leaves[leaf].shape, generator=generator, dtype=torch.float64)

    def ends(step):
        values = leaves | {leaf: leaves[leaf] + 1e-2 * step * direction}
        models = [ta.Bellows(), ta.McKibben()] * 2
        arm = ta.ArmDesign(offsets=values["offsets"], length=0.4, actuators=models, mass=values["mass"])
        load = ta.ExternalLoad(tip=values["tip"], gravity=True)
        found = ta.load_capacity(arm, ta.Task(values["twists"], load=load))
        assert found.converged
        return torch.stack((found.t_min, found.t_max))

    step = torch.zeros((), dtype=torch.float64, requires_grad=True)
    slopes = [torch.autograd.grad(ends(step)[end], step)[0].item() for end in (0, 1)]
    h = 1e-3  # of 1e-2 of each input
    differences = (ends(double(h)) - ends(double(-h))) / (2 * h)
    np.testing.assert_allclose(slopes, differences.numpy(), rtol=1e-5, atol=1e-7)
    assert min(abs(slope) for slope in slopes) > 0


def test_an_impossible_shape_bears_nothing():
    arm = ta.antagonistic_arm()
    shapes = ta.affine_curvature(double([0.0, 0.0]), double([0.0, 90.0]))  # degrees, it seems
    found = ta.load_capacity(arm, ta.Task(shapes, [1.0, 0.0, 0.0]))
    assert found.impossible.tolist() == [False, True]
    assert found.factor[1].isnan()
    assert found.t_max_per_node[1].isnan().all()
    assert not found.attainable[1]
    assert not found.converged[1]
    assert not found.in_range[1]


def test_arm_and_task_of_different_dtype_are_promoted():
    arm, rounded = ta.antagonistic_arm(), REACHED.to(torch.float32)
    found, same = ta.load_capacity(arm, rounded), ta.load_capacity(arm, rounded.to(torch.float64))
    assert found.factor.dtype == torch.float64
    assert torch.equal(found.factor, same.factor)


def in_space(nodes, length, *turn):
    return double([[length, 0.0, 0.0, 0.0, *turn]]).expand(nodes, 6)


def bundle(radius, muscles, length, mass):
    """Three bellows outside and some muscles inside."""
    offsets = torch.cat((ta.ring(radius, 3), ta.ring(radius / 2, muscles, phase=0.5)))
    return ta.ArmDesign(
        offsets=offsets, length=length, actuators=[ta.Bellows()] * 3 + [ta.McKibben()] * muscles, mass=mass
    )


PAYLOADS = {  # arm, shape, and the most kilograms that a scan goes to
    "plane": (
        ta.ArmDesign(ta.antagonistic_arm().radii, 0.5, ta.antagonistic_arm().actuators, mass=0.4),
        {"twists": ta.affine_curvature(0.3, 0.2, length=0.49)},
        8.0,
    ),
    "bellows outside, muscles inside": (bundle(0.06, 6, 0.4, 0.5), {"twists": in_space(10, 0.39, 0.3, 0.5)}, 2.0),
    "two modules and a link": (
        ta.series([bundle(0.06, 6, 0.3, 0.3), ta.RigidLink(length=0.03, mass=0.05), bundle(0.05, 3, 0.25, 0.2)]),
        {
            "twists": torch.cat((in_space(4, 0.29, 0.1, 0.2), in_space(4, 0.24, -0.2, 0.1))),
            "segment_nodes": (4, 4),
        },
        2.0,
    ),
}


@pytest.mark.parametrize("kind", ["point mass", "tip force"])
@pytest.mark.parametrize("name", PAYLOADS)
def test_the_largest_payload_is_where_a_scan_of_payloads_ends(name, kind):
    """Under the weight of arm and links, at every payload for its own what `evaluate` says of the whole load."""
    arm, shape, most = PAYLOADS[name]
    segment = len(shape.get("segment_nodes", (0,))) - 1

    def task(kilograms):
        if kind == "point mass":
            load = ta.ExternalLoad(gravity=True, points=[ta.PointLoad(mass=kilograms, segment=segment)])
        else:
            load = ta.ExternalLoad(tip=[0.0, -9.81 * kilograms] + [0.0] * (3 * arm.dimension - 5), gravity=True)
        return ta.Task(**shape, load=load)

    found = ta.load_capacity(arm, task(0.1))
    assert found.attainable_unloaded
    assert 0.02 < 0.1 * found.factor < most
    scanned = np.linspace(1e-6, most, 41)
    held = [ta.evaluate(arm, task(float(mass)), ("absolute",)).absolute.item() == 0 for mass in scanned]
    assert held == (scanned <= 0.1 * found.factor.item()).tolist()
    assert any(held)
    assert not all(held)
    for share, outside in ((1 - 1e-7, False), (1 + 1e-7, True)):
        assert (ta.evaluate(arm, task(0.1 * share * found.factor.item()), ("absolute",)).absolute > 0) == outside


def test_weight_alone_is_no_payload_to_scale():
    task = ta.Task(ta.affine_curvature(0.5, 1.0, length=0.5), load=ta.ExternalLoad(gravity=True))
    with pytest.raises(ValueError, match=r"^load: must hold a payload to scale, a tip load or point loads, got none"):
        ta.load_capacity(ta.antagonistic_arm(), task)


@pytest.mark.parametrize("space", [False, True])
def test_an_arm_without_driven_actuators_bears_what_it_is_at_rest_with(space):
    """Its sets are points: none, one or all factors serve, though an equilibrium is solved to rounding only."""
    core, zero = ta.elastic_core(45.0, 1.2e-3), [0.0] * (6 if space else 3)
    places = {"offsets": [[0.004, 0.001], [-0.005, 0.002]]} if space else {"radii": [0.004, -0.005]}
    arm = ta.ArmDesign(**places, length=0.05, actuators=core, mass=0.04)
    payload = ta.ExternalLoad(gravity=True, points=[ta.PointLoad(mass=0.02)])
    nothing = ta.ExternalLoad(gravity=True, points=[ta.PointLoad(zero)])
    for rest, load, expected in (
        (ta.ExternalLoad(gravity=True), payload, 0.0),
        (payload, payload, 1.0),
        (ta.ExternalLoad(gravity=True), nothing, np.inf),
        (payload, nothing, np.nan),
    ):
        eq = ta.solve_equilibrium(arm, [0.0, 0.0], rest, 4, base_pose="horizontal")
        found = ta.load_capacity(arm, ta.Task(eq.twists, load=load, base_pose="horizontal"))
        assert float(found.factor) == pytest.approx(expected, abs=1e-9, nan_ok=True)
        assert bool(found.converged)
        assert (bool(found.attainable), bool(found.attainable_unloaded)) == (expected >= 0, expected in (0, np.inf))


def test_gradients_where_nothing_is_driven():
    """A weight under which a core is stretched: `t w = E A ε`."""
    stiffness = torch.tensor(45.0, dtype=torch.float64, requires_grad=True)
    arm = ta.ArmDesign([0.0], 0.05, ta.elastic_core(stiffness, 1.2e-3))
    found = ta.load_capacity(arm, ta.Task([[0.051, 0.0, 0.0]] * 2, [0.0, -0.6, 0.0]))
    assert float(found.factor.detach()) == pytest.approx(45.0 * 0.02 / 0.6)
    assert float(torch.autograd.grad(found.factor, stiffness)[0]) == pytest.approx(0.02 / 0.6)


def test_where_there_is_no_factor_the_reason_says_which_node_lacks_what():
    """An arm in space that holds a shape within its tolerance, but not the very shape."""
    arm = ta.ArmDesign(offsets=ta.ring(radius=0.05, count=3), length=0.4, actuators=ta.Bellows(), mass=0.3)
    shape = torch.tensor([[0.455, 0, 0, 0, 0.1, 0.1]] * 10, dtype=torch.float64)
    task = ta.Task(shape, load=ta.ExternalLoad(gravity=True, points=[ta.PointLoad(mass=0.1)]))
    sets = ta.evaluate(arm, task)
    found = ta.load_capacity(arm, task)
    assert sets.verdict == "held"
    assert bool(found.factor.isnan())
    node, miss = int(sets.worst_node) + 1, float(sets.worst_miss)
    assert found.reason.startswith("no pressures hold this very shape under any multiple of the payload")
    assert f"node {node} lacks {miss:.3g} N of force and moment (N·m counted as N); evaluate tells" in found.reason


@pytest.mark.parametrize("metric", ["absolute", "relative"])
def test_reasons_are_given_where_factors_are_not(metric):
    arms = ta.antagonistic_arm(outer_radius=double([0.05, 0.08]))
    tasks = ta.Task(ta.affine_curvature(double([[1.0], [-3.0]]), double([[1.5], [3.0]])), 0.1 * ta.sample_loads(3))
    found = ta.load_capacity(arms, tasks, metric)
    assert found.reason.shape == tuple(found.factor.shape) == (2, 2, 3)
    np.testing.assert_array_equal(found.reason != "", found.factor.isnan().numpy())
    assert not bool(found.impossible.any())
    assert "" not in found.reason if metric == "relative" else 0 < (found.reason != "").sum() < 12
    miss = ta.evaluate(arms, tasks, metric).worst_miss
    for index in np.argwhere(found.reason != ""):
        change = "change from the base in " if metric == "relative" else ""
        lack = f"lacks {float(miss[tuple(index)]):.3g} N of {change}force and moment (N·m counted as N);"
        assert lack in found.reason[tuple(index)]


def test_the_reason_of_an_impossible_shape_is_that_it_is():
    found = ta.load_capacity(ta.bellows_arm(), ta.Task([[-0.1, 0.0, 0.0]] * 3, [1.0, 0.0, 0.0]))
    assert found.reason == "the shape leaves an actuator no length"
