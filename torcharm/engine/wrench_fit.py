"""Pressures whose reactions come closest to what a shape requires: least squares in wrenches, the shape held.

Nothing moves, so an evaluation costs no more than the actuators' forces. Some pressures have nearly no effect, and
least squares creep along the curved valleys that these make: Levenberg and Marquardt's steps are bent to follow them,
by the second derivative along the step (geodesic acceleration; Transtrum and Sethna 2012, arXiv:1201.5885).
"""

import math
from typing import NamedTuple

from jaxtyping import Bool, Float64

from torcharm.engine.arrays import Array
from torcharm.engine.box_step import factor_free, largest_curvature, optimality, solve_free, write_box_step
from torcharm.engine.compilation import part
from torcharm.engine.copies import copy_row, copy_rows
from torcharm.engine.newton_step import write_balance, write_shape
from torcharm.engine.references import by_reference
from torcharm.engine.sections import set_pressure, write_rates, write_section

FIT_STEPS, FIT_GAIN = 15, 1e-2
"""Steps of a fit where a descent begins, at most; and the share of the squared distance that one must promise, which is
all of it where the shape can be held."""
STEPS, GAIN = 120, 1e-14
"""The same of a fit that is wanted for itself: more steps were not seen to help."""
START_DAMPING, LEAST_DAMPING, MOST_DAMPING = 1e-2, 1e-14, 1e8
"""Of the largest curvature: at first; where it no longer changes a step; and where a step is but rounding."""
NOTHING = 1e-30
"""Of a squared distance [N²]: it has vanished."""
LOOK_AHEAD = 0.1
"""Part of a step after which its second derivative is measured: the error of the difference falls with it."""
BEND = 0.75
"""Most that a step is bent, over its length: beyond, the second derivative is no small correction (Transtrum,
Sethna)."""


@by_reference
class Fit(NamedTuple):
    """Scratch of one fit."""

    normalised: Float64[Array, "2 M"]  # normalised pressures: where the fit is, and what is tried
    miss: Float64[Array, "2 N C"]  # weighted residuals there
    rates: Float64[Array, "M N C"]  # of the first by the normalised pressures
    gradient: Float64[Array, "M"]  # of half the squared distance
    normal: Float64[Array, "M M"]  # its matrix of the normal equations
    nothing: Float64[Array, "M M"]  # zeros
    weight: Float64[Array, "C"]  # roots of the weights of the components


@part
def _evaluate(problem, work, fit, b, twist, at):  # type: ignore[no-untyped-def]
    """Write the residual at one of two pressures; returns the squared distance. `write_carried` was before."""
    arms, balance = problem.arms, work.balance
    for m in range(problem.limit.shape[1]):
        work.pressure[b, m] = fit.normalised[at, m] * problem.limit[b, m]
    set_pressure(arms, balance.drive, work.pressure, b, 1.0)
    total = 0.0
    for segment in range(len(arms.first_node) - 1):
        for i in range(arms.first_node[segment], arms.first_node[segment + 1]):
            write_section(arms, balance.drive, balance.sections, b, segment, i, twist)
            for c in range(len(arms.unknown)):
                one = fit.weight[c] * (balance.sections.reaction[i, c] + balance.carried[i, c])
                fit.miss[at, i, c] = one
                total += one * one
    return total


@part
def _write_normal(problem, work, fit, b, twist):  # type: ignore[no-untyped-def]
    """Write the slopes of the residual at the first pressures, which was evaluated last, and the normal equations."""
    arms, sections = problem.arms, work.balance.sections
    for segment in range(len(arms.first_node) - 1):
        for i in range(arms.first_node[segment], arms.first_node[segment + 1]):
            write_rates(arms, work.balance.drive, sections, b, segment, i, twist)
            for m in range(len(fit.gradient)):
                for c in range(len(arms.unknown)):
                    fit.rates[m, i, c] = fit.weight[c] * sections.rate[i, c, m] * problem.limit[b, m]
    for m in range(len(fit.gradient)):
        for k in range(m + 1):
            total = 0.0
            for i in range(fit.rates.shape[1]):
                for c in range(fit.rates.shape[2]):
                    total += fit.rates[m, i, c] * fit.rates[k, i, c]
            fit.normal[m, k] = fit.normal[k, m] = total
        total = 0.0
        for i in range(fit.rates.shape[1]):
            for c in range(fit.rates.shape[2]):
                total += fit.rates[m, i, c] * fit.miss[0, i, c]
        fit.gradient[m] = total


