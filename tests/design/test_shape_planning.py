"""Shapes through a tip pose: the paper's, and those that an arm holds best, in the plane and in space."""

import math
import re
from typing import Any

import pytest
import torch

import torcharm as ta
from torcharm.design import Objective
from torcharm.design.shape_planning import PAPER_SHAPES, Smoothness, nearest_shape, plan_shape

ARM = ta.ArmDesign([-0.04, -0.01, 0.01, 0.04], 0.51, [ta.Bellows(), ta.McKibben(), ta.McKibben(), ta.Bellows()])
TIP = (0.35, -0.3, 0.0)
LOAD = (6.0, 0.0, 0.0)


def _tip_error(twists: torch.Tensor) -> float:
    return float((ta.poses(twists)[..., -1, :] - torch.tensor(TIP, dtype=torch.float64)).abs().max())


def test_the_published_shape_has_the_published_metrics() -> None:
    plan = plan_shape(ARM, TIP, LOAD, PAPER_SHAPES[0])
    task = ta.Task(plan.twists, LOAD, wrench_at="start")
    found = ta.evaluate(ARM, task, ("absolute", "relative"), hull="edges", power=2)
    assert found.absolute is not None
    assert found.relative is not None
    assert f"{float(found.absolute):.4f}" == "0.2343"
    assert f"{float(found.relative):.5g}" == "132.85"


@pytest.mark.parametrize("smoothness", PAPER_SHAPES)
def test_smooth_shapes_meet_the_tip_and_no_neighbour_is_smoother(smoothness: Smoothness) -> None:
    plan = plan_shape(ARM, TIP, LOAD, smoothness)
    assert plan.found
    assert plan.tip_error < 1e-8
    assert _tip_error(plan.twists) < 1e-8
    length, _, curvature = plan.twists.unbind(-1)

    def cost(length: torch.Tensor, curvature: torch.Tensor) -> torch.Tensor:
        bend = curvature.diff(dim=-1).norm(dim=-1)
        return smoothness.length_weight * (length - smoothness.reference_length).norm(dim=-1) + bend

    assert plan.cost == pytest.approx(float(cost(length, curvature)), rel=1e-9)
    # Neighbours in the null space of the tip, put back onto it by Newton's method.
    generator = torch.Generator().manual_seed(0)
    at = torch.cat((length, curvature))

    def tip(z: torch.Tensor) -> torch.Tensor:
        shape = torch.stack((z[:10], torch.zeros(10).double(), z[10:]), -1)
        return ta.poses(shape)[-1] - torch.tensor(TIP, dtype=torch.float64)

    for step in (1e-2, 1e-3):
        for _ in range(10):
            z = at + step * torch.randn(20, generator=generator, dtype=torch.float64)
            for _ in range(4):
                jacobian = torch.autograd.functional.jacobian(tip, z)
                z = z - torch.linalg.pinv(jacobian) @ tip(z)  # type: ignore[operator]
            assert float(cost(z[:10], z[10:])) >= plan.cost - 1e-9


def test_a_heavy_weight_keeps_lengths_and_a_light_one_lets_them_go() -> None:
    heavy = plan_shape(ARM, TIP, LOAD, Smoothness(45.0, 0.5)).twists[:, 0]
    light = plan_shape(ARM, TIP, LOAD, Smoothness(4.0, 0.51)).twists[:, 0]
    assert torch.equal(heavy, torch.full((10,), 0.5).double())
    assert float(light.max() - light.min()) > 1e-4


def test_the_best_held_shape_is_held() -> None:
    plan = plan_shape(ARM, TIP, LOAD, starts=1, nodes=5)
    smooth = plan_shape(ARM, TIP, LOAD, PAPER_SHAPES[0], nodes=5)
    found = ta.evaluate(ARM, ta.Task(smooth.twists, LOAD), ("absolute", "relative"), power=2)
    assert found.absolute is not None
    assert found.relative is not None
    assert _tip_error(plan.twists) < 1e-8
    assert plan.found
    assert plan.attainability is not None
    assert bool(plan.attainability.shape_in_range)
    assert plan.cost < 1e-2 * float(found.absolute + found.relative)


def test_a_shape_may_be_planned_by_its_predicted_error() -> None:
    plan = plan_shape(ARM, TIP, LOAD, Objective(), starts=1, nodes=4, iterations=20)
    smooth = plan_shape(ARM, TIP, LOAD, PAPER_SHAPES[0], nodes=4)
    errors = [ta.predict_error(ARM, ta.Task(one.twists, LOAD)).shape_error for one in (plan, smooth)]
    assert plan.cost == pytest.approx(float(errors[0]), rel=1e-6)
    assert float(errors[0]) < float(errors[1])


