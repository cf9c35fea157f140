"""Feasible designs: ties, bounds, spacing and strains, in the plane and in space."""

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings, strategies as st

import torcharm as ta
from torcharm.design.feasible import FEASIBLE, convex_corners, feasible_designs
from torcharm.design.space import LEAST_SPACING, DesignSpace, given_values

TASK = ta.Task(ta.affine_curvature([-3.0, 1.0, 6.0], [3.0, 1.5, -1.5]), (3.0, -2.0, 0.5))
RING = ta.ArmDesign(offsets=ta.ring(radius=0.05, count=3), length=0.4, actuators=ta.Bellows())
IN_SPACE = ta.Task([[[0.42, 0.0, 0.0, 0.0, 0.5, -0.8]] * 2 + [[0.4, 0.0, 0.0, 0.0, -0.3, 0.9]] * 2], [1.0] * 6)


def _designs(space: DesignSpace, arm: Any = None, task: ta.Task = TASK, count: int = 12) -> Any:
    feasible = feasible_designs(space, arm or ta.antagonistic_arm(), [task])
    points = feasible.random(count, seed=0)
    assert len(points) == count
    assert max(feasible.violation(point) for point in points) <= FEASIBLE
    return feasible.design(np.array(points))


@pytest.mark.parametrize("arm", [ta.antagonistic_arm(), ta.bellows_arm(), ta.mckibben_arm()])
@pytest.mark.parametrize("tied", [None, "mirror", {"length": "equal"}, ((0, 3), (1, 2))])
def test_random_designs_keep_strains_order_and_bounds(arm: ta.ArmDesign, tied: Any) -> None:
    space = DesignSpace(tied=tied, spacing=0.004, bounds={"radii": (-0.07, 0.07), "length": (0.3, 0.7)})
    designs = _designs(space, arm)
    found = ta.evaluate(designs, TASK, "absolute")
    assert bool(found.in_range.all())
    assert float(designs.radii.diff(dim=-1).min()) >= 0.004 - FEASIBLE
    assert float(designs.radii.abs().max()) <= 0.07 + 1e-9
    assert 0.3 - 1e-9 <= float(designs.length.min()) <= float(designs.length.max()) <= 0.7 + 1e-9
    assert float(designs.radii.std(0).max()) > 3e-3, "they spread"


def test_the_end_of_the_constraints_is_that_of_the_range() -> None:
    """A design that breaks the least of its strain constraints is strained beyond its range."""
    feasible = feasible_designs(DesignSpace(), ta.antagonistic_arm(), [TASK])
    inside = np.mean(feasible.random(12, 0), 0)  # the set is convex
    way = np.random.default_rng(0).normal(size=inside.shape)
    strains = [index for index, name in enumerate(feasible.names) if "strain" in name]
    low, high = 0.0, 10.0
    while high - low > 1e-9:
        middle = (low + high) / 2
        value = feasible.constraint_values(inside + middle * way)[0][strains].min()
        low, high = (middle, high) if value >= 0 else (low, middle)
    for step, within in ((low - 1e-6, True), (high + 1e-6, False)):
        design = feasible.design(inside + step * way)
        assert bool((ta.evaluate(design, TASK, "absolute").strain_excess == 0).all()) == within
    words = feasible.violated_by(feasible.design(inside + (high + 1e-3) * way))
    assert any("strain of actuator" in word for word in words)


@pytest.mark.parametrize(("arm", "task"), [(ta.antagonistic_arm(), TASK), (RING, IN_SPACE)])
def test_derivatives_of_constraints_are_those_of_differences(arm: ta.ArmDesign, task: ta.Task) -> None:
    free = ("radii", "length", "max_pressure") if arm.dimension == 2 else ("radii", "angles", "length")
    feasible = feasible_designs(DesignSpace(free=free, tied="none"), arm, [task])
    point = np.random.default_rng(1).random(feasible.dimension)
    step = 1e-6 * np.eye(feasible.dimension)
    ends = [np.stack([feasible.constraint_values(point + sign * way)[0] for way in step], -1) for sign in (1, -1)]
    np.testing.assert_allclose(feasible.constraint_values(point)[1], (ends[0] - ends[1]) / 2e-6, atol=1e-8)


