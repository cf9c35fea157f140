"""Equilibria of sampled models, corrected on the models themselves."""

import numpy as np
import torch

from torcharm.engine.continuation import FAILED
from torcharm.engine.path import Found
from torcharm.engine.questions import solve
from torcharm.equilibrium.problem import Problem
from torcharm.geometry.rod import group_of

CORRECTIONS = 60
"""Steps at most: each gains the digits to which a table is good, six where it is fine; at a kink that it rounds off,
whose slope it only knows to a half or so, a fraction of one."""


@torch.no_grad()
def corrected(problem: Problem, found: Found, tolerance: float) -> Found:
    """The same equilibria to the tolerance, by Newton steps on the exact residual with the table's slope."""
    packed, columns = problem.packed, problem.unknown
    dimension = group_of(found.twists.shape[-1]).DIMENSION
    measure = np.where(np.array(columns) < dimension, found.scale[:, :1], found.scale[:, 1:])[:, None, :]
    twists, residual, best = found.twists.copy(), np.full(len(found.twists), np.inf), found.twists.copy()
    for _ in range(CORRECTIONS):
        shaped = torch.from_numpy(twists).reshape(*problem.batch, *twists.shape[1:])
        exact = problem.residual(shaped).reshape(len(twists), twists.shape[1], len(columns)).numpy().copy()
        size = np.abs(exact / measure).max((-2, -1))
        better = size < residual
        best[better], residual[better] = twists[better], size[better]
        rows = np.flatnonzero((residual > 1e-3 * tolerance) & (found.reached != FAILED) & np.isfinite(size))
        if not len(rows) or not better[rows].any():
            break
        rows = rows[better[rows]]
        step = exact[rows][:, None]
        solve(packed, twists, rows, step)
        twists[np.ix_(rows, range(twists.shape[1]), columns)] -= step[:, 0]
    return found._replace(twists=best, residual=np.where(np.isinf(residual), np.nan, residual))
