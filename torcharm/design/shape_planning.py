"""Shapes for a tip: the centreline through a tip pose that an arm can best hold, or that is smoothest."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.arm import ArmDesign
from torcharm.attainability import Attainability, evaluate
from torcharm.design.nearest_shape import miss_in_words, nearest_shape
from torcharm.design.objective import Objective, task_values
from torcharm.design.space import Array
from torcharm.equilibrium.solve import whole_load
from torcharm.geometry import rod, se3
from torcharm.inputs import HoldsTensors, TensorLike, as_floating, check_count, check_finite, shown
from torcharm.load import ExternalLoad
from torcharm.task import Task

TIP_TOLERANCE = 1e-8
"""By how much a tip may miss its pose [m, rad] for a plan to count as one."""
STRAIN_SLACK = 1e-7
"""By how much of a length [m] strains stay off the ends of their range."""
LENGTH_UNIT = 0.1
"""In which lengths are counted [m], so that they vary as much as curvatures do."""
COLUMNS = {2: (0, 2), 3: (0, 4, 5)}
"""Of a twist, those that a shape chooses: the length and the bending; shear and torsion are 0."""

Cost = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Smoothness:
    """The paper's heuristic: `a ‖l - l_ref‖ + ‖Δκ‖` over the lengths (N) and the steps (N-1) of curvature.

    Euclidean norms, not squared, and a length of its own for each element: so read, (45, 0.5 m) gives the published
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


@dataclass(frozen=True, eq=False, repr=False)
class PlannedShape(HoldsTensors):
    """A shape, and what it takes to trust it.

    Attributes:
        status: "found"; or "no shape: ..." with why: then numbers are NaN, and there is no attainability.
        twists: (N, 3) or (N, 6) [m, rad].
        tip_error: the largest entry of the tip's error, as of `pose_errors` [m, rad].
        cost: what was minimised.
        attainability: of the shape under the loads, as `evaluate` finds with the objective's options (for a
            heuristic, with its own).
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
    arm: ArmDesign,
    tip_pose: TensorLike,
    load: TensorLike | ExternalLoad,
    objective: Objective | Smoothness | None = None,
    *,
    nodes: int = 10,
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
        arm: one design.
        tip_pose: (3,) [m, m, rad] or (4, 4) in the world frame. Headings in the plane are not wrapped: the arm turns by
            `tip heading - base heading` in all, so adding 2π asks for a loop more.
        load: under which the shape is to be held: tip loads (..., 3) or (..., 6) in the world frame [N, N·m], or an
            `ExternalLoad` with the arm's weight and payloads. Several count as the objective says.
        objective: of the shape as a task of this arm; None takes absolute plus relative unattainability, of squared
            distances and without margins, so that any attainable shape will do. Or a `Smoothness`, of which the arm
            and the loads have no part.
        nodes: N.
        base_pose: (3,) or (4, 4) pose of node 1, or "hanging" (None), "upright" or "horizontal".
        in_range: whether all strains stay in the actuators' characterised range; None: unless the objective is
            a `Smoothness`.
        starts: the first start is the circular arc of the right turn; the others bend at random.
        seed: of these.
        iterations: of a start, at most.

    Raises:
        ValueError: an argument is none of those allowed.
    """
    problem, whole = _problem(arm, tip_pose, load, objective, nodes, base_pose, in_range)
    check_count("starts", starts, 1)
    judge = Objective("unattainability", power=2, relative_weight=1.0, margin=False) if objective is None else objective
    if isinstance(judge, Smoothness):
        plans = [_smoothest(problem, judge, iterations)]
    else:
        plans = _best_held(problem, judge, whole, starts, seed, iterations)
    met = [plan for plan in plans if problem.violation(plan[0]) < TIP_TOLERANCE]
    if not met:
        return _no_shape(problem)
    unknowns, cost = min(met, key=lambda plan: float(plan[1](torch.from_numpy(plan[0]))))
    return _plan(problem, judge, unknowns, cost, whole)