def test_ties_make_symmetric_arms() -> None:
    designs = _designs(DesignSpace(free=("radii", "length", "max_pressure"), tied="mirror"))
    torch.testing.assert_close(designs.radii, -designs.radii.flip(-1))
    torch.testing.assert_close(designs.length, designs.length.flip(-1))
    torch.testing.assert_close(designs.max_pressure, designs.max_pressure.flip(-1))
    space = DesignSpace()
    object.__setattr__(space, "tied", np.array([[0, 3], [1, 2]]))  # which the checks of types in tests refuse
    groups = _designs(space)
    torch.testing.assert_close(groups.radii[:, :2], -groups.radii[:, 2:].flip(-1))
    designs = _designs(DesignSpace(tied=((0, 3),), in_range=False))
    torch.testing.assert_close(designs.radii[:, 0], -designs.radii[:, 3])
    assert float((designs.radii[:, 1] + designs.radii[:, 2]).abs().max()) > 1e-3


def test_in_space_rings_stay_rings_and_turn() -> None:
    space = DesignSpace(free=("radii", "angles", "length"), tied="equal", bounds={"radii": (0.02, 0.06)})
    designs = _designs(space, RING, IN_SPACE)
    y, z = designs.radii, designs.out_of_plane
    radius = (y.square() + z.square()).sqrt()
    torch.testing.assert_close(radius, radius[:, :1].expand_as(radius))
    apart = torch.stack((y - y.roll(1, -1), z - z.roll(1, -1))).norm(dim=0)
    torch.testing.assert_close(apart, 3**0.5 * radius)
    angle = torch.atan2(z, y)[:, 0]
    assert float(angle.std()) > 0.1
    assert bool(ta.evaluate(designs, IN_SPACE, "absolute").in_range.all())


def test_unless_told_otherwise_every_ring_keeps_to_itself_and_a_core_to_the_backbone() -> None:
    offsets = torch.cat((ta.ring(0.06, 3), torch.zeros(1, 2).double(), ta.ring(0.03, 6, phase=0.3)))
    models = [ta.Bellows() for _ in range(3)] + [ta.Bellows()] + [ta.McKibben() for _ in range(6)]
    arm = ta.ArmDesign(offsets=offsets, length=[0.4] * 3 + [0.38] + [0.4] * 6, actuators=models)
    task = ta.Task([[0.39, 0.0, 0.0, 0.0, 0.1, -0.2]] * 2, [0.0] * 6)
    feasible = feasible_designs(DesignSpace(), arm, [task])
    assert feasible.dimension == 5  # two radii and three lengths
    designs = feasible.design(np.array(feasible.random(8, 0)))
    rings = (slice(0, 3), slice(4, 10))
    for own in rings:
        radius = designs.offsets[:, own].norm(dim=-1)  # type: ignore[union-attr]
        torch.testing.assert_close(radius, radius[:, :1].expand_as(radius))
        assert float(radius[:, 0].std()) > 1e-3
        direction = designs.offsets[:, own] / radius.unsqueeze(-1)  # type: ignore[union-attr]
        torch.testing.assert_close(direction, (offsets[own] / offsets[own].norm(dim=-1, keepdim=True)).expand(8, -1, 2))
        lengths = designs.length[:, own]  # type: ignore[union-attr]
        torch.testing.assert_close(lengths, lengths[:, :1].expand_as(lengths))
    assert float(designs.offsets[:, 3].abs().max()) == 0.0  # type: ignore[union-attr]
    turned = _designs(DesignSpace(free="angles"), arm, task)
    angle = turned.offsets[..., 1].atan2(turned.offsets[..., 0])
    off = angle - angle[:, :1] - torch.atan2(offsets[:, 1], offsets[:, 0])
    by = [off[:, own].sin().asin() for own in rings]  # of the first ring, nothing: it turns as one
    torch.testing.assert_close(by[0], torch.zeros_like(by[0]), atol=1e-9, rtol=0)
    torch.testing.assert_close(by[1].abs(), by[1].abs()[:, :1].expand_as(by[1]), atol=1e-9, rtol=0)
    assert float(by[1].abs()[:, 0].std()) > 0.05