def test_several_loads_count_together() -> None:
    loads = torch.tensor([[6.0, 0.0, 0.0], [-6.0, 0.0, 0.0]]).double()
    objective = Objective("unattainability", power=2, margin=False)
    plan = plan_shape(ARM, TIP, loads, objective, starts=1, nodes=4)
    assert plan.attainability is not None
    assert plan.attainability.absolute is not None
    assert plan.attainability.absolute.shape == (2,)
    assert plan.cost == pytest.approx(float(plan.attainability.absolute.mean()), abs=1e-12)


def test_headings_count_their_turns() -> None:
    once = plan_shape(ARM, TIP, LOAD, Smoothness(45.0, 0.5))
    more = plan_shape(ARM, (0.35, -0.3, -2 * math.pi), LOAD, Smoothness(4.0, 0.5))
    assert float(once.twists[:, 2].mean()) == pytest.approx(math.pi / 2)
    assert float(more.twists[:, 2].mean()) == pytest.approx(-1.5 * math.pi)


RING = ta.ArmDesign(offsets=ta.ring(radius=0.05, count=3), length=0.4, actuators=ta.Bellows())


@pytest.mark.parametrize("bend", [(0.0, -0.6), (0.5, 0.7), (-0.8, 0.0), (0.0, 0.0)])
def test_in_space_a_tip_pose_is_met_in_place_and_turn(bend: tuple[float, float]) -> None:
    wanted = torch.tensor([[0.42, 0.0, 0.0, 0.0, *bend]] * 6).double()
    tip = ta.poses(wanted)[-1]
    for objective in (None, Smoothness(10.0, 0.42)):
        plan = plan_shape(RING, tip, [1.0, 0.0, 0.5, 0.0, 0.0, 0.0], objective, nodes=6, starts=1, iterations=30)
        assert plan.found
        assert plan.twists.shape == (6, 6)
        torch.testing.assert_close(ta.poses(plan.twists)[-1], tip, atol=1e-7, rtol=0)
        assert float(plan.twists[:, 1:4].abs().max()) == 0.0
    assert plan.cost < 1e-3, "the arc itself is the smoothest"
    torch.testing.assert_close(plan.twists, wanted, atol=5e-4, rtol=0)


BUNDLE = ta.ArmDesign(
    offsets=torch.cat((ta.ring(0.06, 3), ta.ring(0.03, 6, phase=0.5))),
    length=0.4,
    actuators=[ta.Bellows()] * 3 + [ta.McKibben()] * 6,
    mass=0.5,
)
PAYLOAD = ta.ExternalLoad([0.3, 0.0, -0.2, 0.0, 0.0, 0.0], gravity=True, points=[ta.PointLoad(mass=0.1, at=0.7)])


@pytest.mark.parametrize("seed", [4])
def test_a_pose_that_the_arm_reaches_under_weight_and_payload_has_a_shape_that_is_held(seed: int) -> None:
    pressure = BUNDLE.max_pressure * torch.rand(9, generator=torch.Generator().manual_seed(seed)).double()
    reached = ta.solve_equilibrium(BUNDLE, pressure, PAYLOAD, nodes=5)
    assert bool(reached.stable)
    tip = reached.poses[-1]
    plan = plan_shape(BUNDLE, tip, PAYLOAD, nodes=5, starts=1)
    assert plan.found
    torch.testing.assert_close(ta.poses(plan.twists)[-1], tip, atol=1e-7, rtol=0)
    found = ta.evaluate(BUNDLE, ta.Task(plan.twists, load=PAYLOAD), ("absolute", "relative"))
    assert bool(found.shape_in_range)
    assert found.absolute == pytest.approx(0.0, abs=1e-3)
    assert found.relative == pytest.approx(0.0, abs=1e-3)
    assert plan.attainability is not None
    assert plan.attainability.task.load.gravity


def test_a_planar_tip_in_space_has_the_planar_shape() -> None:
    flat = plan_shape(ARM, TIP, LOAD, PAPER_SHAPES[0])
    length, _, bend = flat.twists.unbind(-1)
    none = torch.zeros_like(length)
    tip = ta.poses(torch.stack((length, none, none, none, none, bend), -1))[-1]
    plan = plan_shape(RING, tip, [0.0] * 6, PAPER_SHAPES[0])
    assert plan.cost == pytest.approx(flat.cost, rel=1e-4)
    torch.testing.assert_close(plan.twists[:, 5], flat.twists[:, 2], atol=2e-3, rtol=0)


