import math
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st

from torcharm import (
    ArmDesign,
    Bellows,
    McKibben,
    PolynomialActuator,
    antagonistic_arm,
    poses,
    reaction_wrench,
    required_wrench,
)
from torcharm.geometry import se2

F64 = torch.float64
wrench_at_nodes = partial(required_wrench, wrench_at="start")


def random_task(seed, nodes, *batch):
    """Shapes with shear, tip loads and base poses."""
    random = np.random.default_rng(seed)
    twists = np.array([0.4, 0.2, 12.0]) * (random.random((*batch, nodes, 3)) - 0.5) + np.array([0.5, 0.0, 0.0])
    load = np.array([20.0, 20.0, 5.0]) * (random.random((*batch, 3)) - 0.5)
    base = np.array([2.0, 2.0, 12.0]) * (random.random((*batch, 3)) - 0.5)
    return torch.from_numpy(twists), torch.from_numpy(load), torch.from_numpy(base)


def carried_by_adjoint(twists, load, base):
    """-q_i with q_i = Ad^{-T}_{g_i⁻¹ g_tip} diag(R_tip, 1)ᵀ q_tip."""
    pose = poses(twists, base)
    tip = pose[-1]
    at_tip = torch.cat((se2.turned(-tip[2], load[:2]), load[2:]))
    rows = [torch.linalg.inv(se2.adjoint(se2.compose(se2.inverse(node), tip))).T @ at_tip for node in pose[:-1]]
    return -torch.stack(rows)


@given(seed=st.integers(0, 10_000), nodes=st.integers(1, 12))
def test_statics_and_the_adjoint_carry_loads_alike(seed, nodes):
    twists, load, base = random_task(seed, nodes)
    found = wrench_at_nodes(twists, load, base)
    torch.testing.assert_close(found, carried_by_adjoint(twists, load, base), rtol=1e-12, atol=1e-12)


@given(seed=st.integers(0, 10_000), nodes=st.integers(1, 6))
def test_the_load_does_the_work_that_the_wrenches_do(seed, nodes):
    """Virtual work: changing a segment's twist, the tip load's work is the segment's mean wrench times the change."""
    twists, load, base = random_task(seed, nodes)
    twists.requires_grad_()
    (work,) = torch.autograd.grad((poses(twists, base)[-1] * load).sum(), twists)
    parts = 400
    fine = twists.detach().repeat_interleave(parts, 0)
    tip = poses(fine, base)[-1]
    at_tip = torch.cat((se2.turned(-tip[2], load[:2]), load[2:]))
    carried = torch.cat((-wrench_at_nodes(fine, load, base), at_tip[None]))
    mean = ((carried[1:] + carried[:-1]) / 2).unflatten(0, (nodes, parts)).mean(1)
    # The trapezoidal rule errs by the square of the angle turned in a part, over 12.
    torch.testing.assert_close(work, mean / nodes, rtol=0, atol=(6.0 / parts) ** 2 * load.abs().max().item())


@pytest.mark.parametrize("nodes", [1, 2, 10])
def test_a_lateral_load_on_a_hanging_arm_gives_a_moment_that_grows_linearly_towards_the_base(nodes):
    length, force = 0.5, 3.0
    twists = torch.tensor([length, 0.0, 0.0], dtype=F64).expand(nodes, 3)
    found = wrench_at_nodes(twists, torch.tensor([force, 0.0, 0.0], dtype=F64))
    below = length * (1 - torch.arange(nodes, dtype=F64) / nodes)  # arm hanging below each node
    # A force to the right, at the end of a lever pointing down, turns counter-clockwise; the arm's left is the right.
    expected = -torch.stack((torch.zeros(nodes, dtype=F64), torch.full((nodes,), force, dtype=F64), force * below), -1)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-14)


def test_a_weight_on_a_hanging_arm_is_pure_tension():
    twists = torch.tensor([0.5, 0.0, 0.0], dtype=F64).expand(4, 3)
    found = wrench_at_nodes(twists, torch.tensor([0.0, -7.0, 0.0], dtype=F64))
    # The load pulls along the heading, so the arm must pull back.
    torch.testing.assert_close(found, torch.tensor([-7.0, 0.0, 0.0], dtype=F64).expand(4, 3), rtol=0, atol=1e-14)