def _problem(
    arm: ArmDesign,
    tip_pose: TensorLike,
    load: TensorLike | ExternalLoad,
    objective: Objective | Smoothness | None,
    nodes: int,
    base_pose: TensorLike | str | None,
    in_range: bool | None,
) -> "tuple[_TipProblem, ExternalLoad]":
    if not isinstance(arm, ArmDesign) or arm.batch_shape:
        raise ValueError(f"arm: must be one design, got {shown(arm)}")
    if objective is not None and not isinstance(objective, (Objective, Smoothness)):
        raise ValueError(f"objective: must be an Objective or a Smoothness, got {shown(objective)}")
    check_count("nodes", nodes, 2)
    columns = 3 if arm.dimension == 2 else 6
    base = rod.as_base(base_pose, arm.radii, columns)
    goal, start, _ = as_floating(tip_pose=tip_pose, base_pose=base, arm=arm.radii)
    shape = rod.group_of(columns).POSE_SHAPE
    for name, value in (("tip_pose", goal), ("base_pose", start)):
        if value.shape != shape:
            raise ValueError(f"{name}: must have shape {shape} for this arm, got {tuple(value.shape)}")
        check_finite(name, value)
        rod.check_rigid(name, value)
    if not isinstance(load, ExternalLoad):
        load, _ = as_floating(load=load, arm=arm.radii)
    whole = whole_load(load, columns, arm.radii)
    limited = not isinstance(objective, Smoothness) if in_range is None else in_range
    strains = _strain_rows(arm, nodes) if limited else None
    return _TipProblem(arm, goal.double().cpu(), start.double().cpu(), nodes, columns, strains), whole


def _no_shape(problem: "_TipProblem") -> PlannedShape:
    none = torch.full((problem.nodes, problem.columns), torch.nan).to(problem.arm.radii)
    ranges = "" if problem.strains is None else " with all strains in the actuators' characterised range"
    start = _arc(problem, float(problem.arm.length.mean()))
    place = (lambda pose: pose[:2]) if problem.columns == 3 else se3.position
    away = float((place(problem.goal) - place(problem.base)).norm())
    near, advice = nearest_shape(problem.tip_miss, problem.tip_jacobian, problem.strains, start, problem.nodes, away)
    length, neutral = LENGTH_UNIT * near[: problem.nodes].mean(), float(problem.arm.length.mean())
    words = (
        f"no shape: none of {problem.nodes} elements was found that meets the tip pose{ranges}; the nearest, of length "
        f"{length:.3g} m (actuators: {neutral:.3g} m), misses it by {miss_in_words(problem.tip_miss(near))}: {advice}"
    )
    return PlannedShape(words, none, math.nan, math.nan, None)


def _plan(
    problem: "_TipProblem", judge: Objective | Smoothness, unknowns: Array, cost: Cost, load: ExternalLoad
) -> PlannedShape:
    at = torch.from_numpy(unknowns)
    twists = problem.twists(at).to(problem.arm.radii)
    task = problem.task(twists, load)
    options: dict[str, Any] = {}
    if isinstance(judge, Objective):
        options = {"weights": judge.weights, "power": judge.power}
    error = float(np.abs(problem.tip_miss(unknowns)).max())
    return PlannedShape("found", twists, error, float(cost(at)), evaluate(problem.arm, task, **options))


@dataclass(frozen=True, eq=False)
class _TipProblem:
    """Unknowns z of a shape, lengths (N, in units of 0.1 m) and then curvatures (N, or 2 N), and their constraints.

    Attributes:
        goal, base: poses.
        columns: of a twist, 3 or 6.
        strains: rows A and bounds b of `A z ≤ b`; None without.
    """

    arm: ArmDesign
    goal: Tensor
    base: Tensor
    nodes: int
    columns: int
    strains: tuple[Array, Array] | None

    @property
    def bends(self) -> slice:
        """Of the unknowns, the curvatures."""
        return slice(self.nodes, None)

    def twists(self, unknowns: Tensor) -> Tensor:
        """(N, 3 or 6)."""
        length, *bends = unknowns.unflatten(0, (-1, self.nodes))
        whole = [torch.zeros_like(length) for _ in range(self.columns)]
        for column, value in zip(COLUMNS[self.arm.dimension], (length * LENGTH_UNIT, *bends), strict=True):
            whole[column] = value
        return torch.stack(whole, -1)

    def task(self, twists: Tensor, load: ExternalLoad) -> Task:
        """A shape (N, 3 or 6) as the task to hold it under loads."""
        return Task(twists, base_pose=self.base.to(twists), load=load)

    def _miss(self, unknowns: Tensor) -> Tensor:
        tip = rod.poses(self.twists(unknowns), self.base)[self.nodes]
        if self.columns == 3:
            return tip - self.goal
        gap = se3.compose(se3.inverse(self.goal), tip)
        return torch.cat((se3.position(gap), se3.log(gap)[3:]))

    def tip_miss(self, unknowns: Array) -> Array:
        """(3,) or (6,) [m, rad]."""
        return self._miss(torch.from_numpy(unknowns)).numpy()

    def tip_jacobian(self, unknowns: Array) -> Array:
        """(3, 2N) or (6, 3N)."""
        return np.asarray(torch.autograd.functional.jacobian(self._miss, torch.from_numpy(unknowns)))

    def violation(self, unknowns: Array) -> float:
        """Of the tip pose, and of strains."""
        over = 0.0 if self.strains is None else float((self.strains[0] @ unknowns - self.strains[1]).max())
        return max(float(np.abs(self.tip_miss(unknowns)).max()), over)

    def onto_tip(self, unknowns: Array, free: slice = slice(None), steps: int = 20) -> Array:
        """The nearest unknowns, by Newton's method, whose tip is where it should be; some may be held."""
        z = unknowns.copy()
        for _ in range(steps):
            miss = self.tip_miss(z)
            if np.abs(miss).max() < 1e-14 or not np.isfinite(miss).all():
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

        tip = {
            "type": "eq",
            "fun": lambda part: self.tip_miss(whole(part)),
            "jac": lambda part: self.tip_jacobian(whole(part))[:, free],
        }
        limits = [tip]
        if self.strains is not None:
            rows, bound = self.strains
            limits.append(
                {"type": "ineq", "fun": lambda part: bound - rows @ whole(part), "jac": lambda part: -rows[:, free]}
            )
        options = {"maxiter": iterations, "ftol": tolerance}
        answer = minimize(value, start[free], jac=True, method="SLSQP", constraints=limits, options=options)
        return self.onto_tip(whole(answer.x), free)


