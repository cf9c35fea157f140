"""Gradients of distances against central differences: every input, every metric, plane and space."""

import numpy as np
import oracle
import pytest
import torch
from hull_cases import double, unchecked
from torch import nn

import torcharm as ta
from torcharm.statics.external_load import HULL, required_wrench, task_wrench

STEP = 1e-5
NODES, LOADS = 4, 5
METRICS = ("absolute", "relative", "signed")


class TorchModel(nn.Module):
    """A user's model with parameters, one of them of its bending moment, and a kink that they move."""

    max_pressure = 60.0
    strain_range = (-1.0, 1.0)
    pressure_range = (0.0, 60.0)

    def __init__(self, gain, knee):
        super().__init__()
        self.gain, self.knee = gain, knee

    @property
    def bending_stiffness(self):
        return -0.01 * self.gain

    def pressure_knots(self, strain):
        return (self.knee + 30 * strain).unsqueeze(0)

    def force(self, strain, pressure):
        beyond = (pressure - self.knee - 30 * strain).relu()
        return self.gain * torch.tanh(pressure / 40) + 0.9 * beyond - 40 * strain


def inputs_of(dimension):
    """All that results may depend on, by name; each a leaf."""
    double = {"dtype": torch.float64}
    wrench = 3 if dimension == 2 else 6
    twists = torch.zeros(NODES, wrench, **double)
    twists[:, 0] = 0.37
    twists[:, -1] = torch.linspace(0.5, 1.1, NODES, **double)
    found = {
        "radii": torch.tensor([0.05, -0.03, -0.045, 0.02], **double),
        "length": torch.tensor([0.36, 0.35, 0.43, 0.38], **double),
        "max_pressure": torch.tensor([40.0, 45.0, 90.0, 55.0], **double),
        "mass": torch.tensor(0.3, **double),
        "twists": twists,
        "tip": 8.0 * torch.randn(LOADS, wrench, generator=torch.Generator().manual_seed(0), **double),
        "point wrench": torch.linspace(-1.0, 2.0, wrench, **double),
        "point mass": torch.tensor(0.2, **double),
        "base_pose": torch.tensor([0.1, 0.2, -1.4], **double),
        "force scale": torch.tensor(1.1, **double),
        "muscle scale": torch.tensor(1.4, **double),
        "gain": torch.tensor(25.0, **double),
        "knee": torch.tensor(22.0, **double),
        "stiffness": torch.tensor(-0.25, **double),
        "constant stiffness": torch.tensor(-0.1, **double),
        "reference": torch.tensor(50.0, **double),
    }
    if dimension == 3:
        found["out_of_plane"] = torch.tensor([0.037, -0.02, 0.04, -0.05], **double)
        twists[:, 4] = torch.linspace(-0.6, 0.4, NODES, **double)
        found["base_pose"] = torch.eye(4, **double)
        found["base_pose"][:3, :3] = torch.tensor([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], **double)
    return {name: value.clone().requires_grad_() for name, value in found.items()}


def arm_of(inputs):
    models = [
        ta.Bellows(force_scale=inputs["force scale"], bending_stiffness=inputs["stiffness"]),
        TorchModel(inputs["gain"], inputs["knee"]),
        ta.McKibben(
            force_scale=inputs["muscle scale"],
            bending_stiffness=ta.LinearBending(inputs["stiffness"], inputs["reference"]),
        ),
        ta.Bellows(bending_stiffness=ta.ConstantBending(inputs["constant stiffness"])),
    ]
    return ta.ArmDesign(
        inputs["radii"],
        inputs["length"],
        models,
        inputs["max_pressure"],
        mass=inputs["mass"],
        out_of_plane=inputs.get("out_of_plane"),
    )


def task_of(inputs):
    points = [
        ta.PointLoad(inputs["point wrench"], at=0.6, frame="body"),
        ta.PointLoad(mass=inputs["point mass"], at=0.8),
    ]
    load = ta.ExternalLoad(tip=inputs["tip"], gravity=True, points=points)
    return ta.Task(inputs["twists"], load=load, base_pose=inputs["base_pose"], wrench_at="start")