def test_a_mirrored_arm_in_space_stays_its_own_mirror_image() -> None:
    offsets = [[0.05, 0.02], [0.03, -0.04], [-0.03, -0.04], [-0.05, 0.02]]
    arm = ta.ArmDesign(offsets=offsets, length=0.4, actuators=ta.Bellows())
    designs = _designs(DesignSpace(free=("radii", "angles"), tied="mirror", in_range=False), arm, IN_SPACE)
    torch.testing.assert_close(designs.radii, -designs.radii.flip(-1))
    torch.testing.assert_close(designs.out_of_plane, designs.out_of_plane.flip(-1))
    assert float(designs.out_of_plane.std()) > 1e-3


def test_diameters_keep_actuators_apart_and_none_share_a_place() -> None:
    arm = ta.ArmDesign([-0.01, -0.01, 0.01, 0.01], 0.5, ta.Bellows(), diameter=[0.02, 0.01, 0.03, 0.02])
    gaps = _designs(DesignSpace(in_range=False), arm).radii.diff(dim=-1)
    assert bool((gaps >= torch.tensor([0.015, 0.02, 0.025]) - FEASIBLE).all())
    plain = _designs(DesignSpace(in_range=False), ta.mckibben_arm())
    assert float(plain.radii.diff(dim=-1).min()) >= LEAST_SPACING - FEASIBLE
    thick = ta.ArmDesign(offsets=RING.offsets, length=0.4, actuators=ta.Bellows(), diameter=0.05)
    designs = _designs(DesignSpace(free=("radii", "angles"), tied="none"), thick, IN_SPACE)
    place = torch.stack((designs.radii, designs.out_of_plane), -1)
    assert float(torch.cdist(place, place)[:, ~torch.eye(3, dtype=torch.bool)].min()) >= 0.05 - FEASIBLE
    named = feasible_designs(DesignSpace(), ta.mckibben_arm(), [TASK]).violated_by(ta.mckibben_arm())
    assert "spacing of actuators 1 and 2 by 5 mm" in named


def moulded(length: Any = 0.1, diameter: Any = None) -> ta.ArmDesign:
    """Three chambers, an elastic core, and a muscle of its own length that is put through the body."""
    models = [ta.chamber(8e-5)] * 3 + [ta.elastic_core(50.0, 4e-3), ta.McKibben()]
    offsets = [*ta.ring(0.01, 3).tolist(), [0.0, 0.0], [0.0, 0.004]]
    return ta.ArmDesign(offsets=offsets, length=length, actuators=models, diameter=diameter)


BODY = ta.Task([[0.1, 0.0, 0.0, 0.0, 0.2, -0.3]] * 4)


@pytest.mark.parametrize("tied", [None, "none", ((0, 1),)])
@pytest.mark.parametrize("free", ["length", ("radii", "length", "max_pressure")])
def test_one_moulded_body_has_one_length(free: Any, tied: Any) -> None:
    arm = moulded()
    designs = _designs(DesignSpace(free=free, tied=tied), arm, BODY)
    assert float(designs.length.std(0).min()) > 1e-4, "they spread"
    torch.testing.assert_close(designs.length[:, 1:4], designs.length[:, :1].expand(-1, 3))
    assert float((designs.length[:, 4] - designs.length[:, 0]).abs().max()) > 1e-4
    names = feasible_designs(DesignSpace(free="length", tied=tied), arm, [BODY]).free.names
    assert sorted(names) == ["length of actuator 5", "length of actuators 1, 2, 3, 4"]
    assert feasible_designs(DesignSpace(free="length", tied="equal"), arm, [BODY]).dimension == 1


def test_bodies_in_series_have_a_length_each() -> None:
    arm = ta.silicone_arm()
    task = ta.Task([[0.125, 0.0, 0.0, 0.0, 0.1, 0.1]] * 4, segment_nodes=(2, 2))
    names = feasible_designs(DesignSpace(free="length"), arm, [task]).free.names
    assert names == ("length of actuators 1, 2, 3, 4", "length of actuators 5, 6, 7, 8")
    apart = moulded(length=[0.1, 0.1, 0.11, 0.1, 0.1])
    assert "ties" in feasible_designs(DesignSpace(free="length", in_range=False), apart, [BODY]).violated_by(apart)