def test_that_no_shape_is_found_is_said_and_no_error() -> None:
    far = torch.eye(4).double()
    far[:3, 3] = 3.0
    for arm, pose, load in ((ARM, (5.0, 5.0, 0.0), LOAD), (RING, far, [0.0] * 6)):
        plan = plan_shape(arm, pose, load, starts=1, nodes=4)
        assert not plan.found
        assert plan.status.startswith("no shape: none of 4 elements")
        assert "characterised range" in plan.status
        assert bool(plan.twists.isnan().all())
        assert plan.attainability is None
        assert math.isnan(plan.cost)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"tip_pose": (0.3, 0.0)}, "tip_pose"),
        ({"tip_pose": (0.3, math.nan, 0.0)}, "tip_pose"),
        ({"arm": RING}, "tip_pose: must have shape \\(4, 4\\)"),
        ({"nodes": 1}, "nodes"),
        ({"load": (1.0, 0.0)}, "load: must have shape"),
        ({"load": ta.ExternalLoad([0.0] * 6)}, "load: must be of 3 components"),
        ({"starts": 0}, "starts"),
        ({"nodes": (4, 4)}, "nodes: must be one number, or one for each of 1 segments"),
        ({"load": ta.ExternalLoad(points=ta.PointLoad(LOAD, segment=1))}, "points.0..segment: must be below 1"),
        ({"arm": ta.bellows_arm(outer_radius=torch.tensor([0.03, 0.04]))}, "one design"),
    ],
)
def test_arguments_are_checked(options: dict[str, Any], words: str) -> None:
    given = {"arm": ARM, "tip_pose": TIP, "load": LOAD, "starts": 1} | options
    with pytest.raises(ValueError, match=words):
        plan_shape(**given)


@pytest.mark.parametrize(("weight", "reference"), [(-1.0, 0.5), (1.0, 0.0), (math.inf, 0.5)])
def test_smoothness_is_checked(weight: float, reference: float) -> None:
    with pytest.raises(ValueError, match="must be a finite number"):
        Smoothness(weight, reference)


@pytest.mark.parametrize(
    ("tip", "said"),
    [
        ((0.0, -1.0, -math.pi / 2), "the tip is 1 m from the base, and the arm at most 0.525 m long: try a longer one"),
        ((0.0, -0.2, -math.pi / 2), "try a shorter arm, or a tip further from the base"),
        ((0.2, -0.2, 3.0), "try less bend, actuators nearer to the centreline, or an arm of another length"),
    ],
)
def test_what_has_no_shape_says_how_near_it_comes_and_what_to_try(tip, said):
    """Along a line the nearest length is an end of the strains that all actuators may have."""
    arm = ta.antagonistic_arm(0.05, 0.015, 0.5)
    status = ta.plan_shape(arm, tip, [0.0, 0.0, 0.0], starts=1, nodes=4).status
    assert status.startswith("no shape: none of 4 elements was found that meets the tip pose")
    assert status.endswith(said)
    if tip[0] == 0.0:
        low, high = zip(*(model.strain_range for model in arm.actuators), strict=True)
        nearest = 0.5 * (1 + (min(high) if tip[1] < -0.5 else max(low)))
        found = re.search(r"of length ([\d.]+) m \(actuators: 0.5 m\), misses it by (\d+) mm and 0°", status)
        assert found is not None, status
        assert float(found[1]) == pytest.approx(nearest, abs=1e-3)
        assert float(found[2]) == pytest.approx(1e3 * abs(nearest + tip[1]), abs=1.0)


def _segments(dimension: int) -> ta.ArmSeries:
    """Two heavy segments of unlike width and length, a crooked link between them and a mount behind."""
    if dimension == 2:
        parts = [ta.ArmDesign([-r, r], length, ta.Bellows(), mass=0.2) for r, length in ((0.05, 0.25), (0.04, 0.2))]
        link = ta.RigidLink(pose=[0.03, 0.01, 0.2], mass=0.05)
    else:
        rings = ((0.05, 0.25), (0.04, 0.2))
        parts = [ta.ArmDesign(offsets=ta.ring(r, 3), length=n, actuators=ta.Bellows(), mass=0.2) for r, n in rings]
        crooked = torch.eye(4).double()
        crooked[:2, :2] = torch.tensor([[math.cos(0.2), -math.sin(0.2)], [math.sin(0.2), math.cos(0.2)]])
        crooked[0, 3] = 0.03
        link = ta.RigidLink(pose=crooked, mass=0.05)
    return ta.series([parts[0], link, parts[1], ta.RigidLink(length=0.02)])


