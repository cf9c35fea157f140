"""Where lines touch sums of curves that are written out."""

from dataclasses import dataclass, replace

import numpy as np

from torcharm._arrays import Array, as_array
from torcharm.distance.arcs import Arcs, Highest, Lines, arcs
from torcharm.hulls import Sections
from torcharm.laws import Laws

LEAST_TURN, MOST_TURN = 0.1, 4.0
"""Bounds on the factor by which a curve's change of curvature may change the turn of a normal."""
MOST_SWAY = 0.3
"""Bound on what its second order may change of a step along a curve."""
ENDING = 0.06
"""Share of the way to a corner that is kept if it is missed by no more."""


@dataclass(frozen=True)
class Touch:
    """Where sets are touched.

    Attributes:
        nx, ny: (Q) the lines' normals.
        x, y: (Q).
        u: (M, Q) the pressure fractions that provide them.
        force: (M, Q) [N].
        along: (M, Q) reaches a newton.
        drop: (M, Q) minus the reaches' second derivatives; infinite at corners. None if all are.
        bends: (M, Q) the curves' radii of curvature in the plane.
        radius: (Q) the boundary's: their sum; 0 at corners.
        rest: (Q) how much further the sets may reach; None: not at all.
        margin: (M, Q) by how much other maxima of the curves reach less far.
    """

    nx: Array
    ny: Array
    x: Array
    y: Array
    u: Array
    force: Array
    along: Array
    drop: Array | None
    bends: Array | None
    radius: Array
    rest: Array | None
    margin: Array


@dataclass(frozen=True)
class CurveSums:
    """Q sums of M actuators' reaction curves in the plane, actuators in the order of the groups.

    Attributes:
        groups: of actuators alike, and which they are.
        bending: (M, Q) bending moment at fraction 1, scaled by moment.
        lever: (M, Q) the same, scaled by force too.
        radii: (M, Q) scaled by moment.
        scale: factors on force and moment.
        order: for each of the arm's actuators, its row here.
    """

    groups: tuple[tuple[Arcs, slice], ...]
    bending: Array
    lever: Array
    radii: Array
    scale: tuple[float, float]
    order: tuple[int, ...]

    def afresh(self) -> "CurveSums":
        """The same for a search of its own, which notes where maxima were."""
        groups = []
        for group, own in self.groups:
            twins = group.twins
            twins = None if twins is None else replace(twins, latest=np.ones_like(twins.latest))
            groups.append((group if twins is None else replace(group, twins=twins), own))
        return replace(self, groups=tuple(groups))

    def touch(self, nx: Array, ny: Array) -> Touch:
        """Where lines with normals n (Q) touch the sets.

        As the normal turns, with a lever `k = s_f s_m b` of the bending moment b and a reach a newton, a fraction
        changes by `k / (a drop)`, and the place along the line by the radius `k² / (a² drop)`.
        """
        lines = self.lines(nx, ny)
        parts = [group.highest(own) for group, own in self._of_groups(lines)]
        u, force, drop, rest, margin = vars(parts[0] if len(parts) == 1 else _joined(parts)).values()
        bends = None
        if drop is not None:
            bends = self.lever / lines.along
            bends *= bends
            bends /= drop
        radius = np.zeros_like(nx) if bends is None else bends.sum(0)
        rest = None if rest is None else rest.sum(0)
        x, y = self.places(u, force)
        return Touch(nx, ny, x, y, u, force, lines.along, drop, bends, radius, rest, margin)

    def lines(self, nx: Array, ny: Array) -> Lines:
        """What a newton and a fraction of each curve reach along directions (Q)."""
        return Lines(self.scale[0] * nx - self.radii * ny, self.bending * ny)

    def places(self, u: Array, force: Array) -> tuple[Array, Array]:
        """The sums' x and y (Q) of fractions and forces (M, Q)."""
        moment: Array = self.bending * u - self.radii * force
        return self.scale[0] * force.sum(0), moment.sum(0)

    def _of_groups(self, lines: Lines) -> list[tuple[Arcs, Lines]]:
        if len(self.groups) == 1:
            return [(self.groups[0][0], lines)]
        return [(group, Lines(lines.along[own], lines.per_fraction[own])) for group, own in self.groups]

    def spread(self, touch: Touch, slack: Array) -> tuple[Array, ...]:
        """As of `Arcs`, of all actuators, of what is touched within slack (Q)."""
        u, force = touch.u, touch.force
        lines, across = self.lines(touch.nx, touch.ny), self.lines(-touch.ny, touch.nx)
        near = (touch.margin <= slack).any(1)
        nothing = np.zeros_like(u)
        if len(self.groups) == 1:
            return self.groups[0][0].spread(lines, across, u, force, slack)
        parts = []
        for (group, rows), (_, own), (_, aside) in zip(
            self.groups, self._of_groups(lines), self._of_groups(across), strict=True
        ):
            if near[rows].any():
                parts.append(group.spread(own, aside, u[rows], force[rows], slack))
            else:
                parts.append((nothing[rows], nothing[rows], u[rows], u[rows], force[rows], force[rows]))
        return tuple(np.concatenate(values) for values in zip(*parts, strict=True))

    def jumps(self, first: Array, last: Array, rise: Array) -> tuple[Array, Array]:
        """Faces (M, Q) that curves may have between fractions: chords, or tangents if known, as long.

        Args:
            first, last: fractions (M, Q).
            rise: (M, Q) of force between them.
        """
        run, rise = last - first, rise.copy()
        for group, own in self.groups:
            known = group.tangent(first[own], last[own])
            if known is not None:
                slope, there = known
                rise[own] = np.where(there, slope * run[own], rise[own])
        return self.scale[0] * rise, self.bending * run - self.radii * rise

    def turn(self, touch: Touch, angle: Array, steep: Array) -> Array:
        """How far (Q, as tangents) normals turn in Newton's step, if to first order that is an angle.

        Of the rate (steep) at which the points come ahead as the normal turns, that part which is the curves' radii
        changes on the way: to how much, they say themselves.
        """
        if touch.drop is None or touch.bends is None:
            return angle
        along, u, bends = touch.along, touch.u, touch.bends
        across = self.scale[0] * -touch.ny - self.radii * touch.nx
        # The place along the line is quadratic in the fraction.
        rate = angle / along
        sway = (0.5 * across * rate).clip(-MOST_SWAY, MOST_SWAY)
        step = rate * self.lever / touch.drop
        target = u + step * (1 + sway)
        # Short of a corner that is missed by little.
        left = ENDING * u
        right = ENDING - left
        low, high = (target > -left) * left, 1 - (target < 1 + right) * right
        step = np.minimum(np.maximum(target, low), high) - u
        change = self._slope_change(touch, step)
        curved = (bends > 0) & (angle != 0)
        slope = along * np.where(curved, change, 0.0)
        turns = slope / ((self.lever + across * slope) * -rate)
        factor = np.where(curved, turns.clip(LEAST_TURN, MOST_TURN) - 1, 0.0)
        gain = (bends * factor).sum(0) / steep
        turned: Array = angle * (1 + gain.clip(LEAST_TURN - 1, MOST_TURN - 1))
        return turned

    def _slope_change(self, touch: Touch, step: Array) -> Array:
        """By how much the curves' slopes (M, Q) change from where they are touched on by steps."""
        assert touch.drop is not None
        change: Array = -step * touch.drop / touch.along
        for group, own in self.groups:
            if group.shape is not None:
                known = group.shape.slope_change(touch.u[own], step[own])
                change[own] = known if group.twins is None else np.where(known != 0, known, change[own])
        return change


