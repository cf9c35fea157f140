"""Shapes for a tip: the centreline through a tip pose that an arm can best hold, or that is smoothest.

A shape of N segments is its lengths l_i and curvatures κ_i (no shear), 2N unknowns; the tip pose takes three.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from torcharm._inputs import TensorLike, as_floating, check_count, check_finite, shown
from torcharm.arm import ArmDesign, check_planar
from torcharm.attainability import Attainability, evaluate
from torcharm.geometry import rod
from torcharm.geometry.rod import BASE_POSE
from torcharm.optimise.objective import Objective
from torcharm.task import Task

TIP_TOLERANCE = 1e-8
"""By how much a tip may miss its pose [m, rad] for a plan to count as one."""
STRAIN_SLACK = 1e-7
"""By how much of a length [m] strains stay off the ends of their range."""
_LENGTH_UNIT = 0.1  # lengths in it vary as much as curvatures do
_PINNED = 1e-9

Array = npt.NDArray[np.float64]
Cost = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Smoothness:
    """The paper's heuristic: `a ‖l - l_ref‖ + ‖Δκ‖` over the lengths (N) and the steps (N-1) of curvature.

    Euclidean norms, not squared, and a length of its own for each segment: so read, (45, 0.5 m) gives the published
    shape 1. A large a keeps all lengths at l_ref exactly.

    Attributes:
        length_weight: a [rad/m].
        reference_length: l_ref [m].
    """

    length_weight: float
    reference_length: float

    def __post_init__(self) -> None:
        for name, low in (("length_weight", -1e-300), ("reference_length", 0.0)):
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and low < value < math.inf):
                raise ValueError(f"{name}: must be finite and {'above' if low == 0 else 'at least'} 0, got {value!r}")


PAPER_SHAPES = (Smoothness(45.0, 0.5), Smoothness(20.0, 0.5), Smoothness(4.0, 0.51))
"""Of the paper's shape study."""


@dataclass(frozen=True, eq=False)
class PlannedShape:
    """A shape, and what it takes to trust it.

    Attributes:
        twists: (N, 3) [m, m, rad].
        tip_error: the largest entry of tip pose minus what was asked for [m, m, rad].
        cost: what was minimised.
        stationarity: norm of the cost's gradient, balanced by the constraints as far as they can, over its norm
            unbalanced: 0 at a minimum.
        converged: whether the tip is met to 1e-8 and, for a heuristic, stationarity is below 1e-5. Unattainability
            may have a kink at its minimum, where stationarity stays large.
        attainability: of the shape under the loads, as `evaluate` finds with the objective's options (for a
            heuristic, with its own).
    """

    twists: Tensor
    tip_error: float
    cost: float
    stationarity: float
    converged: bool
    attainability: Attainability


