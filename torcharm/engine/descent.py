"""Descent to the pressures that bring one arm closest to its goal: Levenberg and Marquardt's method in the box.

Half the cost is minimised over normalised pressures, along equilibria: each is guessed from the last by its rates, and
solved more closely as the pressures change less. The curvature is Gauss and Newton's and, as errors need not be small,
a secant estimate of what that leaves out, `Σ e ∇²e` (Dennis, Gay and Welsch, *ACM TOMS* 7, 1981, with the symmetric
rank-one update); damping follows Nielsen (1999). Steps that lead away from stable equilibria are refused: they are
longer than the arm follows.
"""

import math

from torcharm.engine.box_step import largest_curvature, optimality, write_box_step
from torcharm.engine.compilation import part
from torcharm.engine.copies import copy_rows
from torcharm.engine.path import move_size
from torcharm.engine.pressure_model import (
    FEW_EVALUATIONS,
    HALF_COST,
    LAST_MOVE,
    STABLE,
    evaluate_point,
)

LEAST_GAIN = 1e-4
"""Of the decrease that the model promised; a step that gains less is refused."""
FIRST_DAMPING = 1e-3
"""Of the model's largest curvature."""
LARGEST_DAMPING = 1e5
"""Of the same: steps so short lead nowhere, as at a kink of a force model or where stability ends."""
BLIND_DAMPING = 0.03
"""Of the same, at least, after a step to where there is no stable equilibrium: the model says nothing of those."""
PATIENCE = 4
"""Steps taken, after which a descent must have saved the share that makes it worth while."""
CLOSE, CLOSEST, SHARP = 1e-2, 1e-6, 0.1
"""Newton steps left to an equilibrium: at most; at the end; and over the change of pressures in between, so that
costs that are compared are known better than they differ."""
LONGEST_MOVE = 0.7
"""Of a step along the tangent, as of `move_size`: from further away Newton's method need not come back to the
branch."""
STEPS = 60
"""Of a descent, at most: more were not seen to lead on."""
HOPE = 2.0
"""Times what the last PATIENCE steps saved: what is still to be had, at most."""
WORTH = 1e-5
"""Share of the value that PATIENCE steps must save to go on: at a kink of a force model there is no more to be had,
however long one tries."""
ROUNDING = 1e-12
"""Of half the cost: a smaller decrease is lost in what is left of the equilibria, and the slope tells which of two
points is better."""
FLOOR = 1e-10
"""Of an error over the arm's length: below, rounding decides, and it counts as none."""
OPTIMAL = 1e-7
"""Slope of the error by a normalised pressure, over the arm's length, at which a minimum is reached."""

RUNNING, OPTIMUM, NO_GAIN, HELD_UP, STABILITY_ENDS, NO_START = range(6)
"""How a descent ended: not within its steps; at a first-order optimum; where nothing more is to be had; where shorter
and shorter steps did not go down, as at a kink of a force model; where they left the stable equilibria; or where it
started, as there was no equilibrium."""


@part
def mean_error(problem, work, b, at):  # type: ignore[no-untyped-def]
    """The mean error of a slot over the arm's length, by the weight of what counts most at each pose."""
    weights, length, total = problem.goal.weight, problem.scale.length[b], 0.0
    linear = (weights.shape[2] + 1) // 2  # components of a position; a turn counts by how far it moves the arm's end
    for i in range(weights.shape[1]):
        most = 0.0
        for e in range(weights.shape[2]):
            most = max(most, weights[b, i, e] if e < linear else weights[b, i, e] / length**2)
        total += most
    return math.sqrt(2.0 * work.points.known[at, HALF_COST] / max(total, 1e-300)) / length


@part
def error_slope(problem, work, b, at):  # type: ignore[no-untyped-def]
    """The largest slope of the error [m] by a normalised pressure of those that the box leaves free; 0 of no error."""
    points = work.points
    error = math.sqrt(2.0 * points.known[at, HALF_COST])
    if error <= FLOOR * problem.scale.length[b]:
        return 0.0
    return optimality(points.gradient[at], points.normalised[at]) / error


@part
def _aim(problem, work, b, here, there):  # type: ignore[no-untyped-def]
    """Write the pressures of a step, and where it leads along the tangent; returns the part of it that is taken."""
    points, path, step = work.points, work.path, work.box.step
    for i in range(work.change.shape[1]):
        for c in range(work.change.shape[2]):
            total = 0.0
            for m in range(len(step)):
                total += points.rates[here, m, i, c] * step[m]
            work.change[0, i, c] = total
    size = move_size(problem.arms, problem.scale, path, b, work.change[0])
    short = min(LONGEST_MOVE / max(size, 1e-12), 1.0)
    copy_rows(path.trial, points.twists[here])
    for i in range(work.change.shape[1]):
        for c in range(work.change.shape[2]):
            path.trial[i, problem.arms.unknown[c]] += short * work.change[0, i, c]
    for m in range(len(step)):
        step[m] *= short
        points.normalised[there, m] = min(max(points.normalised[here, m] + step[m], 0.0), 1.0)
    return short


@part
def _foretold(work, here, there):  # type: ignore[no-untyped-def]
    """Whether the model with the secant estimate foretold the change of value better than the one without."""
    points, step = work.points, work.box.step
    plain, more = 0.0, 0.0
    for m in range(len(step)):
        plain += points.gradient[here, m] * step[m]
        for k in range(len(step)):
            plain += 0.5 * points.curvature[here, m, k] * step[m] * step[k]
            more += 0.5 * work.extra[m, k] * step[m] * step[k]
    missed = points.known[there, HALF_COST] - points.known[here, HALF_COST] - plain
    return abs(missed - more) < abs(missed)


