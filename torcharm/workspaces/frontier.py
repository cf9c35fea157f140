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
"""Of the scale: a step that promises less is not worth a state."""
APART = 1.0
"""Of the scale: the side of squares (cubes) of which each gets one attempt at a time."""
TRIES = 4
"""Of each facet: every further one goes half as far, for where the model is good for short steps alone, as near a
snap."""
LONGEST_STEP = 0.25
"""Of a normalised pressure: as far as the slopes may tell, at the first attempt. Of many pressures that do the same, a
step may change all, and little comes of what it promises."""
MARGIN = 1e-3
"""Of the width of a range of strains, kept free: what slopes do not tell of steps of a resolution."""
DAMPING = 1e-2
"""Of the scale, that a whole range of pressure counts as: of steps to one place the shortest is taken."""
PASSES = 6
"""In which the limits are found that a step meets: as many settle, or the next try does."""


@dataclass(frozen=True, eq=False)
class Pushes:
    """Attempts to get beyond the boundary.

    Attributes:
        place: (b, M) normalised pressures.
        normal: (b, D) out of the region.
        height: (b,) where along it the boundary is, as far as is known [m].
    """

    place: Array
    normal: Array
    height: Array

    def __len__(self) -> int:
        return len(self.place)


@dataclass(frozen=True, eq=False)
class Frontier:
    """The boundary of the region that states with some codes make.

    Attributes:
        slopes: of the states, as far as they are known.
        resolution: of the alpha shape [m].
        scale: of attempts: how far they go, at most, and how far they lie apart [m].
        codes: indices into `STATES`.
        low, high: (M,) of normalised pressures.
        in_range: whether strains must stay in their range.
        tries: of each facet, by its corners.
    """

    slopes: KnownSlopes
    resolution: float
    scale: float
    codes: tuple[int, ...]
    low: Array
    high: Array
    in_range: bool
    tries: dict[tuple[int, ...], int] = field(default_factory=dict)

    def push(self, states: Batch, most: int) -> Pushes:
        """Attempts from the corners of the boundary's facets; none where none promises a gain.

        Args:
            states: all that are known.
            most: so many at most, those that promise most.
        """
        index = np.flatnonzero(np.isin(states.code.numpy(), self.codes))
        position = states.position
        shape = alpha_shape(position[index], self.resolution)
        facets, normal = index[shape.facets], shape.normals
        keys = [tuple(key) for key in np.sort(facets, 1).tolist()]
        tried = np.array([self.tries.get(key, 0) for key in keys], dtype=int)
        still = np.flatnonzero(tried < TRIES)
        facets, normal = facets[still], normal[still]
        centre = position[facets].mean(1)
        half = 0.5 ** tried[still, None]
        goal = centre + self.scale * half * normal
        height = (centre * normal).sum(1)
        attempts = [self._attempts(states, corner, goal, half) for corner in facets.T]
        place, promised = (np.stack(part) for part in zip(*attempts, strict=True))
        best = (promised * normal).sum(2).argmax(0), np.arange(len(facets))
        chosen = self._worthwhile(promised[best], normal, height, most)
        for facet in still[chosen]:
            self.tries[keys[facet]] = self.tries.get(keys[facet], 0) + 1
        return Pushes(place[best][chosen], normal[chosen], height[chosen])

    def push_on(self, states: Batch, last: Pushes, most: int) -> Pushes:
        """Further attempts from where the last ones got to, the last of the states."""
        index = np.arange(len(states) - len(last), len(states))
        position = states.position[index]
        height = (position * last.normal).sum(1)
        gained = np.isin(states.code.numpy()[index], self.codes) & (height - last.height > LEAST_GAIN * self.scale)
        index, position, height, normal = index[gained], position[gained], height[gained], last.normal[gained]
        place, promised = self._attempts(states, index, position + self.scale * normal, np.ones((len(index), 1)))
        chosen = self._worthwhile(promised, normal, height, most)
        return Pushes(place[chosen], normal[chosen], height[chosen])

    def _attempts(self, states: Batch, source: Indices, goal: Array, part: Array) -> tuple[Array, Array]:
        """(b, M) normalised pressures that should take tips from states to goals (b, D), and where slopes see them
        end (b, D)."""
        slopes, start, place = self.slopes.of(states, source), states.position[source], states.place.numpy()[source]
        step = self._steps(place, slopes, goal - start, LONGEST_STEP * part)
        return (place + step).clip(self.low, self.high), start + (slopes.tip @ step[..., None])[..., 0]

    def _worthwhile(self, promised: Array, normal: Array, height: Array, most: int) -> Indices:
        """The attempts that promise enough beyond the boundary, so many at most; of several to one place the best."""
        gain = (promised * normal).sum(1) - height
        order = np.argsort(-gain, kind="stable")
        order = order[gain[order] > LEAST_GAIN * self.scale]
        cell = np.floor(promised[order] / (APART * self.scale))
        first = np.sort(np.unique(cell, axis=0, return_index=True)[1])
        return np.asarray(order[first[:most]])

    def _steps(self, place: Array, slopes: Slopes, way: Array, longest: Array) -> Array:
        """(F, M) that move the tip by a way (F, D), as nearly as slopes and limits allow."""
        low, high = np.maximum(self.low, place - longest), np.minimum(self.high, place + longest)
        width = high - low
        tip = slopes.tip * width[:, None]
        gradient, curvature = -(tip.swapaxes(1, 2) @ way[..., None])[..., 0], tip.swapaxes(1, 2) @ tip
        beyond, slope = slopes.beyond + MARGIN, slopes.beyond_slope * width[:, None]
        start = np.where(width > 0, (place - low) / np.where(width > 0, width, 1.0), 0.0)
        weight, met = (self.scale / MARGIN) ** 2, np.zeros(beyond.shape, dtype=bool)
        for _ in range(PASSES if self.in_range else 1):
            held = slope * met[..., None]
            step = box_steps(
                gradient + weight * (held.swapaxes(1, 2) @ np.where(met, beyond, 0.0)[..., None])[..., 0],
                curvature + weight * (held.swapaxes(1, 2) @ held),
                start,
                (DAMPING * self.scale) ** 2,
            )
            before, met = met, beyond + (slope @ step[..., None])[..., 0] > 0
            if (before == met).all():
                break
        return width * step
