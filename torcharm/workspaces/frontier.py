"""Pressures that take an arm's tip beyond the boundary of what it has reached, where any do.

The region reached is an alpha shape. From the corners of each facet of its boundary, the step of pressures is sought
that takes the tip to a place before the facet: least squares with the tip's slope, in the box of pressures and, of a
region in range, within the range of strains. A step that promises nothing shows that the facet lies on the boundary of
what can be reached, to first order; it costs no equilibrium.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from torcharm.engine.box_steps import box_steps
from torcharm.geometry.alpha_shape import Indices, alpha_shape
from torcharm.workspaces.states import Batch, KnownSlopes, Slopes

Array = NDArray[np.float64]

LEAST_GAIN = 0.05
"""Of the resolution: a step that promises less is not worth a state."""
TRIES = 4
"""Of each facet: every further one goes half as far, for where the model is good for short steps alone, as near a
snap."""
LONGEST_STEP = 0.25
"""Of a normalised pressure: as far as the slopes may tell."""
MARGIN = 1e-3
"""Of the width of a range of strains, kept free: what slopes do not tell of steps of a resolution."""
DAMPING = 1e-2
"""Of the resolution, that a whole range of pressure counts as: of steps to one place the shortest is taken."""
PASSES = 6
"""In which the limits are found that a step meets: as many settle, or the next try does."""


@dataclass
class Frontier:
    """Of the region of states with some codes.

    Attributes:
        codes: indices into `STATES`.
        low, high: (M,) of normalised pressures.
        tries: of each facet, by its corners.
    """

    codes: tuple[int, ...]
    low: Array
    high: Array
    in_range: bool
    rounds: int = 0
    tries: dict[tuple[int, ...], int] = field(default_factory=dict)

    def places_beyond(self, slopes: KnownSlopes, states: Batch, resolution: float, most: int) -> Array:
        """(b, M) normalised pressures that should take the tip beyond the boundary; b is 0 where there are none.

        Args:
            slopes: of the states, as far as they are known.
            states: all that are known.
            resolution: of the alpha shape [m].
            most: of b; those that promise most are taken.
        """
        index = np.flatnonzero(np.isin(states.code.numpy(), self.codes))
        position = states.position
        shape = alpha_shape(position[index], resolution)
        facets = index[shape.facets]
        tried = np.array([self.tries.get(tuple(key), 0) for key in np.sort(facets, 1).tolist()], dtype=int)
        still = tried < TRIES
        if not still.any():
            return np.zeros((0, states.place.shape[1]))
        facets, normal, tried = facets[still], shape.normals[still], tried[still]
        centre = position[facets].mean(1)
        goal = centre + resolution * 0.5 ** tried[:, None] * normal
        source, step, promise = self._best_steps(slopes, states, position, facets, goal, normal)
        gain = promise - (centre * normal).sum(1)
        chosen = np.argsort(-gain)[:most]
        chosen = chosen[gain[chosen] > LEAST_GAIN * resolution]
        for key in np.sort(facets[chosen], 1).tolist():
            self.tries[tuple(key)] = self.tries.get(tuple(key), 0) + 1
        return (states.place.numpy()[source[chosen]] + step[chosen]).clip(self.low, self.high)

    def _best_steps(
        self, slopes: KnownSlopes, states: Batch, position: Array, facets: Indices, goal: Array, normal: Array
    ) -> tuple[Indices, Array, Array]:
        """Of each facet the corner (F,) from which a step (F, M) gets furthest along the normal, and how far (F,)."""
        found = []
        for corner in facets.T:
            own, start = slopes.of(states, corner), position[corner]
            step = self._steps(states.place.numpy()[corner], own, goal - start)
            reached = start + (own.tip @ step[..., None])[..., 0]
            found.append((corner, step, (reached * normal).sum(1)))
        best, every = np.argmax([promise for _, _, promise in found], 0), np.arange(len(facets))
        source, step, promise = (np.stack(part)[best, every] for part in zip(*found, strict=True))
        return source, step, promise

    def _steps(self, place: Array, slopes: Slopes, way: Array) -> Array:
        """(F, M) that move the tip by a way (F, D), as nearly as slopes and limits allow."""
        resolution = np.linalg.norm(way, axis=1).mean()
        low, high = np.maximum(self.low, place - LONGEST_STEP), np.minimum(self.high, place + LONGEST_STEP)
        width = high - low
        tip = slopes.tip * width[:, None]
        gradient, curvature = -(tip.swapaxes(1, 2) @ way[..., None])[..., 0], tip.swapaxes(1, 2) @ tip
        beyond, slope = slopes.beyond + MARGIN, slopes.beyond_slope * width[:, None]
        start = np.where(width > 0, (place - low) / np.where(width > 0, width, 1.0), 0.0)
        weight, met = (resolution / MARGIN) ** 2, np.zeros(beyond.shape, dtype=bool)
        for _ in range(PASSES if self.in_range else 1):
            held = slope * met[..., None]
            step = box_steps(
                gradient + weight * (held.swapaxes(1, 2) @ np.where(met, beyond, 0.0)[..., None])[..., 0],
                curvature + weight * (held.swapaxes(1, 2) @ held),
                start,
                (DAMPING * resolution) ** 2,
            )
            before, met = met, beyond + (slope @ step[..., None])[..., 0] > 0
            if (before == met).all():
                break
        return width * step
