"""How the tips of built arms move with what is scattered: to first order by gradients, and by a fit to samples.

Both are slopes B_g (D, K_g) of the tip's place by the parameters of each source g; with the source's covariance C_g the
tip's variance is the sum of `trace(B_g C_g B_gᵀ)`: what each source adds to it.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from torcharm.design.scatter import Source, built_arms, scattered
from torcharm.design.space import Arm
from torcharm.equilibrium.gradient import with_gradients
from torcharm.geometry import se2, se3
from torcharm.pressure.errors import errors_of
from torcharm.pressure.followed import followed_pressure
from torcharm.pressure.pose_cost import PoseCost
from torcharm.pressure.predicted_error import PredictedError
from torcharm.pressure.prepared import prepare
from torcharm.task import Task


def tip_places(error: Tensor) -> Tensor:
    """(..., D) where tips are, seen from where they are to be [m], along axes that are the same for all arms.

    Args:
        error: (..., N+1, 3 or 6) of poses, as of `PredictedError`: what is wanted, seen from the pose reached.
    """
    tip = error[..., -1, :]
    if tip.shape[-1] == 3:
        return se2.inverse(tip)[..., :2]
    turn = se3.exp(torch.cat((torch.zeros_like(tip[..., :3]), tip[..., 3:]), -1))
    return -se3.rotate_back(turn, tip[..., :3])


def tip_slopes(
    arm: Arm,
    task: Task,
    sources: Sequence[Source],
    found: PredictedError,
    pose_cost: PoseCost | None,
    *,
    compensated: bool,
) -> list[Tensor]:
    """For each source the slopes (*task batch, D, K) of the tip's place, as of `tip_places`, by its parameters [m].

    By the implicit function theorem, at one drawn arm, of which `found` is predicted: with its pressures kept, or, of
    compensated ones, with pressures that stay at their minimum. NaN where no stable equilibrium was found.
    """
    base = prepare(arm, task, pose_cost)
    batch = base.batch
    moves = [torch.zeros(*batch, len(source.size), dtype=torch.float64, requires_grad=True) for source in sources]
    with torch.enable_grad():
        built = built_arms(base.problem.arm, sources, moves)  # one for each task, which it alone meets
        limit = built.max_pressure.expand(*batch, arm.actuator_count)
        prepared = replace(base, problem=replace(base.problem, arm=built, pressure=limit))
        kept = found.pressure.detach().to(limit)
        pressure = followed_pressure(prepared, found) if compensated else torch.minimum(kept, limit)
        problem, known = replace(prepared.problem, pressure=pressure), found.stable.cpu()
        reached = with_gradients(problem, found.twists.detach().to(limit), known)
        tip = tip_places(errors_of(prepared, pressure, reached, known, known).pose_errors)
    options: dict[str, Any] = {"retain_graph": True, "allow_unused": True, "materialize_grads": True}
    rows = [torch.autograd.grad(tip[..., d].nansum(), moves, **options) for d in range(arm.dimension)]
    found_slopes = [torch.stack(column, -2) for column in zip(*rows, strict=True)]
    return [torch.where(known[..., None, None], slope, torch.nan) for slope in found_slopes]


def fitted_slopes(tip: Tensor, sources: Sequence[Source], normal: Tensor) -> tuple[list[Tensor], Tensor]:
    """The slopes (D, K) of each source that fit samples best, and the share of the tip's variance that they explain.

    Args:
        tip: (S, D) of built arms on one task; NaN where there is none.
        sources: of scatter.
        normal: (S, ΣL) the numbers from which they were built.
    """
    good = tip.isfinite().all(-1)
    values = torch.cat(scattered(sources, normal), -1)[good].numpy()
    sizes = np.concatenate([source.covariance.diagonal().clamp(min=0).sqrt().numpy() for source in sources])
    wanted = tip[good].numpy()
    if len(wanted) < 2 * (len(sizes) + 1):
        lost = [torch.full((tip.shape[-1], len(source.size)), torch.nan, dtype=torch.float64) for source in sources]
        return lost, torch.tensor(torch.nan)
    scaled = np.where(sizes > 0, values / np.where(sizes > 0, sizes, 1.0), 0.0)
    scaled, centred = scaled - scaled.mean(0), wanted - wanted.mean(0)
    slope = np.linalg.lstsq(scaled, centred, rcond=1e-9)[0]
    left, whole = np.square(centred - scaled @ slope).sum(), np.square(centred).sum()
    explained = 1.0 - left / whole if whole > 0 else np.nan
    slopes = torch.from_numpy((slope / np.where(sizes > 0, sizes, np.inf)[:, None]).T.copy())
    return list(slopes.split([len(source.size) for source in sources], -1)), torch.tensor(explained)


def variances(slopes: Sequence[Tensor], sources: Sequence[Source]) -> Tensor:
    """(G, ...) what each source adds to the variance of the tip's place [m²], by slopes (..., D, K)."""
    found = [(slope @ source.covariance * slope).sum((-2, -1)) for slope, source in zip(slopes, sources, strict=True)]
    return torch.stack(found)
