"""Every choice of force models, each with its best design."""

import math
from typing import Any

import pytest
import torch

import torcharm as ta
from torcharm.design import DesignSpace, Objective, optimise_architectures, optimise_design
from torcharm.design.symmetry import symmetries

NEWTONS = Objective("unattainability")
SHAPES = ta.affine_curvature([-3.0, 1.0], [3.0, 1.5], nodes=3)
TASK = ta.Task(SHAPES, (5.0, -4.0, 1.0))
ARM = ta.antagonistic_arm(outer_radius=0.03)


def _tau(curvature: torch.Tensor, pressure: torch.Tensor) -> torch.Tensor:
    return -0.1 * (curvature - 1.0) + 0.0 * pressure


MIRRORED_LOADS = torch.tensor([[3.0, 1.0, 0.1], [-3.0, 1.0, -0.1]]).double()
MIRRORED = ta.Task(ta.affine_curvature([-1.5, 1.5], [1.0, -1.0], nodes=3), MIRRORED_LOADS)
LENGTHS = DesignSpace(free="length")


def test_all_types_at_all_positions_best_first() -> None:
    found = optimise_architectures(ARM, TASK, objective=NEWTONS, starts=1, iterations=6)
    assert not found.merged
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


@pytest.mark.parametrize(
    ("radii", "lengths", "space", "models", "merged"),
    [
        ((-0.03, 0.03), 0.5, DesignSpace(), None, True),
        ((-0.03, 0.0, 0.03), (0.5, 0.45, 0.5), DesignSpace(), None, True),
        ((-0.03, 0.03), 0.5, DesignSpace(bounds={"radii": ((-0.08, 0.0), (0.0, 0.08))}), None, True),
        ((-0.03, 0.03), 0.5, DesignSpace(tied="mirror"), None, True),
        ((-0.088, -0.024), 0.5, LENGTHS, None, False),
        ((-0.03, 0.031), 0.5, DesignSpace(), None, False),
        ((-0.03, 0.03), (0.5, 0.51), DesignSpace(), None, False),
        ((-0.03, 0.03), 0.5, DesignSpace(bounds={"radii": ((-0.08, 0.0), (0.0, 0.07))}), None, False),
        ((-0.03, 0.03), 0.5, DesignSpace(bounds={"length": ((0.4, 0.45), (0.6, 0.6))}), None, False),
        ((-0.03, 0.0, 0.03), 0.5, DesignSpace(tied=((0, 1),)), None, False),
        ((-0.03, 0.03), 0.5, DesignSpace(), (ta.Bellows(bending_stiffness=ta.BendingFunction(_tau, 30.0)),), False),
    ],
)
def test_only_what_is_its_own_mirror_image_in_all_is_merged(
    radii: Any, lengths: Any, space: DesignSpace, models: Any, merged: bool
) -> None:
    arm = ta.ArmDesign(radii, torch.tensor(lengths).double().expand(len(radii)), [ta.Bellows()] * len(radii))
    kinds = models or (ta.Bellows(), ta.McKibben())
    found = optimise_architectures(arm, MIRRORED, space, NEWTONS, models=kinds, starts=1, iterations=1)
    assert found.merged is merged
    tried = set(found.names) | set(found.infeasible)
    count = len(kinds) ** len(radii)
    assert len(tried) == ((count + len(kinds) ** ((len(radii) + 1) // 2)) // 2 if merged else count)


def test_tasks_that_are_not_their_own_mirror_image_merge_nothing() -> None:
    arm = ta.ArmDesign([-0.03, 0.03], 0.5, ta.Bellows())
    for task in (
        ta.Task(MIRRORED.twists, MIRRORED_LOADS[0]),
        ta.Task(MIRRORED.twists, MIRRORED_LOADS, base_pose=(0.0, 0.0, -1.5)),
        ta.Task(MIRRORED.twists, MIRRORED_LOADS, load=ta.ExternalLoad(points=[ta.PointLoad([1.0, 0.0, 0.0], at=0.5)])),
    ):
        assert not optimise_architectures(arm, task, objective=NEWTONS, starts=1, iterations=1).merged


def test_mirrored_arms_are_worth_the_same_on_mirrored_tasks() -> None:
    """What merging rests on."""
    arm = ta.ArmDesign([-0.03, -0.01, 0.02, 0.04], [0.5, 0.45, 0.47, 0.5], [ta.Bellows(), *[ta.McKibben()] * 3])
    other = ta.ArmDesign(-arm.radii.flip(-1), arm.length.flip(-1), arm.actuators[::-1])
    a, b = (ta.evaluate(one, MIRRORED, "absolute").absolute for one in (arm, other))
    assert a is not None
    assert b is not None
    torch.testing.assert_close(a, b.flip(0))


RING = ta.ArmDesign(offsets=ta.ring(radius=0.05, count=3), length=0.4, actuators=ta.Bellows(), mass=0.2)


def bent_towards(*directions: float, force: float = 0.0, **options: Any) -> ta.Task:
    """Shapes that bend in some directions, under forces across the hanging arm in the same."""
    angle = torch.tensor(directions, dtype=torch.float64)
    way = torch.stack((angle.cos(), 0 * angle, angle.sin()), -1) * force  # body y is world x, body z world z
    return ta.Task(
        ta.constant_curvature(0.5, 0.4, 3, angle), load=ta.ExternalLoad(torch.cat((way, 0 * way), -1), **options)
    )


THIRDS = (0.0, 2 * math.pi / 3, 4 * math.pi / 3)


@pytest.mark.parametrize(
    ("task", "space", "count"),
    [
        (bent_towards(*THIRDS, force=2.0), LENGTHS, 6),
        (bent_towards(*THIRDS, force=2.0, gravity=True), LENGTHS, 6),
        (bent_towards(*THIRDS[:2], force=2.0), LENGTHS, 2),
        (bent_towards(0.0, gravity=True), LENGTHS, 2),  # its own mirror image alone
        (bent_towards(0.0, points=[ta.PointLoad([1.0, -1.0, 0.0, 0.0, 0.0, 0.2])]), LENGTHS, 2),
        (bent_towards(0.0, points=[ta.PointLoad([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])]), LENGTHS, 1),
        (bent_towards(*THIRDS, points=[ta.PointLoad([0.0, 0.0, 0.0, 0.0, 0.1, 0.0])]), LENGTHS, 3),
        (bent_towards(*THIRDS, points=[ta.PointLoad([1.0, 0.0, 0.0, 0.0, 0.0, 0.0], frame="body")]), LENGTHS, 6),
        (bent_towards(*THIRDS, points=[ta.PointLoad([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], frame="body")]), LENGTHS, 1),
        (bent_towards(0.4, gravity=True), LENGTHS, 1),
        (bent_towards(0.4, gravity=True), DesignSpace(free="angles"), 3),
        (bent_towards(0.4, gravity=True), DesignSpace(free="angles", tied="mirror"), 1),
        (bent_towards(*THIRDS, force=2.0), DesignSpace(free="angles", bounds={"angles": (-3.0, 6.0)}), 1),
        (ta.Task(ta.constant_curvature(0.5, 0.4, 3, 0.0), [0.0] * 6), LENGTHS, 2),  # of no batch
        (bent_towards(*THIRDS, force=2.0), DesignSpace(free="length", bounds={"length": (0.3, (0.5, 0.5, 0.6))}), 2),
    ],
)
def test_a_ring_has_as_many_images_as_its_tasks_allow(task: ta.Task, space: DesignSpace, count: int) -> None:
    found = symmetries(RING, (ta.Bellows(), ta.McKibben()), (task,), space)
    assert len(found) == len(set(found)) == count
    assert found[0] == (0, 1, 2)


class Magnet(ta.ExternalLoad):
    """A load with a part of its own, of which nobody knows the image."""

    def tensors(self) -> dict[str, torch.Tensor]:
        return super().tensors() | {"field": torch.ones(3, dtype=torch.float64)}


def test_under_a_load_of_an_unknown_kind_no_arrangement_is_anothers_image() -> None:
    task = bent_towards(*THIRDS, force=2.0)
    assert len(symmetries(RING, (ta.Bellows(),), (task,), LENGTHS)) == 6
    unknown = ta.Task(task.twists, load=Magnet(task.tip_load))
    assert symmetries(RING, (ta.Bellows(),), (unknown,), LENGTHS) == [(0, 1, 2)]


def test_of_arrangements_that_are_images_of_each_other_one_is_tried() -> None:
    task = bent_towards(*THIRDS, force=2.0)
    found = optimise_architectures(RING, task, LENGTHS, NEWTONS, starts=1, iterations=1)
    assert sorted({*found.names, *found.infeasible}) == ["BBB", "BBM", "BMM", "MMM"]
    assert found.merged
    assert float(found.designs[0].best.mass) == 0.2  # type: ignore[union-attr]


@pytest.mark.parametrize("order", symmetries(RING, (ta.Bellows(),), (bent_towards(*THIRDS, force=2.0),), LENGTHS))
def test_images_are_worth_the_same(order: tuple[int, ...]) -> None:
    """What merging rests on."""
    models = [ta.Bellows(), ta.McKibben(), ta.McKibben(force_scale=2.0)]
    points = [ta.PointLoad([0.5, 0, 0, 0, 0, 0], at=0.6, frame="body"), ta.PointLoad([0, -1, 0, 0, 0, 0], mass=0.1)]
    task = bent_towards(*THIRDS, force=2.0, gravity=True, points=points)
    arms = [
        ta.ArmDesign(offsets=RING.offsets, length=0.4, actuators=own, mass=0.2)
        for own in (models, [models[i] for i in order])
    ]
    errors = [ta.predict_error(arm, task).shape_error for arm in arms]
    newtons = [ta.evaluate(arm, task, "absolute").absolute for arm in arms]
    for one, other in (errors, newtons):
        torch.testing.assert_close(one.sort().values, other.sort().values, rtol=1e-5, atol=1e-7)  # type: ignore[union-attr]


def test_a_horizontal_ring_in_gravity_may_be_mirrored_and_not_turned() -> None:
    task = bent_towards(*THIRDS, gravity=True)
    horizontal = ta.Task(task.twists, base_pose="horizontal", load=task.load)
    assert len(symmetries(RING, (ta.Bellows(),), (task,), LENGTHS)) == 6
    assert symmetries(RING, (ta.Bellows(),), (horizontal,), LENGTHS) == [(0, 1, 2), (0, 2, 1)]  # left and right swapped


def test_segments_in_series_have_all_arrangements() -> None:
    lower = ta.ArmDesign(offsets=ta.ring(0.05, 2), length=0.3, actuators=ta.Bellows(), mass=0.2)
    upper = ta.ArmDesign(offsets=[[0.0, 0.0]], length=0.2, actuators=ta.Bellows())
    arm = ta.series([lower, ta.RigidLink(length=0.02, mass=0.05), upper])
    task = ta.Task([[0.3, 0.0, 0.0, 0.0, 0.1, 0.0]] * 2 + [[0.2] + [0.0] * 5], [0.0] * 6, segment_nodes=(2, 1))
    found = optimise_architectures(arm, task, LENGTHS, NEWTONS, starts=1, iterations=1)
    assert sorted({*found.names, *found.infeasible}) == sorted(f"{a}{b}{c}" for a in "BM" for b in "BM" for c in "BM")
    assert not found.merged
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
