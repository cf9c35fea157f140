"""Pressures that take an arm's tip beyond the boundary of what it has reached, where any do.

The region reached is an alpha shape. From the corners of each facet of its boundary, the step of pressures is sought
that takes the tip to a place before the facet: least squares with the tip's slope, in the box of pressures and, of a
region in range, within the range of strains. A step that promises nothing shows that the facet lies on the boundary of
what can be reached, to first order; it costs no equilibrium. Ends and edges too thin for facets are tried as well.
"""

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from torcharm.engine.box_steps import box_steps
from torcharm.geometry.alpha_shape import AlphaShape, Indices, alpha_shape
from torcharm.workspaces.states import EXCLUDED, Batch, KnownSlopes, Slopes

Array = NDArray[np.float64]

LEAST_GAIN = 0.05
"""Of the spacing: a step that promises less is not worth a state."""
TRIES = 4
"""Of each facet: every further one goes half as far, for where the model is good for short steps alone, as near a
snap."""
LONGEST_STEP = 0.25
"""Of a normalised pressure: as far as the slopes may tell, at the first attempt. Of many pressures that do the same, a
step may change all, and little comes of what it promises."""
LONGEST_IN_RANGE = 0.1
"""The same where strains must stay in their range: long steps leave it, as slopes tell where it ends."""
CORRECTED = 0.5
"""Of that, at an attempt that corrects one which did not gain."""
MARGIN = 1e-3
"""Of the width of a range of strains, kept free: what slopes do not tell of steps of a resolution."""
DAMPING = 1e-2
"""Of the resolution, that a whole range of pressure counts as: of steps to one place the shortest is taken."""
SHARP = 0.7
"""Length of the mean of the normals of the facets around a point, below which that is the end or the edge of something
thin: none of them points along it."""
PASSES = 6
"""In which the limits are found that a step meets: as many settle, or the next try does."""


@dataclass(frozen=True, eq=False)
class Pushes:
    """Attempts to get beyond the boundary.

    Attributes:
        normalised: (b, M) normalised pressures.
        normal: (b, D) out of the region.
        goal: (b, D) where they would like to get [m].
        height: (b,) where along it the boundary is, as far as is known [m].
        gain: (b,) how far beyond that they should come [m].
    """

    normalised: Array
    normal: Array
    goal: Array
    height: Array
    gain: Array

    def __len__(self) -> int:
        return len(self.normalised)

    def at(self, index: Indices) -> "Pushes":
        """Some of them."""
        return Pushes(*(getattr(self, own.name)[index] for own in fields(Pushes)))


