"""Equilibria in space: against scipy on an independent statics, closed forms, and the plane."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from oracle.spatial import SCENES, STIFFNESS, arm_and_task, required_wrench
from scipy.optimize import root

import torcharm as ta
from experiments.exactness import models
from torcharm.geometry import se3
from torcharm.geometry.rod import BASE_POSE, as_base

F64 = torch.float64
LIMIT = {"b": 50.0, "m": 100.0}
RIGID = [0, 4, 5]
SPRING = ta.PolynomialActuator(((1, 0, -400.0),), (-0.5, 0.5), (0.0, 60.0), 60.0, bending_stiffness=0.0)
"""Linear springs of 400 N a unit of strain, which no pressure drives."""


def double(values):
    return torch.as_tensor(values, dtype=F64)


def rows(scene):
    """The unknown components: with torsion where any segment gives way to it."""
    return [0, 3, 4, 5] if any(segment.torsion_stiffness for segment in scene.segments) else RIGID


def reaction(segment, pressure):
    """(N, 6) by numpy; torsion by virtual work on the actuators' lengths and on the core."""
    forces = {"b": models.polynomial(models.BELLOWS), "m": models.mckibben()}
    twists, (y, z) = segment.twists, segment.offsets.T
    length = twists[:, :1] - y * twists[:, 5:] + z * twists[:, 4:5]
    strain = (length - segment.length) / segment.length
    force = np.stack([forces[kind].force(strain[:, a], pressure[a]) for a, kind in enumerate(segment.kinds)], -1)
    bent = STIFFNESS * pressure / [LIMIT[kind] for kind in segment.kinds] / length
    found = np.zeros((len(twists), 6))
    found[:, 0] = force.sum(-1)
    found[:, 4] = (z * force).sum(-1) + bent.sum(-1) * twists[:, 4]
    found[:, 5] = (-y * force).sum(-1) + bent.sum(-1) * twists[:, 5]
    if segment.torsion_stiffness is not None:
        lost = (force * (y**2 + z**2) / length).sum(-1)
        found[:, 3] = twists[:, 3] * (lost - segment.torsion_stiffness / twists[:, 0])
    return found


def imbalance(unknowns, scene, pressure):
    columns, parts, first, actuator = rows(scene), [], 0, 0
    unknowns = unknowns.reshape(-1, len(columns))
    for segment in scene.segments:
        twists = np.zeros_like(segment.twists)
        twists[:, columns] = unknowns[first : first + len(twists)]
        first += len(twists)
        parts.append(replace(segment, twists=twists))
    moved, found = replace(scene, segments=tuple(parts)), []
    for segment in moved.segments:
        found.append(reaction(segment, pressure[actuator : actuator + len(segment.kinds)]))
        actuator += len(segment.kinds)
    return (np.concatenate(found) - required_wrench(moved))[:, columns].ravel()


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.name[:24])
def test_agrees_with_scipy_on_an_independent_statics(scene):
    arm, task = arm_and_task(scene)
    pressure = np.concatenate([[0.3 * LIMIT[kind] for kind in segment.kinds] for segment in scene.segments])
    pressure *= np.linspace(0.8, 1.2, len(pressure))
    found = ta.solve_equilibrium(
        arm, pressure, task.load, task.segment_nodes, base_pose=task.base_pose, wrench_at=task.wrench_at
    )
    assert found.status == "converged"
    ours = found.twists.numpy()[:, rows(scene)].ravel()
    nudged = ours * (1 + 1e-4 * np.sin(np.arange(len(ours))))
    theirs = root(imbalance, nudged, (scene, pressure), options={"xtol": 1e-13})
    assert np.abs(theirs.fun).max() < 1e-9
    np.testing.assert_allclose(ours, theirs.x, rtol=0, atol=1e-8)
    np.testing.assert_allclose(
        found.required_torsion, required_wrench(shaped(scene, found.twists))[:, 3], rtol=0, atol=1e-9
    )


