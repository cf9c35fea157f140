"""Descent for many starts at once, within polytopes: projected BFGS and projected Adam.

Both take the step that minimises a quadratic model within the constraints,

    min_d  gᵀd + ½ dᵀ H d   s.t.  A (u + d) ≤ b,

with H from differences of gradients (BFGS, damped; Nocedal & Wright, procedure 18.2) or from their running
squares (Adam). A start is a row of the state; those that have ended no longer cost anything.

The first start of each polytope, which is the feasible design nearest to the given one, descends before the others:
a first answer comes as soon as if there were no others. These then descend together, as many at once as keep the
machine busy; where one ends, the next begins.
"""

from dataclasses import dataclass, fields, replace

import torch
from torch import Tensor

from torcharm.optimise import qp
from torcharm.optimise.objective import SMOOTHED, Judged, Problem

GOING, OPTIMAL, STALLED, LIMIT, FAILED = range(5)
REASONS = ("going", "optimal", "stalled", "iterations", "failed")
COOLING = (0.1, 0.01, 1e-3)
"""Temperatures of smoothed aggregates, as fractions of the values' size when a stage begins."""
FIRST_STEP = 2.0
"""About how far the first step goes, of the distance between bounds."""
SUFFICIENT = 1e-4
MOST_HALVINGS = 15
SHORTEST = 1e-5
"""Share of a step below which it is given up where nothing but designs without a value has been met."""
PATIENCE = {"bfgs": 3, "adam": 30}
RATE, FIRST_DECAY, SECOND_DECAY = 0.05, 0.9, 0.99


@dataclass(frozen=True, eq=False)
class State:
    """S starts on their way; every tensor has S rows.

    Attributes:
        owner: whose polytope each is in.
        point: (S, F).
        value, smooth: (S,) the objective, and what is descended.
        gradient: (S, F).
        best_point, best_value: the best so far.
        hessian: (S, F, F), BFGS.
        first, second: (S, F) running moments, Adam.
        temperature: (S,), and
        stage: (S,) how often it has been lowered.
        fresh: (S,) whether the Hessian is still a guess.
        idle: (S,) iterations without progress.
        age: (S,) iterations in this stage.
        steps: (S,) iterations in all; -1 before the start has been judged.
        reason: (S,) why it ended; GOING while it has not.
    """

    owner: Tensor
    point: Tensor
    value: Tensor
    smooth: Tensor
    gradient: Tensor
    best_point: Tensor
    best_value: Tensor
    hessian: Tensor
    first: Tensor
    second: Tensor
    temperature: Tensor
    stage: Tensor
    fresh: Tensor
    idle: Tensor
    age: Tensor
    steps: Tensor
    reason: Tensor

    def rows(self, index: Tensor) -> "State":
        """Some of the starts, in ascending order."""
        if len(index) == len(self.owner):
            return self
        return State(*(getattr(self, field.name)[index] for field in fields(self)))

    def with_rows(self, index: Tensor, part: "State") -> "State":
        """The state with some of its starts, in ascending order, replaced."""
        if len(index) == len(self.owner):
            return part
        columns = {}
        for field in fields(self):
            column = getattr(self, field.name).clone()
            column[index] = getattr(part, field.name)
            columns[field.name] = column
        return State(**columns)


def blank(point: Tensor, owner: Tensor) -> State:
    """The state of starts at feasible points (S, F) that have not been judged."""
    size, free = point.shape
    hot = torch.full((size,), torch.inf, dtype=torch.float64)
    count = torch.zeros(size, dtype=torch.long)
    return State(
        owner,
        point,
        hot,
        hot,
        torch.zeros_like(point),
        point,
        hot,
        torch.eye(free, dtype=torch.float64).expand(size, free, free).clone(),
        torch.zeros_like(point),
        torch.zeros_like(point),
        torch.ones_like(hot),
        count,
        torch.ones(size, dtype=torch.bool),
        count,
        count,
        count - 1,
        count,
    )


def begin(problem: Problem, point: Tensor, owner: Tensor) -> State:
    """The state of starts at feasible points (S, F), judged."""
    return _begun(problem, blank(point, owner))


def _begun(problem: Problem, state: State) -> State:
    if problem.objective.over in SMOOTHED:
        spread = problem.judge(state.point, state.owner, state.temperature, gradient=False).spread
        state = replace(state, temperature=COOLING[0] * spread.clamp(min=1e-9))
    return _judged_again(problem, replace(state, steps=torch.zeros_like(state.steps)))


def turn(state: State, together: int) -> Tensor:
    """Indices of the starts whose turn it is: of the first of each polytope those that are going, or else the next."""
    going = state.reason == GOING
    first = torch.ones_like(going)
    first[1:] = state.owner[1:] != state.owner[:-1]
    ahead = going & first
    if bool(ahead.any()):
        return ahead.nonzero().squeeze(-1)
    return going.nonzero().squeeze(-1)[:together]


def _judged_again(problem: Problem, state: State) -> State:
    judged = problem.judge(state.point, state.owner, state.temperature, gradient=True)
    state = _noted(replace(state, fresh=torch.ones_like(state.fresh)), state.point, judged)
    failed = ~judged.smooth.isfinite()
    return replace(state, reason=torch.where(failed, FAILED, state.reason))


