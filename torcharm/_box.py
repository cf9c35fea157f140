"""Least squares in a box: what the pressure search, the prediction and the wrench-space fit share."""

import torch
from torch import Tensor
from torch.quasirandom import SobolEngine

START_DAMPING = 1e-2
LEAST_DAMPING = 1e-12
SWEEPS = 1
"""Over the variables of a step."""


def box_step(normal: Tensor, gradient: Tensor, place: Tensor, damping: Tensor) -> Tensor:
    """The Levenberg-Marquardt step from a place in the box [0, 1]^M, cut to it.

    Variables that the step would carry out are stopped at their bound and the step is found anew for the others,
    until none leaves: M times at most. Sweeps over the variables, one after the other, then free what was stopped
    too early, and make the step one of descent in any case. The batch comes last.

    Args:
        normal: (M, M, B) AᵀA.
        gradient: (M, B) Aᵀr.
        place: (M, B) within the box.
        damping: (B,) share of the largest diagonal entry that is added to the diagonal.

    Returns:
        (M, B).
    """
    count = len(place)
    size = normal.diagonal(dim1=0, dim2=1).amax(-1).clamp(min=1e-300)
    matrix = normal.clone()
    matrix.diagonal(dim1=0, dim2=1).add_((damping * size).unsqueeze(-1))
    low, high = -place, 1 - place
    held = ((place <= 0) & (gradient > 0)) | ((place >= 1) & (gradient < 0))
    step = torch.zeros_like(place)
    for _ in range(count):
        answer = torch.where(held, step, _solve(matrix, gradient, step, held, size))
        step = torch.minimum(torch.maximum(answer, low), high)
        leaves = step != answer
        if not bool(leaves.any()):
            break
        held = held | leaves
    slope = gradient + (matrix * step).sum(1)
    step = torch.where((step * (gradient + slope)).sum(0) < 0, step, 0.0)
    for _ in range(SWEEPS):
        slope = gradient + (matrix * step).sum(1)
        for index in range(count):
            wanted = step[index] - slope[index] / matrix[index, index]
            moved = torch.minimum(torch.maximum(wanted, low[index]), high[index])
            slope = torch.addcmul(slope, matrix[index], moved - step[index])
            step[index] = moved
    return step


def _solve(matrix: Tensor, gradient: Tensor, step: Tensor, held: Tensor, size: Tensor) -> Tensor:
    """(M, B) the minimum over the variables that are free, by elimination without pivots: the matrix is positive."""
    free = (~held).to(matrix.dtype)
    right = (gradient + (matrix * (step * held)).sum(1)) * -free
    both = free.unsqueeze(0) * free.unsqueeze(1)
    reduced = torch.cat((matrix * both, right.unsqueeze(1)), 1)
    reduced.diagonal(dim1=0, dim2=1).add_((held * size).mT)
    for index in range(len(matrix)):
        row = reduced[index] / reduced[index, index]
        reduced = torch.addcmul(reduced, reduced[:, index : index + 1], row, value=-1)
        reduced[index] = row
    return reduced[:, -1]


def optimality(gradient: Tensor, place: Tensor) -> Tensor:
    """(...) how far a step down the gradient gets within the box [0, 1]^M: 0 at a first-order optimum."""
    return (place - (place - gradient).clamp(0, 1)).abs().amax(-1)


def spread_points(count: int, dimension: int, like: Tensor, seed: int = 0) -> Tensor:
    """(count, M) points of the unit box, spread evenly: scrambled Sobol points behind the middle."""
    if count <= 1:
        return like.new_full((count, dimension), 0.5)
    drawn = SobolEngine(dimension, scramble=True, seed=seed).draw(count - 1, dtype=torch.float64)
    return torch.cat((like.new_full((1, dimension), 0.5), drawn.to(like)))
