"""What distances must not depend on, or in a known way: order, mirrors, frames, units, batches; plane and space."""

import math

import pytest
import torch
from oracle import spatial as scenes

import torcharm as ta

NODES, DESIGNS, TASKS = 5, 6, 4
METRICS = ("absolute_per_node", "relative_per_node")


def draw(*shape, seed):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def scene(dimension):
    """A batch of designs with muscles and bellows, and a batch of tasks under weight, tip and point loads."""
    offsets = 0.05 * draw(DESIGNS, 4, 2, seed=1)
    kinds = (ta.Bellows(), ta.McKibben(), ta.Bellows(), ta.McKibben(force_scale=1.5))
    across = {"radii": offsets[..., 0]} if dimension == 2 else {"offsets": offsets}
    arm = ta.ArmDesign(**across, length=0.4 + 0.01 * draw(DESIGNS, 4, seed=2), actuators=kinds, mass=0.3)
    twists = torch.zeros(TASKS, NODES, 3 if dimension == 2 else 6, dtype=torch.float64)
    twists[..., 0] = 0.4
    bends = slice(2, 3) if dimension == 2 else slice(4, 6)
    twists[..., bends] = 0.5 * draw(TASKS, NODES, 2, seed=3)[..., : bends.stop - bends.start]
    tip = 5 * draw(TASKS, twists.shape[-1], seed=4)
    tip[:, -1] *= 0.1
    return arm, twists, tip, 2 * draw(twists.shape[-1], seed=5)


def evaluate(arm, twists, tip, point, **options):
    load = ta.ExternalLoad(tip, gravity=True, points=[ta.PointLoad(point, at=0.7)])
    found = ta.evaluate(
        arm, ta.Task(twists, load=load, base_pose=options.pop("base_pose", None)), ("absolute", "relative"), **options
    )
    assert found.converged.all()
    return found


def cross(arm):
    return arm[:, None]


def same(found, wanted, near=1e-9):
    for name in METRICS:
        own, other = getattr(found, name), getattr(wanted, name)
        assert (other > 0).any()
        assert own.numpy() == pytest.approx(other.numpy(), abs=near)


@pytest.mark.parametrize("dimension", [2, 3])
def test_batches_are_loops(dimension):
    arm, twists, tip, point = scene(dimension)
    whole = evaluate(arm, twists, tip, point)
    for design in range(DESIGNS):
        for task in range(TASKS):
            one = evaluate(arm[design], twists[task], tip[task], point)
            for name in (*METRICS, "absolute", "relative"):
                assert getattr(whole, name)[design, task].numpy() == pytest.approx(
                    getattr(one, name).numpy(), abs=1e-10
                )


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("chunk_size", [1, 5])
def test_chunks_are_of_no_matter(dimension, chunk_size):
    arm, twists, tip, point = scene(dimension)
    same(evaluate(arm, twists, tip, point, chunk_size=chunk_size), evaluate(arm, twists, tip, point), 1e-10)


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_order_of_actuators_is_of_no_matter(dimension):
    arm, twists, tip, point = scene(dimension)
    order = [2, 3, 0, 1]
    across = {"radii": arm.radii[:, order]} if dimension == 2 else {"offsets": arm.offsets[:, order]}
    moved = ta.ArmDesign(**across, length=arm.length[:, order], actuators=[arm.actuators[a] for a in order], mass=0.3)
    same(evaluate(moved, twists, tip, point), evaluate(arm, twists, tip, point))


@pytest.mark.parametrize("dimension", [2, 3])
def test_mirrored_arms_hold_mirrored_shapes_under_mirrored_loads(dimension):
    """In the plane by the vertical through the base, as in space: body y, turns about x and z change their sign."""
    arm, twists, tip, point = scene(dimension)
    offsets = arm.offsets * arm.radii.new_tensor((-1.0, 1.0))
    across = {"radii": offsets[..., 0]} if dimension == 2 else {"offsets": offsets}
    mirrored = ta.ArmDesign(**across, length=arm.length, actuators=arm.actuators, mass=0.3)
    shape = (1.0, -1.0, -1.0) if dimension == 2 else (1.0, -1.0, 1.0, -1.0, 1.0, -1.0)
    load = (-1.0, 1.0, -1.0) if dimension == 2 else (-1.0, 1.0, 1.0, 1.0, -1.0, -1.0)
    flip = tip.new_tensor(load)
    same(
        evaluate(mirrored, twists * twists.new_tensor(shape), tip * flip, point * flip),
        evaluate(arm, twists, tip, point),
    )


