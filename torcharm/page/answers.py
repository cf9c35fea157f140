"""What a state means: an arm at its pressures on a task, evaluated."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.arm_series import segments_of
from torcharm.attainability import Attainability, evaluate
from torcharm.attainability.reasons import differences
from torcharm.design.shape_planning import nearest_shape, plan_shape
from torcharm.design.space import Arm
from torcharm.equilibrium.problem import Problem
from torcharm.equilibrium.stability import buckles_in_torsion
from torcharm.geometry import rod
from torcharm.geometry.alpha_shape import AlphaShape
from torcharm.page.state import BEST, State, design_of, pressure_of, task_of
from torcharm.plot._common import Array, array
from torcharm.pressure.at_pressure import error_at_pressure
from torcharm.pressure.search import LESS_COMPRESSION
from torcharm.statics.balance import link_ends
from torcharm.statics.external_load import HULL, task_wrench
from torcharm.study.words import region_size
from torcharm.task import Task
from torcharm.workspaces import workspace
from torcharm.wrench_sets.wrench_set import wrench_hulls

STATES = 4000
"""Of the swept workspace: it is a picture, to be there in a second or, in space, some."""


@dataclass(frozen=True, eq=False)
class NodeSet:
    """What one node can provide, and what is required of it: `(f_x, m)`, or `(f_x, m_y, m_z)` in space [N, N·m].

    Attributes:
        node: from 0.
        corners: (V, 2 or 3) of the set, in the plane in order.
        required: (2 or 3).
        inside: whether the one holds the other.
    """

    node: int
    corners: Array
    required: Array
    inside: bool


@dataclass(frozen=True, eq=False)
class Answer:
    """What is known of a state.

    Attributes:
        state: which it is.
        arm: the design, and
        task: its task, of one shape and one load.
        found: the evaluation, of the prediction or at the pressures by hand.
        twists: (N, K) the shape that the arm takes; None where none was found.
        pressure: (M,) [kPa].
        margins: (N,) how far inside its set each node's requirement is, below 0 outside; 1 N·m counts as 1 N unless
            the study weighs them otherwise.
        node_set: of the node that is shown.
        verdict: a word, and
        reason: why, or nothing.
        warnings: what to know before trusting the figures.
        region: where the tip can be under the state's load, where that was asked for.
    """

    state: State
    arm: Arm
    task: Task
    found: Attainability
    twists: Tensor | None
    pressure: tuple[float, ...]
    margins: Array
    node_set: NodeSet
    verdict: str
    reason: str
    warnings: tuple[str, ...]
    region: AlphaShape | None = None


@torch.no_grad()
def answer(state: State) -> Answer:
    """Evaluate a state."""
    arm, task = design_of(state), task_of(state)
    found, buckled = _evaluated(state, arm, task)
    prediction, distances = found.prediction, found.absolute_per_node
    assert prediction is not None
    assert distances is not None
    known = bool(prediction.stable)
    twists = prediction.twists.detach() if known else None
    return Answer(
        state=state,
        arm=arm,
        task=task,
        found=found,
        twists=twists,
        pressure=tuple(prediction.pressure.tolist()),
        margins=-array(distances),
        node_set=_node_set(arm, task, state.node, bool(distances[state.node] <= 0)),
        verdict=str(found.verdict),
        reason=_reason(state, found, twists),
        warnings=tuple(_warnings(state, found, twists, buckled)),
    )


def _evaluated(state: State, arm: Arm, task: Task) -> tuple[Attainability, bool]:
    """The evaluation, and whether the arm buckles in torsion at the shape that it takes."""
    settings = state.study.settings
    how: dict[str, Any] = {"tolerance": settings.tolerance, "weights": settings.weights, "signed": True}
    if state.mode == BEST:
        found = evaluate(arm, task, **how)
    else:
        given = torch.tensor(pressure_of(state), dtype=torch.float64)
        found = evaluate(arm, task, found=error_at_pressure(arm, task, given), **how)
    prediction = found.prediction
    assert prediction is not None
    return found, bool(prediction.stable) and _buckles(arm, task, prediction.pressure, prediction.twists)


def settled(found: Answer) -> State:
    """The state with the pressures that were found, where they are the task's best."""
    if found.state.mode != BEST or not all(map(math.isfinite, found.pressure)):
        return found.state
    return replace(found.state, pressure=found.pressure)


def place_of_node(task: Task, node: int) -> tuple[int, int]:
    """The segment on which a node is, and its number there, all from 0."""
    counts, segment = task.nodes_of_segments, 0
    while node >= counts[segment]:
        node -= counts[segment]
        segment += 1
    return segment, node


