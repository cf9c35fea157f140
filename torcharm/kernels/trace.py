"""Paths of equilibria: `_tracing.trace`, one arm after the other."""

import math

import numpy as np

from torcharm import _tracing
from torcharm._arrays import Array
from torcharm.engine.compilation import jit
from torcharm.kernels.arms import Arms
from torcharm.kernels.copies import put_all
from torcharm.kernels.march import BY_FILLING, BY_LOAD, imbalance, look, moves, new_march, solve

_LARGEST, _SMALL, _AIMED, _UNLOADED = (
    _tracing.LARGEST_MOVE,
    _tracing.SMALL_MOVE,
    _tracing.AIMED_MOVE,
    _tracing.UNLOADED,
)
_CONTRACTION, _CORRECTIONS = _tracing.CONTRACTION, _tracing.CORRECTIONS


@jit
def trace(
    arms: Arms,
    rows: Array,
    places: Array,
    loading: bool,
    start: Array,
    first_step: float,
    looks: int,
    least_share: float,
    first_row: int,
    last_row: int,
    out: Array,
    shares: Array,
) -> None:
    """Follow the equilibria of s = 0 to s = 1, as far as they go, of some of B arms.

    Args:
        arms: of `rows` (B,).
        places: (B, M) pressures at s = 1, as shares of their limits.
        loading: whether the load grows, or the pressure.
        start: (B, 2, N).
        first_step, looks, least_share: as of `_tracing.trace`.
        first_row, last_row: which, without the last.
        out: (3, B, 2, N) takes where the paths ended, their quickest points, and the rates there.
        shares: (2, B) takes the shares of both.
    """
    nodes, actuators = start.shape[2], places.shape[1]
    ease = 1.0 if loading else _UNLOADED
    march = new_march(arms, nodes)
    base, tangent, bend = np.empty((2, nodes)), np.empty((2, nodes)), np.empty((2, nodes))
    trial, quick, rush = np.empty((2, nodes)), np.empty((2, nodes)), np.empty((2, nodes))
    full, acting = np.empty(actuators), np.empty(actuators)
    for at in range(first_row, last_row):
        row = rows[at]
        for m in range(actuators):
            full[m] = places[at, m] * arms.limits[row, m]
        put_all(base, start[at])
        put_all(quick, start[at])
        put_all(trial, start[at])
        tangent[:], bend[:], rush[:] = 0.0, 0.0, 0.0
        share, step, speed, sign, aim, turn = 0.0, first_step, 0.0, 0.0, 0.0, 0
        first = ratio = moved = haste = when = 0.0
        for _ in range(looks):
            for m in range(actuators):
                acting[m] = full[m] if loading else full[m] * aim
            force, moment = look(arms, row, trial, acting, aim if loading else 0.0, not loading, march)
            _, new_sign = solve(
                arms,
                row,
                trial,
                full,
                aim if loading else 0.0,
                BY_LOAD if loading else BY_FILLING,
                False,
                False,
                0.0,
                0.0,
                march,
            )
            newton, new_tangent = march.change[1], march.change[2]
            size, new_speed = moves(arms, row, newton, march.turned[1]), moves(arms, row, new_tangent, march.turned[2])
            if turn == 0:
                first = size
            elif turn == 1:
                ratio = size / max(first, 1e-300)
            there = imbalance(arms, row, force, moment) <= arms.tolerance if aim >= 1 else size <= ease * _SMALL
            if not there:
                moved += size
            trusted = ratio < _CONTRACTION or moved < ease * _SMALL
            if there and trusted and (new_sign == sign or sign == 0) and math.isfinite(new_speed):
                # Ahead from a new equilibrium
                started = sign != 0
                taken = aim - share if started else step
                share = aim
                half = 0.5 / max(taken, 1e-12)
                curved = started and share < 1
                for c in range(2):
                    for i in range(nodes):
                        base[c, i] = trial[c, i] + newton[c, i]
                        bend[c, i] = (new_tangent[c, i] - tangent[c, i]) * half if curved else 0.0
                        tangent[c, i] = new_tangent[c, i]
                speed, sign = new_speed, new_sign
                stretch = min(max((ease * _AIMED / max(first, 1e-12)) ** (1 / 3), 0.3), 4.0)
                step = taken * stretch if started else taken
                if speed > haste:
                    put_all(quick, base)
                    put_all(rush, tangent)
                    haste, when = speed, share
            elif not there and trusted and moved < _LARGEST and turn < _CORRECTIONS:
                for c in range(2):
                    for i in range(nodes):
                        trial[c, i] += newton[c, i]
                turn += 1
                continue
            else:  # once more from the last with a shorter step
                step = 0.25 * (aim - share if sign != 0 else step)
            if not (sign != 0 and share < 1 and step >= least_share):
                break
            ahead = min(step, _LARGEST / max(speed, 1e-12), 1 - share)
            aim = share + ahead
            if aim > 1 - 1e-9:
                aim = 1.0
            for c in range(2):
                for i in range(nodes):
                    trial[c, i] = base[c, i] + ahead * (tangent[c, i] + bend[c, i] * ahead)
            turn, first, ratio, moved = 0, 0.0, 0.0, 0.0
        put_all(out[0, at], base)
        put_all(out[1, at], quick)
        put_all(out[2, at], rush)
        shares[0, at], shares[1, at] = share, when
