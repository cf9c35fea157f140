"""Distances one at a time with scipy's solvers: an accurate reference, and the paper's kind of solver.

Both loop over the batch on the CPU. They are for checking and for timing, not for optimising.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from torcharm.wrench_sets.hull_distance import HullAnswer, HullDistance, HullProblem, mix, solve_hulls

CHUNK = 4096
"""Problems scaled and checked at once; they are solved one by one."""
SLSQP_ITERATIONS = 200
"""Far more than the 10 to 30 that it takes where it gets anywhere."""
SLSQP_TOLERANCE = 1e-15
"""Of the objective, which is at most 1: below it there is only rounding."""
SUM_WEIGHT = 1e2
"""How much more a sum of weights that is not 1 counts than a distance, where several groups have a sum each.

Every pass divides what is missing by its square, and rounding grows with it.
"""
SUM_PASSES = 20
"""Passes at most until the sums of all groups are 1: three or four are usual."""
SUM_ACCURACY = 1e-14
"""By so much a sum of weights may be off before they are divided by it."""

Array = np.ndarray[Any, np.dtype[np.float64]]


def nnls_distance(
    point: Float[Tensor, "*#batch D"], vertices: Float[Tensor, "*#batch V D"], *, groups: int = 1
) -> HullDistance:
    """Distance from points to hulls of vertices by Lawson and Hanson's non-negative least squares.

    The weights that minimise `‖[H - w; 1] s - [0; 1]‖` over s ≥ 0 are, divided by their sum, those of the hull's
    point nearest to w. Where the set is a sum of hulls the sum of each group's weights gets a row of its own, and a
    multiplier: least squares are solved again with the rows' targets moved by what was missing, until nothing is. With
    H - w divided by its largest entry units do not matter, and the distance is right to a few roundings of that entry.
    Distances within the rounding of the coordinates are 0.

    The value is differentiable with respect to point and vertices, once, by the envelope theorem:
    with the weights held. Where several sets of weights are optimal (duplicated vertices) it is one
    of several gradients. The weights themselves carry none. Where scipy gives up, the answer is NaN and not converged.

    Args:
        point: where from.
        vertices: V points of any dimension, in any order within their group, duplicates allowed.
        groups: into which the vertices are divided evenly, group after group; the set is the sum of the groups' hulls.

    Raises:
        ValueError: there is no vertex, or dimensions, batches or groups do not fit.

    Example:
        >>> round(float(ta.nnls_distance(torch.ones(2), torch.eye(2)).value), 4)  # to the line from (1, 0) to (0, 1)
        0.7071
    """
    return solve_hulls(point, vertices, groups, partial(_answer, nnls_weights), CHUNK)


def slsqp_distance(
    point: Float[Tensor, "*#batch D"], vertices: Float[Tensor, "*#batch V D"], *, groups: int = 1
) -> HullDistance:
    """Distance from points to hulls of vertices by sequential quadratic programming, without gradient.

    It stands in for the paper's fmincon, for timing: a general solver on the paper's problem
    `min_s ½‖Hᵀ s - w‖², s ≥ 0, 1ᵀs = 1`, started from equal weights, with H - w scaled as for `nnls_distance`.
    Its distances are mostly good to 1e-8 of max|H - w|, at worst to some 1e-5 (`converged` is then False);
    inside a hull they are seldom exactly 0.

    Args:
        point: where from.
        vertices: V points of any dimension.
        groups: as of `nnls_distance`.

    Raises:
        ValueError: there is no vertex, or dimensions, batches or groups do not fit.

    Example:
        >>> round(float(ta.slsqp_distance(torch.ones(2), torch.eye(2)).value), 4)  # to the line from (1, 0) to (0, 1)
        0.7071
    """
    with torch.no_grad():
        return solve_hulls(point, vertices, groups, partial(_answer, slsqp_weights), CHUNK)


def _answer(find: Callable[[Tensor, int], Tensor], problem: HullProblem) -> HullAnswer:
    weights = find(problem.offsets, problem.groups)
    touching = touches(problem.offsets, weights, problem.groups, problem.blur)
    return HullAnswer(weights, touching, torch.zeros_like(touching), problem.length(weights, touching))


@torch.no_grad()
def touches(offsets: Tensor, weights: Tensor, groups: int, blur: Tensor) -> Tensor:
    """Whether (B) what weights mix to is the origin, to within the rounding that is left where least squares end."""
    rounding = blur if groups == 1 else SUM_WEIGHT * blur
    return torch.linalg.vector_norm(mix(weights, offsets), dim=-1) <= rounding


def nnls_weights(offsets: Float[Tensor, "B V D"], groups: int) -> Float[Tensor, "B V"]:
    """Weights of the sets' points nearest to the origin; NaN where the solver gives up."""
    from scipy.optimize import nnls

    def one(vertices: Array) -> Array:
        weight = 1.0 if groups == 1 else SUM_WEIGHT
        columns = np.concatenate((vertices.T, weight * member_rows(groups, len(vertices))))
        target = np.zeros(len(columns))
        target[-groups:] = weight
        for _ in range(1 if groups == 1 else SUM_PASSES):
            found = np.asarray(nnls(columns, target, maxiter=30 * len(vertices))[0])
            missing = 1.0 - found.reshape(groups, -1).sum(-1)
            if np.abs(missing).max() <= SUM_ACCURACY:
                break
            target[-groups:] += weight * missing
        return found

    return _each(one, offsets, groups)


def slsqp_weights(offsets: Float[Tensor, "B V D"], groups: int) -> Float[Tensor, "B V"]:
    """Weights of the sets' points nearest to the origin, as good as SLSQP's."""
    from scipy.optimize import minimize

    members = member_rows(groups, offsets.shape[1])

    def one(vertices: Array) -> Array:
        def objective(weights: Array) -> tuple[float, Array]:
            residual = weights @ vertices
            return 0.5 * float(residual @ residual), vertices @ residual

        count = len(vertices)
        found = minimize(
            objective,
            np.full(count, groups / count),
            jac=True,
            method="SLSQP",
            bounds=[(0.0, 1.0)] * count,
            constraints={"type": "eq", "fun": lambda s: members @ s - 1.0, "jac": lambda s: members},
            options={"maxiter": SLSQP_ITERATIONS, "ftol": SLSQP_TOLERANCE},
        )
        return np.asarray(found.x).clip(min=0.0)

    return _each(one, offsets, groups)


def member_rows(groups: int, count: int) -> Array:
    """(G, V) one row for each group, with ones at its vertices."""
    return np.kron(np.eye(groups), np.ones((1, count // groups)))


def _each(one: Callable[[Array], Array], offsets: Tensor, groups: int) -> Tensor:
    """Weights (B, V), of sum 1 in each group, one problem after the other."""
    vertices = offsets.detach().cpu().numpy()
    weights = np.full(vertices.shape[:2], np.nan)
    for index, own in enumerate(vertices):
        try:
            found = one(own).reshape(groups, -1)
        except RuntimeError:  # scipy's word for too many iterations
            continue
        total = found.sum(-1, keepdims=True)
        if (total > 0).all():
            weights[index] = (found / total).ravel()
    return torch.as_tensor(weights, device=offsets.device)