@pytest.mark.parametrize(("dimension", "counts"), [(2, (3, 1)), (3, (1, 2))])
def test_segments_in_series_hold_a_pose_that_they_reach_under_their_weight(
    dimension: int, counts: tuple[int, int]
) -> None:
    """Poses by the forward mechanics; those of the shape found by its own product of exponentials, links included."""
    arm = _segments(dimension)
    load = ta.ExternalLoad(gravity=True, points=[ta.PointLoad(mass=0.1, segment=1, at=0.5)])
    share = torch.linspace(0.02, 0.15, arm.actuator_count).double()
    reached = ta.solve_equilibrium(arm, arm.max_pressure * share, load, counts)
    assert bool(reached.stable)
    tip = reached.poses[-1]
    plan = plan_shape(arm, tip, load, nodes=counts, starts=1)
    assert plan.found, plan.status
    links = [link and link.end(dimension) for link in arm.links]
    poses = ta.poses(plan.twists, segment_nodes=counts, links=links)  # type: ignore[arg-type]
    torch.testing.assert_close(poses[-1], tip, atol=1e-7, rtol=0)
    assert plan.attainability is not None
    assert plan.attainability.task.segment_nodes == counts
    assert bool(plan.attainability.shape_in_range)
    assert plan.cost < 1e-6


def test_in_series_the_smoothest_shape_keeps_each_segment_at_its_length_and_may_jump_between() -> None:
    arm = _segments(2)
    counts, wanted = (3, 4), torch.tensor([[0.25, 0.0, 0.8]] * 3 + [[0.25, 0.0, -0.5]] * 4).double()
    links = [link and link.end(2) for link in arm.links]
    tip = ta.poses(wanted, segment_nodes=counts, links=links)[-1]  # type: ignore[arg-type]
    plan = plan_shape(arm, tip, LOAD, Smoothness(45.0, 0.25), nodes=counts)
    assert plan.cost == pytest.approx(0.0, abs=1e-6)
    torch.testing.assert_close(plan.twists, wanted, atol=1e-5, rtol=0)


def test_what_has_no_shape_in_series_counts_all_segments_and_links() -> None:
    arm = _segments(2)
    status = plan_shape(arm, (0.0, -2.0, -math.pi / 2), LOAD, nodes=2, starts=1).status
    most = sum((1 + ta.Bellows().strain_range[1]) * length for length in (0.25, 0.2)) + math.hypot(0.03, 0.01) + 0.02
    assert status.startswith("no shape: none of 4 elements")
    assert "(actuators: 0.45 m)" in status
    assert f"the arm at most {most:.3g} m long: try a longer one" in status


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_nearest_shape_has_the_tip_and_hardly_changes_more_than_it_must(dimension: int) -> None:
    arm = ARM if dimension == 2 else ta.antagonistic_ring(length=0.5)
    bend = ta.affine_curvature(-0.5, 1.0, 0.5, 6, **({} if dimension == 2 else {"direction": 0.3}))
    task = ta.Task(bend)
    tip = ta.poses(bend)[-1]
    assert nearest_shape(arm, task, tip) == pytest.approx(bend, abs=1e-12)
    moved = tip.clone()
    (moved[:2] if dimension == 2 else moved[:2, 3]).add_(0.003)
    found = nearest_shape(arm, task, moved)
    assert found is not None
    torch.testing.assert_close(ta.poses(found)[-1], moved, rtol=0, atol=1e-7)
    columns = [0, 2] if dimension == 2 else [0, 4, 5]
    scale = torch.tensor([0.1, *[1.0] * (dimension - 1)], dtype=torch.float64)
    change = ((found - bend)[:, columns] / scale).flatten()
    # Nearest is a change without a part along which the tip stays; steps towards it leave a little of one.
    unknowns = (bend[:, columns] / scale).flatten().requires_grad_()

    def tip_of(values: torch.Tensor) -> torch.Tensor:
        shape = torch.zeros_like(bend).index_copy(1, torch.tensor(columns), values.reshape(6, -1) * scale)
        pose = ta.poses(shape)[-1]
        return pose if dimension == 2 else pose[:3].flatten()

    jacobian = torch.autograd.functional.jacobian(tip_of, unknowns)
    along = jacobian.T @ torch.linalg.lstsq(jacobian.T, change[:, None], driver="gelsd").solution
    assert float((along[:, 0] - change).norm()) < 0.1 * float(change.norm())


@pytest.mark.parametrize("tip", [(0.0, 0.3, -1.5), (0.0, 0.0, -1.57), (5.0, 5.0, 0.0)])
def test_a_tip_that_no_arm_of_such_a_length_has_has_no_nearest_shape(tip: tuple[float, float, float]) -> None:
    assert nearest_shape(ARM, ta.Task(ta.constant_curvature(0.5, 0.5, 4)), tip) is None


def test_a_tip_of_space_is_none_of_a_planar_arm() -> None:
    with pytest.raises(ValueError, match="tip_pose"):
        nearest_shape(ARM, ta.Task(ta.constant_curvature(0.5, 0.5, 4)), torch.eye(4))
