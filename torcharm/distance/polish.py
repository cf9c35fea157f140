"""From sampled polygons to the attainable sets themselves: how `evaluate` polishes."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from torcharm._arrays import Array, as_array, pick
from torcharm.distance.closed_form import NearestFaces
from torcharm.distance.newton import solve
from torcharm.distance.problems import Found, Problems, gap_of, problems_of
from torcharm.distance.search import search_faces
from torcharm.distance.touch import CurveSums
from torcharm.hulls import ExactHulls, Sections

RIVALS = 4
"""So many times at most a nearer face is searched for from inside."""


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


@np.errstate(all="ignore")  # of a NaN there is no distance, and it says so
def polish(
    sections: Sections,
    hulls: ExactHulls,
    sums: tuple[CurveSums, Array] | None,
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
        sums: of the curves, and where they are right, if all models write out their laws.
        faces: nearest to the points, with slots.
        point: (B, L) each.
        relative: whether the sets are of differences from node 1.
        signed: whether points inside are asked for.
        fractions: whether pressure fractions are.
    """
    square, inside, blur = (as_array(value) for value in (faces.square, faces.inside, faces.blur))
    wanted = np.ones_like(inside) if signed else ~(inside | (square <= np.square(blur)))
    was_square, was_inside, square, inside, converged = square, inside, square.copy(), inside.copy(), ~wanted
    fraction = np.zeros((2, len(sections.radii), *square.shape), square.dtype) if fractions else None

    def take(section: Array, load: Array, found: Found) -> None:
        # The polygon lies inside the set: its distance bounds the set's, from above outside and from below inside.
        place = section, load
        before = was_inside[place]
        gain = np.sqrt(was_square[place]) - np.sqrt(found.square)
        gain = np.where(before & found.inside, -gain, gain)
        better = found.done & ((gain >= -2 * gap_of(blur[place])) | (found.inside & ~before))
        square[place] = np.where(better, found.square, was_square[place])
        inside[place] = np.where(better, found.inside, before)
        converged[place] = better
        if fraction is not None and found.fraction is not None:
            fraction[:, :, section, load] = found.fraction

    open_ones = wanted
    if sums is not None:
        curves, holds = sums
        section, load = (wanted & holds[:, None]).nonzero()
        if len(section):
            own = curves if square.shape[1] == 1 and len(section) == len(square) else pick(curves, section)
            problems = start(hulls, faces, point, section, load)
            found = solve(problems, own, fractions=fractions)
            if signed:
                _try_rivals(hulls, section, problems, own, found, fractions=fractions)
            if found.fraction is not None:
                found = replace(found, fraction=found.fraction[:, curves.order])
            take(section, load, found)
        open_ones = wanted & ~converged
    left = open_ones.nonzero()
    if len(left[0]):
        section, load = left
        take(section, load, search_faces(sections, hulls, faces, point, section, load, relative))
    device = faces.square.device
    answers = replace(faces, square=torch.from_numpy(square).to(device), inside=torch.from_numpy(inside).to(device))
    ends = None if fraction is None else torch.from_numpy(fraction).to(device)
    return Polished(answers, ends, torch.from_numpy(converged).to(device))


def _try_rivals(
    hulls: ExactHulls, section: Array, problems: Problems, curves: CurveSums, found: Found, *, fractions: bool
) -> None:
    """From inside, put nearer faces in place of those that were found, if there are any.

    The set's margin in any direction is at least the polygon's: edges of the polygon further away than what was found
    are none. At the others' normals the sets' margins say whether it is worth to search from there.
    """
    polygons = [as_array(value) for value in vars(hulls.polygons).values()]
    index = (found.inside & found.done).nonzero()[0]
    for _ in range(RIVALS):
        if not len(index):
            break
        margin = np.sqrt(found.square[index]) - problems.tolerance[index]
        x, y, edge_x, edge_y = (value[:, section[index]] for value in polygons)
        y = _lowered(hulls, y, section[index])
        length = np.hypot(edge_x, edge_y)
        over = (problems.point[0, index] - x) * edge_y - (problems.point[1, index] - y) * edge_x
        slot, place = ((length > 0) & (over > -margin * length)).nonzero()
        own, size = index[place], length[slot, place]
        normal = np.stack((edge_y[slot, place], -edge_x[slot, place])) / size
        touch = pick(curves, own).touch(*normal)
        over = normal[0] * (problems.point[0, own] - touch.x) + normal[1] * (problems.point[1, own] - touch.y)
        best = np.full_like(margin, -np.inf)
        np.maximum.at(best, place, over)
        chosen = ((over == best[place]) & (over > -margin[place])).nonzero()[0]
        if not len(chosen):
            break
        number = own[chosen]
        begin = np.stack((x, y))[:, slot, place][:, chosen]
        edge = np.stack((edge_x, edge_y))[:, slot, place][:, chosen]
        other = replace(pick(problems, number), normal=normal[:, chosen], ends=np.stack((begin, begin + edge)))
        nearer = solve(other, pick(curves, number), fractions=fractions)
        better = nearer.done & nearer.inside & (nearer.square < found.square[number])
        # What is further than the margin seen, or not found at all, is no answer.
        found.done[number] = better
        found.square[number] = np.where(better, nearer.square, found.square[number])
        if found.fraction is not None and nearer.fraction is not None:
            found.fraction[:, :, number] = np.where(better, nearer.fraction, found.fraction[:, :, number])
        index = number[better]


def _lowered(hulls: ExactHulls, y: Array, section: Array) -> Array:
    """Scaled moments (..., Q) required of sections (Q), less what is borne at no pressure: for curves without it."""
    resting = hulls.curves.resting
    return y if resting is None else y - hulls.scale[1] * as_array(resting)[section]


def start(
    hulls: ExactHulls, faces: NearestFaces, point: tuple[Tensor, Tensor], section: Array, load: Array
) -> Problems:
    """From the polygons' nearest faces to problems: those (Q) of sections and loads."""
    assert faces.slot is not None
    x, y, blur, square, inside, slot = (
        as_array(value)[section, load] for value in (*point, faces.blur, faces.square, faces.inside, faces.slot)
    )
    begin_x, begin_y, edge_x, edge_y = (as_array(value)[slot, section] for value in vars(hulls.polygons).values())
    y, begin_y = _lowered(hulls, y, section), _lowered(hulls, begin_y, section)
    return problems_of(x, y, begin_x, begin_y, edge_x, edge_y, square, inside, blur)
