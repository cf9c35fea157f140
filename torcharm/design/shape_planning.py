"""Shapes for a tip: the centreline through a tip pose that an arm can best hold, or that is smoothest."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.arm_series import ArmSeries, segments_of
from torcharm.attainability import Attainability, evaluate
from torcharm.design.objective import Objective, task_values
from torcharm.design.space import Arm, Array
from torcharm.design.tip_problem import LENGTH_UNIT, Cost, TipProblem, strain_rows, value_and_slope, why_no_shape
from torcharm.equilibrium.solve import segment_counts, whole_load
from torcharm.geometry import rod
from torcharm.inputs import HoldsTensors, TensorLike, as_floating, check_count, check_finite, check_number, shown
from torcharm.load import ExternalLoad
from torcharm.task import Task, check_segments

TIP_TOLERANCE = 1e-8
"""By how much a tip may miss its pose [m, rad] for a plan to count as one."""

MOST_STRETCH = 3.0
"""A length over an arm's that no actuator takes: a shape that needs it is none."""


@dataclass(frozen=True)
class Smoothness:
    """The paper's heuristic: `a ‖l - l_ref‖ + ‖Δκ‖` over the lengths (N) and the steps (N-1) of curvature.

    Euclidean norms, not squared, and a length of its own for each element: so read, (45, 0.5 m) gives the published
    shape 1. A large a keeps all lengths at l_ref exactly. In series curvature may jump from one segment to the next.

    Attributes:
        length_weight: a [rad/m].
        reference_length: l_ref [m], of each segment.

    Raises:
        ValueError: the weight is negative, the length is not above 0, or one is not finite.

    Example:
        >>> smooth = ta.Smoothness(length_weight=45.0, reference_length=0.5)
        >>> plan = ta.plan_shape(ta.bellows_arm(), [0.12, -0.48, -1.1], [0.0, 0.0, 0.0], smooth, nodes=4)
        >>> plan.twists[:, 0].round(decimals=2).tolist()  # elements keep their length
        [0.5, 0.5, 0.5, 0.5]
    """

    length_weight: float
    reference_length: float

    def __post_init__(self) -> None:
        check_number("length_weight", self.length_weight, 0.0)
        check_number("reference_length", self.reference_length, 0.0, strict=True, unit="m")


PAPER_SHAPES = (Smoothness(45.0, 0.5), Smoothness(20.0, 0.5), Smoothness(4.0, 0.51))
"""Of the paper's shape study."""


@dataclass(frozen=True, eq=False, repr=False)
class PlannedShape(HoldsTensors):
    """A shape, and what it takes to trust it.

    Attributes:
        status: "found"; or "no shape: ..." with why: then numbers are NaN, and there is no attainability.
        twists: (N, 3) or (N, 6) [m, rad], segment after segment.
        tip_error: the largest entry of the tip's error, as of `pose_errors` [m, rad].
        cost: what was minimised.
        attainability: of the shape under the loads, as `evaluate` finds with the objective's options (for a
            heuristic, with its own).

    Example:
        >>> plan = ta.plan_shape(ta.antagonistic_arm(), [0.12, -0.48, -1.1], [1.0, 0.0, 0.0], nodes=2, starts=1)
        >>> plan.found, plan.attainability.verdict  # it ends there, and the arm can hold it
        (True, 'held')
    """

    status: str
    twists: Tensor
    tip_error: float
    cost: float
    attainability: Attainability | None

    @property
    def found(self) -> bool:
        """Whether the tip is met to 1e-8, within the strain ranges if they are asked for."""
        return self.status == "found"

    def __repr__(self) -> str:
        """Shapes and the outcome, no tensors."""
        return f"PlannedShape(twists {tuple(self.twists.shape)}, cost {self.cost:.4g}, {self.status})"


