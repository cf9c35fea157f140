"""The simplex of a set's points that is nearest to a wrench, in D components: faces, corners and their weights."""

import math
from functools import cache
from typing import Any, NamedTuple

from jaxtyping import Float64

from torcharm.engine.arrays import Array
from torcharm.engine.compilation import part
from torcharm.engine.references import by_reference


@by_reference
class Simplex(NamedTuple):
    """A point, the simplex of the set's points nearest to it, and scratch to work in."""

    target: Float64[Array, "D"]  # the point w
    normal: Float64[Array, "D"]  # a direction to begin with; then the unit normal from the set to the point
    weight: Float64[Array, "D"]  # of the points whose mix is nearest; 0 where one is not needed
    pressure: Float64[Array, "D M"]  # of these points
    corner: Float64[Array, "D D"]  # these points, seen from w
    point: Float64[Array, "D"]  # the set's point that was last asked for, seen from w
    fresh: Float64[Array, "M"]  # its pressures
    nearest: Float64[Array, "D"]
    face: Float64[Array, "D"]
    trial: Float64[Array, "D"]
    back: Float64[Array, "D"]
    turn: Float64[Array, "D D"]  # how the set's point moves as the normal turns
    system: Float64[Array, "2*D-1 2*D"]  # equations that sharpen the answer


@part
def determinant(a, b, c):  # type: ignore[no-untyped-def]
    """Of three vectors of space."""
    x, y, z = b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]
    return a[0] * x + a[1] * y + a[2] * z


class SimplexParts(NamedTuple):
    """What is done with a simplex in D components."""

    ahead_of: Any
    surrounded: Any
    nearest_face: Any
    take: Any
    begin: Any
    write_back: Any


