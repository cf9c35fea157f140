"""From sampled polygons to the attainable sets themselves: how `evaluate` polishes."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torcharm._select import pick
from torcharm.distance.closed_form import BOUNDARY_ULPS, NearestFaces
from torcharm.distance.newton import Found, Problems, solve
from torcharm.distance.search import search_faces
from torcharm.distance.touch import CurveSums, curve_sums
from torcharm.hulls import ExactHulls, Sections
from torcharm.laws import Laws

RIVALS = 4
"""So many times at most a nearer face is searched for from inside."""
GAP = 1e-12
"""By how much the two bounds of a distance may differ, relative to the size of the coordinates."""
LEAST_GAP = 8.0
"""The same in blurs, where numbers hold less."""


@dataclass(frozen=True)
class Polished:
    """Nearest faces of the sets themselves, where those of sampled polygons do not do.

    Attributes:
        faces: squared distances and sides, as of the polygons' faces.
        fraction: (2, M, B, L) pressure fractions at the ends of the faces, if asked for,
        converged: (B, L).
    """

    faces: NearestFaces
    fraction: Tensor | None
    converged: Tensor


def polish(
    sections: Sections,
    hulls: ExactHulls,
    laws: Laws | None,
    faces: NearestFaces,
    point: tuple[Tensor, Tensor],
    *,
    relative: bool,
    signed: bool,
    fractions: bool,
) -> Polished:
    """From the nearest faces of polygons inside the sets to those of the sets.

    A point inside its polygon is inside its set; unless margins are asked for, only the others are looked at.
    Where the force models write out their laws Newton's method answers; what is left over is searched for.

    Args:
        sections: the actuators.
        hulls: sampled from their curves.
        laws: of the curves, if all models write theirs.
        faces: nearest to the points, with slots.
        point: (B, L) each.
        relative: whether the sets are of differences from node 1.
        signed: whether points inside are asked for.
        fractions: whether pressure fractions are.
    """
    wanted = torch.ones_like(faces.inside) if signed else ~(faces.inside | (faces.square <= faces.blur.square()))
    square, inside, converged = faces.square.clone(), faces.inside.clone(), ~wanted
    fraction = square.new_zeros(2, len(sections.radii), *square.shape) if fractions else None

    def take(section: Tensor, load: Tensor, found: Found) -> None:
        # The polygon lies inside the set: its distance bounds the set's, from above outside and from below inside.
        was_inside, blur = faces.inside[section, load], faces.blur[section, load]
        gain = faces.square[section, load].sqrt() - found.square.sqrt()
        gain = torch.where(was_inside & found.inside, -gain, gain)
        bounded = gain >= -2 * _gap(blur)
        better = found.done & (bounded | (found.inside & ~was_inside))
        place = section, load
        square[place] = torch.where(better, found.square, square[place])
        inside[place] = torch.where(better, found.inside, inside[place])
        converged[place] = better
        if fraction is not None and found.fraction is not None:
            fraction[:, :, section, load] = found.fraction

    open_ones = wanted
    if laws is not None:
        sums, holds = curve_sums(laws, hulls.curves.bending, hulls.curves.radii, hulls.scale)
        lawful = wanted & holds.unsqueeze(-1)
        section, load = lawful.nonzero(as_tuple=True)
        if len(section):
            own = sums if square.shape[1] == 1 and len(section) == len(square) else pick(sums, section)
            problems = start(hulls, faces, point, section, load)
            found = solve(problems, own, fractions=fractions)
            if signed:
                _try_rivals(hulls, section, problems, own, found, fractions=fractions)
            if found.fraction is not None:
                found = replace(found, fraction=found.fraction[:, sums.order])
            take(section, load, found)
        open_ones = wanted & ~converged
    section, load = open_ones.nonzero(as_tuple=True)
    if len(section):
        take(section, load, search_faces(sections, hulls, faces, point, section, load, relative))
    return Polished(replace(faces, square=square, inside=inside), fraction, converged)


def _try_rivals(
    hulls: ExactHulls, section: Tensor, problems: Problems, curves: CurveSums, found: Found, *, fractions: bool
) -> None:
    """From inside, put nearer faces in place of those that were found, if there are any.

    The set's margin in any direction is at least the polygon's: edges of the polygon further away than what was found
    are none. At the others' normals the sets' margins say whether it is worth to search from there.
    """
    index = (found.inside & found.done).nonzero().squeeze(-1)
    for _ in range(RIVALS):
        if not len(index):
            break
        margin = found.square[index].sqrt() - problems.tolerance[index]
        x, y, edge_x, edge_y = (value[:, section[index]] for value in vars(hulls.polygons).values())
        y = hulls.lowered(y, section[index])
        length = torch.hypot(edge_x, edge_y)
        over = (problems.point[0, index] - x) * edge_y - (problems.point[1, index] - y) * edge_x
        slot, place = ((length > 0) & (over > -margin * length)).nonzero(as_tuple=True)
        own, size = index[place], length[slot, place]
        normal = torch.stack((edge_y[slot, place], -edge_x[slot, place])) / size
        over = (normal * (problems.point[:, own] - pick(curves, own).touch(normal).point)).sum(0)
        best = torch.full_like(margin, -torch.inf).scatter_reduce(0, place, over, "amax")
        chosen = ((over == best[place]) & (over > -margin[place])).nonzero().squeeze(-1)
        if not len(chosen):
            break
        number = own[chosen]
        begin = torch.stack((x, y))[:, slot, place][:, chosen]
        edge = torch.stack((edge_x, edge_y))[:, slot, place][:, chosen]
        other = replace(pick(problems, number), normal=normal[:, chosen], ends=torch.stack((begin, begin + edge)))
        nearer = solve(other, pick(curves, number), fractions=fractions)
        better = nearer.done & nearer.inside & (nearer.square < found.square[number])
        # What is further than the margin seen, or not found at all, is no answer.
        found.done[number] = better
        found.square[number] = torch.where(better, nearer.square, found.square[number])
        if found.fraction is not None and nearer.fraction is not None:
            found.fraction[:, :, number] = torch.where(better, nearer.fraction, found.fraction[:, :, number])
        index = number[better]


def _gap(blur: Tensor) -> Tensor:
    """By how much the two bounds of distances may differ."""
    return blur * max(LEAST_GAP, GAP / (BOUNDARY_ULPS * torch.finfo(blur.dtype).eps))


def start(
    hulls: ExactHulls, faces: NearestFaces, point: tuple[Tensor, Tensor], section: Tensor, load: Tensor
) -> Problems:
    """From the polygons' nearest faces to problems: those (Q) of sections and loads."""
    assert faces.slot is not None
    polygons, place, slot = hulls.polygons, (section, load), faces.slot[section, load]
    x, y, blur, square, inside = (value[place] for value in (*point, faces.blur, faces.square, faces.inside))
    begin_x, begin_y, edge_x, edge_y = (
        value[slot, section] for value in (polygons.x, polygons.y, polygons.edge_x, polygons.edge_y)
    )
    side = 1 - 2 * inside.to(x.dtype)
    from_x, from_y, span = x - begin_x, y - begin_y, edge_x * edge_x + edge_y * edge_y
    foot = from_x * edge_x + from_y * edge_y
    edge = (foot > 0) & (foot < span)
    share = (foot / span.clamp(min=torch.finfo(x.dtype).tiny)).clamp(0, 1)
    # Of a polygon without area the point may be on either side of either edge.
    facing = (side * (from_x * edge_y - from_y * edge_x)).sign()
    nx = torch.where(edge, facing * edge_y, side * (from_x - share * edge_x))
    ny = torch.where(edge, -facing * edge_x, side * (from_y - share * edge_y))
    length = torch.hypot(nx, ny)
    nowhere = (length <= torch.finfo(x.dtype).tiny).to(x.dtype)
    normal = torch.stack((nx + nowhere, ny)) / (length + nowhere)
    y, begin_y = hulls.lowered(y, section), hulls.lowered(begin_y, section)
    begin = torch.stack((begin_x, begin_y))
    ends = torch.stack((begin, begin + torch.stack((edge_x, edge_y))))
    turned = facing < 0
    if bool(turned.any()):
        ends = torch.where(turned, ends.flip(0), ends)
    edge = edge & (nowhere == 0)
    return Problems(torch.stack((x, y)), normal, side, square.sqrt(), _gap(blur), edge, ends)