def test_what_is_never_under_pressure_takes_no_room_unless_it_has_a_diameter() -> None:
    space = DesignSpace(free=("radii", "angles"), tied="none", spacing=0.005, in_range=False)
    pairs = [name for name in feasible_designs(space, moulded(), [BODY]).names if "spacing" in name]
    assert len(pairs) == 6
    assert not any("4" in name for name in pairs)
    wide = feasible_designs(space, moulded(diameter=0.002), [BODY]).names
    assert any("spacing of actuators 4 and 5" in name for name in wide)
    planar = ta.ArmDesign([-0.02, 0.0, 0.001], 0.1, [ta.chamber(8e-5), ta.elastic_core(50.0, 4e-3), ta.McKibben()])
    straight = ta.Task([[0.1, 0.0, 0.0]] * 3)
    names = feasible_designs(DesignSpace(free="radii", in_range=False), planar, [straight]).names
    assert names == ("spacing of actuators 1 and 3",)


def test_what_is_not_free_stays() -> None:
    arm = ta.mckibben_arm()
    designs = _designs(DesignSpace(free="length"), arm)
    torch.testing.assert_close(designs.radii, arm.radii.expand(12, 4))
    torch.testing.assert_close(designs.max_pressure, arm.max_pressure.expand(12, 4))
    space = DesignSpace(bounds={"length": ((0.3, 0.4, 0.4, 0.3), (0.5, 0.4, 0.6, 0.5))}, in_range=False)
    feasible = feasible_designs(space, ta.antagonistic_arm(), [TASK])
    assert feasible.dimension == 7
    lengths = feasible.design(np.array(feasible.random(5, 0))).length
    torch.testing.assert_close(lengths[:, 1], torch.full((5,), 0.4).double())


def test_a_feasible_design_is_kept_and_another_is_brought_in() -> None:
    feasible = feasible_designs(DesignSpace(), ta.antagonistic_arm(), [TASK])
    inside = feasible.design(np.array(feasible.random(3, 0)))
    for point, back in zip(feasible.free.inverse(given_values(inside)), feasible.random(3, 0), strict=True):
        np.testing.assert_allclose(point, back, atol=1e-12)
        np.testing.assert_allclose(feasible.project(back), back, atol=1e-6)
    paper = ta.antagonistic_arm()
    assert not bool(ta.evaluate(paper, TASK, "absolute").in_range.all()), "the paper's arm strains too far"
    near = feasible.project(feasible.free.inverse(given_values(paper))[0])
    assert bool(ta.evaluate(feasible.design(near), TASK, "absolute").in_range.all())
    # No other feasible point is nearer.
    goal = feasible.free.inverse(given_values(paper))[0]
    for other in feasible.random(20, 1):
        for share in (1.0, 0.1, 0.01):
            assert np.linalg.norm(near + share * (other - near) - goal) >= np.linalg.norm(near - goal) - 1e-6


def test_segments_in_series_have_their_own_values() -> None:
    arm = ta.series([ta.bellows_arm(), ta.RigidLink(length=0.03), ta.antagonistic_arm(outer_radius=0.05)])
    twists = torch.cat((ta.affine_curvature(-1.0, 1.0, nodes=3), ta.affine_curvature(1.0, 0.5, nodes=2)))
    task = ta.Task(twists, (1.0, 0.0, 0.0), segment_nodes=(3, 2))
    feasible = feasible_designs(DesignSpace(tied="mirror"), arm, [task])
    assert feasible.dimension == 8
    designs = feasible.design(np.array(feasible.random(4, 0)))
    assert isinstance(designs, ta.ArmSeries)
    assert designs.links[0] is arm.links[0]
    assert bool(ta.evaluate(designs, task, "absolute").in_range.all())
    assert any("actuators 5, 8" in name for name in feasible.free.names)


