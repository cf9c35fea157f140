"""Nearest faces by search on cubics, of force models that write out no laws and where Newton's method fails."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from torcharm._arrays import Array, as_array
from torcharm.distance.closed_form import NearestFaces, start_normals
from torcharm.distance.problems import Found
from torcharm.distance.support import LEAST, NARROW, REFITS, WINDOW, CurveSum, NearestPoints, nearest_points
from torcharm.hulls import ExactHulls, Sections
from torcharm.pieces import Pieces, fit_pieces, refit_pieces
from torcharm.polygon import face_square


def search_faces(
    sections: Sections,
    hulls: ExactHulls,
    faces: NearestFaces,
    point: tuple[Tensor, Tensor],
    sections_of: Array,
    loads_of: Array,
    relative: bool,
) -> Found:
    """The nearest faces of problems (Q) of sections and loads, by search."""
    section, load = (torch.from_numpy(value).to(faces.square.device) for value in (sections_of, loads_of))
    normals = start_normals(hulls.polygons, faces, *point)
    x, y, nx, ny, blur = (value[section, load] for value in (*point, *normals, faces.blur))
    y = hulls.lowered(y, section)
    pieces = fit_pieces(sections, section, relative=relative)
    bending = hulls.curves.bending[:, section]
    sums = CurveSum(pieces, bending, sections.radii[:, section], hulls.scale)
    found = nearest_points(sums, x, y, (nx, ny), 4 * blur)
    _refit(found, sums, x, y, 4 * blur, partial(refit_pieces, sections, relative=relative), section)
    square = face_square((x, y), found.ends.corner(0), found.ends.corner(1))
    return Found(*(as_array(value) for value in (square, found.inside, found.ends.fraction, found.converged)))


def _refit(
    found: NearestPoints,
    sums: CurveSum,
    x: Tensor,
    y: Tensor,
    tolerance: Tensor,
    fit: Callable[[Tensor, Tensor, Tensor], Pieces],
    section: Tensor,
) -> None:
    """Search again, on ever shorter stretches, where a piece that was touched is only near its force.

    Args:
        found: what is improved.
        sums, x, y, tolerance: as for `nearest_points`.
        fit: from sections (q), starts and widths (K, M, q) to pieces.
        section: (Q) of the sums.
    """
    loose = found.ends.rough.flatten(0, 1).any(0).nonzero().squeeze(-1)
    share = torch.full_like(x[loose], WINDOW)
    index = torch.arange(len(loose), device=x.device)
    for _ in range(REFITS if len(loose) else 0):
        own = loose[index]
        begin, width = found.ends.window(own, share[index])
        near = replace(sums.of(own), pieces=fit(section[own], begin, width))
        normal = found.normal[0, own], found.normal[1, own]
        found.put(own, nearest_points(near, x[own], y[own], normal, tolerance[own]))
        held = found.ends.held(own, begin, width).flatten(0, 1).any(0)
        found.converged[own] &= ~held
        share[index] = torch.where(held, share[index], share[index] * NARROW)
        index = index[share[index] >= LEAST]
        if not len(index):
            break
