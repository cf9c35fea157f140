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

from torcharm.distance.result import HullAnswer, HullDistance, HullProblem, mix, solve_hulls

CHUNK = 4096
SLSQP_ITERATIONS = 200
SLSQP_TOLERANCE = 1e-15

Array = np.ndarray[Any, np.dtype[np.float64]]


def nnls_distance(point: Float[Tensor, "*#batch D"], vertices: Float[Tensor, "*#batch V D"]) -> HullDistance:
    """Distance from points to convex hulls by Lawson and Hanson's non-negative least squares.

    The weights that minimise `‖[H - w; 1] s - [0; 1]‖` over s ≥ 0 are, divided by their sum, those of the hull's
    point nearest to w. With H - w divided by its largest entry units do not matter, and the distance is
    right to a few roundings of that entry. Distances within the rounding of the coordinates are 0.

    The value is differentiable with respect to point and vertices, once, by the envelope theorem:
    with the weights held. Where several sets of weights are optimal (duplicated vertices) it is one
    of several gradients. The weights themselves carry none.

    Args:
        point: where from.
        vertices: V points of any dimension, in any order, duplicates allowed.

    Raises:
        ValueError: there is no vertex, or dimensions or batches do not fit.
    """
    return solve_hulls(point, vertices, partial(_answer, nnls_weights), CHUNK)


def slsqp_distance(point: Float[Tensor, "*#batch D"], vertices: Float[Tensor, "*#batch V D"]) -> HullDistance:
    """Distance from points to convex hulls by sequential quadratic programming, without gradient.

    It stands in for the paper's fmincon, for timing: a general solver on the paper's problem
    `min_s ½‖Hᵀ s - w‖², s ≥ 0, 1ᵀs = 1`, started from equal weights, with H - w scaled as for `nnls_distance`.
    Its distances are mostly good to 1e-8 of max|H - w|, at worst to some 1e-5 (`converged` is then False);
    inside a hull they are seldom exactly 0.

    Args:
        point: where from.
        vertices: V points of any dimension.

    Raises:
        ValueError: there is no vertex, or dimensions or batches do not fit.
    """
    with torch.no_grad():
        return solve_hulls(point, vertices, partial(_answer, slsqp_weights), CHUNK)


def _answer(find: Callable[[Tensor], Tensor], problem: HullProblem) -> HullAnswer:
    weights = find(problem.offsets)
    with torch.no_grad():
        residual = mix(weights, problem.offsets)
        touching = torch.linalg.vector_norm(residual, dim=-1) <= problem.blur
    never = torch.zeros_like(touching)
    return HullAnswer(weights, touching, never, problem.length(weights, touching), torch.zeros_like(problem.blur))


def nnls_weights(offsets: Float[Tensor, "B V D"]) -> Float[Tensor, "B V"]:
    """Weights of the hulls' points nearest to the origin; NaN where the solver gives up."""
    from scipy.optimize import nnls

    def one(vertices: Array) -> Array:
        columns = np.concatenate((vertices.T, np.ones((1, len(vertices)))))
        target = np.zeros(len(columns))
        target[-1] = 1.0
        return np.asarray(nnls(columns, target, maxiter=30 * len(vertices))[0])

    return _each(one, offsets)


def slsqp_weights(offsets: Float[Tensor, "B V D"]) -> Float[Tensor, "B V"]:
    """Weights of the hulls' points nearest to the origin, as good as SLSQP's."""
    from scipy.optimize import minimize

    def one(vertices: Array) -> Array:
        def objective(weights: Array) -> tuple[float, Array]:
            residual = weights @ vertices
            return 0.5 * float(residual @ residual), vertices @ residual

        count = len(vertices)
        found = minimize(
            objective,
            np.full(count, 1.0 / count),
            jac=True,
            method="SLSQP",
            bounds=[(0.0, 1.0)] * count,
            constraints={"type": "eq", "fun": lambda s: s.sum() - 1.0, "jac": lambda s: np.ones((1, count))},
            options={"maxiter": SLSQP_ITERATIONS, "ftol": SLSQP_TOLERANCE},
        )
        return np.asarray(found.x).clip(min=0.0)

    return _each(one, offsets)


def _each(one: Callable[[Array], Array], offsets: Tensor) -> Tensor:
    """Weights (B, V) of sum 1, one problem after the other."""
    vertices = offsets.detach().cpu().numpy()
    weights = np.full(vertices.shape[:2], np.nan)
    for index, own in enumerate(vertices):
        try:
            found = one(own)
        except RuntimeError:  # scipy's word for too many iterations
            continue
        total = found.sum()
        if total > 0:
            weights[index] = found / total
    return torch.as_tensor(weights, device=offsets.device)
