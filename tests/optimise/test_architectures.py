"""Every choice of force models, each with its best design."""

import random
from typing import Any

import pytest
import torch

import torcharm as ta
from torcharm.optimise import DesignSpace, optimise_architectures, optimise_design

SHAPES = ta.affine_curvature([-3.0, 1.0], [3.0, 1.5], nodes=3)
TASK = ta.Task(SHAPES, (5.0, -4.0, 1.0))
ARM = ta.antagonistic_arm(outer_radius=0.03)


def test_all_types_at_all_positions_best_first() -> None:
    found = optimise_architectures(ARM, TASK, starts=1, iterations=6)
    assert not found.mirrored
    assert sorted(found.names) == sorted({f"{a}{b}{c}{d}" for a in "BM" for b in "BM" for c in "BM" for d in "BM"})
    values = [design.value for design in found.designs]
    assert values == sorted(values)
    assert all(design.in_range for design in found.designs)
    chosen = found.designs[found.names.index("BMMB")]
    assert [type(model).__name__[0] for model in chosen.best.actuators] == list("BMMB")
    alone = optimise_design(ARM, TASK, starts=1, iterations=6)
    assert chosen.value == pytest.approx(alone.value, rel=1e-6)


def test_mirror_images_are_merged_where_tasks_are_their_own_mirror_image() -> None:
    shapes = ta.affine_curvature([-3.0, 3.0], [3.0, -3.0], nodes=3)
    loads = torch.tensor([[3.0, 1.0, 0.1], [-3.0, 1.0, -0.1]]).double()
    found = optimise_architectures(ARM, ta.Task(shapes, loads), starts=1, iterations=2)
    assert found.mirrored
    assert len(found.names) == 10
    assert not any(name != name[::-1] and name[::-1] in found.names for name in found.names)
    lopsided = ta.Task(shapes, torch.tensor([3.0, 1.0, 0.1]).double())
    assert not optimise_architectures(ARM, lopsided, starts=1, iterations=1).mirrored


def test_mirrored_arms_are_worth_the_same_on_mirrored_tasks() -> None:
    """What merging rests on."""
    shapes = ta.affine_curvature([-3.0, 3.0], [3.0, -3.0], nodes=3)
    loads = torch.tensor([[3.0, 1.0, 0.1], [-3.0, 1.0, -0.1]]).double()
    task = ta.Task(shapes, loads)
    arm = ta.ArmDesign([-0.03, -0.01, 0.02, 0.04], [0.5, 0.45, 0.47, 0.5], [ta.Bellows(), *[ta.McKibben()] * 3])
    other = ta.ArmDesign(-arm.radii.flip(-1), arm.length.flip(-1), arm.actuators[::-1])
    a, b = (ta.evaluate(one, task, "absolute").absolute for one in (arm, other))
    assert a is not None
    assert b is not None
    torch.testing.assert_close(a, b.flip(0))


MIRRORED_SHAPES = ta.affine_curvature([-1.5, 1.5], [1.0, -1.0], nodes=3)
MIRRORED = ta.Task(MIRRORED_SHAPES, torch.tensor([[3.0, 1.0, 0.1], [-3.0, 1.0, -0.1]]).double())
LENGTHS = DesignSpace(free="length")


def _tau(curvature: torch.Tensor, pressure: torch.Tensor) -> torch.Tensor:
    return -0.1 * (curvature - 1.0) + 0.0 * pressure


