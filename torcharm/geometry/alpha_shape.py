"""Alpha shapes: the region that a cloud of points fills, at a resolution.

Of the Delaunay triangles of the points (in space tetrahedra) those stay whose circumscribed circle (sphere) has a
radius of at most α: H. Edelsbrunner, D. G. Kirkpatrick and R. Seidel, *On the shape of a set of points in the plane*,
1983; H. Edelsbrunner and E. P. Mücke, *Three-dimensional alpha shapes*, 1994. Unlike a convex hull it has dents and
holes: all that are wider than 2 α.
"""

from dataclasses import dataclass
from math import factorial
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class AlphaShape:
    """Of P points of the plane or of space, whose region may be empty.

    Attributes:
        points: (P, D), D being 2 or 3 [m].
        radius: α [m].
        facets: (F, D) indices of the points at the ends of the boundary's lines, or at the corners of its triangles.
        normals: (F, D) the unit vectors out of the region across them.
        kept: (T,) which of Delaunay's simplices belong to the region.
        triangulation: Delaunay's of `scipy.spatial`; None where the points span no area (volume).
    """

    points: Array
    radius: float
    facets: Indices
    normals: Array
    kept: NDArray[np.bool_]
    triangulation: Any

    @property
    def size(self) -> float:
        """Its area [m²], in space its volume [m³]."""
        if self.triangulation is None:
            return 0.0
        corners = self.points[self.triangulation.simplices[self.kept]]
        edges = corners[:, 1:] - corners[:, :1]
        return float(np.abs(np.linalg.det(edges)).sum()) / factorial(self.points.shape[1])

    @property
    def filled(self) -> NDArray[np.bool_]:
        """(P,) which of its points are corners of the region: the others lie alone, as in a spike thinner than α."""
        filled = np.zeros(len(self.points), dtype=np.bool_)
        if self.triangulation is not None:
            filled[self.triangulation.simplices[self.kept]] = True
        return filled

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """(...) which of some points (..., D) lie within."""
        if self.triangulation is None:
            return np.zeros(points.shape[:-1], dtype=np.bool_)
        simplex = self.triangulation.find_simplex(points)
        return np.asarray((simplex >= 0) & self.kept[simplex])

    def loops(self) -> list[Array]:
        """Closed lines (Q, 2) around a region of the plane and, the other way round, around its holes; the last point
        is the first."""
        ends: dict[int, list[int]] = {}
        for first, second in self.facets.tolist():
            ends.setdefault(first, []).append(second)
        found = []
        while ends:
            at = next(iter(ends))
            way = [at]
            while at in ends:
                following = ends[at].pop()
                if not ends[at]:
                    del ends[at]
                at = following
                way.append(at)
            found.append(self.points[way])
        return found


def alpha_shape(points: Array, radius: float) -> AlphaShape:
    """The alpha shape of points (P, D) for a radius α [m]."""
    from scipy.spatial import Delaunay, QhullError

    size = points.shape[1]
    try:
        whole = Delaunay(points)
    except (QhullError, ValueError):  # too few points, or all on a line
        nothing = np.zeros((0, size))
        return AlphaShape(points, radius, nothing.astype(np.intp), nothing, np.zeros(0, dtype=np.bool_), None)
    kept = _circumradius(whole) <= radius
    beside = (whole.neighbors >= 0) & kept[whole.neighbors]
    simplex, corner = np.nonzero(kept[:, None] & ~beside)
    others = np.array([[k for k in range(size + 1) if k != own] for own in range(size + 1)])
    facets = np.take_along_axis(whole.simplices[simplex], others[corner], 1).astype(np.intp)
    normals = _normals(points[facets])
    inward = points[whole.simplices[simplex, corner]] - points[facets[:, 0]]
    turned = (normals * inward).sum(1) > 0
    normals[turned] *= -1
    if size == 2:  # the region is to the left of each line
        facets[turned] = facets[turned][:, ::-1]
    return AlphaShape(points, radius, facets, normals, kept, whole)


def _circumradius(whole: Any) -> Array:
    """(T,) of Delaunay's simplices; infinite where one is flat.

    Of the plane n·x + m z + o = 0 through their corners on the paraboloid z = s |x|² + t to which Qhull lifts them, the
    points below are the circle's (sphere's): its centre is -n / (2 m s), and |centre|² - radius² is (m t + o) / (m s).
    """
    normal, rise, offset = whole.equations[:, :-2], whole.equations[:, -2], whole.equations[:, -1]
    steep = np.abs(rise) > FLAT
    rise = np.where(steep, rise, 1.0)
    scale = rise * whole.paraboloid_scale
    centre = normal / (-2 * scale[:, None])
    square = (centre**2).sum(1) - (rise * whole.paraboloid_shift + offset) / scale
    return np.where(steep, np.sqrt(np.maximum(square, 0.0)), np.inf)


FLAT = 1e-12
"""Slope of a simplex's plane against upright, below which rounding decides where its circle lies."""


def _normals(corners: Array) -> Array:
    """(F, D) unit vectors across facets (F, D, D)."""
    edge = corners[:, 1] - corners[:, 0]
    across = (
        np.stack((edge[:, 1], -edge[:, 0]), -1)
        if corners.shape[2] == 2
        else np.cross(edge, corners[:, 2] - corners[:, 0])
    )
    return across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-300)