@torch.no_grad()
def hold(inputs):
    """Let the tip loads be those that pressures hold, but for a small rest: every node is then inside its set."""
    generator = torch.Generator().manual_seed(2)
    arm, columns = arm_of(inputs), list(HULL[inputs["twists"].shape[-1]])
    pressure = inputs["max_pressure"] * (0.4 + 0.2 * torch.rand(LOADS, 4, generator=generator, dtype=torch.float64))
    wanted = ta.reaction_wrench(arm, inputs["twists"], pressure)
    inputs["tip"].zero_()
    nothing = task_wrench(arm, task_of(inputs))[..., columns]
    unit = torch.eye(inputs["tip"].shape[-1], dtype=torch.float64).unsqueeze(-2)
    by_tip = required_wrench(inputs["twists"], unit.squeeze(-2), inputs["base_pose"], wrench_at="start")[..., columns]
    rest = (wanted - nothing).flatten(1).mT
    inputs["tip"].copy_(torch.linalg.lstsq(by_tip.flatten(1).mT, rest).solution.mT)


def distances(inputs, metric, weight):
    """A sum of the nodes' distances with different weights, so that no gradient cancels; and they themselves."""
    name = "relative" if metric == "relative" else "absolute"
    found = ta.evaluate(arm_of(inputs), task_of(inputs), name, signed=metric == "signed")
    assert found.converged.all()
    per_node = getattr(found, f"{name}_per_node")
    return (per_node * weight).sum(), per_node.detach()


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("metric", METRICS)
def test_table(dimension, metric):
    weight = torch.linspace(1.0, 1.9, LOADS * NODES, dtype=torch.float64).view(LOADS, NODES)
    inputs = inputs_of(dimension)
    if metric == "signed":
        hold(inputs)
    value, per_node = distances(inputs, metric, weight)
    if metric == "signed":
        assert (per_node < 0).float().mean() > 0.4
    else:
        assert (per_node[:, 1:] > 0).float().mean() > 0.7
    gradients = torch.autograd.grad(value, list(inputs.values()), allow_unused=True)
    generator, wrong = torch.Generator().manual_seed(1), {}
    for (name, leaf), gradient in zip(inputs.items(), gradients, strict=True):
        assert gradient is not None, f"{name}: lost"
        assert gradient.isfinite().all(), name
        direction = torch.rand(leaf.shape, generator=generator, dtype=torch.float64) - 0.4
        if name == "base_pose" and dimension == 3:
            direction[:] = leaf.detach() @ torch.tensor(SPIN, dtype=torch.float64)
        along = float((gradient * direction).sum())
        size = max(1.0, float(leaf.detach().abs().max())) if leaf.ndim == 0 else float(leaf.detach().abs().max())
        differences = []
        for step in (STEP * size, 2 * STEP * size):
            ends = []
            for sign in (1.0, -1.0):
                moved = {**inputs, name: (leaf + sign * step * direction).detach()}
                with torch.no_grad():
                    ends.append(float(distances(moved, metric, weight)[0]))
            differences.append((ends[0] - ends[1]) / (2 * step))
        difference = (4 * differences[0] - differences[1]) / 3
        scale = max(abs(along), abs(difference), 1e-3 * float(value.detach().abs()) / size)
        if abs(along - difference) > 1e-6 * scale:
            wrong[name] = (along, difference)
        if abs(along) <= 1e-9 * scale:
            wrong[name] = "no effect, and so no test"
    assert wrong == {}


SPIN = [[0.0, -0.3, 0.5, 0.1], [0.3, 0.0, -0.2, 0.2], [-0.5, 0.2, 0.0, -0.1], [0.0, 0.0, 0.0, 0.0]]
"""A body twist, along which a pose stays a pose to first order."""


@pytest.mark.parametrize("chunk_size", [None, 2])
def test_second_derivatives_are_refused_and_directional_ones_right(chunk_size):
    """`jvp` goes through a graph of the gradient, in which normals and pressures are held: it needs no second one."""
    radii = torch.tensor([-0.05, 0.0, 0.05], dtype=torch.float64, requires_grad=True)
    task = ta.Task(ta.affine_curvature(-3.0, 3.0), ta.sample_loads(5))
    models = [ta.Bellows(), ta.McKibben(), ta.Bellows()]

    def total(radii):
        return ta.evaluate(
            ta.ArmDesign(radii, 0.5, models), task, ("absolute", "relative"), chunk_size=chunk_size
        ).absolute.sum()

    def room(radii):
        return ta.load_capacity(ta.ArmDesign(radii, 0.5, models), task, chunk_size=chunk_size).t_max_per_node.sum()

    direction = torch.tensor([1.0, -0.5, 2.0], dtype=torch.float64)
    (gradient,) = torch.autograd.grad(total(radii), radii, create_graph=True)
    slope = torch.autograd.functional.jvp(total, radii.detach(), direction)[1]
    assert slope.item() == pytest.approx((gradient @ direction).item(), rel=1e-12)
    for answer in (total, room):
        (gradient,) = torch.autograd.grad(answer(radii), radii, create_graph=True)
        with pytest.raises(RuntimeError, match="second derivatives"):
            torch.autograd.grad(gradient.sum(), radii)


