"""The step in the box: `_box.box_step` for one element."""

import numpy as np

from torcharm import _box
from torcharm._arrays import Array
from torcharm.engine.compilation import inlined

_SWEEPS = _box.SWEEPS


@inlined
def box_step(normal: Array, gradient: Array, place: Array, damping: float, step: Array) -> None:
    """The Levenberg-Marquardt step (M,) from a place in the box, cut to it, with the matrix AᵀA and Aᵀr."""
    count = place.shape[0]
    size = 1e-300
    for i in range(count):
        size = max(size, normal[i, i])
    extra = damping * size
    held, reduced = np.empty(count, np.bool_), np.empty((count, count + 1))
    for i in range(count):
        held[i] = (place[i] <= 0 and gradient[i] > 0) or (place[i] >= 1 and gradient[i] < 0)
        step[i] = 0.0
    for _ in range(count):
        leaves = False
        for i in range(count):  # the minimum over the variables that are free
            if held[i]:
                for j in range(count):
                    reduced[i, j] = 0.0
                reduced[i, i], reduced[i, count] = 1.0, step[i]
                continue
            right = -gradient[i]
            for j in range(count):
                if held[j]:
                    right -= normal[i, j] * step[j]
                    reduced[i, j] = 0.0
                else:
                    reduced[i, j] = normal[i, j]
            reduced[i, i] += extra
            reduced[i, count] = right
        for i in range(count):
            pivot = reduced[i, i]
            for j in range(i, count + 1):
                reduced[i, j] /= pivot
            for k in range(count):
                factor = reduced[k, i]
                if k != i and factor != 0:
                    for j in range(i, count + 1):
                        reduced[k, j] -= factor * reduced[i, j]
        for i in range(count):
            answer = reduced[i, count]
            if held[i]:
                continue
            if answer < -place[i]:
                step[i], held[i], leaves = -place[i], True, True
            elif answer > 1 - place[i]:
                step[i], held[i], leaves = 1 - place[i], True, True
            else:
                step[i] = answer
        if not leaves:
            break
    value = 0.0
    for i in range(count):
        value += step[i] * (2 * gradient[i] + _row(normal, extra, step, i))
    if not value < 0:
        step[:] = 0.0
    for _ in range(_SWEEPS):
        for i in range(count):
            slope = gradient[i] + _row(normal, extra, step, i)
            wanted = step[i] - slope / (normal[i, i] + extra)
            step[i] = min(max(wanted, -place[i]), 1 - place[i])


@inlined
def _row(normal: Array, extra: float, step: Array, i: int) -> float:
    """The damped matrix times the step, entry i."""
    total = extra * step[i]
    for j in range(step.shape[0]):
        total += normal[i, j] * step[j]
    return total
