"""Nonlinear least squares in a box, B small problems at once: Levenberg and Marquardt with active bounds.

    min ½‖r(u)‖²,  0 ≤ u ≤ 1,   u (B, M) with M small

Each step minimises a damped quadratic model within the box. Its curvature is Gauss and Newton's `JᵀJ` and, as residuals
need not be small, a secant estimate of what that leaves out, `Σ r ∇²r` (Dennis, Gay and Welsch 1981, with the
symmetric rank-one update). What has converged leaves the batch.
"""

from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor

LEAST_GAIN = 1e-4
"""Of the decrease that the model promised; less is refused."""
FIRST_DAMPING = 1e-3
"""Of the model's largest curvature."""
LARGEST_DAMPING = 1e9
"""Of the same: a step so short that rounding decides whether it went down."""
BLIND = 0.03
"""The least damping, of the same, after a step to where there is no value."""
PATIENCE, WORTH = 4, 1e-3
"""Steps taken, and the share of the value that they must save to go on: at a kink of the residuals there is no more to
be had, however long one tries."""
INNER_STEPS = 8
"""Newton steps to the minimum of a model in the box."""
BACKTRACKS = 5
"""Lengths tried of each, halved each time."""


class Model(NamedTuple):
    """Half the sum of squares (B,), its gradient (B, M), and `JᵀJ` (B, M, M).

    With a hint (B, ...), of the caller's choice, that helps to evaluate places nearby.
    """

    value: Tensor
    gradient: Tensor
    curvature: Tensor
    hint: Tensor


Look = Callable[[Tensor, Tensor, Tensor, Tensor], Model]
"""From indices (b,) of problems, places (b, M), and other places with their hints to models. A value that is not
finite is no place to go."""


def minimise(
    look: Look,
    start: Tensor,
    hint: Tensor,
    judge: Callable[[Tensor, Model, Tensor], Tensor],
    steps: int,
    worth: float = WORTH,
) -> tuple[Tensor, Tensor]:
    """Minimise from starts (B, M) in the box, and return where that ended, and the hint there.

    Args:
        look: at the problems.
        start: (B, M).
        hint: (B, ...) of the starts.
        judge: from indices, models and places to whether they have converged (b,).
        steps: at most so many.
        worth: share of the value that `PATIENCE` steps must save to go on.
    """
    place = start.clone()
    active = torch.arange(len(start), device=start.device)
    here, model = start, look(active, start, start, hint)
    hint = model.hint.clone()
    extra = torch.zeros_like(model.curvature)
    augmented = torch.zeros_like(active, dtype=torch.bool)
    damping = FIRST_DAMPING * _largest(model.curvature)
    growth = torch.full_like(damping, 2.0)
    before, taken = model.value, torch.zeros_like(active)
    for _ in range(steps):
        leave = judge(active, model, here) | ~model.value.isfinite()
        leave |= damping > LARGEST_DAMPING * _largest(model.curvature)
        due = taken == PATIENCE
        leave |= due & (model.value > (1 - worth) * before)
        before, taken = torch.where(due, model.value, before), torch.where(due, torch.zeros_like(taken), taken)
        if bool(leave.any()):
            place[active[leave]], hint[active[leave]] = here[leave], model.hint[leave]
            keep = ~leave
            active, here, extra = active[keep], here[keep], extra[keep]
            augmented, damping, growth = augmented[keep], damping[keep], growth[keep]
            before, taken = before[keep], taken[keep]
            model = Model(*(part[keep] for part in model))
            if not len(active):
                break
        used = torch.where(augmented[:, None, None], extra, torch.zeros_like(extra))
        move, promised = box_step(model.gradient, model.curvature + used, here, damping)
        there = here + move
        tried = look(active, there, here, model.hint)
        augmented = _foretold(model, extra, move, tried)
        extra = _secant(extra, move, tried, model)
        gain = (model.value - tried.value) / promised.clamp(min=1e-300)
        good = (gain > LEAST_GAIN) & tried.value.isfinite()
        here = torch.where(good[:, None], there, here)
        model = _choose(good, tried, model)
        easier = (1 - (2 * gain.clamp(-1, 2) - 1) ** 3).clamp(min=0.1)  # Nielsen's rule
        least = torch.where(tried.value.isfinite(), torch.zeros_like(damping), BLIND * _largest(model.curvature))
        damping = torch.where(good, damping * easier, torch.maximum(damping * growth, least))
        growth = torch.where(good, torch.full_like(growth, 2.0), growth * 2)
        taken = taken + good
    place[active], hint[active] = here, model.hint
    return place, hint


def _choose(first: Tensor, one: Model, other: Model) -> Model:
    """The one model where that is wanted (B,), else the other."""
    pairs = zip(one, other, strict=True)
    return Model(*(torch.where(first.view(-1, *[1] * (a.ndim - 1)), a, b) for a, b in pairs))


