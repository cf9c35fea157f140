"""The engine's balance and Newton step, against plain statics in torch and dense matrices by differences."""

from dataclasses import replace

import balances
import numpy as np
import pytest
import torch
from oracle.spatial import SCENES, arm_and_task

import torcharm as ta
from torcharm.engine.arms import arms_of, sizes_of
from torcharm.engine.arrays import make
from torcharm.engine.balance import Balance
from torcharm.engine.loads import loads_of
from torcharm.statics.cross_section import reaction_wrench
from torcharm.statics.external_load import required_wrench

HULL = {3: [0, 2], 6: [0, 4, 5]}
STEP = 1e-6
"""Of differences: their error is that of rounding, 1e-9 of the largest entries."""


class Case:
    """One arm under its load at a pressure and a shape that is no equilibrium."""

    def __init__(self, arm, load, base, nodes, twists, pressure, middle=False, shear=None):
        self.arm, self.load, self.base, self.nodes, self.middle = arm, load, base, nodes, middle
        self.twists, self.pressure = np.array(twists)[None], np.array(pressure)[None]
        self.arms = arms_of(arm, (1,), nodes, shear)
        self.loads = loads_of(arm, load, base, (1,), nodes, middle=middle)
        self.scratch = make(Balance, sizes_of(self.arms))
        self.shape = (sum(nodes), len(self.arms.unknown))

    def balance(self, twists=None, pressure=None, factor=1.0):
        residual, pivots = np.zeros((1, *self.shape)), np.zeros((1, 2), dtype=np.int64)
        pressure = self.pressure if pressure is None else pressure
        twists = self.twists if twists is None else twists
        balances.balances(self.arms, self.loads, pressure, twists, factor, self.scratch, residual, pivots)
        return residual[0], pivots[0]

    def slope(self, factor=1.0):
        """J by central differences."""
        columns = []
        for i in range(self.shape[0]):
            for c in self.arms.unknown:
                ends = []
                for sign in (1, -1):
                    twists = self.twists.copy()
                    twists[0, i, c] += sign * STEP
                    ends.append(self.balance(twists, factor=factor)[0].ravel())
                columns.append((ends[0] - ends[1]) / (2 * STEP))
        return np.stack(columns, -1)


LAW = ta.BendingFunction(lambda k, p: -(0.05 + p / 200) * (k + 0.2 * k**3), 50.0)
"""Of what is sampled, such cubics are exact."""


def with_law(arm):
    """The same arm, whose actuators all bear moments by the law."""
    models = [replace(model, bending_stiffness=LAW) for model in arm.actuators]
    across = {"radii": arm.radii} if arm.dimension == 2 else {"offsets": arm.offsets}
    return ta.ArmDesign(**across, length=arm.length, actuators=models, max_pressure=arm.max_pressure, mass=arm.mass)


def spatial_case(index, middle, shear=None, law=False):
    arm, task = arm_and_task(SCENES[index])
    arm = with_law(arm) if law else arm
    pressure = np.random.default_rng(index).uniform(0, 40, arm.actuator_count)
    return Case(arm, task.load, task.base_pose, list(task.segment_nodes), task.twists.numpy(), pressure, middle, shear)


def planar_case(middle, shear=None, points=True, law=False):
    """Two segments with a bent link, gravity, and loads of each kind at the ends of elements and inside."""
    rng = np.random.default_rng(1)
    half = ta.ArmDesign(ta.antagonistic_arm().radii, 0.5, ta.antagonistic_arm().actuators, mass=0.4)
    half = with_law(half) if law else half
    arm = ta.series([half, ta.RigidLink(pose=[0.05, 0.01, 0.3], mass=0.1), half])
    wrench = [0.5, 0.6, 0.07]
    loads = [
        ta.PointLoad(wrench, 0, 0.33),
        ta.PointLoad(wrench, 1, 0.33, "body", mass=0.2),
        ta.PointLoad(wrench, 1, 0.31, "body"),
        ta.PointLoad(wrench, 0, 1.0, mass=0.3),
        ta.PointLoad(wrench, 1, 0.0),
    ]
    twists = np.stack((rng.uniform(0.5, 0.52, 9), rng.uniform(0, 0.02, 9), rng.uniform(0, 1, 9)), -1)
    twists[:, 1] *= shear is not None
    load = ta.ExternalLoad([1.0, 2.0, 0.1], points, loads if points else ())
    base = torch.tensor([0.3, -0.2, -1.2], dtype=torch.float64)
    return Case(arm, load, base, [4, 5], twists, rng.uniform(0, 40, 8), middle, shear)


CASES = {
    **{f"space {i} {at}": (spatial_case, i, at == "middle") for i in range(8) for at in ("start", "middle")},
    "space, shear": (spatial_case, 6, True, 500.0),
    "plane start": (planar_case, False),
    "plane middle": (planar_case, True),
    "plane start, shear": (planar_case, False, 500.0),
    "plane middle, shear": (planar_case, True, 500.0),
    "plane, a tip load": (planar_case, False, None, False),
    "plane, a law of bending": (planar_case, True, None, True, True),
    "space, a law of bending": (spatial_case, 0, True, None, True),
}


