"""Least squares in the box [0, 1]^M for many problems at once: see `box_step`."""

import numpy as np

from torcharm.engine.arrays import Array, make
from torcharm.engine.box_step import BoxStep, write_box_step
from torcharm.engine.compilation import kernel
from torcharm.engine.copies import copy_row


def box_steps(gradient: Array, curvature: Array, point: Array, damping: float) -> Array:
    """The steps (B, M) that minimise `g·s + ½ s·(H + d 1) s` with `point + s` in the box.

    Args:
        gradient: (B, M) g.
        curvature: (B, M, M) H, symmetric.
        point: (B, M) in the box.
        damping: d.
    """
    step = np.zeros(gradient.shape)
    first, second, at = map(np.ascontiguousarray, (gradient, curvature, point))
    _write_all(first, second, at, float(damping), make(BoxStep, {"M": gradient.shape[1]}), step)
    return step


@kernel
def _write_all(gradient, curvature, point, damping, box, step):  # type: ignore[no-untyped-def]
    """Write the steps, one problem after the other."""
    for b in range(len(gradient)):
        write_box_step(box, gradient[b], curvature[b], curvature[b], False, point[b], damping)
        copy_row(step[b], box.step)