@pytest.mark.parametrize(
    ("space", "words"),
    [
        ({"bounds": {"length": (0.1, 0.2)}}, "largest strain of actuator"),
        ({"bounds": {"radii": (0.05, 0.051)}, "spacing": 0.01, "in_range": False}, "spacing of actuators"),
        ({"free": "length"}, "strain of actuator"),
        ({"bounds": {"radii": (0.1, -0.1)}}, "radii must be finite, the lowest first"),
        ({"bounds": {"length": (0.0, 1.0)}}, "above 0 m"),
        ({"bounds": {"radii": (0.0, 0.0), "length": (0.5, 0.5)}}, "nothing free"),
        ({"free": "max_pressure", "bounds": {"max_pressure": (200.0, 300.0)}}, "characterised pressures"),
        ({"free": "angles"}, "the arm is planar"),
        ({"tied": ((0, 4),)}, "counted from 0"),
        ({"tied": "mirrored"}, "must be one of mirror, equal, ring, none"),
        ({"tied": "ring"}, "must not be 'ring' for a planar arm"),
    ],
)
def test_what_cannot_be_is_said(space: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        _nearest(DesignSpace(**space), ta.antagonistic_arm())


def test_limits_without_bounds_stay_within_those_given() -> None:
    """A designer's pump limit is a limit: to pass it, bounds must say so."""
    models = ta.antagonistic_arm().actuators
    arm = ta.ArmDesign([-0.05, -0.015, 0.015, 0.05], 0.5, models, [30.0, 0.0, 60.0, 45.0])
    free = feasible_designs(DesignSpace(free="max_pressure", in_range=False), arm, [TASK]).free
    assert free(np.ones(len(free.low)))[3].tolist() == [30.0, 0.0, 60.0, 45.0]
    assert free(np.zeros(len(free.low)))[3].tolist() == [0.0] * 4
    wider = DesignSpace(free="max_pressure", bounds={"max_pressure": (0.0, 50.0)}, in_range=False)
    assert feasible_designs(wider, arm, [TASK]).free.high.tolist() == [50.0] * 4


def _nearest(space: DesignSpace, arm: ta.ArmDesign) -> Any:
    feasible = feasible_designs(space, arm, [TASK])
    return feasible.project(feasible.free.inverse(given_values(arm))[0])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"free": ()}, "at least one"),
        ({"free": ("radius",)}, "must be one of radii"),
        ({"bounds": {"max_pressure": (0, 1)}}, "is not free"),
        ({"spacing": 0.0}, "above 0 m"),
    ],
)
def test_spaces_are_checked(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        DesignSpace(**options)


def test_given_designs_must_agree_in_what_is_fixed() -> None:
    arms = ta.antagonistic_arm(outer_radius=torch.tensor([0.05, 0.06]).double())
    with pytest.raises(ValueError, match="agree in radii"):
        feasible_designs(DesignSpace(free="length", in_range=False), arms, [TASK])


@given(st.integers(2, 3), st.lists(st.tuples(*[st.integers(-4, 4)] * 3), min_size=1, max_size=30))
@settings(max_examples=50, deadline=None)
def test_corners_bound_all_points(columns: int, points: list[tuple[int, int, int]]) -> None:
    cloud = np.array(points, dtype=np.float64)[:, :columns]
    corners = convex_corners(cloud)
    for normal in np.random.default_rng(0).normal(size=(50, columns)):
        assert (cloud @ normal).max() <= (corners @ normal).max() + 1e-9
    assert {tuple(corner) for corner in corners} <= {tuple(point) for point in cloud}


@pytest.mark.parametrize(
    ("space", "named", "other"),
    [
        (DesignSpace(spacing=0.08, bounds={"radii": (-0.06, 0.06)}), "spacing of actuators 1 and 2", "strain"),
        (DesignSpace(bounds={"length": (0.1, 0.2)}), "largest strain of actuator", "spacing"),
    ],
)
def test_what_cannot_be_kept_is_named_and_no_more(space: DesignSpace, named: str, other: str) -> None:
    arm = ta.ArmDesign([-0.05, 0.0, 0.05], 0.5, "bellows")
    straight = ta.Task(ta.affine_curvature(0.0, 0.0, length=0.5, nodes=2))
    feasible = feasible_designs(space, arm, [straight])
    with pytest.raises(ValueError, match=f"among them {named}") as caught:
        feasible.project(feasible.free.inverse(given_values(arm))[0])
    assert f"{other} of" not in str(caught.value)
    assert ("optimise.spacing" in str(caught.value)) == ("spacing" in named)
    assert ("in_range = false" in str(caught.value)) == ("strain" in named)
