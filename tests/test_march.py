"""The march along the arm against the assembled balance and a factorisation of its matrix."""

from types import SimpleNamespace

import pytest
import torch

import torcharm as ta
from torcharm import mechanics
from torcharm.actuators import force_slopes

MIXED = ta.ArmDesign(
    [-0.08, 0.01, 0.07], 0.5, [ta.Bellows(bending_stiffness=ta.ConstantBending(-0.2)), ta.Bellows(), ta.McKibben()]
)
ARMS = {"antagonistic": ta.antagonistic_arm(), "bellows": ta.bellows_arm(), "mixed": MIXED}


def last(value):
    return value.movedim(0, -1).contiguous()


def scene(arm, nodes, shear, count=40):
    generator = torch.Generator().manual_seed(nodes)

    def normal(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    rows = [0.5 + 0.03 * normal(count, nodes), 0.5 * normal(count, nodes)]
    rows[1][0] = 0  # straight
    if shear is not None:
        rows.insert(1, 0.02 * normal(count, nodes))
    design = arm._map(lambda value: value.expand(count, *value.shape))
    pressure = torch.rand(count, arm.actuator_count, generator=generator, dtype=torch.float64) * arm.max_pressure
    load = normal(count, 3) * torch.tensor([10.0, 10.0, 1.0])
    base = torch.tensor([0.1, 0.2, -1.5], dtype=torch.float64).expand(count, 3)
    return design, torch.stack(rows, 1), pressure, load, base


@pytest.mark.parametrize("shear", [None, 1e3])
@pytest.mark.parametrize("nodes", [1, 2, 7])
@pytest.mark.parametrize("name", ARMS)
def test_march_solves_the_assembled_balance(name, nodes, shear):
    design, z, pressure, load, base = scene(ARMS[name], nodes, shear)
    limits = design.max_pressure
    found = mechanics.balance(design, z, pressure, load, base, shear)
    rate = mechanics.load_wrench(found.kinematics, load, shear=shear is not None)
    right = torch.cat(
        (found.residual.unsqueeze(-1), found.by_pressure * limits[:, None, None, :], rate.unsqueeze(-1)), -1
    )
    change, sign = mechanics.solve_signed(found.stiffness, -right)
    moved = mechanics.pose_change(found.kinematics, change)
    arms = mechanics.Arms.of(design, load, base, shear)
    ours = mechanics.march(arms, last(z), last(pressure), each_pressure=last(limits))
    loads = mechanics.march(arms, last(z), last(pressure), load=arms.tip_load)
    close = {"rtol": 1e-6, "atol": 1e-8}
    torch.testing.assert_close(ours.change.movedim(-1, 0), change[..., :-1], **close)
    torch.testing.assert_close(loads.change.movedim(-1, 0)[..., 1], change[..., -1], **close)
    torch.testing.assert_close(ours.turned.movedim(-1, 0), moved[:, 2, 1:, :-1], **close)
    torch.testing.assert_close(ours.slid.movedim(-1, 0), moved[:, :2, 1:, :-1], **close)
    pose = torch.cat((ours.position, ours.heading.unsqueeze(0))).permute(2, 1, 0)
    torch.testing.assert_close(pose, found.kinematics.pose[:, 1:], rtol=0, atol=1e-13)
    torch.testing.assert_close(ours.force, found.residual[:, :-1].abs().flatten(1).amax(-1), rtol=1e-10, atol=1e-9)
    torch.testing.assert_close(ours.moment, found.residual[:, -1].abs().amax(-1), rtol=1e-10, atol=1e-9)
    assert (ours.sign == sign).all()


@pytest.mark.parametrize("name", ARMS)
def test_share_of_the_load(name):
    design, z, pressure, load, base = scene(ARMS[name], 4, None)
    part = torch.linspace(0, 1, len(load)).double()
    arms, less = (mechanics.Arms.of(design, force, base, None) for force in (load, part[:, None] * load))
    ours, same = mechanics.march(arms, last(z), last(pressure), part), mechanics.march(less, last(z), last(pressure))
    torch.testing.assert_close(ours.change, same.change)


@pytest.mark.parametrize("name", ARMS)
def test_relax_is_the_march_without_load(name):
    design, z, pressure, load, base = scene(ARMS[name], 1, None)
    arms = mechanics.Arms.of(design, torch.zeros_like(load), base, None)
    limits = last(design.max_pressure)
    ours = mechanics.relax(arms, last(z), last(pressure), limits)
    whole = mechanics.march(arms, last(z), last(pressure), each_pressure=limits)
    torch.testing.assert_close(ours.change[:, :, 0], whole.change[:, :, 0])
    torch.testing.assert_close(ours.change[:, :, 1], whole.change[:, :, 1:].sum(2))
    assert (ours.sign == whole.sign).all()


@pytest.mark.parametrize(
    "model",
    [
        ta.Bellows(),
        ta.McKibben(),
        ta.McKibben(force_scale=2.0),
        ta.PolynomialActuator(((1, 0, -40.0), (0, 1, 0.8)), (-0.5, 0.5), (0.0, 60.0), 60.0),
        ta.PolynomialActuator(((1, 0, -40.0),), (-0.5, 0.5), (0.0, 60.0), 60.0),
        ta.PolynomialActuator(((0, 0, 3.0),), (-0.5, 0.5), (0.0, 60.0), 60.0),
    ],
)
def test_force_slopes_are_those_of_autograd(model):
    strain = torch.linspace(-0.5, 0.06, 57, dtype=torch.float64).unsqueeze(-1)
    pressure = torch.linspace(0, 100, 41, dtype=torch.float64)
    written = model.force_slopes(strain.expand(57, 41), pressure.expand(1, 41))

    members = ("bending_stiffness", "max_pressure", "strain_range", "pressure_range", "force")
    plain = SimpleNamespace(**{member: getattr(model, member) for member in members})
    derived = force_slopes(plain, strain.expand(57, 41), pressure.expand(57, 41))
    for ours, theirs in zip(written, derived, strict=True):
        torch.testing.assert_close(ours.expand(57, 41), theirs, rtol=1e-10, atol=1e-10)
    assert model.force_slopes(strain.expand(57, 41), pressure.expand(1, 41), False)[2] is None