def _strain_rows(arm: ArmDesign, nodes: int) -> tuple[Array, Array]:
    """`(1 + ε₋) l̂ ≤ l + z κ_y - y κ_z ≤ (1 + ε₊) l̂` for every actuator at every node, over the unknowns."""
    across, neutral = arm.offsets.detach().double().cpu().numpy(), arm.length.detach().double().cpu().numpy()
    rows, bounds, unit = [], [], np.eye(nodes)
    for (y, z), length, model in zip(across, neutral, arm.actuators, strict=True):
        own = np.hstack((LENGTH_UNIT * unit, *((z * unit,) if arm.dimension == 3 else ()), -y * unit))
        for sign, edge in zip((-1.0, 1.0), (float(end) for end in model.strain_range), strict=True):
            if math.isfinite(edge):
                rows.append(sign * own)
                bounds.append(np.full(nodes, sign * (1 + edge) * length - STRAIN_SLACK))
    if not rows:
        return np.zeros((1, arm.dimension * nodes)), np.ones(1)
    return np.concatenate(rows), np.concatenate(bounds)


def _arc(problem: _TipProblem, length: float) -> Array:
    """Unknowns of an arc of constant curvature: in the plane that of the right turn, in space that by which the base's
    heading becomes the tip's."""
    if problem.columns == 3:
        bends = [float(problem.goal[2] - problem.base[2])]
    else:
        x, y, z = (problem.base[:3, :3].T @ problem.goal[:3, 0]).tolist()
        aside = math.hypot(y, z)
        turn = math.atan2(aside, x) / aside if aside > 1e-9 else 0.0
        bends = [-turn * z, turn * y]
    return np.repeat([length / LENGTH_UNIT, *bends], problem.nodes)


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
    nodes, bends, reference = problem.nodes, problem.bends, judge.reference_length / LENGTH_UNIT

    def steps(z: Tensor) -> Tensor:
        return z[bends].unflatten(0, (-1, nodes)).diff()

    def cost(z: Tensor) -> Tensor:
        return judge.length_weight * LENGTH_UNIT * _norm(z[:nodes] - reference) + _norm(steps(z))

    start = _arc(problem, judge.reference_length)
    pinned = problem.minimise(lambda z: steps(z).square().sum(), problem.onto_tip(start, bends), iterations, bends)
    if problem.violation(pinned) < TIP_TOLERANCE:
        slope = _gradient(cost, pinned)
        jacobian = problem.tip_jacobian(pinned)
        multipliers, *_ = np.linalg.lstsq(jacobian[:, bends].T, -slope[bends], rcond=None)
        pull = float(np.linalg.norm(jacobian[:, :nodes].T @ multipliers))
        if problem.strains is None and pull <= judge.length_weight * LENGTH_UNIT:
            return pinned, cost
        start = pinned
        start[:nodes] -= 1e-3 * (jacobian[:, :nodes].T @ multipliers) / max(pull, 1e-300)
    return problem.minimise(cost, problem.onto_tip(start), iterations), cost


def _best_held(
    problem: _TipProblem, judge: Objective, load: ExternalLoad, starts: int, seed: int, iterations: int
) -> list[tuple[Array, Cost]]:
    """From each start the shape that the arm holds best."""

    def cost(z: Tensor) -> Tensor:
        shaped = problem.task(problem.twists(z).to(problem.arm.radii), load)
        return judge.total(task_values(judge, problem.arm, shaped)).double()

    random = np.random.default_rng(seed)
    arc = _arc(problem, float(problem.arm.length.mean()))
    plans: list[tuple[Array, Cost]] = []
    for index in range(starts):
        wished = arc.copy()
        if index:
            wished[problem.bends] += random.normal(0.0, 1.0, len(wished) - problem.nodes)
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