def test_in_space_it_is_of_no_matter_how_the_cross_section_is_turned():
    arm, twists, tip, point = scene(3)
    angle = 0.9
    turn = twists.new_tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    turned = ta.ArmDesign(offsets=arm.offsets @ turn.mT, length=arm.length, actuators=arm.actuators, mass=0.3)
    shape = twists.clone()
    shape[..., 1:3], shape[..., 4:] = twists[..., 1:3] @ turn.mT, twists[..., 4:] @ turn.mT
    base = torch.from_numpy(scenes.hanging(roll=-angle))
    same(evaluate(turned, shape, tip, point, base_pose=base), evaluate(arm, twists, tip, point))


def test_the_world_may_turn_about_the_vertical():
    arm, twists, tip, point = scene(3)
    cos, sin = math.cos(0.8), math.sin(0.8)
    turn = twists.new_tensor([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    base = torch.from_numpy(scenes.hanging(0.4, -0.3))
    moved = base.clone()
    moved[:3, :3] = turn @ base[:3, :3]

    def turned(wrench):
        return torch.cat((wrench[..., :3] @ turn.mT, wrench[..., 3:] @ turn.mT), -1)

    same(
        evaluate(arm, twists, turned(tip), turned(point), base_pose=moved),
        evaluate(arm, twists, tip, point, base_pose=base),
    )


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("unit", [1e-3, 1e3])
def test_the_unit_of_length_is_of_no_matter(dimension, unit):
    """Metres times `unit`: moments and weights of moments follow; strains, forces and angles stay."""
    arm, twists, tip, point = scene(dimension)
    arm = ta.ArmDesign(arm.radii, arm.length, arm.actuators, out_of_plane=arm.out_of_plane)
    models = [
        type(model)(force_scale=model.force_scale, bending_stiffness=model.bending_stiffness * unit**2)
        for model in arm.actuators
    ]
    z = None if arm.out_of_plane is None else unit * arm.out_of_plane
    scaled = ta.ArmDesign(unit * arm.radii, unit * arm.length, models, out_of_plane=z)
    linear = 2 if dimension == 2 else 3
    shape, force, body = twists.clone(), tip.clone(), point.clone()
    shape[..., :dimension] *= unit
    force[..., linear:] *= unit
    body[..., linear:] *= unit
    same(
        evaluate(scaled, shape, force, body, weights=(1.0, unit**-2)),
        evaluate(arm, twists, tip, point),
        1e-8,
    )


@pytest.mark.parametrize("dimension", [2, 3])
def test_the_unit_of_force_scales_distances(dimension):
    arm, twists, tip, point = scene(dimension)
    one = evaluate(arm, twists, tip, point)
    for metric in METRICS:
        found = evaluate(arm, twists, tip, point, weights=(1e4, 1e4))
        assert getattr(found, metric).numpy() == pytest.approx(100 * getattr(one, metric).numpy(), abs=1e-8, rel=1e-9)


@pytest.mark.parametrize("dimension", [2, 3])
def test_an_actuator_without_pressure_adds_what_it_holds_back(dimension):
    """A limit of 0 is an elastic core: one at the axis moves the required force by its own."""
    _, twists, _, _ = scene(dimension)
    nothing = torch.zeros(1, 2, dtype=torch.float64)
    across = {"radii": nothing[:, 0]} if dimension == 2 else {"offsets": nothing}
    core = ta.ArmDesign(**across, length=0.38, actuators=ta.Bellows(), max_pressure=[0.0])
    found = ta.evaluate(core, ta.Task(twists, torch.zeros(twists.shape[-1], dtype=torch.float64)), "absolute")
    strain = torch.tensor((0.4 - 0.38) / 0.38, dtype=torch.float64)
    alone = float(ta.Bellows().force(strain, torch.zeros((), dtype=torch.float64)))
    assert found.absolute_per_node.numpy() == pytest.approx(abs(alone), abs=1e-12)
