"""Least squares in the box [0, 1]^M: the step that minimises a damped quadratic model within it."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from torcharm.engine.arrays import Array
from torcharm.engine.compilation import part
from torcharm.engine.references import by_reference

LEAST_SHIFT = 1e-12
"""Of the largest diagonal entry, added to the diagonal of a model: rounding makes no pivot below it negative."""
FIRST_SHIFT = 1e-3
"""The same where the model is not convex on what may move; ten times as much until it is."""
INWARD = 1e-12
"""Of the steepest slope at the point: what is less is rounding, and frees no variable from its bound."""


@by_reference
class BoxStep(NamedTuple):
    """Scratch of steps of M variables."""

    step: Float64[Array, "M"]
    held: Float64[Array, "M"]  # 1 where a variable is held at its bound, else 0
    matrix: Float64[Array, "M M"]  # the damped model
    factor: Float64[Array, "M M"]  # its Cholesky factor on the free variables
    right: Float64[Array, "M"]  # a right-hand side, and the solution
    slope: Float64[Array, "M"]  # of the damped model


@part
def optimality(gradient, point):  # type: ignore[no-untyped-def]
    """How far a step down a gradient gets within the box: 0 at a first-order optimum."""
    most = 0.0
    for m in range(len(point)):
        most = max(most, abs(point[m] - min(max(point[m] - gradient[m], 0.0), 1.0)))
    return most


@part
def largest_curvature(curvature):  # type: ignore[no-untyped-def]
    """The largest diagonal entry, at least next to nothing."""
    most = 1e-30
    for m in range(len(curvature)):
        most = max(most, curvature[m, m])
    return most


@part
def factor_free(box):  # type: ignore[no-untyped-def]
    """Factor the damped model on the free variables; whether it is positive definite there."""
    for m in range(len(box.step)):
        for k in range(m + 1):
            total = box.matrix[m, k]
            if box.held[m] or box.held[k]:
                total = 1.0 if m == k else 0.0
            for j in range(k):
                total -= box.factor[m, j] * box.factor[k, j]
            if m == k:
                if not total > 0.0:
                    return False
                box.factor[m, m] = np.sqrt(total)
            else:
                box.factor[m, k] = total / box.factor[k, k]
    return True


@part
def solve_free(box):  # type: ignore[no-untyped-def]
    """Replace `right` by the solution on the free variables, as factored; 0 for the others."""
    count = len(box.step)
    for m in range(count):
        total = 0.0 if box.held[m] else box.right[m]
        for k in range(m):
            total -= box.factor[m, k] * box.right[k]
        box.right[m] = total / box.factor[m, m]
    for m in range(count - 1, -1, -1):
        total = box.right[m]
        for k in range(m + 1, count):
            total -= box.factor[k, m] * box.right[k]
        box.right[m] = total / box.factor[m, m]


@part
def _write_slope(box, gradient):  # type: ignore[no-untyped-def]
    for m in range(len(gradient)):
        total = gradient[m]
        for k in range(len(gradient)):
            total += box.matrix[m, k] * box.step[k]
        box.slope[m] = total


@part
def write_box_step(box, gradient, curvature, extra, use_extra, point, damping):  # type: ignore[no-untyped-def]
    """Write the step that minimises `g·s + ½ s·(H + d 1) s` within the box; returns the decrease that it promises.

    The primal active-set method (Nocedal and Wright, *Numerical Optimization*, 2006, ch. 16): the minimum on the free
    variables, as far as no other leaves the box; at the minimum, of those that are held the one that the slope draws
    inward most is freed. Where the model is not convex the damping grows.

    Args:
        gradient: (M,) g.
        curvature, extra: (M, M) H, and what is added to it if `use_extra`.
        point: (M,) in the box.
        damping: d.
    """
    count, scale = len(point), largest_curvature(curvature)
    shift, steepest = damping + LEAST_SHIFT * scale, 0.0
    for m in range(count):
        box.step[m] = 0.0
        box.held[m] = (point[m] <= 0.0 and gradient[m] >= 0.0) or (point[m] >= 1.0 and gradient[m] <= 0.0)
        steepest = max(steepest, abs(gradient[m]))
    for _ in range(40):  # the shift is beyond any curvature then
        for m in range(count):
            for k in range(count):
                box.matrix[m, k] = curvature[m, k]
                if use_extra:
                    box.matrix[m, k] += extra[m, k]
            box.matrix[m, m] += shift
        if factor_free(box):
            break
        shift = max(10.0 * shift, FIRST_SHIFT * scale)
    for _ in range(4 * count + 4):  # the method ends by itself: rounding might have it go in circles
        _write_slope(box, gradient)
        for m in range(count):
            box.right[m] = -box.slope[m]
        if not factor_free(box):
            break
        solve_free(box)
        length, blocking = 1.0, -1
        for m in range(count):
            if box.held[m]:
                continue
            free = 1.0 - point[m] - box.step[m] if box.right[m] > 0.0 else point[m] + box.step[m]
            if abs(box.right[m]) * length > free:
                length, blocking = max(free, 0.0) / abs(box.right[m]), m
        for m in range(count):
            if not box.held[m]:
                box.step[m] += length * box.right[m]
        if blocking >= 0:
            box.held[blocking] = 1.0
            box.step[blocking] = 1.0 - point[blocking] if box.right[blocking] > 0.0 else -point[blocking]
            continue
        _write_slope(box, gradient)
        freed, most = -1, INWARD * steepest
        for m in range(count):
            if box.held[m]:
                inward = -box.slope[m] if point[m] + box.step[m] <= 0.0 else box.slope[m]
                if inward > most:
                    freed, most = m, inward
        if freed < 0:
            break
        box.held[freed] = 0.0
    promised = 0.0
    for m in range(count):
        moved = 0.0
        for k in range(count):
            moved += box.matrix[m, k] * box.step[k]
        promised -= box.step[m] * (gradient[m] + 0.5 * moved)
    return promised