@given(seed=st.integers(0, 10_000), moment=st.floats(-5, 5))
def test_a_pure_moment_is_the_same_at_every_node_of_any_shape(seed, moment):
    twists, _, base = random_task(seed, 5)
    found = wrench_at_nodes(twists, torch.tensor([0.0, 0.0, moment], dtype=F64), base)
    torch.testing.assert_close(found, torch.tensor([0.0, 0.0, -moment], dtype=F64).expand(5, 3), rtol=0, atol=1e-14)


def test_a_quarter_circle_worked_by_hand():
    # From the origin heading down, turning left (to the right of the world): the tip is at (R, -R).
    radius = 0.5 / (math.pi / 2)
    twists = torch.tensor([0.5, 0.0, math.pi / 2], dtype=F64).expand(2, 3)
    found = wrench_at_nodes(twists, torch.tensor([0.0, -4.0, 1.0], dtype=F64))
    half = math.sqrt(0.5)
    # Node 1 sees the tip R to the right; node 2 sits at (R (1 - cos 45°), -R sin 45°) heading -45°.
    expected = [[-4.0, 0.0, -1.0 + 4 * radius], [-4 * half, 4 * half, -1.0 + 4 * radius * half]]
    torch.testing.assert_close(found, torch.tensor(expected, dtype=F64), rtol=0, atol=1e-14)


def test_nodes_are_the_starts_of_segments_and_the_tip_is_none_of_them():
    twists, load, base = random_task(3, 4)
    found = wrench_at_nodes(twists, load, base)
    assert found.shape == (4, 3)
    pose = poses(twists, base)
    for node, wrench in zip(pose[:-1], found, strict=True):
        moment = load[2] + (pose[-1, 0] - node[0]) * load[1] - (pose[-1, 1] - node[1]) * load[0]
        torch.testing.assert_close(wrench[2], -moment)
    assert not torch.isclose(found[-1, 2], -load[2])  # the last node is one segment away from the tip


@pytest.mark.parametrize(
    ("shapes", "loads", "bases", "batch"),
    [
        ((), (), (), ()),
        ((4,), (), (), (4,)),
        ((), (5,), (), (5,)),
        ((4, 1), (5,), (), (4, 5)),
        ((), (5,), (2, 1), (2, 5)),
    ],
)
def test_required_wrenches_broadcast(shapes, loads, bases, batch):
    twists, _, _ = random_task(0, 3, *shapes)
    _, load, _ = random_task(1, 3, *loads)
    _, _, base = random_task(2, 3, *bases)
    found = wrench_at_nodes(twists, load, base)
    assert found.shape == (*batch, 3, 3)
    every = twists.expand(*batch, 3, 3), load.expand(*batch, 3), base.expand(*batch, 3)
    for index in np.ndindex(*batch):
        one = wrench_at_nodes(*(value[index] for value in every))
        torch.testing.assert_close(found[index], one, rtol=0, atol=1e-13)


def test_required_wrenches_are_differentiable():
    inputs = [value.requires_grad_() for value in random_task(0, 3)]
    assert torch.autograd.gradcheck(wrench_at_nodes, inputs)


@dataclass(frozen=True)
class Fluid:
    """A made-up model whose force is the derivative of an energy, `U = -A p l - ½ k (l - l̂)²/l̂`."""

    area: float = 0.6
    stiffness: float = 40.0
    bending_stiffness: float = -0.25
    max_pressure: float = 60.0
    strain_range: tuple[float, float] = (-1.0, 1.0)
    pressure_range: tuple[float, float] = (0.0, 60.0)

    def force(self, strain, pressure):
        return self.area * pressure - self.stiffness * strain


def fluid_energy(arm, length, curvature, pressure):
    """Energy the actuators have given off at pressures p, per unit of arc; bending apart."""
    total = 0.0
    for model, radius, neutral, p in zip(arm.actuators, arm.radii, arm.length, pressure, strict=True):
        own = length - radius * curvature
        total = total + model.area * p * own - 0.5 * model.stiffness * (own - neutral) ** 2 / neutral
    return total