@pytest.mark.parametrize("turn", [0.0, 1e-13, 1e-9])
@pytest.mark.parametrize("kind", ["exact", "edges"])
def test_values_with_gradients_are_those_without_on_a_straight_arm(turn, kind):
    arm = ta.antagonistic_arm()
    tracked = ta.ArmDesign(arm.radii.clone().requires_grad_(), arm.length, arm.actuators)
    for length in (0.37, 0.45, 0.5, 0.6):
        task = ta.Task(ta.affine_curvature(turn, turn, length=length), ta.sample_loads(60))
        plain, result = (
            ta.evaluate(arm, task, ("absolute", "relative"), hull=kind),
            ta.evaluate(tracked, task, ("absolute", "relative"), hull=kind),
        )
        torch.testing.assert_close(result.absolute.detach(), plain.absolute, rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(result.relative.detach(), plain.relative, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("turn", [0.0, 1e-9, 0.3])
def test_values_with_gradients_are_those_without_beside_the_joint_of_parallel_faces(turn):
    # Equal actuators make parallel faces, end to end; the points stand beside the joints, to within rounding or not.
    linear = ta.PolynomialActuator(((0, 1, 0.937),), (-1.0, 1.0), (0.0, 10.0), 10.0)
    arm = ta.ArmDesign([0.0513, 0.0513, 0.0513], 0.5, [linear] * 3)
    twists = double([[0.5, 0.0, turn]])
    joints = ta.reaction_wrench(arm, twists, double([[10.0, 0.0, 0.0], [10.0, 10.0, 0.0]]))  # (2, 1, 2)
    along = (joints[1] - joints[0]) / (joints[1] - joints[0]).norm()
    across = along.flip(-1) * double([1.0, -1.0])
    aside = double([sign * 10.0**power for power in np.linspace(-14, -4, 101) for sign in (-1, 1)])[:, None, None, None]
    away = double([-7.0, -0.3, 0.3, 7.0])[:, None, None, None, None]
    required = (joints + aside * along + away * across).squeeze(-2).reshape(-1, 2)
    # which load asks for it? one segment: the wrench is linear in the load
    unit = double(np.array([oracle.required_wrenches(twists, load)[0, [0, 2]] for load in np.eye(3)]))
    loads = required @ torch.linalg.pinv(unit)
    plain = ta.evaluate(arm, ta.Task(twists, loads, wrench_at="start"), ("absolute",))
    tracked = ta.evaluate(arm, ta.Task(twists, loads.clone().requires_grad_(), wrench_at="start"), ("absolute",))
    assert (plain.absolute > 0).all()
    torch.testing.assert_close(tracked.absolute.detach(), plain.absolute, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("length", [0.37, 0.45, 0.49])
@unchecked()
def test_gradients_on_a_straight_arm_are_those_of_central_differences(length):
    models = [ta.Bellows(), ta.McKibben(), ta.McKibben(), ta.Bellows()]
    radii = double([-0.07, -0.02, 0.015, 0.06])
    task = ta.Task(ta.affine_curvature(0.0, 0.0, length=length, nodes=4), ta.sample_loads(20))

    def total(limits):
        return ta.evaluate(ta.ArmDesign(radii, 0.5, models, limits), task, ("absolute",)).absolute

    limits, step = double([40.0, 80.0, 90.0, 45.0], grad=True), 1e-3
    total(limits).sum().backward()
    for index, shift in enumerate(step * torch.eye(4, dtype=torch.float64)):
        found = (total(limits.detach() + shift) - total(limits.detach() - shift)).sum() / (2 * step)
        assert limits.grad[index].item() == pytest.approx(found.item(), rel=1e-6, abs=1e-6)