def _largest(curvature: Tensor) -> Tensor:
    return curvature.diagonal(dim1=-2, dim2=-1).amax(-1).clamp(min=1e-30)


def _foretold(model: Model, extra: Tensor, move: Tensor, tried: Model) -> Tensor:
    """(B,) whether the model with the secant estimate foretold the change of value better than the one without."""
    plain = (model.gradient * move).sum(-1) + 0.5 * (_times(model.curvature, move) * move).sum(-1)
    more = 0.5 * (_times(extra, move) * move).sum(-1)
    missed = tried.value - model.value - plain
    return (missed - more).abs() < missed.abs()


def _secant(extra: Tensor, move: Tensor, tried: Model, model: Model) -> Tensor:
    """The estimate of `Σ r ∇²r`, such that the model at the new place would have foretold the old gradient."""
    wanted = tried.gradient - model.gradient - _times(tried.curvature, move)
    now = (_times(extra, move) * move).sum(-1).abs()
    extra = extra * ((wanted * move).sum(-1).abs() / now.clamp(min=1e-300)).clamp(max=1.0)[:, None, None]  # sized
    missed = (wanted - _times(extra, move)) * (move != 0)  # what has not moved has told nothing of its curvature
    along = (missed * move).sum(-1)
    sound = along.abs() > 1e-8 * missed.norm(dim=-1) * move.norm(dim=-1)
    sound &= tried.value.isfinite() & tried.gradient.isfinite().all(-1) & model.value.isfinite()
    update = missed.unsqueeze(-1) * missed.unsqueeze(-2) / torch.where(sound, along, 1.0)[:, None, None]
    return torch.where(sound[:, None, None], extra + update, extra)


def _times(matrix: Tensor, vector: Tensor) -> Tensor:
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)


def box_step(gradient: Tensor, curvature: Tensor, place: Tensor, damping: Tensor) -> tuple[Tensor, Tensor]:
    """The step (B, M) that minimises the damped model in the box, and the decrease (B,) that the model promises.

    Newton's method on the free variables, projected; a variable at a bound is free unless the gradient pushes it out.

    Args:
        gradient: (B, M).
        curvature: (B, M, M), symmetric; where it is not positive definite for what may move, it is shifted until it is.
        place: (B, M) in the box.
        damping: (B,) added to its diagonal.
    """
    eye = torch.eye(place.shape[-1], dtype=place.dtype, device=place.device)
    scale = _largest(curvature.abs())
    free = (~(((place <= 0) & (gradient > 0)) | ((place >= 1) & (gradient < 0)))).to(place.dtype)
    reduced = curvature * free.unsqueeze(-1) * free.unsqueeze(-2)
    least = torch.linalg.eigvalsh(reduced + torch.diag_embed((1 - free) * scale.unsqueeze(-1)))[:, 0]
    shift = damping + (1e-12 * scale - 1.1 * least).clamp(min=0)
    curvature = curvature + shift[:, None, None] * eye
    scale = scale + shift
    lengths = 0.5 ** torch.arange(BACKTRACKS, dtype=place.dtype, device=place.device)
    there, slope = place, gradient
    for _ in range(INNER_STEPS):
        held = ((there <= 0) & (slope > 0)) | ((there >= 1) & (slope < 0))
        free = (~held).to(place.dtype)
        downhill = free * slope
        if bool((downhill.abs() <= 1e-12 * gradient.abs().amax(-1, keepdim=True)).all()):
            break
        reduced = curvature * free.unsqueeze(-1) * free.unsqueeze(-2)
        factor, _ = torch.linalg.cholesky_ex(reduced + torch.diag_embed((1 - free) * scale.unsqueeze(-1)))
        newton = torch.cholesky_solve(downhill.unsqueeze(-1), factor).squeeze(-1)
        cauchy = downhill / (scale.unsqueeze(-1) * place.shape[-1])  # short enough to go down when projected
        newton = torch.where(newton.isfinite(), newton, cauchy)
        ahead = torch.cat((lengths.view(-1, 1) * newton.unsqueeze(1), cauchy.unsqueeze(1)), 1)
        steps = (there.unsqueeze(1) - ahead).clamp(0, 1) - there.unsqueeze(1)
        change = (steps * slope.unsqueeze(1)).sum(-1) + 0.5 * ((steps @ curvature) * steps).sum(-1)
        least, best = change.min(-1)
        step = steps.gather(1, best.view(-1, 1, 1).expand(-1, 1, steps.shape[-1])).squeeze(1)
        step = torch.where((least < 0).unsqueeze(-1), step, torch.zeros_like(step))
        there = there + step
        slope = slope + _times(curvature, step)
    move = there - place
    promised = -(move * gradient).sum(-1) - 0.5 * (_times(curvature, move) * move).sum(-1)
    return move, promised
