"""Every choice of force models, each with its best design."""

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