def plan_shape(
    arm: ArmDesign,
    tip_pose: TensorLike,
    tip_load: TensorLike,
    objective: Objective | Smoothness | None = None,
    *,
    nodes: int = 10,
    base_pose: TensorLike = BASE_POSE,
    in_range: bool | None = None,
    starts: int = 4,
    seed: int = 0,
    iterations: int = 200,
) -> PlannedShape:
    """The shape through a tip pose that minimises an objective of one arm under tip loads.

    scipy's SLSQP with torch's gradients from several starts, and a last Newton step onto the tip pose.

    Args:
        arm: one design.
        tip_pose: (3,) [m, m, rad] in the world frame. Headings are not wrapped: the arm turns by
            `tip heading - base heading` in all, so adding 2π asks for a loop more.
        tip_load: (3,) or (..., 3) loads under which the shape is to be held [N, N, N·m]; several count
            as the objective says.
        objective: the objective of the shape as a task of this arm; None takes absolute plus relative unattainability,
            of squared distances and without margins, so that any attainable shape will do. Margins ask for many more
            iterations. Or a `Smoothness`, of which the arm and the loads have no part.
        nodes: N.
        base_pose: (3,) pose of node 1 [m, m, rad].
        in_range: whether all strains stay in the actuators' characterised range; None: unless the objective is
            a `Smoothness`.
        starts: the first start is the circular arc of the right turn; the others bend at random.
        seed: of these.
        iterations: of a start, at most.

    Raises:
        ValueError: an argument is none of those allowed, or no shape meets the tip pose (and the strain ranges).
    """
    if not isinstance(arm, ArmDesign) or arm.batch_shape:
        raise ValueError(f"arm: must be one design, got {shown(arm)}")
    check_planar(arm)
    if objective is not None and not isinstance(objective, (Objective, Smoothness)):
        raise ValueError(f"objective: must be an Objective or a Smoothness, got {shown(objective)}")
    check_count("nodes", nodes, 2)
    check_count("starts", starts, 1)
    goal, base, load, _ = as_floating(tip_pose=tip_pose, base_pose=base_pose, tip_load=tip_load, arm=arm.radii)
    for name, value in (("tip_pose", goal), ("base_pose", base)):
        if value.shape != (3,):
            raise ValueError(f"{name}: must have shape (3,), got {tuple(value.shape)}")
        check_finite(name, value)
    judge = Objective(power=2, relative_weight=1.0, margin=False) if objective is None else objective
    limited = not isinstance(judge, Smoothness) if in_range is None else in_range
    problem = _TipProblem(arm, goal.double(), base.double(), nodes, _strain_rows(arm, nodes) if limited else None)
    if isinstance(judge, Smoothness):
        plans = [_smoothest(problem, judge, iterations)]
    else:
        plans = _best_held(
            problem, judge, Task(torch.zeros(nodes, 3).to(arm.radii), load, base), starts, seed, iterations
        )
    met = [plan for plan in plans if problem.violation(plan[0]) < TIP_TOLERANCE]
    if not met:
        ranges = " with all strains in the actuators' characterised range" if limited else ""
        raise ValueError(f"tip_pose: no shape of {nodes} segments was found that meets {goal.tolist()}{ranges}")
    unknowns, cost = min(met, key=lambda plan: float(plan[1](torch.from_numpy(plan[0]))))
    return _plan(problem, judge, unknowns, cost, load)


def _plan(
    problem: "_TipProblem", judge: Objective | Smoothness, unknowns: Array, cost: Cost, load: Tensor
) -> PlannedShape:
    at = torch.from_numpy(unknowns)
    twists = problem.twists(at).to(problem.arm.radii)
    task = Task(twists, load, problem.base.to(twists))
    if isinstance(judge, Objective):
        attainability = judge.results(problem.arm, (task,))[0]
    else:
        attainability = evaluate(problem.arm, task)
    error = float(np.abs(problem.tip_miss(unknowns)).max())
    stationarity = _stationarity(problem, cost, unknowns)
    converged = error < TIP_TOLERANCE and (isinstance(judge, Objective) or stationarity < 1e-5)
    return PlannedShape(twists, error, float(cost(at)), stationarity, converged, attainability)


