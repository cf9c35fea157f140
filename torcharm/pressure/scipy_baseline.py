"""The paper's pressure search: one pressure at a time through scipy, for validation."""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from torcharm.engine.arrays import row_of
from torcharm.engine.continuation import CONTINUED, FAILED, WARM
from torcharm.engine.pose_error import NO_GOAL
from torcharm.engine.pressure_model import Problem as EngineProblem
from torcharm.engine.questions import find
from torcharm.engine.searches import Searches
from torcharm.equilibrium.solve import TOLERANCE
from torcharm.equilibrium.stability import stays
from torcharm.inputs import check_choice
from torcharm.pressure.pose_cost import pose_errors
from torcharm.pressure.prepared import Prepared
from torcharm.pressure.starts import nothing_found, spread_points

SCIPY_METHODS = ("L-BFGS-B", "SLSQP", "TNC", "trust-constr", "Nelder-Mead", "Powell", "COBYLA")
NOTHING = 1e3
"""A cost [m²] for pressures without equilibrium: more than any arm's, and finite for scipy's sake."""
SAME_COST = 1e-6
"""Difference of the cost that scipy ended at and that from zero load, over 1 m² or itself, that counts as none."""
STEP = 1e-7
"""Of normalised pressures, for the slope of the cost at the end: its error is that of equilibria solved to 1e-10 of
the load, over the step."""

Numbers = NDArray[np.float64]


def search_one_by_one(prepared: Prepared, starts: int, seed: int, method: str, progress: bool | None) -> Searches:
    """Search one task after the other; Ctrl-C raises."""
    from rich.progress import track

    check_choice("scipy_method", method, SCIPY_METHODS)
    out = nothing_found(prepared, starts)
    points = spread_points(starts, prepared.engine.limit.shape[1], seed)
    with torch.no_grad():
        targets = prepared.poses(prepared.twists)
        tail = targets.shape[prepared.twists.ndim - 2 :]
        targets = targets.expand(*prepared.batch, *tail).reshape(-1, *tail)
        weights = torch.from_numpy(prepared.flat(prepared.weights, 2))
        pairs = range(len(out.how))
        for b in pairs if progress is False else track(pairs, "pressure search", transient=True):
            _search(_Task(prepared, b, targets[b], weights[b]), points, method, out)
    return out


class _Task:
    """One pair of a design and a task, with the cost of its poses at normalised pressures."""

    def __init__(self, prepared: Prepared, b: int, target: Tensor, weights: Tensor) -> None:
        self.prepared, self.b, self.target, self.weights = prepared, b, target, weights
        self.packed = _row(prepared.engine, b)
        self.limit = self.packed.limit[0]
        self.warm = np.zeros((0, *prepared.shape.shape[1:]))

    def solve(self, normalised: Numbers, warm: bool) -> tuple[float, Numbers, int]:
        """The cost at an equilibrium, its twists, and how it is reached; from the last one if warm."""
        packed = self.packed._replace(limit=(np.clip(normalised, 0, 1) * self.limit)[None])
        found = find(packed, self.warm if warm else self.warm[:0], TOLERANCE)
        if found.reached[0] == FAILED or not bool(stays(packed, found)[0]):
            return NOTHING, found.twists[0], FAILED
        error = pose_errors(self.prepared.poses(torch.from_numpy(found.twists[0])), self.target)
        return float((self.weights * error.square()).sum()), found.twists[0], int(found.reached[0])

    def cost(self, normalised: Numbers) -> float:
        """The cost, warm-started by the last equilibrium."""
        value, twists, how = self.solve(normalised, warm=True)
        if how != FAILED:
            self.warm = twists[None]
        return value

    def slope(self, normalised: Numbers) -> Numbers:
        """The cost's slope by normalised pressures, by differences within the box."""
        slope = np.zeros_like(normalised)
        for m in range(len(normalised)):
            high, low = normalised.copy(), normalised.copy()
            high[m], low[m] = min(normalised[m] + STEP, 1.0), max(normalised[m] - STEP, 0.0)
            slope[m] = (self.cost(high) - self.cost(low)) / (high[m] - low[m])
        return slope


def _row(packed: EngineProblem, b: int) -> EngineProblem:
    """One of the problems."""
    arms, loads, scale = row_of(packed.arms, b), row_of(packed.loads, b), row_of(packed.scale, b)
    return EngineProblem(arms, loads, scale, NO_GOAL, packed.limit[b : b + 1])


def _search(task: _Task, points: Numbers, method: str, out: Searches) -> None:
    """Write what is found for one task."""
    from scipy.optimize import minimize

    b, best = task.b, np.inf
    for s, start in enumerate(points):
        task.warm = task.warm[:0]
        answer = minimize(task.cost, start, method=method, bounds=[(0.0, 1.0)] * len(start))
        normalised = np.clip(answer.x, 0.0, 1.0)
        value, twists, how = task.solve(normalised, warm=False)
        out.start_cost[b, s] = value if how != FAILED else np.inf
        if how == FAILED or value >= best:
            continue
        best, same = value, abs(value - float(answer.fun)) <= SAME_COST * (1.0 + value)
        out.normalised[b], out.twists[b], out.half_cost[b] = normalised, twists, 0.5 * value
        out.how[b], out.confirmed[b] = how, bool(answer.success) and same and how in (CONTINUED, WARM)
    if np.isfinite(best):
        task.warm = out.twists[b][None]
        slope, normalised = task.slope(out.normalised[b]), out.normalised[b]
        out.optimality[b] = np.abs(normalised - np.clip(normalised - slope, 0.0, 1.0)).max()
