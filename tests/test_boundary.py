from itertools import pairwise

import pytest
import torch

import torcharm as ta
from torcharm._boundary import find_boundary
from torcharm._branch_search import _distinct
from torcharm._continuation import resting
from torcharm._descent import Goal, Searches, Setting
from torcharm._reaching import Block, lowest
from torcharm._rounds import _inner, _measure, _normal
from torcharm.search import checked_outer, flat_problem, outer_poses

ARMS = {"antagonistic": ta.antagonistic_arm(), "bellows": ta.bellows_arm()}
# shares of the limits near which the arm buckles to one side or to the other, and the paper's load
CASES = {"antagonistic": ([0.75, 0.18, 0.3, 0.275], 85), "bellows": ([0.3, 0.1, 0.05, 0.25], 3)}


def block_of(arm, task):
    outer = checked_outer(arm, task)
    problem, _ = flat_problem(outer, None)
    weight = outer.twists.new_ones(outer.nodes + 1, 3)
    goal = Goal.of(outer_poses(outer), weight)
    setting = Setting(problem.arms, problem.scale, problem.arm.max_pressure.mT.contiguous(), goal)
    own = Searches.of(setting, problem.tolerance)
    return problem, Block(own, resting(problem).unknowns.movedim(0, -1).contiguous(), outer.nodes)


def boundary_from(block, place, steps=12):
    near = block.reach(place)
    normal = _normal(block, near)
    way = _inner(normal, place)
    return find_boundary(block.searches, place, near.quick, near.share, _measure(block, near), way, steps), normal


def crossing(name):
    """A block of one search, and its boundary, from a pressure beside it."""
    arm, (place, load) = ARMS[name], CASES[name]
    task = ta.Task(ta.affine_curvature(-3.0, 3.0, nodes=10), ta.sample_loads(100)[load : load + 1])
    problem, block = block_of(arm, task)
    edge, _ = boundary_from(block, torch.tensor(place, dtype=torch.float64).unsqueeze(1))
    return arm, task, problem, block, edge


@pytest.mark.parametrize("name", ARMS)
def test_the_boundary_is_a_singular_equilibrium(name):
    arm, _, problem, _, edge = crossing(name)
    assert edge.found.all()
    pressure = edge.place.mT * arm.max_pressure
    there = type(problem).of(
        problem.arm, pressure, problem.tip_load * edge.share, problem.base_pose, None, problem.tolerance
    )
    balance = there.balance(edge.unknowns.movedim(-1, 0))
    assert float(there.imbalance(balance.residual)) < 1e-7
    # in lengths and curvatures of like size
    size = torch.tensor([0.1, 1.0], dtype=torch.float64).repeat_interleave(10)
    matrix = balance.stiffness.reshape(20, 20) * size
    values = torch.linalg.svdvals(matrix / matrix.norm(dim=1, keepdim=True))
    assert values[-1] < 1e-5 * values[0]
    assert values[-2] > 1e-3 * values[0]


@pytest.mark.parametrize("name", ARMS)
def test_arms_go_to_different_sides_of_it(name):
    arm, task, _, _, edge = crossing(name)
    sides = []
    for away in (-0.03, -0.015, 0.015, 0.03):
        pressure = (edge.place + away * _inner(edge.normal, edge.place)).clamp(0, 1).mT * arm.max_pressure
        sides.append(ta.solve_equilibrium(arm, pressure, task.tip_load, 10).twists[0])
    apart = [(one - two).abs().max() for one, two in pairwise(sides)]
    assert apart[1] > 5 * apart[0]
    assert apart[1] > 5 * apart[2]


@pytest.mark.parametrize("name", ARMS)
def test_it_is_found_from_both_sides_and_its_normal_is_its_own(name):
    _, _, _, block, edge = crossing(name)
    way = _inner(edge.normal, edge.place)
    many = torch.zeros(2, dtype=torch.long)
    both = (edge.place + way * torch.tensor([-0.02, 0.02], dtype=torch.float64)).clamp(0, 1)
    start = block[many].reach(both)
    measure = _measure(block[many], start)
    again = find_boundary(block[many].searches, both, start.quick, start.share, measure, way.repeat(1, 2), 12)
    assert again.found.all()
    torch.testing.assert_close(again.place, edge.place.expand(-1, 2), rtol=0, atol=1e-6)
    # off along a tangent, the distance to it is of second order
    tangent = torch.zeros_like(edge.normal)
    tangent[1], tangent[2] = edge.normal[2], -edge.normal[1]
    tangent = tangent / tangent.norm()
    for step in (1e-3, -1e-3):
        guess = edge.unknowns + (edge.shift * (step * tangent)).sum(2)
        beside = find_boundary(
            block.searches, edge.place + step * tangent, guess, edge.share, measure[..., :1], edge.normal, 6
        )
        assert beside.found.all()
        assert ((beside.place - edge.place) * edge.normal).sum().abs() < 0.03 * abs(step)
        assert ((beside.place - edge.place) * tangent).sum().sub(step).abs() < 1e-9


def test_without_a_bifurcation_none_is_found():
    arm = ARMS["bellows"]
    task = ta.Task(ta.affine_curvature(-1.0, 1.0, nodes=5), torch.tensor([[1.0, 0.5, 0.0]], dtype=torch.float64))
    _, block = block_of(arm, task)
    place = torch.tensor([0.5, 0.4, 0.3, 0.2], dtype=torch.float64).unsqueeze(1)
    edge, _ = boundary_from(block, place)
    assert not edge.found.any()
    torch.testing.assert_close(edge.place, place)
    assert edge.unknowns.isfinite().all()
    assert (edge.normal == 0).all()


def test_lowest_of_each_row():
    rows = torch.tensor([2, 0, 2, 3, 0])
    cost = torch.tensor([5.0, 1.0, 4.0, float("inf"), 2.0], dtype=torch.float64)
    have, where = lowest(rows, cost, 5)
    assert have.tolist() == [0, 2]
    assert where.tolist() == [1, 2]


def test_in_single_precision_no_direction_is_none():
    arm = ARMS["bellows"]
    design = ta.ArmDesign(arm.radii.float(), arm.length.float(), arm.actuators)
    task = ta.Task(ta.affine_curvature(-3.0, 3.0, nodes=4), ta.sample_loads(1)).to(torch.float32)
    _, block = block_of(design, task)
    near = block.reach(torch.full((4, 1), 0.5))
    still = near._replace(rush=torch.zeros_like(near.rush))
    assert torch.equal(_measure(block, still), still.rush)
    assert torch.equal(_normal(block, still), torch.zeros(4, 1))


def test_places_are_told_apart_by_where_they_come_first():
    columns = torch.tensor([[1.0, 0.0, 1.0, 0.0, 1.0], [2.0, 2.0, 2.0, 2.0, 3.0]])
    assert _distinct(columns).tolist() == [0, 1, 4]
    assert _distinct(columns[:, :0]).tolist() == []