@dataclass(frozen=True, eq=False)
class _TipProblem:
    """Unknowns z = (l / 0.1 m, κ) of a shape, and their constraints.

    Attributes:
        goal, base: (3,) poses.
        strains: rows A and bounds b of `A z ≤ b`; None without.
    """

    arm: ArmDesign
    goal: Tensor
    base: Tensor
    nodes: int
    strains: tuple[Array, Array] | None

    def twists(self, unknowns: Tensor) -> Tensor:
        length, curvature = unknowns[: self.nodes] * _LENGTH_UNIT, unknowns[self.nodes :]
        return torch.stack((length, torch.zeros_like(length), curvature), -1)

    def _miss(self, unknowns: Tensor) -> Tensor:
        return rod.poses(self.twists(unknowns), self.base)[-1] - self.goal

    def tip_miss(self, unknowns: Array) -> Array:
        """(3,) [m, m, rad]."""
        return self._miss(torch.from_numpy(unknowns)).numpy()

    def tip_jacobian(self, unknowns: Array) -> Array:
        """(3, 2N)."""
        found = torch.autograd.functional.jacobian(self._miss, torch.from_numpy(unknowns))
        return np.asarray(found)

    def violation(self, unknowns: Array) -> float:
        """Of the tip pose, and of strains."""
        over = 0.0 if self.strains is None else float((self.strains[0] @ unknowns - self.strains[1]).max())
        return max(float(np.abs(self.tip_miss(unknowns)).max()), over)

    def onto_tip(self, unknowns: Array, free: slice = slice(None), steps: int = 20) -> Array:
        """The nearest unknowns, by Newton's method, whose tip is where it should be; some may be held."""
        z = unknowns.copy()
        for _ in range(steps):
            miss = self.tip_miss(z)
            if np.abs(miss).max() < 1e-14:
                break
            z[free] -= np.linalg.pinv(self.tip_jacobian(z)[:, free]) @ miss
        return z

    def minimise(
        self, cost: Cost, start: Array, iterations: int, free: slice = slice(None), tolerance: float = 1e-15
    ) -> Array:
        """The unknowns that SLSQP reaches, those not free held, and put onto the tip pose."""
        from scipy.optimize import minimize

        held = start.copy()
        scale = abs(float(cost(torch.from_numpy(start)))) or 1.0

        def whole(part: Array) -> Array:
            z = held.copy()
            z[free] = part
            return z

        def value(part: Array) -> tuple[float, Array]:
            z = torch.from_numpy(whole(part)).requires_grad_()
            found = cost(z)
            (slope,) = torch.autograd.grad(found, z)
            sound = bool(found.isfinite()) and bool(slope.isfinite().all())
            return (found.item() / scale, slope.numpy()[free] / scale) if sound else (1e30, np.zeros_like(part))

        limits = [
            {
                "type": "eq",
                "fun": lambda part: self.tip_miss(whole(part)),
                "jac": lambda part: self.tip_jacobian(whole(part))[:, free],
            }
        ]
        if self.strains is not None:
            rows, bound = self.strains
            limits.append(
                {"type": "ineq", "fun": lambda part: bound - rows @ whole(part), "jac": lambda part: -rows[:, free]}
            )
        options = {"maxiter": iterations, "ftol": tolerance}
        answer = minimize(value, start[free], jac=True, method="SLSQP", constraints=limits, options=options)
        return self.onto_tip(whole(answer.x), free)


def _strain_rows(arm: ArmDesign, nodes: int) -> tuple[Array, Array]:
    """`(1 + ε₋) l̂ ≤ l - r κ ≤ (1 + ε₊) l̂` for every actuator at every node, over the unknowns."""
    radii, neutral = arm.radii.detach().double().numpy(), arm.length.detach().double().numpy()
    rows, bounds = [], []
    for index, model in enumerate(arm.actuators):
        own = np.hstack((_LENGTH_UNIT * np.eye(nodes), -radii[index] * np.eye(nodes)))
        for sign, edge in zip((-1.0, 1.0), model.strain_range, strict=True):
            if math.isfinite(edge):
                rows.append(sign * own)
                bounds.append(np.full(nodes, sign * (1 + edge) * neutral[index] - STRAIN_SLACK))
    if not rows:
        return np.zeros((1, 2 * nodes)), np.ones(1)
    return np.concatenate(rows), np.concatenate(bounds)


def _arc(problem: _TipProblem, length: float) -> Array:
    """Unknowns of the arc of constant curvature whose heading ends where it should."""
    turn = float(problem.goal[2] - problem.base[2])
    return np.concatenate((np.full(problem.nodes, length / _LENGTH_UNIT), np.full(problem.nodes, turn)))


def _norm(value: Tensor) -> Tensor:
    """The Euclidean norm, whose gradient at 0 is 0."""
    square = value.square().sum()
    nought = square < 1e-300
    return torch.where(nought, 0.0, torch.where(nought, 1.0, square).sqrt())