def plan_shape(
    arm: Arm,
    tip_pose: TensorLike,
    load: TensorLike | ExternalLoad,
    objective: Objective | Smoothness | None = None,
    *,
    nodes: int | Sequence[int] = 10,
    base_pose: TensorLike | str | None = None,
    in_range: bool | None = None,
    starts: int = 4,
    seed: int = 0,
    iterations: int = 200,
) -> PlannedShape:
    """The shape through a tip pose that minimises an objective of one arm under its loads.

    A shape of N elements is its lengths and curvatures, 2N unknowns in the plane and 3N in space; the tip takes three
    or six. Each element's wrench is taken at its middle. scipy's SLSQP with torch's gradients from several starts, and
    a last Newton step onto the tip pose. That no shape was found is no error but said by the `status`.

    Args:
        arm: one design, or segments in series with their links.
        tip_pose: (3,) [m, m, rad] or (4, 4) in the world frame. Headings in the plane are not wrapped: the arm turns by
            `tip heading - base heading` in all, so adding 2π asks for a loop more.
        load: under which the shape is to be held: tip loads (..., 3) or (..., 6) in the world frame [N, N·m], or an
            `ExternalLoad` with the arm's weight and payloads. Several count as the objective says.
        objective: of the shape as a task of this arm; None takes absolute plus relative unattainability, of squared
            distances and without margins, so that any attainable shape will do. Or a `Smoothness`, of which the arm
            and the loads have no part.
        nodes: number of elements, of each segment or one for each; N in all. One element a segment makes a shape of
            constant curvature in each.
        base_pose: (3,) or (4, 4) pose of node 1, or "hanging" (None), "upright" or "horizontal".
        in_range: whether all strains stay in the actuators' characterised range; None: unless the objective is
            a `Smoothness`.
        starts: the first start is the circular arc of the right turn; the others bend at random.
        seed: of these.
        iterations: of a start, at most.

    Raises:
        ValueError: an argument is none of those allowed.

    Example:
        >>> plan = ta.plan_shape(ta.antagonistic_arm(), [0.12, -0.48, -1.1], [1.0, 0.0, 0.0], nodes=2, starts=1)
        >>> plan.status, ta.poses(plan.twists)[-1].round(decimals=3).tolist()
        ('found', [0.12, -0.48, -1.1])
    """
    problem, whole = _problem(arm, tip_pose, load, objective, nodes, base_pose, in_range)
    check_count("starts", starts, 1)
    if objective is None:
        objective = Objective("unattainability", power=2, relative_weight=1.0, margin=False)
    if isinstance(objective, Smoothness):
        plans = [_smoothest(problem, objective, iterations)]
    else:
        plans = _best_held(problem, objective, whole, starts, seed, iterations)
    met = [plan for plan in plans if problem.violation(plan[0]) < TIP_TOLERANCE]
    like = segments_of(arm)[0][0].radii
    if not met:
        none = torch.full((problem.count, 3 * arm.dimension - 3), torch.nan).to(like)
        return PlannedShape(why_no_shape(problem), none, math.nan, math.nan, None)
    values = [float(cost(torch.from_numpy(unknowns))) for unknowns, cost in met]
    best = met[int(np.argmin(values))][0]
    twists = problem.twists(torch.from_numpy(best)).to(like)
    options: Any = {"weights": objective.weights, "power": objective.power} if isinstance(objective, Objective) else {}
    error = float(np.abs(problem.tip_miss(best)).max())
    return PlannedShape("found", twists, error, min(values), evaluate(arm, problem.task(twists, whole), **options))


def nearest_shape(arm: Arm, task: Task, tip_pose: TensorLike) -> Tensor | None:
    """The shape nearest to a task's whose tip is at a pose: what a dragged tip leaves of it, in milliseconds.

    Newton's method, of which each step is the least change of lengths (in units of 0.1 m) and bends (in rad); so it is
    nearest where the tip is moved a little. Without shear and torsion.
    Strains are not limited, and no load is looked at: `plan_shape` does both.

    Args:
        arm: one design, or segments in series with their links.
        task: one shape, and where its base is.
        tip_pose: (3,) or (4, 4), as of `plan_shape`.

    Returns:
        (N, 3) or (N, 6) twists; None where none was found, or one that leaves an actuator no length or an element
        more than three times the arm's.

    Raises:
        ValueError: arm, task and pose do not fit.
    """
    nodes = task.nodes_of_segments
    problem, _ = _problem(arm, tip_pose, task.load, PAPER_SHAPES[0], nodes, task.base_pose, False)
    near = problem.onto_tip(problem.unknowns(task.twists), accuracy=0.1 * TIP_TOLERANCE)
    if not problem.violation(near) < TIP_TOLERANCE:
        return None
    twists = problem.twists(torch.from_numpy(near)).to(task.twists)
    segments = zip(segments_of(arm)[0], twists.split(nodes), strict=True)
    lengths = [rod.actuator_lengths(own, part.radii if arm.dimension == 2 else part.offsets) for part, own in segments]
    longest = MOST_STRETCH * float(problem.neutral.max())
    sound = all(bool((length > 0).all()) for length in lengths) and bool((twists[:, 0] > 0).all())
    return twists if sound and bool((twists[:, 0] < longest).all()) else None


