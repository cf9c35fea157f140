"""Least squares in a box: what the pressure search and the wrench-space fit share."""

import torch
from torch import Tensor
from torch.quasirandom import SobolEngine

START_DAMPING = 1e-2
LEAST_DAMPING = 1e-12
SWEEPS = 2
"""Over the variables of a step."""


def box_step(normal: Tensor, gradient: Tensor, place: Tensor, damping: Tensor) -> Tensor:
    """The Levenberg-Marquardt step from a place in the box [0, 1]^M, cut to it.

    Variables that the step would carry out are stopped at their bound and the step is found anew for the others,
    until none leaves: M times at most. Sweeps over the variables, one after the other, then free what was stopped
    too early, and make the step one of descent in any case.

    Args:
        normal: (..., M, M) AᵀA.
        gradient: (..., M) Aᵀr.
        place: (..., M) within the box.
        damping: (...) share of the largest diagonal entry that is added to the diagonal.

    Returns:
        (..., M).
    """
    count = place.shape[-1]
    size = normal.diagonal(dim1=-2, dim2=-1).amax(-1).clamp(min=1e-300)
    eye = torch.eye(count, dtype=place.dtype, device=place.device)
    matrix = normal + (damping * size)[..., None, None] * eye
    held = ((place <= 0) & (gradient > 0)) | ((place >= 1) & (gradient < 0))
    step = torch.zeros_like(place)
    for _ in range(count):
        free = (~held).to(place.dtype)
        reduced = matrix * free.unsqueeze(-1) * free.unsqueeze(-2) + torch.diag_embed(
            held.to(place.dtype) * size[..., None]
        )
        right = -(gradient + (matrix @ (step * held).unsqueeze(-1)).squeeze(-1)) * free
        answer, _ = torch.linalg.solve_ex(reduced, right.unsqueeze(-1))
        answer = torch.where(held, step, answer.squeeze(-1))
        step = answer.clamp(-place, 1 - place)
        leaves = (step != answer) & ~held
        if not bool(leaves.any()):
            break
        held = held | leaves
    model = (step * (2 * gradient + (matrix @ step.unsqueeze(-1)).squeeze(-1))).sum(-1)
    step = torch.where((model < 0).unsqueeze(-1), step, torch.zeros_like(step))
    slope = gradient + (matrix @ step.unsqueeze(-1)).squeeze(-1)
    places, moves = place.unbind(-1), list(step.unbind(-1))
    for _ in range(SWEEPS):
        for index, at in enumerate(places):
            column = matrix[..., index]
            wanted = moves[index] - slope[..., index] / column[..., index]
            moved = torch.minimum(torch.maximum(wanted, -at), 1 - at)
            slope = slope + (moved - moves[index]).unsqueeze(-1) * column
            moves[index] = moved
    return torch.stack(moves, -1)


def optimality(gradient: Tensor, place: Tensor) -> Tensor:
    """(...) how far a step down the gradient gets within the box [0, 1]^M: 0 at a first-order optimum."""
    return (place - (place - gradient).clamp(0, 1)).abs().amax(-1)


def spread_points(count: int, dimension: int, like: Tensor, seed: int = 0) -> Tensor:
    """(count, M) points of the unit box, spread evenly: scrambled Sobol points behind the middle."""
    if count <= 1:
        return like.new_full((count, dimension), 0.5)
    drawn = SobolEngine(dimension, scramble=True, seed=seed).draw(count - 1, dtype=torch.float64)
    return torch.cat((like.new_full((1, dimension), 0.5), drawn.to(like)))