def _smoothest(problem: _TipProblem, judge: Smoothness, iterations: int) -> tuple[Array, Cost]:
    """The smoothest shape.

    `a ‖l - l_ref‖` has a kink at l = l_ref, where its minimum sits if a is large. So first lengths are held there; and
    only if a step away from them pays, `‖J_lᵀ λ‖ > a` with λ the multipliers of the tip pose, are they let go.
    """
    nodes, reference = problem.nodes, judge.reference_length / _LENGTH_UNIT

    def cost(z: Tensor) -> Tensor:
        return judge.length_weight * _LENGTH_UNIT * _norm(z[:nodes] - reference) + _norm(z[nodes:].diff())

    start = _arc(problem, judge.reference_length)
    bends = slice(nodes, 2 * nodes)
    pinned = problem.minimise(
        lambda z: z[nodes:].diff().square().sum(), problem.onto_tip(start, bends), iterations, bends
    )
    if problem.violation(pinned) < TIP_TOLERANCE:
        slope = _gradient(cost, pinned)
        jacobian = problem.tip_jacobian(pinned)
        multipliers, *_ = np.linalg.lstsq(jacobian[:, bends].T, -slope[bends], rcond=None)
        pull = float(np.linalg.norm(jacobian[:, :nodes].T @ multipliers))
        if problem.strains is None and pull <= judge.length_weight * _LENGTH_UNIT:
            return pinned, cost
        start = pinned
        start[:nodes] -= 1e-3 * (jacobian[:, :nodes].T @ multipliers) / max(pull, 1e-300)
    freed = problem.minimise(cost, problem.onto_tip(start), iterations)
    return freed, cost


def _best_held(
    problem: _TipProblem, judge: Objective, task: Task, starts: int, seed: int, iterations: int
) -> list[tuple[Array, Cost]]:
    """From each start the shape that the arm holds best."""

    def cost(z: Tensor) -> Tensor:
        shaped = Task(problem.twists(z).to(task.twists), task.tip_load, task.base_pose)
        return judge.total(judge.per_task(problem.arm, (shaped,))).double()

    random = np.random.default_rng(seed)
    arc = _arc(problem, float(problem.arm.length.mean()))
    plans: list[tuple[Array, Cost]] = []
    for index in range(starts):
        wished = arc.copy()
        if index:
            wished[problem.nodes :] += random.normal(0.0, 1.0, problem.nodes)
        start = problem.minimise(partial(_apart, torch.from_numpy(wished)), wished, 100)
        if problem.violation(start) < TIP_TOLERANCE:
            plans.append((problem.minimise(cost, start, iterations, tolerance=1e-9), cost))
    return plans


def _apart(wished: Tensor, unknowns: Tensor) -> Tensor:
    return (unknowns - wished).square().sum()


def _gradient(cost: Cost, unknowns: Array) -> Array:
    z = torch.from_numpy(unknowns).requires_grad_()
    (slope,) = torch.autograd.grad(cost(z), z)
    return slope.numpy()


def _stationarity(problem: _TipProblem, cost: Cost, unknowns: Array) -> float:
    """What is left of the gradient when constraints have balanced what they can, as a share of it."""
    from scipy.optimize import nnls

    nodes = problem.nodes
    slope = _gradient(cost, unknowns)
    size = float(np.linalg.norm(slope))
    if size == 0:
        return 0.0
    tip = problem.tip_jacobian(unknowns)
    normals = [tip, -tip]
    if problem.strains is not None:
        rows, bound = problem.strains
        normals.append(rows[rows @ unknowns > bound - 1e-6])
    # Lengths pinned at a kink are balanced by it: `_smoothest` has compared the pull with the weight.
    unknown = slice(nodes, 2 * nodes) if np.ptp(unknowns[:nodes]) < _PINNED and not slope[:nodes].any() else slice(None)
    _, left = nnls(np.concatenate(normals).T[unknown], -slope[unknown] / size)
    return float(left)