@dataclass(frozen=True, eq=False)
class Frontier:
    """The boundary of the region that states with some codes make.

    Attributes:
        slopes: of the states, as far as they are known.
        resolution: of the alpha shape, and how far attempts go at most [m].
        spacing: how far those that promise little lie apart [m].
        least: a gain that nobody would see [m].
        codes: indices into `STATES`.
        low, high: (M,) of normalised pressures.
        in_range: whether strains must stay in their range.
        tries: of each facet, by its corners.
    """

    slopes: KnownSlopes
    resolution: float
    spacing: float
    least: float
    codes: tuple[int, ...]
    low: Array
    high: Array
    in_range: bool
    tries: dict[tuple[int, ...], int] = field(default_factory=dict)

    @property
    def least_gain(self) -> float:
        """A step that promises less is not worth a state [m]."""
        return max(LEAST_GAIN * self.spacing, self.least)

    def own(self, states: Batch) -> Indices:
        """Those of all states that make the region."""
        return np.flatnonzero(np.isin(states.code.numpy(), self.codes))

    def push(self, states: Batch, most: int) -> Pushes:
        """Attempts from the corners of the boundary's facets; none where none promises a gain.

        Args:
            states: all that are known.
            most: so many at most, those that promise most.
        """
        index, position = self.own(states), states.position
        shape = alpha_shape(position[index], self.resolution)
        spike, away = ways_out_of_spikes(shape)
        facets = index[np.concatenate((shape.facets, np.tile(spike[:, None], (1, position.shape[1]))))]
        normal = np.concatenate((shape.normals, away))
        keys = [tuple(key) for key in np.sort(facets, 1).tolist()]
        tried = np.array([self.tries.get(key, 0) for key in keys], dtype=int)
        still = np.flatnonzero(tried < TRIES)
        facets, normal = facets[still], normal[still]
        centre = position[facets].mean(1)
        half = 0.5 ** tried[still, None]
        goal = centre + self.resolution * half * normal
        height = (centre * normal).sum(1)
        corners = facets.T  # each facet is tried from all of them
        many = [np.tile(one, (len(corners), 1)) for one in (goal, half)]
        found = self._attempts(states, corners.ravel(), *many)
        normalised, promised = (part.reshape(*corners.shape, part.shape[-1]) for part in found)
        best = (promised * normal).sum(2).argmax(0), np.arange(len(facets))
        gain = (promised[best] * normal).sum(1) - height
        chosen = self._worthwhile(promised[best], gain, most)
        hopeless = gain <= self.least_gain  # and would be again; but ways out of spikes change with what is around
        for facet in still[hopeless & (facets[:, 0] != facets[:, 1])]:
            self.tries[keys[facet]] = TRIES
        for facet in still[chosen]:
            self.tries[keys[facet]] = self.tries.get(keys[facet], 0) + 1
        return Pushes(normalised[best][chosen], normal[chosen], goal[chosen], height[chosen], gain[chosen])

    def push_on(self, states: Batch, last: Pushes, most: int) -> Pushes:
        """Further attempts from where the last ones got to, the last of the states: onwards from those that gained,
        and of the others once more to the same goal, which lies closer now and within limits told better."""
        index = np.arange(len(states) - len(last), len(states))
        code = states.code.numpy()[index]
        known = np.flatnonzero(code <= EXCLUDED)
        index, code, last = index[known], code[known], last.at(known)
        position, normal = states.position[index], last.normal
        height = (position * normal).sum(1)
        gained = np.isin(code, self.codes) & (height - last.height > self.least_gain)
        height = np.where(gained, height, last.height)
        goal = np.where(gained[:, None], position + self.resolution * normal, last.goal)
        normalised, promised = self._attempts(states, index, goal, np.where(gained, 1.0, CORRECTED)[:, None])
        gain = (promised * normal).sum(1) - height
        chosen = self._worthwhile(promised, gain, most)
        return Pushes(normalised[chosen], normal[chosen], goal[chosen], height[chosen], gain[chosen])

    def _attempts(self, states: Batch, source: Indices, goal: Array, part: Array) -> tuple[Array, Array]:
        """(b, M) normalised pressures that should take tips from states to goals (b, D), and where slopes see them
        end (b, D)."""
        slopes, start, normalised = (
            self.slopes.of(states, source),
            states.position[source],
            states.normalised.numpy()[source],
        )
        longest = LONGEST_IN_RANGE if self.in_range else LONGEST_STEP
        step = self._steps(normalised, slopes, goal - start, longest * part)
        return (normalised + step).clip(self.low, self.high), start + (slopes.tip @ step[..., None])[..., 0]

    def _worthwhile(self, promised: Array, gain: Array, most: int) -> Indices:
        """The attempts whose gain is enough, so many at most; of several to one place the best."""
        order = np.argsort(-gain, kind="stable")
        order = order[gain[order] > self.least_gain]
        level = np.floor(np.log2(np.maximum(gain[order] / self.spacing, 1.0)))[:, None]  # far ones lie as far apart
        cell = np.floor(promised[order] / (self.spacing * 2**level))
        first = np.sort(np.unique(np.concatenate((level, cell), 1), axis=0, return_index=True)[1])
        return np.asarray(order[first[:most]])

    def _steps(self, normalised: Array, slopes: Slopes, way: Array, longest: Array) -> Array:
        """(F, M) that move the tip by a way (F, D), as nearly as slopes and limits allow."""
        low, high = np.maximum(self.low, normalised - longest), np.minimum(self.high, normalised + longest)
        width = high - low
        tip = slopes.tip * width[:, None]
        gradient, curvature = -(tip.swapaxes(1, 2) @ way[..., None])[..., 0], tip.swapaxes(1, 2) @ tip
        beyond, slope = slopes.beyond + MARGIN, slopes.beyond_slope * width[:, None]
        start = np.where(width > 0, (normalised - low) / np.where(width > 0, width, 1.0), 0.0)
        weight, met = (self.resolution / MARGIN) ** 2, np.zeros(beyond.shape, dtype=bool)
        step, unsettled = np.zeros(normalised.shape), np.arange(len(normalised))
        for _ in range(PASSES if self.in_range else 1):
            held = slope[unsettled] * met[unsettled, :, None]
            step[unsettled] = box_steps(
                gradient[unsettled]
                + weight * (held.swapaxes(1, 2) @ np.where(met, beyond, 0.0)[unsettled, :, None])[..., 0],
                curvature[unsettled] + weight * (held.swapaxes(1, 2) @ held),
                start[unsettled],
                (DAMPING * self.resolution) ** 2,
            )
            meets = beyond[unsettled] + (slope[unsettled] @ step[unsettled, :, None])[..., 0] > 0
            changed = (meets != met[unsettled]).any(1)
            met[unsettled] = meets
            unsettled = unsettled[changed]
            if not len(unsettled):
                break
        return width * step


def ways_out_of_spikes(shape: AlphaShape) -> tuple[Indices, Array]:
    """Points (b,) where facets tell no way out, and that way (b, D) from each: sharp corners and edges, and points that
    are no corner of the region, as at the end of a spike thinner than the resolution."""
    from scipy.spatial import cKDTree

    points, facets = shape.points, shape.facets
    normal, count = np.zeros(points.shape), np.zeros(len(points))
    np.add.at(normal, facets, shape.normals[:, None])
    np.add.at(count, facets, 1.0)
    sharp = np.flatnonzero(np.linalg.norm(normal, axis=1) < SHARP * count)
    filled = shape.filled
    alone = np.flatnonzero(~filled) if filled.any() else sharp[:0]
    inner = points[filled]
    away = points[alone] - inner[cKDTree(inner).query(points[alone])[1]] if len(alone) else points[:0]
    way = np.concatenate((normal[sharp], away))
    return np.concatenate((sharp, alone)), way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-300)
