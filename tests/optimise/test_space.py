"""Feasible designs: ties, bounds, spacing and strains."""

import dataclasses
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import torcharm as ta
from torcharm.optimise.feasible import feasible_designs
from torcharm.optimise.space import DesignSpace, convex_corners

SHAPES = ta.affine_curvature([-3.0, 1.0, 6.0], [3.0, 1.5, -1.5])
TASK = ta.Task(SHAPES, (3.0, -2.0, 0.5))


def _designs(space: DesignSpace, arm: ta.ArmDesign | None = None, count: int = 200) -> ta.ArmDesign:
    polytope = feasible_designs(space, arm or ta.antagonistic_arm(), [TASK])
    points = polytope.sample(count, seed=0)
    assert float(polytope.violation(points).max()) < 1e-12
    return polytope.design(points)


@pytest.mark.parametrize("arm", [ta.antagonistic_arm(), ta.bellows_arm(), ta.mckibben_arm()])
@pytest.mark.parametrize("tied", [None, "mirror", {"length": "equal"}, ((0, 3), (1, 2))])
def test_sampled_designs_keep_strains_order_and_bounds(arm: ta.ArmDesign, tied: Any) -> None:
    space = DesignSpace(tied=tied, spacing=0.004, bounds={"radii": (-0.07, 0.07), "length": (0.3, 0.7)})
    designs = _designs(space, arm)
    found = ta.evaluate(designs, TASK, "absolute")
    assert bool(found.in_range.all())
    assert float(designs.radii.diff(dim=-1).min()) >= 0.004 - 1e-12
    assert float(designs.radii.abs().max()) <= 0.07 + 1e-12
    assert float(designs.length.min()) >= 0.3 - 1e-12
    assert float(designs.length.max()) <= 0.7 + 1e-12
    assert float(designs.radii.std(0).min()) > 1e-3, "the sample spreads"


def test_the_boundary_of_the_polytope_is_the_end_of_the_range() -> None:
    """Just outside any strain constraint, evaluate says that a strain is out of range."""
    polytope = feasible_designs(DesignSpace(), ta.antagonistic_arm(), [TASK])
    strained = [index for index, name in enumerate(polytope.names) if name.startswith("strain")]
    for index in strained:
        row = polytope.rows[index]
        point = polytope.centre + row * (polytope.bound[index] - polytope.centre @ row) * (1 + 1e-4)
        assert not bool(ta.evaluate(polytope.design(point), TASK, "absolute").in_range.all())


def test_mirror_ties_make_symmetric_arms() -> None:
    designs = _designs(DesignSpace(free=("radii", "length", "max_pressure"), tied="mirror"))
    torch.testing.assert_close(designs.radii, -designs.radii.flip(-1))
    torch.testing.assert_close(designs.length, designs.length.flip(-1))
    torch.testing.assert_close(designs.max_pressure, designs.max_pressure.flip(-1))


def test_groups_keep_the_signs_of_the_given_arm() -> None:
    designs = _designs(DesignSpace(tied=((0, 3),), ordered=False, in_range=False))
    torch.testing.assert_close(designs.radii[:, 0], -designs.radii[:, 3])
    assert float((designs.radii[:, 1] + designs.radii[:, 2]).abs().max()) > 1e-3


def test_what_is_not_free_stays() -> None:
    arm = ta.mckibben_arm()
    designs = _designs(DesignSpace(free="length"), arm)
    torch.testing.assert_close(designs.radii, arm.radii.expand(200, 4))
    torch.testing.assert_close(designs.max_pressure, arm.max_pressure.expand(200, 4))


def test_bounds_that_meet_fix_a_value() -> None:
    polytope = feasible_designs(
        DesignSpace(bounds={"length": ((0.3, 0.4, 0.4, 0.3), (0.5, 0.4, 0.6, 0.5))}, in_range=False),
        ta.antagonistic_arm(),
        [TASK],
    )
    assert polytope.dimension == 7
    torch.testing.assert_close(polytope.design(polytope.sample(20, 0)).length[:, 1], torch.full((20,), 0.4).double())