def _noted(state: State, point: Tensor, judged: Judged) -> State:
    """The state moved to points just judged, the best of them kept."""
    assert judged.gradient is not None
    better = judged.value < state.best_value
    return replace(
        state,
        point=point,
        value=judged.value,
        smooth=judged.smooth,
        gradient=judged.gradient,
        best_point=torch.where(better.unsqueeze(-1), point, state.best_point),
        best_value=torch.where(better, judged.value, state.best_value),
    )


def advance(problem: Problem, state: State, method: str, tolerance: float, total: int) -> tuple[State, int]:
    """One iteration of the starts whose turn it is; also the number of designs evaluated.

    Args:
        tolerance: a start is optimal when its model promises less, as a fraction of its value, and stalled
            when it has gained less for some iterations.
        total: iterations of a start, at most (Adam's rate falls over them).
    """
    going = turn(state, problem.together)
    part = state.rows(going)
    fresh = (part.steps < 0).nonzero().squeeze(-1)
    if len(fresh):
        return state.with_rows(going, part.with_rows(fresh, _begun(problem, part.rows(fresh)))), len(fresh)
    given = part
    step = {"bfgs": _bfgs, "adam": _adam}[method]
    part, evaluations = step(problem, part, tolerance, total)
    gain = given.smooth - part.smooth if method == "bfgs" else _gain_of_best(given, part)
    slow = gain <= tolerance * part.smooth.abs().clamp(min=1e-9)
    idle = torch.where(slow, part.idle + 1, 0)
    ended = (part.reason == GOING) & (idle >= PATIENCE[method])
    reason = torch.where(ended, STALLED, part.reason)
    part = replace(part, idle=idle, age=part.age + 1, steps=part.steps + 1, reason=reason)
    part, more = _next_stage(problem, part)
    if int(part.steps.max()) >= total:
        out = (part.reason == GOING) & (part.steps >= total)
        part = replace(part, reason=torch.where(out, LIMIT, part.reason))
    return state.with_rows(going, part), evaluations + more


def _gain_of_best(before: State, after: State) -> Tensor:
    gain = before.best_value - after.best_value
    return torch.where(gain.isfinite(), gain, 0.0)


def _next_stage(problem: Problem, state: State) -> tuple[State, int]:
    """Starts that ended at one temperature go on at the next, from the best that they have seen."""
    if problem.objective.over not in SMOOTHED:
        return state, 0
    on = ((state.reason == OPTIMAL) | (state.reason == STALLED)) & (state.stage < len(COOLING) - 1)
    index = on.nonzero().squeeze(-1)
    if not len(index):
        return state, 0
    part = state.rows(index)
    cooler = torch.tensor(COOLING)[part.stage + 1] / torch.tensor(COOLING)[part.stage]
    none = torch.zeros_like(part.age)
    part = replace(
        part,
        point=part.best_point,
        temperature=part.temperature * cooler,
        stage=part.stage + 1,
        reason=none,
        idle=none,
        age=none,
        first=torch.zeros_like(part.first),
        second=torch.zeros_like(part.second),
    )
    return state.with_rows(index, _judged_again(problem, part)), len(index)


def _bfgs(problem: Problem, state: State, tolerance: float, total: int) -> tuple[State, int]:
    rows, bound = problem.constraints(state.owner)
    hessian = state.hessian
    if bool(state.fresh.any()):
        hessian = torch.where(state.fresh[:, None, None], _guess(state.gradient), hessian)
    model = qp.solve(hessian, state.gradient, rows, bound - _times(rows, state.point))
    step = model.step
    promise = (state.gradient * step).sum(-1)
    worth = -promise > tolerance * state.smooth.abs().clamp(min=1e-9)
    reason = torch.where(worth, state.reason, OPTIMAL)

    taken, judged, evaluations, found = _line_search(problem, state, step, promise, worth)
    assert judged.gradient is not None
    change = judged.gradient - state.gradient
    updated = _updated(hessian, taken, change, state.fresh)
    # A step that fails from a learnt Hessian is tried again from a guess; from a guess, that is the end.
    lost = worth & ~found
    reason = torch.where(lost & state.fresh, STALLED, reason)
    moved = replace(
        _noted(state, state.point + taken, judged),
        hessian=torch.where(found[:, None, None], updated, hessian),
        fresh=lost,
        reason=reason,
    )
    return moved, evaluations


def _guess(gradient: Tensor) -> Tensor:
    """A multiple of the identity by which the first step goes about `FIRST_STEP`."""
    size = gradient.norm(dim=-1).clamp(min=1e-12) / FIRST_STEP
    return size[:, None, None] * torch.eye(gradient.shape[-1], dtype=gradient.dtype)