def shaped(scene, twists):
    parts = torch.split(twists, [len(segment.twists) for segment in scene.segments])
    segments = [replace(segment, twists=part.numpy()) for segment, part in zip(scene.segments, parts, strict=True)]
    return replace(scene, segments=tuple(segments))


def turned_about_heading(angle):
    return se3.exp(double([0.0, 0.0, 0.0, angle, 0.0, 0.0]))


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5])
@pytest.mark.parametrize("wrench_at", ["start", "middle"])
def test_a_planar_problem_in_any_plane_of_space_has_its_planar_answer(angle, wrench_at):
    radii, pressure = double([-0.08, -0.015, 0.015, 0.08]), double([20.0, 30.0, 20.0, 25.0])
    actuators = ta.antagonistic_arm().actuators
    flat = ta.ArmDesign(radii, 0.5, actuators, mass=0.2)
    point = [0.3, -0.5, 0.02]
    load = ta.ExternalLoad([2.0, -3.0, 0.1], True, [ta.PointLoad(point, at=0.53, frame="body", mass=0.1)])
    planar = ta.solve_equilibrium(flat, pressure, load, 7, wrench_at=wrench_at)
    offsets = torch.stack((radii * math.cos(angle), radii * math.sin(angle)), -1)
    arm = ta.ArmDesign(offsets=offsets, length=0.5, actuators=actuators, mass=0.2)
    back = turned_about_heading(-angle)
    base = as_base(None, double(0.0), 6) @ back  # so that the arm's plane is the world's
    lifted = se3.turn_wrench_back(back, se3.vector_from_plane(double(point)))
    point = ta.PointLoad(lifted, at=0.53, frame="body", mass=0.1)
    load = ta.ExternalLoad(se3.vector_from_plane(double([2.0, -3.0, 0.1])), True, [point])
    found = ta.solve_equilibrium(arm, pressure, load, 7, base_pose=base, wrench_at=wrench_at)
    ours, theirs = found.poses[..., :3, 3], planar.poses[..., :2]
    torch.testing.assert_close(ours[:, :2], theirs, rtol=0, atol=1e-8)
    assert ours[:, 2].abs().max() < 1e-8
    curvature = found.twists[:, 4:].square().sum(-1).sqrt()
    torch.testing.assert_close(curvature, planar.twists[:, 2].abs(), rtol=0, atol=1e-8)
    assert found.status == planar.status == "converged"


def spring_arm(**options):
    """Isotropic: bending stiffness 400 · 4 r²/2 / l̂ = 4 N·m² for r = 50 mm, over a length of 0.5 m."""
    given = {"offsets": ta.ring(0.05, 4), "length": 0.5, "actuators": SPRING}
    return ta.ArmDesign(**(given | options))


BENDING = 400 * 4 * 0.05**2 / 2 / 0.5
"""N·m for a unit of curvature: `m = BENDING κ`."""


@pytest.mark.parametrize("direction", [0.0, 1.0, 4.0])
def test_a_pure_moment_in_any_plane_bends_to_a_circle(direction):
    moment = double([0.0, 0.0, 0.0, 0.8 * math.sin(direction), 0.0, 0.8 * math.cos(direction)])
    found = ta.solve_equilibrium(spring_arm(), [0.0] * 4, moment, 6)
    # Body y is world x and body z world z where the arm hangs
    expected = double([0.8 * math.sin(direction), 0.8 * math.cos(direction)]) / BENDING
    torch.testing.assert_close(found.twists[:, 4:], expected.expand(6, 2), rtol=0, atol=1e-9)
    torch.testing.assert_close(found.twists[:, 0], torch.full((6,), 0.5, dtype=F64), rtol=0, atol=1e-12)
    chord = (found.poses[-1, :3, 3] - found.poses[0, :3, 3]).norm()
    turn = 0.8 / BENDING
    assert chord == pytest.approx(2 * 0.5 / turn * math.sin(turn / 2), abs=1e-9)


CORE = ta.PolynomialActuator(
    ((1, 0, -1e9),), (-0.5, 0.5), (0.0, 60.0), 60.0, bending_stiffness=ta.ConstantBending(-2.0)
)
"""A rod of its own: 2 N·m² against bending, hard to stretch."""


