"""The paper's pressure search: one pressure at a time through scipy."""

from dataclasses import replace

import torch
from torch import Tensor

from torcharm import mechanics
from torcharm._box import optimality, spread_points
from torcharm._continuation import WARM_DAMPING, Problem, loaded, settle, unloaded
from torcharm._descent import Goal
from torcharm._inputs import check_choice
from torcharm.equilibrium import solve_equilibrium

SCIPY_METHODS = ("L-BFGS-B", "SLSQP", "TNC", "trust-constr", "Nelder-Mead", "Powell", "COBYLA")
NOTHING = 1e3
"""A cost [m²] for pressures without equilibrium: large, and finite for scipy's sake."""


def search_one_by_one(
    problem: Problem, goal: Goal, nodes: int, starts: int, seed: int, method: str, progress: bool | None
) -> tuple[Tensor, ...]:
    """As the batched search of a block, one after the other; Ctrl-C raises."""
    from rich.progress import track

    check_choice("scipy_method", method, SCIPY_METHODS)
    total, size = problem.pressure.shape
    places = spread_points(starts, size, problem.pressure, seed)
    rows = track(range(total), "pressure search", disable=progress is False, transient=True)
    found = [_search(problem[at], goal[at], nodes, places, method) for at in (torch.tensor([row]) for row in rows)]
    if not found:
        from torcharm.search import empty_result

        return empty_result(problem, nodes, starts)
    return tuple(torch.cat(column) for column in zip(*found, strict=True))


def _search(problem: Problem, goal: Goal, nodes: int, places: Tensor, method: str) -> tuple[Tensor, ...]:
    import numpy as np
    from scipy.optimize import minimize

    limits = problem.arm.max_pressure
    warm: list[Tensor] = []

    def cost(x: "np.ndarray") -> float:  # type: ignore[type-arg]
        place = torch.as_tensor(x.copy()).to(limits).clamp(0, 1)
        here = replace(problem, pressure=place * limits)
        settled = settle(here, warm[0], WARM_DAMPING) if warm else None
        if settled is None or not bool(settled.arrived):
            path = loaded(here, unloaded(here).unknowns.expand(-1, -1, nodes).contiguous())
            if not bool(path.arrived):
                return NOTHING
            unknowns = path.unknowns
        else:
            unknowns = settled.unknowns
        warm[:] = [unknowns]
        return float(goal.cost(unknowns.movedim(0, -1), problem.base_pose.mT))

    ends, costs, success = [], [], []
    with torch.no_grad():
        for start in places:
            warm.clear()
            bounds = [(0.0, 1.0)] * len(start)
            answer = minimize(cost, start.double().numpy(), method=method, bounds=bounds)
            ends.append(torch.as_tensor(answer.x).to(limits).clamp(0, 1))
            costs.append(float(answer.fun))
            success.append(bool(answer.success))
        place = torch.stack(ends)
        true = solve_equilibrium(
            problem.arm,
            place * limits,
            problem.tip_load,
            nodes,
            base_pose=problem.base_pose,
            shear_stiffness=problem.shear_stiffness,
        )
        reached = mechanics.to_unknowns(true.twists, shear=problem.components == 3).movedim(0, -1)
        confirmed = torch.where(true.stable, goal.cost(reached, problem.base_pose.mT), float("inf"))
        best = int(confirmed.argmin())
        slope = _slope(replace(problem, pressure=place[best, None] * limits), goal, true.twists[best, None])
        steepest = optimality(slope, place[best])
    pick = slice(best, best + 1)
    same = (confirmed[best] - costs[best]).abs() <= 1e-6 * (1 + confirmed[best])
    converged = true.converged[pick] & success[best] & same
    return (
        place[pick] * limits,
        confirmed[pick],
        true.twists[pick],
        true.residual[pick],
        true.continued[pick],
        converged,
        steepest.view(1),
        confirmed.unsqueeze(0),
        true.in_range[pick],
    )


def _slope(problem: Problem, goal: Goal, twists: Tensor) -> Tensor:
    """(M,) the cost's derivative by pressures as shares of the limits, by the implicit function theorem."""
    unknowns = mechanics.to_unknowns(twists, shear=problem.components == 3).movedim(0, -1)
    limits = problem.arm.max_pressure.mT
    _, gradient, _ = goal.model(mechanics.march(problem.arms, unknowns, problem.pressure.mT, each_pressure=limits))
    return 2 * gradient[:, 0]
