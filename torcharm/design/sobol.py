"""Sobol' indices: which share of the tip's variance each source of scatter has alone, and together with others.

With A and B two independent draws of all numbers, and A_g the first with those of source g from B, the variance that g
has alone is `E[f(B) (f(A_g) - f(A))]` (A. Saltelli et al., Computer Physics Communications 2010), and that of all in
which it has a part `E[(f(A) - f(A_g))²] / 2` (M. J. W. Jansen, Computer Physics Communications 1999). Both add up over
the coordinates of a place. Where they differ, sources act together.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from torcharm.design.scatter import Source, normal_numbers


def index_numbers(sources: Sequence[Source], samples: int, seed: int) -> Tensor:
    """(n (G + 2), ΣL) for each sample the normal numbers A, B and all A_g of G names; n is the power of 2 that samples
    hold."""
    count = 2 ** (samples.bit_length() - 1)
    one, other = normal_numbers((*sources, *sources), count, seed).chunk(2, -1)
    parts = [pair.split([source.mix.shape[1] for source in sources], -1) for pair in (one, other)]
    mixes = []
    for name in dict.fromkeys(source.name for source in sources):
        chosen = [parts[source.name == name][k] for k, source in enumerate(sources)]
        mixes.append(torch.cat(chosen, -1))
    return torch.stack((one, other, *mixes), 1).flatten(0, 1)


def sobol_indices(tip: Tensor, names: int) -> tuple[Tensor, Tensor]:
    """First-order and total indices (G, T), of the places (n (G + 2), T, D) of tips that `index_numbers` built.

    Arms without a tip are left out, with all that are compared with them. NaN where tips do not differ.
    """
    tip = tip.unflatten(0, (-1, names + 2)).movedim(1, 0)
    known = tip.isfinite().all(-1).all(0).unsqueeze(-1)  # (n, T, 1)
    count = known.sum(0)
    mean = torch.where(known, tip[:2], 0.0).sum((0, 1)) / (2 * count)
    one, other, *mixed = torch.where(known, tip - mean, 0.0)
    moved = torch.stack(mixed) - one
    variance = torch.stack((one, other)).square().sum((0, 1, 3)) / 2
    return (other * moved).sum((1, 3)) / variance, moved.square().sum((1, 3)) / 2 / variance