def _joined(parts: list[Highest]) -> Highest:
    """Maxima of all groups."""
    drop = rest = None
    if any(part.drop is not None for part in parts):
        drop = np.concatenate([np.full_like(part.u, np.inf) if part.drop is None else part.drop for part in parts])
    rests = [part.rest for part in parts if part.rest is not None]
    if rests:
        rest = np.concatenate(rests)
    u, force, margin = (np.concatenate([getattr(part, name) for part in parts]) for name in ("u", "force", "margin"))
    return Highest(u, force, drop, rest, margin)


@np.errstate(all="ignore")
def curve_sums(
    laws: Laws, sections: Sections, scale: tuple[float, float], *, relative: bool
) -> tuple[CurveSums, Array]:
    """The sums of laws' curves at B sections; and whether (B) they are right.

    Args:
        laws: of the actuators; relative: of differences from node 1.
        sections: the actuators.
        scale: factors on force and moment.
        relative: whether the sums are of differences.
    """
    holds, groups, start = laws.holds, [], 0
    for law in laws.groups:
        group, known = arcs(law)
        holds = holds & known
        groups.append((group, slice(start, start + len(group.rate[0]))))
        start = groups[-1][1].stop
    count = len(sections.radii)
    places = [
        place for law in laws.groups for place in (range(count)[law.rows] if isinstance(law.rows, slice) else law.rows)
    ]
    order = tuple(places.index(own) for own in range(count))
    bending = sections.bending
    moments = as_array(bending - sections.at_first_node(bending) if relative else bending)
    offsets = as_array(sections.radii)
    if len(groups) > 1:
        moments, offsets = moments[places], offsets[places]
    moments = scale[1] * moments
    return CurveSums(tuple(groups), moments, scale[0] * moments, scale[1] * offsets, scale, order), holds