@pytest.mark.parametrize("stiffness", [2.0, 0.7])
def test_moment_torsion_and_force_wind_a_helix(stiffness):
    """Kirchhoff's helix: κ = (k, 0, c)/l along the body carries m = (C k, 0, B c)/l and a force F along κ, with
    `F = (m_x - k m_z/c) |κ|/l`; with C = B there is no force."""
    arm = ta.ArmDesign(offsets=[[0.0, 0.0]], length=0.5, actuators=CORE, torsion_stiffness=stiffness)
    kappa, errors = double([0.9, 0.0, 1.4]), []
    moment = double([stiffness, 2.0, 2.0]) * kappa / 0.5
    axis = kappa / kappa.norm()
    force = (moment[0] - kappa[0] * moment[2] / kappa[2]) * kappa.norm() / 0.5 * axis
    strains = torch.cat((double([0.5, 0.0, 0.0]), kappa))
    for nodes in (20, 40):
        end = ta.poses(strains.expand(nodes, 6))[-1]
        tip = se3.turn_wrench(end, torch.cat((force, moment)).unsqueeze(0))[0]
        found = ta.solve_equilibrium(arm, [0.0], tip, nodes)
        errors.append(float((found.poses[-1, :3, 3] - end[:3, 3]).norm()))
    assert max(errors) < 1e-8  # exact: the strains are even, and so is the balance


@pytest.mark.parametrize("wrench_at", ["start", "middle"])
def test_an_arm_hanging_under_its_weight_stretches_by_the_weight_below(wrench_at):
    found = ta.solve_equilibrium(spring_arm(mass=3.0), [0.0] * 4, ta.ExternalLoad(gravity=True), 5, wrench_at=wrench_at)
    below = (5 - torch.arange(5, dtype=F64) - (0.5 if wrench_at == "middle" else 0.0)) / 5
    expected = 0.5 * (1 + 9.81 * 3.0 * below / 1600)
    torch.testing.assert_close(found.twists[:, 0], expected, rtol=0, atol=1e-11)
    assert found.twists[:, 1:].abs().max() < 1e-11


@pytest.mark.parametrize(("wrench_at", "low", "high"), [("start", 0.985, 1.0), ("middle", 0.999, 1.001)])
def test_a_push_along_the_arm_buckles_it_at_eulers_load(wrench_at, low, high):
    """`F l = (π/2)² B` of a clamped column of the length l to which the push has shortened it."""
    critical = 800 - math.sqrt(800**2 - 1600 * (math.pi / 2) ** 2 * BENDING / 0.5)  # l = 0.5 (1 - F/1600)
    for ratio, stable in ((low, True), (high, False)):
        load = double([0.0, ratio * critical, 0.0, 0.0, 0.0, 0.0])
        found = ta.solve_equilibrium(spring_arm(), [0.0] * 4, load, 40, wrench_at=wrench_at)
        assert bool(found.stable) == stable


def test_an_arm_that_twists_buckles_in_torsion_where_pushes_take_its_stiffness():
    """Four springs under a pull are stretched: they pull back, and stiffen. Pushed, they soften and buckle."""
    found = [
        ta.solve_equilibrium(spring_arm(torsion_stiffness=0.02), [0.0] * 4, double([0.0, push, 0.0, 0.0, 0.0, 0.0]), 4)
        for push in (-6.0, 6.0, 10.0)
    ]
    # Σ f ρ² = F r², against C = 0.02 N·m²: at 8 N, before bending gives way
    assert [bool(one.buckles_in_torsion.all()) for one in found] == [False, False, True]
    assert [bool(one.stable) for one in found] == [True, True, False]