def _line_search(
    problem: Problem, state: State, step: Tensor, promise: Tensor, wanted: Tensor
) -> tuple[Tensor, Judged, int, Tensor]:
    """Backtrack until the decrease is a fair share of what was promised.

    Returns:
        The steps taken (0 where none was found), the points judged, designs evaluated, and whether one was found.
    """
    length = torch.ones_like(promise)
    value, smooth, gradient = state.value.clone(), state.smooth.clone(), state.gradient.clone()
    taken = torch.zeros_like(step)
    found = torch.zeros_like(wanted)
    open_ = wanted.nonzero().squeeze(-1)
    evaluations = 0
    for _ in range(MOST_HALVINGS):
        if not len(open_):
            break
        trial = length[open_].unsqueeze(-1) * step[open_]
        judged = problem.judge(state.point[open_] + trial, state.owner[open_], state.temperature[open_], gradient=True)
        evaluations += len(open_)
        assert judged.gradient is not None
        rise = judged.smooth - state.smooth[open_]
        enough = rise <= SUFFICIENT * length[open_] * promise[open_]
        good = open_[enough]
        value[good], smooth[good], gradient[good] = judged.value[enough], judged.smooth[enough], judged.gradient[enough]
        taken[good], found[good] = trial[enough], True
        open_, rise = open_[~enough], rise[~enough]
        slope = promise[open_] * length[open_]
        # The minimum of the parabola through value, slope and what was found; a failure has no value.
        parabola = -slope / (2 * (rise - slope)).clamp(min=1e-300)
        length[open_] = length[open_] * torch.where(rise.isfinite(), parabola, 0.1).clamp(0.1, 0.5)
        open_ = open_[rise.isfinite() | (length[open_] > SHORTEST)]
    return taken, Judged(value, smooth, gradient, value), evaluations, found


def _updated(hessian: Tensor, step: Tensor, change: Tensor, fresh: Tensor) -> Tensor:
    """BFGS's update, damped so that it stays positive definite; a guess is first scaled to what was seen."""
    along = (step * change).sum(-1)
    seen = along > 1e-12 * step.norm(dim=-1) * change.norm(dim=-1)
    curvature = torch.where(seen, along / step.square().sum(-1).clamp(min=1e-300), 1.0)
    eye = torch.eye(step.shape[-1], dtype=step.dtype)
    hessian = torch.where((fresh & seen)[:, None, None], curvature[:, None, None] * eye, hessian)
    bent = _times(hessian, step)
    stiffness = (step * bent).sum(-1).clamp(min=1e-300)
    blend = torch.where(along < 0.2 * stiffness, 0.8 * stiffness / (stiffness - along).clamp(min=1e-300), 1.0)
    secant = blend.unsqueeze(-1) * change + (1 - blend).unsqueeze(-1) * bent
    across = (step * secant).sum(-1).clamp(min=1e-300)
    updated = (
        hessian
        - bent.unsqueeze(-1) * bent.unsqueeze(-2) / stiffness[:, None, None]
        + secant.unsqueeze(-1) * secant.unsqueeze(-2) / across[:, None, None]
    )
    moved = (step != 0).any(-1) & updated.isfinite().all(-1).all(-1)
    return torch.where(moved[:, None, None], updated, hessian)


def _adam(problem: Problem, state: State, tolerance: float, total: int) -> tuple[State, int]:
    rows, bound = problem.constraints(state.owner)
    count = (state.age + 1).unsqueeze(-1).double()
    first = FIRST_DECAY * state.first + (1 - FIRST_DECAY) * state.gradient
    second = SECOND_DECAY * state.second + (1 - SECOND_DECAY) * state.gradient.square()
    mean, square = first / (1 - FIRST_DECAY**count), second / (1 - SECOND_DECAY**count)
    share = (state.age.double() / total).clamp(max=1.0)
    rate = RATE * (0.01 + 0.99 * 0.5 * (1 + torch.cos(torch.pi * share)))
    weight = (square.sqrt() + 1e-12 + 1e-6 * square.sqrt().amax(-1, keepdim=True)) / rate.unsqueeze(-1)
    step = qp.solve(torch.diag_embed(weight), mean, rows, bound - _times(rows, state.point)).step
    point = state.point + step
    judged = problem.judge(point, state.owner, state.temperature, gradient=True)
    # A step onto what has no value is not taken; the next one is shorter, as the moments decay.
    sound = judged.smooth.isfinite()
    assert judged.gradient is not None
    kept = sound.unsqueeze(-1)
    judged = Judged(
        torch.where(sound, judged.value, state.value),
        torch.where(sound, judged.smooth, state.smooth),
        torch.where(kept, judged.gradient, state.gradient),
        judged.spread,
    )
    moved = _noted(state, torch.where(kept, point, state.point), judged)
    return replace(moved, first=torch.where(kept, first, 0.5 * first), second=second), len(point)


def projected_gradient(problem: Problem, point: Tensor, owner: Tensor, gradient: Tensor) -> Tensor:
    """`‖P(u - ∇) - u‖∞` (S,): 0 where no feasible direction descends, P the projection onto the polytope."""
    rows, bound = problem.constraints(owner)
    eye = torch.ones_like(point)
    step = qp.solve(torch.diag_embed(eye), gradient, rows, bound - _times(rows, point)).step
    return step.abs().amax(-1)


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)
