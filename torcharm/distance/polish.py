"""From sampled polygons to the attainable sets themselves: how `evaluate` polishes."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from torcharm.distance.closed_form import BOUNDARY_ULPS, NearestFaces, nearest_faces, start_normals
from torcharm.distance.newton import Found, Problems, at_actuator, solve
from torcharm.distance.support import search_faces
from torcharm.hulls import ExactHulls, Sections, build_hulls
from torcharm.laws import Laws, law_curves

FINER = (17, 65)
"""Even samples of a curve for further tries."""
GAP = 1e-12
"""By how much the two bounds of a distance may differ, relative to the size of the coordinates."""
LEAST_GAP = 8.0
"""The same in blurs, where numbers hold less."""


@dataclass(frozen=True)
class Polished:
    """Nearest faces of the sets themselves, where those of sampled polygons do not do.

    Attributes:
        faces: squared distances and sides, as of the polygons' faces.
        fraction: (2, M, B, L) pressure fractions at the ends of the faces; meaningless for points that
            were not polished, whose distance is 0.
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
        if fraction is not None:
            fraction[:, :, section, load] = found.fraction

    open_ones = wanted
    if laws is not None:
        lawful = wanted & laws.holds.unsqueeze(-1)
        section, load = lawful.nonzero(as_tuple=True)
        for samples in (None, *FINER):
            if not len(section):
                break
            if samples is None:
                found = solve(start(hulls, laws, faces, point, section, load), hulls.scale)
            else:
                found = refined(hulls, laws, point, section, load, samples, signed=signed)
            take(section, load, found)
            left = ~converged[section, load]
            section, load = section[left], load[left]
        open_ones = wanted & ~lawful
    section, load = open_ones.nonzero(as_tuple=True)
    if len(section):
        take(section, load, search_faces(sections, hulls, faces, point, section, load, relative))
    return Polished(replace(faces, square=square, inside=inside), fraction, converged)


def _gap(blur: Tensor) -> Tensor:
    """By how much the two bounds of distances may differ."""
    return blur * max(LEAST_GAP, GAP / (BOUNDARY_ULPS * torch.finfo(blur.dtype).eps))


def refined(
    hulls: ExactHulls,
    laws: Laws,
    point: tuple[Tensor, Tensor],
    section: Tensor,
    load: Tensor,
    samples: int,
    *,
    signed: bool,
) -> Found:
    """Another try, from polygons of more samples, for problems (Q) of sections and loads."""
    laws, bending, radii = laws.of(section), hulls.curves.bending[:, section], hulls.curves.radii[:, section]
    resting = None if hulls.curves.resting is None else hulls.curves.resting[section]
    finer = build_hulls(law_curves(laws, bending, radii, samples, resting), "exact", hulls.scale)
    assert isinstance(finer, ExactHulls)
    x, y = (value[section, load].unsqueeze(-1) for value in point)
    faces = nearest_faces(finer.polygons, x, y, slots=True)
    every = torch.arange(len(section), device=section.device)
    found = solve(start(finer, laws, faces, (x, y), every, torch.zeros_like(every)), hulls.scale)
    within = (faces.inside | (faces.square <= faces.blur.square()))[:, 0] & (not signed)
    return replace(found, done=found.done | within, inside=found.inside | within)


def start(
    hulls: ExactHulls, laws: Laws, faces: NearestFaces, point: tuple[Tensor, Tensor], section: Tensor, load: Tensor
) -> Problems:
    """From the polygons' nearest faces to problems: those (Q) of sections and loads."""
    curves, scale, polygons = hulls.curves, hulls.scale, hulls.polygons
    normal = start_normals(polygons, faces, *point)
    assert faces.slot is not None
    x, y, nx, ny, blur, slot, inside = (
        value[section, load] for value in (*point, *normal, faces.blur, faces.slot, faces.inside)
    )
    edge_x, edge_y = polygons.edge_x[slot, section], polygons.edge_y[slot, section]
    span = edge_x.square() + edge_y.square() + torch.finfo(x.dtype).tiny
    share = ((x - polygons.x[slot, section]) * edge_x + (y - polygons.y[slot, section]) * edge_y) / span
    share = share.clamp(0, 1)

    actuators = len(curves.radii)
    edge = hulls.order[slot, section]
    sample, own = edge // actuators, edge % actuators
    first, step = curves.grid[sample, own, section], hulls.step[sample, own, section]
    forward = hulls.turn[own, section] > 0
    part = torch.where(forward, share, 1 - share)
    every = torch.arange(len(x), device=x.device)

    law = laws.of(section)
    beside = laws.beside(curves.grid) if laws.winding else curves.grid.new_zeros(2, 0, *curves.radii.shape)
    beside = beside.index_select(-1, section)
    grid, force, radii, bending = (
        value.index_select(-1, section) for value in (curves.grid, curves.force, curves.radii, curves.bending)
    )
    per_force = scale[0] * nx - (scale[1] * ny) * radii
    per_fraction = (scale[1] * ny) * bending
    top, best = (per_force * force + per_fraction * grid).max(0)
    u = grid.gather(0, best[None])[0]
    u[own, every] = first + part * step
    tolerance = _gap(blur)
    bulge = (per_force * law.force(u) + per_fraction * u - top)[own, every]
    face = (share > 0) & (share < 1) & (bulge <= tolerance)
    last = first + step
    # On a straight face one end is let go: that into which the curve rises, if there is one.
    u[own, every] = torch.where(face, first, u[own, every])
    other = last
    if bool(face.any()):
        _, slope, _, after, before, _, _ = law.around(u)
        away = at_actuator(torch.where(step > 0, slope + after, -(slope + before)) * per_force, own)
        away = away + step.sign() * at_actuator(per_fraction, own)
        swap = face & (away <= 0)
        u[own, every] = torch.where(swap, last, u[own, every])
        other = torch.where(swap, first, last)
    u_other = u.clone()
    u_other[own, every] = other
    other_force = law.force(u_other)[own, every]
    side = 1 - 2 * inside.to(x.dtype)
    return Problems(
        law,
        radii,
        bending,
        grid,
        force,
        beside[0],
        beside[1],
        x,
        hulls.lowered(y, section),
        side,
        tolerance,
        every,
        nx,
        ny,
        u,
        face,
        own,
        other,
        other_force,
        torch.zeros_like(x),
    )
