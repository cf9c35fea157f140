"""Designs by index: design i of a sweep follows from the arm, the space, the seed and i, and is stored nowhere.

Sobol points, scrambled, fill a space more evenly than random ones, and any of them can be had without those before it:
point i is `x_0 XOR V_b XOR ...` over the bits b that are set in the Gray code of i, with F direction numbers V_b that
two neighbours in the sequence tell, as `V_b = x(2^b) XOR x(2^b - 1)`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import prod
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from torcharm.design.space import Array, FreeValues
from torcharm.inputs import check_choice, check_count, shown

SAMPLINGS = ("sobol", "grid")
BITS = 30
"""Of PyTorch's Sobol points: at most 2³⁰ differ."""
LARGEST_INDEX = 2**53
"""Up to which grids count: whole numbers are exact in double precision."""

Indices = npt.NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SobolPoints:
    """Scrambled Sobol points in [0, 1)^F.

    Attributes:
        first: (F,) the first point, as integers of 30 bits.
        directions: (B, F) what each bit of an index's Gray code flips.
    """

    first: Indices
    directions: Indices

    def __call__(self, indices: Indices) -> Array:
        """The points (n, F) at indices (n,)."""
        gray = indices ^ (indices >> 1)
        found = np.broadcast_to(self.first, (len(indices), len(self.first))).copy()
        for bit, direction in enumerate(self.directions):
            found ^= (gray >> bit & 1)[:, None] * direction
        return np.asarray(found * 0.5**BITS)


@dataclass(frozen=True, eq=False)
class GridPoints:
    """All combinations of evenly spaced levels; the last free value changes first.

    Attributes:
        levels: how many for each of the F free values, both bounds included; one level is the middle.
    """

    levels: tuple[int, ...]

    def __call__(self, indices: Indices) -> Array:
        """The points (n, F) at indices (n,)."""
        places = np.stack(np.unravel_index(indices, self.levels), -1)
        steps = np.array(self.levels) - 1
        return np.where(steps > 0, places / np.maximum(steps, 1), 0.5)


Sampler = SobolPoints | GridPoints


def sobol_points(dimension: int, seed: int, count: int) -> SobolPoints:
    """The scrambled sequence of PyTorch's `SobolEngine` of a seed, as far as its first `count` points."""
    engine = torch.quasirandom.SobolEngine(dimension, scramble=True, seed=seed)

    def draw() -> Indices:
        return np.asarray((engine.draw(1, dtype=torch.float64)[0] * 2**BITS).round().long().numpy())

    engine.fast_forward(1)  # the engine rounds its very first point to single precision
    one, two, three = draw(), draw(), draw()
    directions = [two ^ three, one ^ two]
    engine.reset()  # it goes no step back, and the next pair begins with the third point
    for bit in range(2, (count - 1).bit_length()):
        engine.fast_forward(2**bit - 1 - engine.num_generated)
        before = draw()
        directions.append(before ^ draw())
    first = one ^ directions[0]
    return SobolPoints(first, np.array(directions))


def sampler_of(
    sampling: str, dimension: int, count: int | None, levels: int | Sequence[int] | None, seed: int
) -> tuple[Sampler, int]:
    """How points are sampled, and how many there are."""
    check_choice("sampling", sampling, SAMPLINGS)
    check_count("seed", seed, 0)
    if sampling == "grid":
        try:
            given = [levels] * dimension if isinstance(levels, int) else list(levels)  # type: ignore[arg-type]
            each = tuple(check_count("levels", level, 1) for level in given)
        except (TypeError, ValueError):
            each = ()
        if len(each) != dimension or prod(each) > LARGEST_INDEX:
            raise ValueError(
                f"levels: must be an integer of at least 1, or one for each of the {dimension} free values, with "
                f"at most {LARGEST_INDEX:.2g} combinations, got {shown(levels)}"
            )
        if count is not None and count != prod(each):
            raise ValueError(f"count: must be left out of a grid, or be its {prod(each)} designs, got {shown(count)}")
        return GridPoints(each), prod(each)
    if levels is not None:
        raise ValueError(f"levels: must be left out unless sampling is 'grid', got {shown(levels)}")
    if count is None or check_count("count", count, 1) > 2**BITS:
        raise ValueError(f"count: must be an integer from 1 to {2**BITS} for Sobol points, got {shown(count)}")
    return sobol_points(dimension, seed, count), count


@dataclass(frozen=True, eq=False)
class DesignPoints:
    """Of each index its point u in [0, 1]^F, and the values that it stands for.

    Attributes:
        free: what the free values are.
        sampler: where points lie.
        order: for each segment in the plane its actuators from right to left, which the radii of a Sobol point are
            sorted into, as those of `optimise_design`'s random starts are: other orders are no designs of the space. A
            grid would hold each design several times that way, and keeps its points.
    """

    free: FreeValues
    sampler: Sampler
    order: tuple[tuple[int, ...], ...]

    def __call__(self, indices: Indices) -> Array:
        """The points (n, F) at indices (n,): of each the same, whichever others are asked beside it."""
        points = self.sampler(indices)
        if self.order and isinstance(self.sampler, SobolPoints) and np.abs(self.free.spread[0]).max() > 0:
            points = self.free.in_order(points, self.order)
            inside = np.clip(points, 0.0, 1.0)
            points = np.where(np.abs(points - inside) < 1e-9, inside, points)
        return points

    def values(self, indices: Indices) -> Array:
        """Radii [m], angles [rad], lengths [m] and limits [kPa] of all actuators: (n, 4, M)."""
        return self.free(self(indices))

    def to_json(self) -> dict[str, Any]:
        """All that `points_from_json` needs."""
        numbers = {name: np.asarray(value).tolist() for name, value in vars(self.sampler).items()}
        free = {name: np.asarray(value).tolist() for name, value in vars(self.free).items() if name != "members"}
        return {"sampler": numbers, "order": self.order, "members": self.free.members, **free}


def points_from_json(content: dict[str, Any]) -> DesignPoints:
    """The points that `DesignPoints.to_json` wrote."""
    spread, base, low, high = (np.array(content[name], dtype=np.float64) for name in ("spread", "base", "low", "high"))
    free = FreeValues(spread, base, low, high, tuple(content["fields"]), tuple(map(tuple, content["members"])))
    given = content["sampler"]
    sampler: Sampler
    if "levels" in given:
        sampler = GridPoints(tuple(given["levels"]))
    else:
        first = np.array(given["first"], dtype=np.int64)
        sampler = SobolPoints(first, np.array(given["directions"], dtype=np.int64).reshape(-1, len(first)))
    return DesignPoints(free, sampler, tuple(map(tuple, content["order"])))
