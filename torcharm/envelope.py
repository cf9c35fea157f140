"""Convex hulls of sampled curves: which samples of a graph are its corners, and the edges between them."""

import torch
from torch import Tensor

AT_ONCE = 300_000
"""Up to so many slopes between samples are taken at once: below it calls cost more than arithmetic."""


def convex_curves(grid: Tensor, force: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """The hull of each actuator's curve, from the graph of its force over pressure.

    Bending is linear in pressure, so `(p, f) → (f, -r f + τ)` is affine and keeps convex hulls: the
    hull of the graph serves every radius and curvature, K = 0 included.

    Args:
        grid: (S, 1, 1) pressure fractions, evenly spaced from 0 to 1.
        force: (S, M, B).

    Returns:
        Edges that, multiplied by their turn (M, B) of 1 or -1, go round each hull counter-clockwise
        in the (p, f) plane: their steps in fraction (S, M or 1, B or 1) and in force (S, M, B).
        Slots off the hull are zero. Differentiable, with the corners held.
    """
    with torch.no_grad():
        low, high = _bends(grid, force)
        turning = len(grid) > 3 and bool(((low < 0) & (high > 0)).any())
        target = envelope_targets(grid, force) if turning else None
    if target is None:
        # Convex or concave: the samples, in order or reversed, already go round.
        turn = 1 - 2 * (low < 0).to(force.dtype)
        return grid.roll(-1, 0) - grid, force.roll(-1, 0).sub_(force), turn
    step = grid.expand_as(force).gather(0, target) - grid
    return step, force.gather(0, target).sub_(force), torch.ones_like(force[0])


def _bends(grid: Tensor, force: Tensor) -> tuple[Tensor, Tensor]:
    """The least and the greatest (M, B) second difference along each curve; 0 of two samples."""
    if len(grid) == 2:
        return torch.zeros_like(force[0]), torch.zeros_like(force[0])
    if grid.shape[1:] == (1, 1):
        bend = force[2:] + force[:-2]
        bend.sub_(force[1:-1], alpha=2)
    else:
        rise, step = force.diff(dim=0), grid.diff(dim=0)
        bend = (rise[1:] * step[:-1]).addcmul_(rise[:-1], step[1:], value=-1)
    return bend.amin(0), bend.amax(0)


def envelope_targets(grid: Tensor, force: Tensor) -> Tensor:
    """For each sample (S, M, B) of a curve the next corner round its hull (or itself).

    A sample is on the lower envelope if every slope to its right exceeds every slope to its left;
    on the upper, the other way round. The lower is walked rightwards, the upper back.
    """
    if grid.shape[1:] == (1, 1) and force.numel() * len(force) <= AT_ONCE:
        return _targets_at_once(grid, force)
    count = len(force)
    left_max, right_max = force.new_full((2, *force.shape), -torch.inf)
    left_min, right_min = force.new_full((2, *force.shape), torch.inf)
    for gap in range(1, count):
        slope = (force[gap:] - force[:-gap]).div_(grid[gap:] - grid[:-gap])  # of twins not a number: passed over
        torch.fmax(left_max[gap:], slope, out=left_max[gap:])
        torch.fmin(left_min[gap:], slope, out=left_min[gap:])
        torch.fmax(right_max[:-gap], slope, out=right_max[:-gap])
        torch.fmin(right_min[:-gap], slope, out=right_min[:-gap])
    lower, upper = (right_min > left_max).to(force.dtype), (right_max < left_min).to(force.dtype)

    target = torch.arange(count, dtype=force.dtype, device=force.device).view(-1, 1, 1).expand_as(force).clone()
    after, before = torch.full_like(force[0], count - 1), torch.zeros_like(force[0])
    places = target[:, :1, :1].clone()
    for slot in range(1, count):  # the upper envelope
        reached = torch.lerp(before, places[slot], upper[slot])
        target[slot].lerp_(before, upper[slot])
        before = reached
    for slot in range(count - 2, -1, -1):  # the lower one, which goes first where both hold
        reached = torch.lerp(after, places[slot], lower[slot])
        target[slot].lerp_(after, lower[slot])
        after = reached
    return target.long()


def _targets_at_once(grid: Tensor, force: Tensor) -> Tensor:
    """The same of few curves on one grid, from all slopes at once: a tenth of the calls, of ten times the size."""
    count = len(grid)
    own = torch.arange(count, device=force.device).view(-1, 1, 1)
    run = grid.unsqueeze(0) - grid.unsqueeze(1)
    slope = (force.unsqueeze(0) - force.unsqueeze(1)).div_(torch.where(run == 0, 1.0, run))
    not_right = torch.where(run > 0, 0.0, torch.inf).to(force.dtype)
    not_left = not_right.transpose(0, 1)
    right_min, right_max = (slope + not_right).amin(1), (slope - not_right).amax(1)
    left_min, left_max = (slope + not_left).amin(1), (slope - not_left).amax(1)
    lower, upper = right_min > left_max, right_max < left_min
    after = torch.where(lower, own, count - 1)[1:].flip(0).cummin(0).values.flip(0)
    back = torch.where(upper, own, 0)[:-1].cummax(0).values
    target = own.expand_as(force).clone()
    target[1:] = torch.where(upper[1:], back, target[1:])
    target[:-1] = torch.where(lower[:-1], after, target[:-1])
    return target
