"""Where lines touch sums of curves that are written out."""

from dataclasses import dataclass

import torch
from torch import Tensor

from torcharm.distance.arcs import Arcs, Highest, Lines, arcs
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
        point: (2, Q) x and y.
        parts: (2, M, Q) the actuators' parts of them.
        u: (M, Q) the pressure fractions that provide them.
        along, across: (M, Q) reaches, and places along the lines, a newton.
        drop: (M, Q) minus the reaches' second derivatives; infinite at corners. None if all are.
        bends: (M, Q) the curves' radii of curvature in the plane.
        radius: (Q) the boundary's: their sum; 0 at corners.
        rest: (Q) how much further the sets may reach; None: not at all.
        face: (M, Q) each, if asked for: how far actuators may go, and be touched, to the right and to the left, and
            their fractions there.
    """

    point: Tensor
    parts: Tensor
    u: Tensor
    along: Tensor
    across: Tensor
    drop: Tensor | None
    bends: Tensor | None
    radius: Tensor
    rest: Tensor | None
    face: tuple[Tensor, ...] | None


@dataclass(frozen=True)
class CurveSums:
    """Q sums of M actuators' reaction curves in the plane, actuators in the order of the groups.

    Attributes:
        groups: of actuators alike, and how many.
        bending: (M, Q) bending moment at fraction 1, scaled by moment.
        lever: (M, Q) the same, scaled by force too.
        radii: (M, Q) scaled by moment.
        scale: factors on force and moment.
        order: where in it each of the arm's actuators is.
    """

    groups: tuple[tuple[Arcs, int], ...]
    bending: Tensor
    lever: Tensor
    radii: Tensor
    scale: tuple[float, float]
    order: tuple[int, ...]

    def touch(self, normal: Tensor, slack: Tensor | None = None) -> Touch:
        """Where lines with normals (2, Q) touch the sets, and if asked for within slack (Q) of there.

        As the normal turns, with a lever `k = s_f s_m b` of the bending moment b and a reach a newton, a fraction
        changes by `k / (a drop)`, and the place along the line by the radius `k² / (a² drop)`.
        """
        nx, ny = normal
        fx, fy = self.scale[0] * normal
        along, across = torch.addcmul(fx, self.radii, ny, value=-1), -torch.addcmul(fy, self.radii, nx)
        lines = Lines(along, self.bending * ny, across, self.bending * nx)
        parts: list[Highest] = []
        for group, own in self.by_group():
            whole = len(self.groups) == 1
            part = lines if whole else Lines(*(value[own] for value in vars(lines).values()))
            parts.append(group.highest(part, slack))
        if len(parts) == 1:
            u, force, drop, rest, face = vars(parts[0]).values()
        else:
            u, force = torch.cat([part.u for part in parts]), torch.cat([part.force for part in parts])
            drops = [torch.full_like(part.u, torch.inf) if part.drop is None else part.drop for part in parts]
            drop = None if all(part.drop is None for part in parts) else torch.cat(drops)
            rests = [part.rest for part in parts if part.rest is not None]
            rest = torch.cat(rests) if rests else None
            face = None
            if slack is not None:
                face = tuple(torch.cat(values) for values in zip(*(part.faces or () for part in parts), strict=True))
        shares = torch.stack((self.scale[0] * force, torch.addcmul(self.bending * u, self.radii, force, value=-1)))
        bends = None if drop is None else (self.lever / along).square_().div_(drop)
        radius = torch.zeros_like(nx) if bends is None else bends.sum(0)
        rest = None if rest is None else rest.sum(0)
        return Touch(shares.sum(1), shares, u, along, across, drop, bends, radius, rest, face)

    def by_group(self) -> list[tuple[Arcs, slice]]:
        """The groups, and which actuators they are."""
        starts = [0]
        for _, count in self.groups:
            starts.append(starts[-1] + count)
        return [
            (group, slice(start, start + count)) for (group, count), start in zip(self.groups, starts, strict=False)
        ]

    def jumps(self, chord: Tensor, first: Tensor, last: Tensor) -> Tensor:
        """Faces (2, M, Q) that curves may have between fractions (M, Q): chords, or tangents if known, as long."""
        for group, own in self.by_group():
            known = group.tangent(first[own], last[own])
            if known is not None:
                slope, there = known
                edge = torch.stack((self.scale[0] * slope, self.bending[own] - self.radii[own] * slope))
                face = torch.where(there, edge * (last[own] - first[own]), chord[:, own])
                chord = (
                    face if len(self.groups) == 1 else torch.cat((chord[:, : own.start], face, chord[:, own.stop :]), 1)
                )
        return chord

    def turn(self, touch: Touch, angle: Tensor, steep: Tensor) -> Tensor:
        """How far (Q, as tangents) normals turn in Newton's step, if to first order that is an angle.

        Of the rate (steep) at which the points come ahead as the normal turns, that part which is the curves' radii
        changes on the way: to how much, they say themselves.
        """
        if touch.drop is None or touch.bends is None:
            return angle
        lever, along, u, bends = self.lever, touch.along, touch.u, touch.bends
        # The place along the line is quadratic in the fraction.
        rate = angle / along
        sway = (0.5 * touch.across * rate).clamp(-MOST_SWAY, MOST_SWAY)
        step = rate * lever / touch.drop
        target = torch.addcmul(u, step, 1 + sway)
        # Short of a corner that is missed by little.
        left = ENDING * u
        right = ENDING - left
        low, high = (target > -left) * left, 1 - (target < 1 + right) * right
        step = torch.clamp(target, low, high).sub_(u)
        change = self._slope_change(touch, step)
        curved = (bends > 0) & (angle != 0)
        slope = along * torch.where(curved, change, 0.0)
        turns = slope / (torch.addcmul(lever, touch.across, slope) * -rate)
        gain = (bends * torch.where(curved, turns.clamp(LEAST_TURN, MOST_TURN) - 1, 0.0)).sum(0) / steep
        return angle * (1 + gain.clamp(LEAST_TURN - 1, MOST_TURN - 1))

    def _slope_change(self, touch: Touch, step: Tensor) -> Tensor:
        """By how much the curves' slopes (M, Q) change from where they are touched on by steps."""
        assert touch.drop is not None
        (group, _), *others = self.groups
        if not others and group.shape is not None and group.twins is None:
            return group.shape.slope_change(touch.u, step)
        change = -step * touch.drop / touch.along
        for group, own in self.by_group():
            if group.shape is not None:
                known = group.shape.slope_change(touch.u[own], step[own])
                change[own] = known if group.twins is None else torch.where(known != 0, known, change[own])
        return change


def curve_sums(laws: Laws, bending: Tensor, radii: Tensor, scale: tuple[float, float]) -> tuple[CurveSums, Tensor]:
    """The sums of laws' curves at B sections; and whether (B) they are right.

    Args:
        laws: of M actuators.
        bending: (M, B) bending moments at fraction 1 [N·m].
        radii: (M, B) [m].
        scale: factors on force and moment.
    """
    holds, groups = laws.holds, []
    for law in laws.groups:
        group, known = arcs(law)
        holds = holds & known
        groups.append((group, len(law.coefficients[0])))
    count = len(radii)
    places = [
        place for law in laws.groups for place in (range(count)[law.rows] if isinstance(law.rows, slice) else law.rows)
    ]
    order = tuple(places.index(own) for own in range(count))
    if len(groups) > 1:
        bending, radii = (torch.cat([value[law.rows] for law in laws.groups]) for value in (bending, radii))
    bending = scale[1] * bending
    return CurveSums(tuple(groups), bending, scale[0] * bending, scale[1] * radii, scale, order), holds