def _problem(
    arm: Arm,
    tip_pose: TensorLike,
    load: TensorLike | ExternalLoad,
    objective: Objective | Smoothness | None,
    nodes: int | Sequence[int],
    base_pose: TensorLike | str | None,
    in_range: bool | None,
) -> tuple[TipProblem, ExternalLoad]:
    if not isinstance(arm, (ArmDesign, ArmSeries)) or arm.batch_shape:
        raise ValueError(f"arm: must be one design, got {shown(arm)}")
    if objective is not None and not isinstance(objective, (Objective, Smoothness)):
        raise ValueError(f"objective: must be an Objective or a Smoothness, got {shown(objective)}")
    segments = segments_of(arm)[0]
    counts = segment_counts(nodes, len(segments))
    if sum(counts) < 2:
        raise ValueError(f"nodes: must be at least 2 in all, got {sum(counts)}")
    columns, like = 3 * arm.dimension - 3, segments[0].radii
    base = rod.as_base(base_pose, like, columns)
    goal, start, _ = as_floating(tip_pose=tip_pose, base_pose=base, arm=like)
    shape = rod.group_of(columns).POSE_SHAPE
    for name, value in (("tip_pose", goal), ("base_pose", start)):
        if value.shape != shape:
            raise ValueError(f"{name}: must have shape {shape} for this arm, got {tuple(value.shape)}")
        check_finite(name, value)
        rod.check_rigid(name, value)
    if not isinstance(load, ExternalLoad):
        load, _ = as_floating(load=load, arm=like)
    whole = whole_load(load, columns, like)
    check_segments(whole, len(segments))
    limited = not isinstance(objective, Smoothness) if in_range is None else in_range
    strains = strain_rows(arm, counts) if limited else None
    return TipProblem(arm, goal.double().cpu(), start.double().cpu(), counts, strains), whole


def _norm(value: Tensor) -> Tensor:
    """The Euclidean norm, but that its gradient at 0 is 0."""
    return (value.square().sum() + 1e-300).sqrt()


def _smoothest(problem: TipProblem, objective: Smoothness, iterations: int) -> tuple[Array, Cost]:
    """The smoothest shape.

    `a ‖l - l_ref‖` has a kink at l = l_ref, where its minimum sits if a is large. So first lengths are held there; and
    only if a step away from them pays, `‖J_lᵀ λ‖ > a` with λ the multipliers of the tip pose, are they let go.
    """
    count, bends, reference = problem.count, problem.bends, objective.reference_length / LENGTH_UNIT

    def steps(z: Tensor) -> Tensor:
        return torch.cat([part.diff() for part in problem.curvatures(z)], -1)

    def cost(z: Tensor) -> Tensor:
        return objective.length_weight * LENGTH_UNIT * _norm(z[:count] - reference) + _norm(steps(z))

    start = problem.arc(np.full(len(problem.nodes), objective.reference_length))
    pinned = problem.minimise(lambda z: steps(z).square().sum(), problem.onto_tip(start, bends), iterations, bends)
    if problem.violation(pinned) < TIP_TOLERANCE:
        _, slope = value_and_slope(cost, pinned)
        jacobian = problem.tip_jacobian(pinned)
        multipliers, *_ = np.linalg.lstsq(jacobian[:, bends].T, -slope[bends], rcond=None)
        pull = float(np.linalg.norm(jacobian[:, :count].T @ multipliers))
        if problem.strains is None and pull <= objective.length_weight * LENGTH_UNIT:
            return pinned, cost
        start = pinned
        start[:count] -= 1e-3 * (jacobian[:, :count].T @ multipliers) / max(pull, 1e-300)
    return problem.minimise(cost, problem.onto_tip(start), iterations), cost


def _best_held(
    problem: TipProblem, objective: Objective, load: ExternalLoad, starts: int, seed: int, iterations: int
) -> list[tuple[Array, Cost]]:
    """From each start the shape that the arm holds best."""
    like = segments_of(problem.arm)[0][0].radii

    def cost(z: Tensor) -> Tensor:
        shaped = problem.task(problem.twists(z).to(like), load)
        values = task_values(objective, problem.arm, shaped, in_range=problem.strains is not None)
        return objective.total(values).double()

    random = np.random.default_rng(seed)
    plans: list[tuple[Array, Cost]] = []
    for index in range(starts):
        wished = problem.arc(problem.neutral)
        if index:
            wished[problem.bends] += random.normal(0.0, 1.0, len(wished) - problem.count)
        near = torch.from_numpy(wished)
        start = problem.minimise(lambda z, near=near: (z - near).square().sum(), wished, 100)  # type: ignore[misc]
        if problem.violation(start) < TIP_TOLERANCE:
            plans.append((problem.minimise(cost, start, iterations, tolerance=1e-9), cost))
    return plans