@cache
def simplex_parts(D: int) -> SimplexParts:
    """For 2 components (plane) or 3 (space): loops of known length are unrolled."""

    @part
    def ahead_of(simplex):  # type: ignore[no-untyped-def]
        """How far w lies beyond the supporting plane that was last asked for: a lower bound of its distance."""
        ahead = 0.0
        for c in range(D):
            ahead -= simplex.normal[c] * simplex.point[c]
        return ahead

    @part
    def surrounded(simplex):  # type: ignore[no-untyped-def]
        """Whether w is strictly inside the simplex of the D corners and the new point."""
        s, y = simplex.point, simplex.corner
        if D == 2:
            a = s[0] * y[0, 1] - s[1] * y[0, 0]
            b = y[0, 0] * y[1, 1] - y[0, 1] * y[1, 0]
            c = y[1, 0] * s[1] - y[1, 1] * s[0]
            return (a > 0 and b > 0 and c > 0) or (a < 0 and b < 0 and c < 0)
        a, b, c = determinant(s, y[0], y[1]), determinant(s, y[1], y[2]), determinant(s, y[2], y[0])
        d = determinant(y[0], y[2], y[1])
        return (a > 0 and b > 0 and c > 0 and d > 0) or (a < 0 and b < 0 and c < 0 and d < 0)

    @part
    def nearest_face(simplex):  # type: ignore[no-untyped-def]
        """Find the face nearest to w of those that hold the new point: its nearest point, and the corners' weights.

        Faces are measured by orthogonal components, not by normal equations, which fail on thin sets. Returns the new
        point's weight and the squared distance.
        """
        s, y, face, x, trial = simplex.point, simplex.corner, simplex.face, simplex.nearest, simplex.trial
        best, own = 0.0, 1.0
        for c in range(D):
            x[c] = s[c]
            best += s[c] * s[c]
            face[c] = 0.0
        for i in range(D):
            along, length, square = 0.0, 0.0, 0.0
            for c in range(D):
                e = y[i, c] - s[c]
                along -= e * s[c]
                length += e * e
            if 0.0 < along < length:
                t = along / length
                for c in range(D):
                    trial[c] = s[c] + t * (y[i, c] - s[c])
                    square += trial[c] * trial[c]
                if square < best:
                    best, own = square, 1.0 - t
                    for c in range(D):
                        face[c] = 0.0
                        x[c] = trial[c]
                    face[i] = t
        if D == 3:
            for k in range(3):
                i, j = (k + 1) % 3, (k + 2) % 3
                ee, ef, ff, along = 0.0, 0.0, 0.0, 0.0
                for c in range(D):
                    ee += (y[i, c] - s[c]) ** 2
                    ef += (y[i, c] - s[c]) * (y[j, c] - s[c])
                shear = ef / ee if ee > 0.0 else 0.0
                for c in range(D):
                    f = y[j, c] - s[c] - shear * (y[i, c] - s[c])
                    ff += f * f
                    along -= f * s[c]
                if not (ee > 0.0 and 0.0 < along < ff):
                    continue
                v = along / ff
                u = 0.0
                for c in range(D):
                    u -= (s[c] + v * (y[j, c] - s[c])) * (y[i, c] - s[c]) / ee
                if u > 0.0 and u + v < 1.0:
                    square = 0.0
                    for c in range(D):
                        trial[c] = s[c] + u * (y[i, c] - s[c]) + v * (y[j, c] - s[c])
                        square += trial[c] * trial[c]
                    if square < best:
                        best, own = square, 1.0 - u - v
                        face[i], face[j], face[k] = u, v, 0.0
                        for c in range(D):
                            x[c] = trial[c]
        return own, best

    @part
    def take(simplex, own):  # type: ignore[no-untyped-def]
        """Let the new point take the place of the corner of least weight."""
        slot = 0
        for i in range(D):
            simplex.weight[i] = simplex.face[i]
            if simplex.weight[i] < simplex.weight[slot]:
                slot = i
        simplex.weight[slot] = own
        for c in range(D):
            simplex.corner[slot, c] = simplex.point[c]
        for a in range(len(simplex.fresh)):
            simplex.pressure[slot, a] = simplex.fresh[a]

    @part
    def begin(simplex):  # type: ignore[no-untyped-def]
        """Let all corners be the first point; returns its squared distance."""
        square = 0.0
        for i in range(D):
            simplex.weight[i] = 1.0 if i == 0 else 0.0
            simplex.nearest[i] = simplex.point[i]
            square += simplex.point[i] * simplex.point[i]
            for c in range(D):
                simplex.corner[i, c] = simplex.point[c]
            for a in range(len(simplex.fresh)):
                simplex.pressure[i, a] = simplex.fresh[a]
        return square

    @part
    def write_back(simplex, length):  # type: ignore[no-untyped-def]
        """Write the direction from the simplex to w: across its corners, if they are further apart than w is from them.

        A difference of wrenches has lost as many digits as it is small.
        """
        y, back = simplex.corner, simplex.back
        full = True
        for c in range(D):
            back[c] = -simplex.nearest[c] / length
            full = full and simplex.weight[c] > 0.0
        if not full:
            return
        if D == 2:
            a, b = y[0, 1] - y[1, 1], y[1, 0] - y[0, 0]
            across = math.sqrt(a * a + b * b)
            if across > length:
                back[0], back[1] = a / across, b / across
        else:
            e0, e1, e2 = y[1, 0] - y[0, 0], y[1, 1] - y[0, 1], y[1, 2] - y[0, 2]
            f0, f1, f2 = y[2, 0] - y[0, 0], y[2, 1] - y[0, 1], y[2, 2] - y[0, 2]
            a, b, c = e1 * f2 - e2 * f1, e2 * f0 - e0 * f2, e0 * f1 - e1 * f0
            across = math.sqrt(a * a + b * b + c * c)
            broad = math.sqrt(max(e0 * e0 + e1 * e1 + e2 * e2, f0 * f0 + f1 * f1 + f2 * f2))
            if across > length * broad:
                back[0], back[1], back[2] = a / across, b / across, c / across
        along = 0.0
        for c in range(D):
            along += back[c] * y[0, c]
        if along > 0.0:
            for c in range(D):
                back[c] = -back[c]

    return SimplexParts(ahead_of, surrounded, nearest_face, take, begin, write_back)