def case_of(name):
    make, *arguments = CASES[name]
    return make(*arguments)


@pytest.mark.parametrize("name", CASES)
def test_the_residual_is_the_reaction_less_what_loads_require(name):
    case = case_of(name)
    segments = getattr(case.arm, "segments", (case.arm,))
    required = required_wrench(
        torch.from_numpy(case.twists[0]),
        case.load,
        case.base,
        wrench_at="middle" if case.middle else "start",
        segment_nodes=case.nodes,
        mass=[segment.mass for segment in segments],
        links=getattr(case.arm, "links", None),
    )
    twists = torch.from_numpy(case.twists[0]).split(case.nodes)
    pressure = torch.from_numpy(case.pressure[0]).split([segment.actuator_count for segment in segments])
    reaction = torch.cat([reaction_wrench(*parts) for parts in zip(segments, twists, pressure, strict=True)])
    hull = HULL[required.shape[-1]]
    found, _ = case.balance()
    rows = [list(case.arms.unknown).index(column) for column in hull]
    np.testing.assert_allclose(found[:, rows], reaction - required[:, hull], rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", CASES)
def test_solutions_are_those_of_the_dense_matrix_by_differences(name):
    case = case_of(name)
    slope = case.slope()
    right = np.random.default_rng(0).normal(size=(1, 4, *case.shape))
    found = right.copy()
    balances.solutions(case.arms, case.loads, case.pressure, case.twists, np.array([0]), case.scratch, found)
    for one, given in zip(found[0], right[0], strict=True):
        theirs = np.linalg.solve(slope, given.ravel())
        np.testing.assert_allclose(one.ravel(), theirs, rtol=0, atol=3e-8 * np.abs(theirs).max())


@pytest.mark.parametrize("name", CASES)
def test_slopes_by_pressure_and_load_are_those_by_differences(name):
    case = case_of(name)
    count = case.pressure.shape[1]
    by_pressure, by_load = np.zeros((1, count, *case.shape)), np.zeros((1, *case.shape))
    given = case.arms, case.loads, case.pressure, case.twists, 0.7, case.scratch
    balances.rates(*given, by_pressure, by_load)
    for a in range(count):
        ends = []
        for sign in (1, -1):
            pressure = case.pressure.copy()
            pressure[0, a] += sign * 1e-5
            ends.append(case.balance(pressure=pressure, factor=0.7)[0])
        np.testing.assert_allclose(by_pressure[0, a], (ends[0] - ends[1]) / 2e-5, rtol=0, atol=1e-7)
    slope = case.balance(factor=1.0)[0] - case.balance(factor=0.0)[0]  # it is linear in the load factor
    np.testing.assert_allclose(by_load[0], slope, rtol=0, atol=1e-12)


def test_positive_pivots_count_the_unstable_directions():
    """A straight arm alike in all directions under a growing push along it: two directions go at once, then four."""
    arm = ta.ArmDesign(offsets=ta.ring(0.04, 4), length=0.4, actuators=ta.Bellows())
    base = torch.tensor([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], dtype=torch.float64)
    twists = np.tile([0.4, 0, 0, 0, 0, 0], (8, 1)).astype(float)
    counts = []
    for push in (0.1, 1.0, 5.0, 20.0, 60.0):
        case = Case(arm, ta.ExternalLoad([0.0, push, 0, 0, 0, 0]), base, [8], twists, [10.0] * 4)
        values = np.linalg.eigvals(case.slope())
        counts.append(int((values.real > 0).sum()))
        _, pivots = case.balance()
        assert pivots.tolist() == [counts[-1], 0]
    assert counts[0] == 0
    assert 2 in counts
    assert counts[-1] >= 4


def test_a_direction_without_stiffness_takes_no_step():
    """Actuators in one plane, without pressure: nothing resists bending out of it, and nothing asks for it."""
    offsets = torch.tensor([[-0.05, 0.0], [0.05, 0.0]], dtype=torch.float64)
    arm = ta.ArmDesign(offsets=offsets, length=0.4, actuators=ta.Bellows())
    base = torch.eye(4, dtype=torch.float64)
    twists = np.tile([0.41, 0, 0, 0, 0, 0.1], (3, 1))
    case = Case(arm, ta.ExternalLoad(torch.zeros(6, dtype=torch.float64)), base, [3], twists, [0.0, 0.0])
    _, pivots = case.balance()
    assert pivots.tolist() == [0, 3]
    right = np.ones((1, 1, *case.shape))
    balances.solutions(case.arms, case.loads, case.pressure, case.twists, np.array([0]), case.scratch, right)
    assert (right[0, 0, :, 1] == 0).all()
    assert np.isfinite(right).all()