@given(seed=st.integers(0, 10_000))
def test_reaction_is_the_gradient_of_the_actuators_energy(seed):
    """Virtual work settles the sign: ∂l_α/∂κ = -r_α, so the moment is -Σ r f."""
    random = np.random.default_rng(seed)
    models = [Fluid(area=a, stiffness=k, bending_stiffness=0.0) for a, k in random.random((3, 2)) * [1, 50]]
    arm = ArmDesign(torch.from_numpy(random.random(3) * 0.2 - 0.1), torch.from_numpy(random.random(3) + 0.3), models)
    pressure = torch.from_numpy(random.random(3) * 60)
    length, curvature = torch.from_numpy(random.random(2) * [0.3, 6] + [0.3, -3])

    twists = torch.stack((length, length * 0, curvature))[None]
    found = reaction_wrench(arm, twists, pressure)[0]
    step = 1e-4  # the energy is quadratic: central differences are exact but for rounding
    by_length, by_curvature = (
        (
            fluid_energy(arm, length + dl, curvature + dk, pressure)
            - fluid_energy(arm, length - dl, curvature - dk, pressure)
        )
        / (2 * step)
        for dl, dk in ((step, 0.0), (0.0, step))
    )
    torch.testing.assert_close(found, torch.stack((by_length, by_curvature)), rtol=1e-8, atol=1e-8)


def test_a_bellows_on_the_left_bends_the_arm_to_the_right():
    arm = ArmDesign([0.05], 0.5, [Bellows()])
    twists = torch.tensor([[0.5, 0.0, 0.0]], dtype=F64)
    force, moment = reaction_wrench(arm, twists, torch.tensor([50.0], dtype=F64))[0].tolist()
    assert force > 0
    assert moment == pytest.approx(-0.05 * force, rel=1e-15)


def reaction_by_loops(arm, twists, pressure):
    """Reactions by plain loops over nodes and actuators, each model asked for one number at a time."""
    rows = []
    for length, _, curvature in twists:
        force_sum = moment_sum = 0.0
        for model, radius, neutral, p in zip(arm.actuators, arm.radii, arm.length, pressure, strict=True):
            own = length - radius * curvature
            force = model.force((own - neutral) / neutral, p)
            force_sum += force
            moment_sum += -radius * force + model.bending_stiffness * p / model.max_pressure * curvature / own
        rows.append(torch.stack((force_sum, moment_sum)))
    return torch.stack(rows)


B, M, P = Bellows(), McKibben(), PolynomialActuator(((0, 1, 1.0), (1, 0, -9.0)), (-0.5, 0.5), (0.0, 50.0), 40.0)
ORDERS = {
    "one": [M],
    "alike": [B, B, B],
    "two kinds": [B, M],
    "the paper's": [B, M, M, B],
    "alternating": [B, M, B, M, B],
    "evenly spaced": [M, B, B, M, B, B, M],
    "irregular": [B, B, M, B, M, M, B],
    "three kinds": [P, M, B, B, P, M, P],
    "equal copies": [Bellows(), McKibben(), Bellows(), McKibben()],
    "scaled": [McKibben(force_scale=2.0), M, McKibben(force_scale=2.0), M],
}


@pytest.mark.parametrize("models", ORDERS.values(), ids=ORDERS.keys())
def test_reaction_is_the_sum_over_actuators_in_any_order(models):
    twists, _, _ = random_task(4, 5)
    count = len(models)
    arm = ArmDesign(torch.linspace(-0.06, 0.09, count), torch.linspace(0.45, 0.55, count), models)
    arm = replace(arm, radii=arm.radii.double(), length=arm.length.double(), max_pressure=arm.max_pressure.double())
    pressure = torch.linspace(5.0, 45.0, count, dtype=F64)
    found = reaction_wrench(arm, twists, pressure)
    torch.testing.assert_close(found, reaction_by_loops(arm, twists, pressure), rtol=1e-11, atol=1e-11)


def test_reaction_does_not_depend_on_the_order_of_actuators():
    twists, _, _ = random_task(5, 4)
    kinds, radii, pressure = [B, M, P, M], np.array([-0.05, -0.01, 0.02, 0.06]), np.array([10.0, 20.0, 30.0, 40.0])
    expected = reaction_wrench(ArmDesign(radii, 0.5, kinds), twists, torch.from_numpy(pressure))
    for order in permutations(range(4)):
        chosen = list(order)
        arm = ArmDesign(radii[chosen], 0.5, [kinds[index] for index in order])
        found = reaction_wrench(arm, twists, torch.from_numpy(pressure[chosen]))
        torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("designs", "shapes", "pressures", "batch"),
    [
        ((), (), (), ()),
        ((3,), (), (), (3,)),
        ((), (4,), (), (4,)),
        ((), (), (5,), (5,)),
        ((3, 1), (4,), (2, 1, 1), (2, 3, 4)),
    ],
)
def test_reactions_broadcast(designs, shapes, pressures, batch):
    random = np.random.default_rng(0)
    models = [B, M, M, B]
    radii = torch.from_numpy(random.random((*designs, 4)) * 0.1)
    twists, _, _ = random_task(1, 3, *shapes)
    pressure = torch.from_numpy(random.random((*pressures, 4)) * 50)
    found = reaction_wrench(ArmDesign(radii, 0.5, models), twists, pressure)
    assert found.shape == (*batch, 3, 2)
    every = radii.expand(*batch, 4), twists.expand(*batch, 3, 3), pressure.expand(*batch, 4)
    for index in np.ndindex(*batch):
        one_radii, one_twists, one_pressure = (value[index] for value in every)
        one = reaction_wrench(ArmDesign(one_radii, 0.5, models), one_twists, one_pressure)
        torch.testing.assert_close(found[index], one, rtol=1e-12, atol=1e-12)