@part
def _bend(problem, work, fit, b, twist):  # type: ignore[no-untyped-def]
    """Write as the second pressures where the step leads, bent."""
    box = work.box
    count = len(box.step)
    for m in range(count):
        fit.normalised[1, m] = fit.normalised[0, m] + LOOK_AHEAD * box.step[m]
    _evaluate(problem, work, fit, b, twist, 1)
    for m in range(count):
        box.held[m], total = box.step[m] == 0.0, 0.0
        for i in range(fit.rates.shape[1]):
            for c in range(fit.rates.shape[2]):
                bent = (fit.miss[1, i, c] - fit.miss[0, i, c]) / LOOK_AHEAD  # and less the slope, half of r'' ahead
                for k in range(count):
                    bent -= fit.rates[k, i, c] * box.step[k]
                total += fit.rates[m, i, c] * bent
        box.right[m] = total / LOOK_AHEAD
    side = length = 0.0
    if factor_free(box):
        solve_free(box)
        for m in range(count):
            side += box.right[m] ** 2
            length += box.step[m] ** 2
    bends = side <= BEND * BEND * length and length > 0.0
    for m in range(count):
        ahead = fit.normalised[0, m] + box.step[m]
        if bends:
            ahead -= box.right[m]
        fit.normalised[1, m] = min(max(ahead, 0.0), 1.0)


@part
def write_carried(problem, work, b, twist):  # type: ignore[no-untyped-def]
    """Write what the sections of a shape (N, K) carry, once for all fits at it."""
    for m in range(problem.limit.shape[1]):
        work.pressure[b, m] = 0.0
    set_pressure(problem.arms, work.balance.drive, work.pressure, b, 1.0)
    write_shape(problem.arms, problem.loads, work.balance, b, twist, False)
    write_balance(problem.arms, problem.loads, work.balance, b, twist, 1.0, 0.0, 0.0)


@part
def fit_wrenches(problem, work, fit, b, twist, steps, gain):  # type: ignore[no-untyped-def]
    """Minimise the squared distance from the first pressures on, where `write_carried` was before.

    Args:
        steps: at most so many.
        gain: a step that promises no more of the squared distance is the last.

    Returns:
        The squared distance at the first pressures, and whether the descent came to its end.
    """
    value = _evaluate(problem, work, fit, b, twist, 0)
    _write_normal(problem, work, fit, b, twist)
    damping = START_DAMPING
    for _ in range(steps):
        scale = largest_curvature(fit.normal)
        promised = write_box_step(
            work.box, fit.gradient, fit.normal, fit.nothing, False, fit.normalised[0], damping * scale
        )
        if not math.isfinite(value):
            return value, False
        if 2.0 * promised <= gain * value + NOTHING or damping > MOST_DAMPING:
            return value, True
        _bend(problem, work, fit, b, twist)
        tried = _evaluate(problem, work, fit, b, twist, 1)
        if tried < value:
            value = tried
            copy_row(fit.normalised[0], fit.normalised[1])
            copy_rows(fit.miss[0], fit.miss[1])
            _write_normal(problem, work, fit, b, twist)
            damping = max(0.1 * damping, LEAST_DAMPING)
        else:
            damping *= 5.0
    return value, False


@by_reference
class FitAnswers(NamedTuple):
    """Fits of B arms."""

    normalised: Float64[Array, "B M"]  # normalised pressures
    square: Float64[Array, "B"]  # squared distances
    miss: Float64[Array, "B N C"]  # weighted residuals
    optimality: Float64[Array, "B"]  # the largest entry of the projected gradient of half the squared distance
    done: Bool[Array, "B"]  # whether the descents came to their ends


@part
def fit_all(problem, shape, starts, first, last, work, fit, out):  # type: ignore[no-untyped-def]
    """Fit the arms from one to another, without the last, from several starts each, and keep the best.

    Args:
        shape: (B, N, K) twists.
        starts: (S, M) normalised pressures.
        out: is written.
    """
    for b in range(first, last):
        write_carried(problem, work, b, shape[b])
        out.square[b] = math.inf
        for s in range(len(starts)):
            copy_row(fit.normalised[0], starts[s])
            value, done = fit_wrenches(problem, work, fit, b, shape[b], STEPS, GAIN)
            if value < out.square[b]:
                _evaluate(problem, work, fit, b, shape[b], 0)
                out.square[b], out.done[b] = value, done
                _write_normal(problem, work, fit, b, shape[b])
                out.optimality[b] = optimality(fit.gradient, fit.normalised[0])
                copy_row(out.normalised[b], fit.normalised[0])
                copy_rows(out.miss[b], fit.miss[0])