@part
def _update_secant(work, here, there):  # type: ignore[no-untyped-def]
    """Change the estimate so that the model at the new pressures would have foretold the old gradient."""
    points, step, extra, missed = work.points, work.box.step, work.extra, work.missed
    count = len(step)
    now = wanted_along = 0.0
    for m in range(count):
        wanted = points.gradient[there, m] - points.gradient[here, m]
        for k in range(count):
            wanted -= points.curvature[there, m, k] * step[k]
            now += extra[m, k] * step[m] * step[k]
        missed[m] = wanted
        wanted_along += wanted * step[m]
    sizing = min(abs(wanted_along) / max(abs(now), 1e-300), 1.0)
    along = square = length = 0.0
    for m in range(count):
        for k in range(count):
            extra[m, k] *= sizing
    for m in range(count):
        for k in range(count):
            missed[m] -= extra[m, k] * step[k]
        if step[m] == 0.0:  # what has not moved has told nothing of its curvature
            missed[m] = 0.0
        along += missed[m] * step[m]
        square += missed[m] * missed[m]
        length += step[m] * step[m]
    if not abs(along) > 1e-8 * math.sqrt(square * length):
        return
    for m in range(count):
        for k in range(count):
            extra[m, k] += missed[m] * missed[k] / along


@part
def descend(problem, work, b, here, there, free, best, steps):  # type: ignore[no-untyped-def]
    """Follow the cost of arm b down from the point of a slot.

    Args:
        here: slot of the point, as of `evaluate_point`, and another one to try steps in.
        free: whether to go through equilibria that are not stable, as there are no others.
        best: a value that is known: a descent that is not about to go below it is given up.
        steps: at most.

    Returns:
        The slot of the best point, with its equilibrium closely solved, and how the descent ended.
    """
    points, box = work.points, work.box
    if not math.isfinite(points.known[here, HALF_COST]):
        return here, NO_START
    count = len(box.step)
    for m in range(count):
        for k in range(count):
            work.extra[m, k] = 0.0
    augmented, left, growth, taken, before = False, False, 2.0, 0, points.known[here, HALF_COST]
    damping, ended = FIRST_DAMPING * largest_curvature(points.curvature[here]), RUNNING
    for _ in range(steps):
        scale, value = largest_curvature(points.curvature[here]), points.known[here, HALF_COST]
        promised = write_box_step(
            box,
            points.gradient[here],
            points.curvature[here],
            work.extra,
            augmented,
            points.normalised[here],
            damping,
        )
        ended = RUNNING
        if error_slope(problem, work, b, here) <= OPTIMAL * problem.scale.length[b]:
            ended = OPTIMUM
        elif damping > LARGEST_DAMPING * scale:
            ended = STABILITY_ENDS if left else HELD_UP
        elif not promised > 0.0:
            ended = NO_GAIN
        elif taken == PATIENCE:
            if value > (1.0 - WORTH) * before or value - HOPE * (before - value) > best:
                ended = NO_GAIN
            taken, before = 0, value
        if ended != RUNNING:
            if points.known[here, LAST_MOVE] <= CLOSEST:
                break
            if not _refine(problem, work, b, here, free):
                break
            before, taken = points.known[here, HALF_COST], 0
            continue
        promised *= _aim(problem, work, b, here, there)
        change = 0.0
        for m in range(count):
            change = max(change, abs(box.step[m]))
        close = min(max(SHARP * change, CLOSEST), CLOSE)
        found = evaluate_point(problem, work, b, there, close, FEW_EVALUATIONS)
        left = not (found and (free or points.known[there, STABLE] > 0.0))
        if left:
            damping = max(damping * growth, BLIND_DAMPING * scale)
            growth *= 2.0
            continue
        augmented = _foretold(work, here, there)
        _update_secant(work, here, there)
        quality = (value - points.known[there, HALF_COST]) / max(promised, 1e-300)
        if promised <= ROUNDING * value and abs(value - points.known[there, HALF_COST]) <= ROUNDING * value:
            calmer = error_slope(problem, work, b, there) < 0.5 * error_slope(problem, work, b, here)
            quality = 1.0 if calmer else 0.0
        if quality > LEAST_GAIN:
            here, there = there, here
            easier = 1.0 - (2.0 * min(max(quality, -1.0), 2.0) - 1.0) ** 3
            damping, growth, taken = damping * max(easier, 0.1), 2.0, taken + 1
        else:
            damping, growth = damping * growth, 2.0 * growth
            if points.known[here, LAST_MOVE] > CLOSEST and not _refine(problem, work, b, here, free):
                break
    if points.known[here, LAST_MOVE] > CLOSEST:
        _refine(problem, work, b, here, free)
    return here, ended


@part
def _refine(problem, work, b, here, free):  # type: ignore[no-untyped-def]
    """Solve the equilibrium of a slot closely; whether it is still one. If not, the slot's value is infinite."""
    copy_rows(work.path.trial, work.points.twists[here])
    found = evaluate_point(problem, work, b, here, CLOSEST, FEW_EVALUATIONS)
    if not (found and (free or work.points.known[here, STABLE] > 0.0)):
        work.points.known[here, HALF_COST] = math.inf
        return False
    return True