def test_a_limit_set_on_the_arm_does_not_stiffen_its_material():
    twists, _, _ = random_task(6, 4)
    pressure = torch.tensor([10.0, 20.0, 30.0, 40.0], dtype=F64)
    arm = antagonistic_arm()
    limited = replace(arm, max_pressure=[40.0, 0.0, 90.0, 41.0])
    assert torch.equal(reaction_wrench(limited, twists, pressure), reaction_wrench(arm, twists, pressure))


def test_bending_is_linear_in_pressure_and_resists_curvature():
    twists = torch.tensor([[0.5, 0.0, 2.0]], dtype=F64)
    arm = ArmDesign([0.0], 0.5, [Bellows()])
    for share in (0.0, 0.5, 1.0):
        _, moment = reaction_wrench(arm, twists, torch.tensor([50.0 * share], dtype=F64))[0].tolist()
        assert moment == pytest.approx(-share / 3.5 * 2.0 / 0.5, rel=1e-14, abs=0)


def test_without_bending_stiffness_the_moment_is_the_forces_alone():
    twists = torch.tensor([[0.5, 0.0, 2.0], [0.5, 0.0, -1.0]], dtype=F64)
    arm = ArmDesign([0.02], 0.5, [Bellows(bending_stiffness=0.0)])
    force, moment = reaction_wrench(arm, twists, torch.tensor([30.0], dtype=F64)).unbind(-1)
    assert torch.equal(moment, -0.02 * force)


def test_the_middle_actuator_without_pressure_at_rest_gives_nothing():
    arm = ArmDesign([0.0, 0.0], 0.5, [Bellows(), McKibben()])
    twists = torch.tensor([[0.5, 0.0, 3.0]], dtype=F64)
    assert reaction_wrench(arm, twists, torch.zeros(2, dtype=F64)).tolist() == [[0.0, 0.0]]


@pytest.mark.parametrize("models", [(B, B, B, B), (B, M, M, B), (B, B, M, B)], ids=["alike", "sliced", "listed"])
def test_reactions_are_differentiable_in_everything(models):
    twists = torch.tensor([[0.47, 0.0, 1.0], [0.46, 0.0, -2.0]], dtype=F64, requires_grad=True)
    radii = torch.tensor([-0.08, -0.015, 0.015, 0.08], dtype=F64, requires_grad=True)
    length = torch.tensor([0.5, 0.51, 0.52, 0.53], dtype=F64, requires_grad=True)
    pressure = torch.tensor([10.0, 60.0, 70.0, 40.0], dtype=F64, requires_grad=True)

    def reaction(twists, radii, length, pressure):
        return reaction_wrench(ArmDesign(radii, length, models), twists, pressure)

    assert torch.autograd.gradcheck(reaction, (twists, radii, length, pressure))


def test_float32_stays_float32():
    arm = ArmDesign(torch.tensor([-0.05, 0.05]), 0.5, [B, M])
    twists = torch.tensor([[0.5, 0.0, 1.0]])
    assert reaction_wrench(arm, twists, torch.tensor([10.0, 20.0])).dtype == torch.float32
    assert wrench_at_nodes(twists, torch.ones(3)).dtype == torch.float32


@pytest.mark.parametrize("models", [(B, B), (B, M)], ids=["alike", "mixed"])
def test_mixed_precision_promotes_alike_for_all_arms(models):
    arm = ArmDesign(torch.tensor([-0.05, 0.05]), 0.5, models)
    assert reaction_wrench(arm, torch.tensor([[0.5, 0.0, 1.0]]), torch.tensor([10.0, 20.0], dtype=F64)).dtype == F64
