"""Every choice of force models, each with its best design."""

import pytest
import torch

import torcharm as ta
from torcharm.design import DesignSpace, Objective, optimise_architectures, optimise_design

NEWTONS = Objective("unattainability")
SHAPES = ta.affine_curvature([-3.0, 1.0], [3.0, 1.5], nodes=3)
TASK = ta.Task(SHAPES, (5.0, -4.0, 1.0))
ARM = ta.antagonistic_arm(outer_radius=0.03)


MIRRORED_LOADS = torch.tensor([[3.0, 1.0, 0.1], [-3.0, 1.0, -0.1]]).double()
LENGTHS = DesignSpace(free="length")


def test_all_types_at_all_positions_best_first() -> None:
    found = optimise_architectures(ARM, TASK, objective=NEWTONS, starts=1, iterations=6)
    assert sorted(found.names) == sorted({f"{a}{b}{c}{d}" for a in "BM" for b in "BM" for c in "BM" for d in "BM"})
    values = [design.value for design in found.designs]
    assert values == sorted(values)
    chosen = found.designs[found.names.index("BMMB")]
    assert [type(model).__name__[0] for model in chosen.best.actuators] == list("BMMB")
    alone = optimise_design(ARM, TASK, objective=NEWTONS, starts=1, iterations=6)
    assert chosen.value == pytest.approx(alone.value, rel=1e-6)
    assert repr(found).startswith(f"Architectures({found.names[0]} ")


def test_models_go_by_name() -> None:
    arm = ta.ArmDesign([-0.03, 0.03], 0.5, "bellows")
    options = {"objective": NEWTONS, "starts": 1, "iterations": 3}
    named = optimise_architectures(arm, TASK, models=["mckibben", ta.Bellows()], **options)
    made = optimise_architectures(arm, TASK, models=[ta.McKibben(), ta.Bellows()], **options)
    assert named.names == made.names
    assert [one.value for one in named.designs] == [one.value for one in made.designs]
    assert {type(model) for model in named.designs[0].best.actuators} <= {ta.Bellows, ta.McKibben}


def test_the_default_objective_is_the_shape() -> None:
    """Muscle and bellows, of two architectures that are nearly each other's mirror image, is the better."""
    arm = ta.ArmDesign([-0.088, -0.024], 0.5, ta.Bellows())
    task = ta.Task(ta.affine_curvature([-0.561, 0.561], [1.64, -1.64], 0.483, 5), MIRRORED_LOADS)
    space = DesignSpace(free="length", in_range=False)
    found = optimise_architectures(arm, task, space, starts=1, iterations=15)
    assert sorted(found.names) == ["BB", "BM", "MB", "MM"]
    other = ta.ArmDesign([-0.088, -0.024], 0.5, [ta.McKibben(), ta.Bellows()])
    alone = optimise_design(other, task, space, starts=1, iterations=15)
    assert found.designs[found.names.index("MB")].value == pytest.approx(alone.value, rel=1e-6)


def test_segments_in_series_have_all_arrangements() -> None:
    lower = ta.ArmDesign(offsets=ta.ring(0.05, 2), length=0.3, actuators=ta.Bellows(), mass=0.2)
    upper = ta.ArmDesign(offsets=[[0.0, 0.0]], length=0.2, actuators=ta.Bellows())
    arm = ta.series([lower, ta.RigidLink(length=0.02, mass=0.05), upper])
    task = ta.Task([[0.3, 0.0, 0.0, 0.0, 0.1, 0.0]] * 2 + [[0.2] + [0.0] * 5], [0.0] * 6, segment_nodes=(2, 1))
    found = optimise_architectures(arm, task, LENGTHS, NEWTONS, starts=1, iterations=1)
    assert sorted({*found.names, *found.infeasible}) == sorted(f"{a}{b}{c}" for a in "BM" for b in "BM" for c in "BM")
    best = found.designs[0].best
    assert isinstance(best, ta.ArmSeries)
    assert "".join(type(model).__name__[0] for model in best.actuators) == found.names[0]
    assert best.links == arm.links


def test_infeasible_architectures_are_named() -> None:
    space = DesignSpace(bounds={"radii": (-0.06, 0.06), "length": (0.4, 0.5)}, spacing=0.025)
    found = optimise_architectures(ARM, TASK, space, NEWTONS, starts=1, iterations=1)
    assert "BBBB" in found.names
    assert "MMMM" in found.infeasible
    pair = ta.ArmDesign([-0.03, 0.03], 0.5, ["bellows", "mckibben"])
    with pytest.raises(ValueError, match="no architecture"):
        optimise_architectures(pair, TASK, DesignSpace(bounds={"length": (0.01, 0.02)}))


def test_what_cannot_be_tried_is_refused() -> None:
    arm = ta.ArmDesign([0.001 * index for index in range(13)], 0.5, [ta.Bellows()] * 13)
    with pytest.raises(ValueError, match="8192 architectures"):
        optimise_architectures(arm, TASK)