@pytest.mark.parametrize(
    ("radii", "lengths", "space", "models", "merged"),
    [
        ((-0.03, 0.03), 0.5, DesignSpace(), None, True),
        ((-0.03, 0.0, 0.03), (0.5, 0.45, 0.5), DesignSpace(tied=((0, 2),)), None, True),
        ((-0.03, 0.03), 0.5, DesignSpace(bounds={"radii": ((-0.08, 0.0), (0.0, 0.08))}), None, True),
        ((-0.03, 0.03), 0.5, DesignSpace(tied="mirror"), None, True),
        ((-0.088, -0.024), 0.5, LENGTHS, None, False),
        ((-0.03, 0.031), 0.5, DesignSpace(), None, False),
        ((-0.03, 0.03), (0.5, 0.51), DesignSpace(), None, False),
        ((-0.03, 0.03), 0.5, DesignSpace(bounds={"radii": ((-0.08, 0.0), (0.0, 0.07))}), None, False),
        ((-0.03, 0.03), 0.5, DesignSpace(bounds={"length": ((0.4, 0.45), (0.6, 0.6))}), None, False),
        ((-0.03, 0.0, 0.03), 0.5, DesignSpace(tied=((0, 1),), ordered=False), None, False),
        ((-0.03, 0.03), 0.5, DesignSpace(), (ta.Bellows(bending_stiffness=ta.BendingFunction(_tau, 30.0)),), False),
    ],
)
def test_only_what_is_its_own_mirror_image_in_all_is_merged(
    radii: Any, lengths: Any, space: DesignSpace, models: Any, merged: bool
) -> None:
    arm = ta.ArmDesign(radii, torch.tensor(lengths).double().expand(len(radii)), [ta.Bellows()] * len(radii))
    kinds = models or (ta.Bellows(), ta.McKibben())
    found = optimise_architectures(arm, MIRRORED, space, models=kinds, starts=1, iterations=1)
    assert found.mirrored is merged
    tried = set(found.names) | set(found.infeasible)
    count = len(kinds) ** len(radii)
    assert len(tried) == ((count + len(kinds) ** ((len(radii) + 1) // 2)) // 2 if merged else count)


def test_no_best_is_lost_to_a_mirror_image() -> None:
    """Random arms and spaces, mirrored or not, on tasks that are always mirrored."""
    draw, merged = random.Random(7), 0
    for _ in range(8):
        outer, other, length = draw.uniform(0.02, 0.09), draw.uniform(-0.09, 0.015), draw.uniform(0.42, 0.55)
        radii = (-outer, outer) if draw.random() < 0.4 else (-outer, other)
        lengths = (length, length if draw.random() < 0.7 else 0.9 * length)
        arm = ta.ArmDesign(sorted(radii), torch.tensor(lengths).double(), [ta.Bellows(), ta.McKibben()])
        slope, intercept, force = draw.uniform(-1.5, 1.5), draw.uniform(-1.5, 1.5), draw.uniform(-6.0, 6.0)
        task = ta.Task(
            ta.affine_curvature([slope, -slope], [intercept, -intercept], nodes=4),
            torch.tensor([[force, -1.0, 0.5], [-force, -1.0, -0.5]]).double(),
        )
        space = DesignSpace(free=draw.choice(("length", ("radii", "length"))), in_range=False)
        found = optimise_architectures(arm, task, space, starts=1, iterations=3)
        swapped = ta.ArmDesign(arm.radii, arm.length, [ta.McKibben(), ta.Bellows()])
        values = [optimise_design(one, task, space, starts=1, iterations=3).value for one in (arm, swapped)]
        best_mixed = min(one.value for name, one in zip(found.names, found.designs, strict=True) if len({*name}) == 2)
        assert best_mixed == pytest.approx(min(values), rel=1e-6, abs=1e-9)
        merged += found.mirrored
    assert 0 < merged < 8


def test_infeasible_architectures_are_named() -> None:
    space = DesignSpace(bounds={"radii": (-0.06, 0.06), "length": (0.4, 0.5)}, spacing=0.025)
    found = optimise_architectures(ARM, TASK, space, starts=1, iterations=1)
    assert "BBBB" in found.names
    assert "MMMM" in found.infeasible
    with pytest.raises(ValueError, match="no architecture"):
        optimise_architectures(ARM, TASK, DesignSpace(bounds={"length": (0.01, 0.02)}))


def test_too_many_are_refused() -> None:
    arm = ta.ArmDesign([0.001 * index for index in range(13)], 0.5, [ta.Bellows()] * 13)
    with pytest.raises(ValueError, match="8192 architectures"):
        optimise_architectures(arm, TASK)