def test_dead_and_following_forces_agree_for_small_loads_and_differ_for_large_ones():
    arm, gaps = spring_arm(), []
    for size in (0.01, 0.1, 10.0):
        wrench = double([size, 0.0, size, 0.0, 0.0, 0.0])
        turned = se3.turn_wrench_back(as_base(None, double(0.0), 6), wrench.unsqueeze(0))[0]
        dead = ta.solve_equilibrium(arm, [0.0] * 4, wrench, 6)
        following = ta.ExternalLoad(points=[ta.PointLoad(turned, frame="body")])
        gaps.append(float((ta.solve_equilibrium(arm, [0.0] * 4, following, 6).poses - dead.poses).abs().max()) / size)
    assert gaps[1] / gaps[0] == pytest.approx(10, rel=0.1)  # the difference grows with the square of the load
    assert gaps[2] > 1e-3


@pytest.mark.parametrize(("wrench_at", "order"), [("start", 1), ("middle", 2)])
def test_refinement_converges_at_its_order(wrench_at, order):
    arm = ta.ArmDesign(offsets=ta.ring(0.05, 4, 0.3), length=0.4, actuators=[ta.Bellows(), ta.McKibben()] * 2, mass=0.3)
    load = ta.ExternalLoad([1.0, -2.0, 1.5, 0.02, 0.0, 0.05], True, [ta.PointLoad([0.0, 0.5, 0, 0, 0, 0], at=0.43)])
    pressure, tips = [20.0, 30.0, 15.0, 25.0], []
    for nodes in (10, 20, 40, 80, 640):
        found = ta.solve_equilibrium(arm, pressure, load, nodes, wrench_at=wrench_at)
        tips.append(found.poses[-1, :3, 3])
    errors = [float((tip - tips[-1]).norm()) for tip in tips[:-1]]
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    if order == 2:
        np.testing.assert_allclose(orders, 2, atol=0.5)
        assert errors[0] <= 0.003 * 0.4
    else:
        np.testing.assert_allclose(orders, 1, atol=0.35)


def test_gradients_by_finite_differences():
    first, second = arm_and_task(SCENES[6])[0].segments
    leaves = [
        double(np.linspace(5, 25, 10)),
        double([0.1, 0.5, -0.2, 0.02, 0.03, 0.0]),
        first.offsets.clone(),
        second.length.clone(),
        double(0.3),
        double(0.5),
        double([0.02, 0.002, -0.003, 0.4, 0.05, -0.03]),
    ]

    def twists(pressure, tip, offsets, length, mass, torsion, link):
        lower = ta.ArmDesign(
            offsets=offsets, length=0.3, actuators=first.actuators, mass=mass, torsion_stiffness=torsion
        )
        upper = ta.ArmDesign(offsets=second.offsets, length=length, actuators=second.actuators, torsion_stiffness=0.2)
        whole = ta.series([lower, ta.RigidLink(pose=se3.exp(link), mass=0.1), upper])
        load = ta.ExternalLoad(tip, True, [ta.PointLoad([0.0, 0.4, 0.1, 0.02, 0.0, 0.0], at=0.37, frame="body")])
        found = ta.solve_equilibrium(whole, pressure, load, [2, 2], tolerance=1e-12)
        assert found.converged
        return found.twists

    assert torch.autograd.gradcheck(twists, [leaf.requires_grad_() for leaf in leaves], eps=1e-5, atol=1e-6, rtol=1e-5)


def test_a_stiff_spring_converges():
    """Strains are known to 1e-16 and the stiffness is 1e7 N: no residual is below 1e-9 N."""
    for stiffness in (1e3, 1e5, 1e7):
        spring = ta.PolynomialActuator(((1, 0, -stiffness), (0, 1, 1.0)), (-0.5, 0.5), (0.0, 60.0), 60.0)
        arm = ta.ArmDesign([-0.05, 0.05], 0.4, [spring] * 2)
        found = ta.solve_equilibrium(arm, [10.0, 20.0], [1.0, -2.0, 0.3])
        assert found.status == "converged"
        assert found.residual < 1e-10
        torch.testing.assert_close(
            found.twists[:, 0].mean(), double(0.4 * (1 + 32 / (2 * stiffness))), rtol=0, atol=3 / stiffness
        )


def test_the_base_pose_of_a_planar_arm_lifts_to_space():
    assert np.allclose(se3.from_plane(double(BASE_POSE)), as_base(None, double(0.0), 6))