def _node_set(arm: Arm, task: Task, node: int, inside: bool) -> NodeSet:
    """Of the one node alone, as its segment's other nodes have no part in it."""
    segment = segments_of(arm)[0][place_of_node(task, node)[0]]
    corners = array(wrench_hulls(segment, task.twists[node : node + 1]).vertices[0])
    required = array(task_wrench(arm, task)[node, HULL[task.twists.shape[-1]]])
    return NodeSet(node, corners, required, inside)


def _buckles(arm: Arm, task: Task, pressure: Tensor, twists: Tensor) -> bool:
    if arm.dimension == 2 or all(one.torsion_stiffness is None for one in segments_of(arm)[0]):
        return False
    nodes = task.nodes_of_segments
    problem = Problem(arm, pressure, task.load, task.base_pose, nodes, task.wrench_at, None, torch.Size())
    return bool(buckles_in_torsion(problem, twists).any())


def _reason(state: State, found: Attainability, twists: Tensor | None) -> str:
    """Why the task is not held. Of pressures by hand nothing is said of others, which were not tried."""
    if state.mode == BEST or found.verdict != "missed" or twists is None:
        return str(found.reason)
    assert found.tip_error is not None
    task = found.task
    wrong = differences(task.twists, twists.to(task.twists), task.nodes_of_segments)
    off = f"tip off by {1e3 * float(found.tip_error):.3g} mm at these pressures"
    return f"{off}: {wrong}" if wrong else off


def _warnings(state: State, found: Attainability, twists: Tensor | None, buckled: bool) -> Iterator[str]:
    prediction = found.prediction
    assert prediction is not None
    if not bool(found.in_range) and not bool(found.impossible):
        yield "Out of range: there the force models are extrapolated."
    if twists is None:
        yield "No stable equilibrium was found: the task's shape alone is shown."
    elif state.mode == BEST and not bool(prediction.reached):
        yield "Snapped: stable, but loading from rest leads to another shape."
    elif not bool(prediction.reached):
        yield f"Snapped: on the way to the full load the arm jumped; other shapes are possible. Try {LESS_COMPRESSION}."
    if buckled:
        yield "Torsion: pushing actuators take all stiffness against torsion away; the arm would twist aside."


def followed(state: State, pose: Array) -> Tensor | None:
    """The shape nearest to the state's whose tip is at a pose (4, 4), dragged there; None if there is none."""
    arm, task = design_of(state), task_of(state)
    heading = float(_tip_of(arm, task)[2]) if arm.dimension == 2 else None
    return nearest_shape(arm, task, _in_group(pose, heading))


def planned(state: State) -> tuple[Tensor | None, str]:
    """A shape through the state's tip that lacks as little as any, or None, and in words what came of it."""
    arm, task = design_of(state), task_of(state)
    nodes = task.nodes_of_segments
    found = plan_shape(arm, _tip_of(arm, task), task.load, nodes=nodes, base_pose=task.base_pose, starts=1)
    if not found.found:
        return None, f"Not planned, {found.status}."
    return found.twists, "Planned: a shape through this tip whose nodes lack as little as any."


def swept(state: State) -> tuple[AlphaShape, str]:
    """Where the tip can be under the state's load, over all pressures, and how large that is in words."""
    task = task_of(state)
    how: dict[str, Any] = {"base_pose": task.base_pose, "wrench_at": task.wrench_at}
    found = workspace(design_of(state), task.load, states=STATES, **how)
    if not bool(found.reached.any()):
        return found.region, "Nothing is reached under this load within what was characterised."
    return found.region, f"The tip reaches {region_size(found)} under this load, within what was characterised."


def same_reach(one: State, other: State) -> bool:
    """Whether the tip reaches the same places in two states: those of one arm under one load."""
    keys = [
        (state.arm, state.task, state.load, state.designs[state.arm], state.tip, state.payload, state.gravity)
        for state in (one, other)
    ]
    return one.study is other.study and keys[0] == keys[1]


def _tip_of(arm: Arm, task: Task) -> Tensor:
    """Where a task's shape ends, links included."""
    links = [None if end is None else end.to(task.twists) for end in link_ends(arm)]
    return rod.poses(task.twists, task.base_pose, segment_nodes=task.segment_nodes, links=links)[-1]


def _in_group(pose: Array, near: float | None) -> Tensor:
    """A pose (4, 4) as one of an arm in space, or in the plane: (x, y, θ), with θ within half a turn of another."""
    if near is None:
        return torch.from_numpy(np.ascontiguousarray(pose, np.float64))
    heading = math.atan2(pose[1, 0], pose[0, 0])
    turns = round((near - heading) / (2 * math.pi))
    return torch.tensor([pose[0, 3], pose[1, 3], heading + 2 * math.pi * turns], dtype=torch.float64)
