"""Descents to the pressure that brings an arm closest to a shape: `_descent.descend`, one after the other."""

import math

import numpy as np

from torcharm import _box, _descent, _tracing
from torcharm._arrays import Array
from torcharm.engine.compilation import jit
from torcharm.kernels.arms import Arms
from torcharm.kernels.box import box_step
from torcharm.kernels.copies import put, put_all
from torcharm.kernels.goal import Goal, model
from torcharm.kernels.march import NONE, look, moves, new_march, solve

_NEAR, _NEWTON_STEPS, _NARROWEST = _descent.NEAR, _descent.NEWTON_STEPS, _descent.NARROWEST
_FLOOR, _STIFF = _descent.FLOOR, _descent.STIFF
_START_DAMPING, _LEAST_DAMPING = _box.START_DAMPING, _box.LEAST_DAMPING
_LARGEST, _CONTRACTION = _tracing.LARGEST_MOVE, _tracing.CONTRACTION


@jit
def descend(
    arms: Arms,
    goal: Goal,
    rows: Array,
    wall: Array,
    walled: bool,
    gain: float,
    settled: float,
    looks: int,
    first_row: int,
    last_row: int,
    places: Array,
    unknowns: Array,
    costs: Array,
    ended: Array,
) -> None:
    """Follow the cost down, of some of B searches.

    Args:
        arms, goal: of `rows` (B,).
        wall: (B, M) normals, along which the pressures are held, if walled.
        gain, looks: as of `_descent.descend`.
        settled: Newton's step at which a descent may end.
        first_row, last_row: which, without the last.
        places: (B, M) where to start, and takes where it ends.
        unknowns: (B, 2, N) the same.
        costs, ended: (B,) take the costs, and whether the descents ended by themselves.
    """
    size, nodes = places.shape[1], unknowns.shape[2]
    march = new_march(arms, nodes)
    columns, products = np.empty((1 + size, 3, nodes)), np.empty((1 + size, 1 + size))
    normal, bound, gradient = np.empty((size, size)), np.empty((size, size)), np.empty(size)
    motion, turned = np.empty((size, 2, nodes)), np.empty((size, nodes))
    trial_place, trial, acting, step = np.empty(size), np.empty((2, nodes)), np.empty(size), np.empty(size)
    dz, dturn = np.empty((2, nodes)), np.empty(nodes)
    for at in range(first_row, last_row):
        row = rows[at]
        place, z = places[at], unknowns[at]
        put(trial_place, place)
        put_all(trial, z)
        normal[:], gradient[:], motion[:], turned[:] = 0.0, 0.0, 0.0, 0.0
        best, unsettled, sign, damping, promise = math.inf, 0.0, 0.0, _START_DAMPING, 0.0
        turn, stalled, first, over = 0, 0, 0.0, False
        for _ in range(looks):
            for m in range(size):
                acting[m] = trial_place[m] * arms.limits[row, m]
            look(arms, row, trial, acting, 1.0, True, march)
            _, new_sign = solve(arms, row, trial, acting, 1.0, NONE, True, True, 0.0, 0.0, march)
            newton = march.change[1]
            length = moves(arms, row, newton, march.turned[1])
            near = length <= _NEAR
            if turn == 0:
                first = length
            on = not near and (turn != 1 or length < _CONTRACTION * first)
            on = on and length < _LARGEST and turn < _NEWTON_STEPS
            better, sound, cost, quality = False, False, math.nan, 0.0
            if near and (new_sign == sign or sign == 0):
                model(goal, row, march, 2, columns, products)
                cost, check = products[0, 0], 0.0
                for m in range(size):
                    check += products[0, 1 + m]
                sound = math.isfinite(cost) and math.isfinite(check)
                better = sound and cost < best
            if better:
                drop = best - cost
                quality = drop / max(promise, 1e-300)
                if quality > 0.75:
                    damping /= 10
                if quality < 0.25 and promise > 0:
                    damping *= 3
                put(place, trial_place)
                for c in range(2):
                    for i in range(nodes):
                        z[c, i] = trial[c, i] + newton[c, i]
                best, unsettled, sign = cost, length, new_sign
                for m in range(size):
                    gradient[m] = products[0, 1 + m]
                    put(normal[m], products[1 + m, 1:])
                    put_all(motion[m], march.change[2 + m])
                    put(turned[m], march.turned[2 + m])
                stalled = stalled + 1 if drop < gain * cost else 0
            elif not on:
                damping = max(damping, 1e-6) * (5.0 if sound else 10.0)
            damping = min(max(damping, _LEAST_DAMPING), _NARROWEST)
            if on and not better:
                for c in range(2):
                    for i in range(nodes):
                        trial[c, i] += newton[c, i]
                turn += 1
                continue
            # The next attempt
            turn = 0
            if not better and unsettled > settled and math.isfinite(best):
                # A cost that was corrected too much is in the way: look at the best point once more
                put(trial_place, place)
                put_all(trial, z)
                best, unsettled, promise = math.inf, 0.0, 0.0
                continue
            stiff = 0.0
            if walled:
                for m in range(size):
                    stiff = max(stiff, normal[m, m])
                stiff *= _STIFF
            for m in range(size):
                for k in range(size):
                    bound[m, k] = normal[m, k] + stiff * wall[at, m] * wall[at, k] if walled else normal[m, k]
            box_step(bound, gradient, place, damping, step)
            promised = 0.0
            for m in range(size):
                curved = 0.0
                for k in range(size):
                    curved += normal[m, k] * step[k]
                promised += step[m] * (2 * gradient[m] + curved)
            dz[:], dturn[:] = 0.0, 0.0
            for m in range(size):
                for i in range(nodes):
                    dz[0, i] += motion[m, 0, i] * step[m]
                    dz[1, i] += motion[m, 1, i] * step[m]
                    dturn[i] += turned[m, i] * step[m]
            # Too far along the tangent to come back from: shorter
            short = min(0.7 * _LARGEST / max(moves(arms, row, dz, dturn), 1e-12), 1.0)
            promise = -promised * short
            done = (promise <= gain * best + _FLOOR and unsettled <= settled) or stalled >= 5
            if not math.isfinite(best) or damping >= _NARROWEST or done:
                over = True
                break
            for m in range(size):
                trial_place[m] = min(max(place[m] + step[m] * short, 0.0), 1.0)
            for c in range(2):
                for i in range(nodes):
                    trial[c, i] = z[c, i] + dz[c, i] * short
        costs[at], ended[at] = best, over and math.isfinite(best)