def test_a_feasible_design_is_kept_and_another_is_brought_in() -> None:
    polytope = feasible_designs(DesignSpace(), ta.antagonistic_arm(), [TASK])
    inside = polytope.design(polytope.sample(3, 0))
    kept = polytope.design(polytope.nearest(inside))
    torch.testing.assert_close(kept.radii, inside.radii, atol=1e-15, rtol=0)
    paper = ta.evaluate(ta.antagonistic_arm(), TASK, "absolute")
    assert not bool(paper.in_range.all()), "the paper's arm strains too far"
    assert bool(ta.evaluate(polytope.design(polytope.nearest(ta.antagonistic_arm())), TASK, "absolute").in_range.all())


@pytest.mark.parametrize(
    ("space", "words"),
    [
        ({"bounds": {"length": (0.1, 0.2)}}, "characterised range"),
        ({"bounds": {"radii": (0.05, 0.051)}, "spacing": 0.01}, "far apart"),
        ({"free": "length"}, "Bellows"),
        ({"bounds": {"radii": (-0.1, 0.1), "length": (0.5, 0.5)}, "spacing": 0.06}, "with that spacing"),
        ({"bounds": {"radii": (0.1, -0.1)}}, "radii must be finite, the lowest first"),
        ({"bounds": {"length": (0.0, 1.0)}}, "above 0 m"),
        ({"bounds": {"radii": (0.0, 0.0), "length": (0.5, 0.5)}}, "nothing free"),
        ({"free": "max_pressure", "bounds": {"max_pressure": (200.0, 300.0)}}, "characterised pressures"),
        ({"tied": ((0, 4),)}, "counted from 0"),
        ({"tied": "mirrored"}, "must be one of mirror, equal"),
    ],
)
def test_what_cannot_be_is_said(space: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        feasible_designs(DesignSpace(**space), ta.antagonistic_arm(), [TASK])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"free": ()}, "at least one"),
        ({"free": ("radius",)}, "must be one of radii"),
        ({"bounds": {"max_pressure": (0, 1)}}, "is not free"),
        ({"spacing": -1.0}, "at least 0 m"),
        ({"spacing": 0.01, "ordered": False}, "ordered"),
    ],
)
def test_spaces_are_checked(options: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        DesignSpace(**options)


def test_given_designs_must_agree_in_what_is_fixed() -> None:
    arms = ta.antagonistic_arm(outer_radius=torch.tensor([0.05, 0.06]).double())
    with pytest.raises(ValueError, match="agree in radii"):
        feasible_designs(DesignSpace(free="length", in_range=False), arms, [TASK])


@given(st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=1, max_size=30))
@settings(max_examples=50, deadline=None)
def test_corners_bound_all_points(points: list[tuple[int, int]]) -> None:
    cloud = torch.tensor(points, dtype=torch.float64).numpy()
    corners = convex_corners(cloud)
    turns = torch.linspace(0, 6.28, 50, dtype=torch.float64).numpy()
    for turn in turns:
        normal = torch.tensor([turn]).cos().item(), torch.tensor([turn]).sin().item()
        assert (cloud @ normal).max() <= (corners @ normal).max() + 1e-12
    assert {tuple(corner) for corner in corners} <= {tuple(point) for point in cloud}


def test_a_wider_model_widens_the_polytope() -> None:
    wide = dataclasses.replace(ta.Bellows(), strain_range=(-0.9, 5.0))
    arm = ta.ArmDesign(ta.bellows_arm().radii, 0.5, [wide] * 4)
    narrow = feasible_designs(DesignSpace(), ta.bellows_arm(), [TASK])
    assert feasible_designs(DesignSpace(), arm, [TASK]).radius > narrow.radius
