"""How deep a wrench lies inside an attainable set, `min_{|n|=1} h(n) - n·w`, by expanding a polytope within the set.

Of a polytope of the set's points that holds w, the face nearest to w bounds the depth from below, and the set's support
along that face's normal bounds it from above. The point that attains the support becomes a corner, until the bounds
meet (van den Bergen 2001). Unlike the distance from outside this is no convex problem: all faces must be kept.
"""

import math
from functools import cache
from typing import Any, NamedTuple

from jaxtyping import Bool, Float64, Int64

from torcharm.engine.arrays import Array
from torcharm.engine.compilation import part
from torcharm.engine.copies import copy_row
from torcharm.engine.distance import TOUCHING, nearest_part
from torcharm.engine.references import by_reference
from torcharm.engine.sharpen import FAR

DEPTH_GAP = 1e-10
"""The gap, as a part of the problem's size, at which the depth is known."""
CORNERS = {2: 80, 3: 300}
"""Corners of the polytope at most: of smooth sets in space the depth is then known to 1e-6 or so, and flagged."""
BEYOND = 1e-14
"""By this part of the problem's size a point must lie beyond a face to be a new corner: less is rounding."""
NUDGE = 1e-10
"""By this part of the problem's size a point is moved that lies on a face of its simplex, where sides cannot be told:
more than the gap up to which a distance counts as known."""
NUDGES = {2: ((0.93, 0.37), (-0.37, 0.93)), 3: ((0.77, 0.53, 0.34), (-0.61, 0.77, 0.17), (-0.18, -0.34, 0.92))}
"""What it is moved along: independent, for one to leave the face; along no axis or diagonal, for arms are symmetric."""
NEVER = 1e300
"""The distance that is given to faces without area, which no depth is measured to."""


@by_reference
class Polytope(NamedTuple):
    """A polytope with V corners, and scratch to work in."""

    corner: Float64[Array, "V D"]  # seen from w
    pressure: Float64[Array, "V M"]
    face: Int64[Array, "2*V+8 D"]  # each face's corners
    normal: Float64[Array, "2*V+8 D"]  # outward, of length 1
    offset: Float64[Array, "2*V+8"]  # of faces from w
    seen: Bool[Array, "2*V+8"]  # whether a face is to be removed
    used: Int64[Array, "2"]  # corners and faces in use


def sizes_of_set(actuators: int, dimension: int) -> dict[str, int]:
    """What the names in shapes of scratch for one set stand for."""
    return {"M": actuators, "D": dimension, "V": CORNERS[dimension]}


@cache
def depth_parts(D: int, ask: Any) -> tuple[Any, Any]:
    """`depth` and `weigh` for sets in D components whose support is asked for by `ask`."""

    @part
    def add_corner(polytope, point, pressure):  # type: ignore[no-untyped-def]
        at = polytope.used[0]
        copy_row(polytope.corner[at], point)
        copy_row(polytope.pressure[at], pressure)
        polytope.used[0] = at + 1

    @part
    def orient(polytope, f):  # type: ignore[no-untyped-def]
        """Write a face's outward normal and its distance from w, which is inside."""
        corner, face, n = polytope.corner, polytope.face, polytope.normal
        i, j = face[f, 0], face[f, 1]
        if D == 2:
            n[f, 0], n[f, 1] = corner[j, 1] - corner[i, 1], corner[i, 0] - corner[j, 0]
        else:
            k = face[f, 2]
            ax, ay, az = corner[j, 0] - corner[i, 0], corner[j, 1] - corner[i, 1], corner[j, 2] - corner[i, 2]
            bx, by, bz = corner[k, 0] - corner[i, 0], corner[k, 1] - corner[i, 1], corner[k, 2] - corner[i, 2]
            n[f, 0], n[f, 1], n[f, 2] = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        length, offset = 0.0, 0.0
        for c in range(D):
            length += n[f, c] * n[f, c]
            offset += n[f, c] * corner[i, c]
        length = math.sqrt(length)
        if not length > 0.0:
            polytope.offset[f] = NEVER
            return
        sign = -1.0 / length if offset < 0.0 else 1.0 / length
        for c in range(D):
            n[f, c] *= sign
        polytope.offset[f] = offset * sign

    @part
    def shared(polytope, f, skip):  # type: ignore[no-untyped-def]
        """Whether the ridge of a removed face, all its corners but one, belongs to another removed face."""
        for g in range(polytope.used[1]):
            if g != f and polytope.seen[g]:
                common = 0
                for i in range(D):
                    if i != skip:
                        for j in range(D):
                            common += polytope.face[g, j] == polytope.face[f, i]
                if common == D - 1:
                    return True
        return False

    @part
    def expand(polytope, new):  # type: ignore[no-untyped-def]
        """Replace the faces marked as seen by faces from their rim to the new corner; whether there was room."""
        last = polytope.used[1]
        for f in range(polytope.used[1]):
            if polytope.seen[f]:
                for skip in range(D):
                    if not shared(polytope, f, skip):
                        if last >= len(polytope.offset):
                            return False
                        for i in range(D):
                            polytope.face[last, i] = new if i == skip else polytope.face[f, i]
                        polytope.seen[last] = False
                        orient(polytope, last)
                        last += 1
        kept = 0
        for f in range(last):
            if not polytope.seen[f]:
                copy_row(polytope.face[kept], polytope.face[f])
                copy_row(polytope.normal[kept], polytope.normal[f])
                polytope.offset[kept] = polytope.offset[f]
                polytope.seen[kept] = False
                kept += 1
        polytope.used[1] = kept
        return True

    @part
    def nearest_face(polytope):  # type: ignore[no-untyped-def]
        nearest = 0
        for f in range(polytope.used[1]):
            if polytope.offset[f] < polytope.offset[nearest]:
                nearest = f
        return nearest

    @part
    def write_weights(polytope, f, weight):  # type: ignore[no-untyped-def]
        """Write weights that mix a face's corners to its plane's point nearest to w; returns the least of them."""
        corner, face, n = polytope.corner, polytope.face, polytope.normal
        if D == 2:
            i, j = face[f, 0], face[f, 1]
            along, square = 0.0, 0.0
            for c in range(D):
                e = corner[j, c] - corner[i, c]
                along -= corner[i, c] * e
                square += e * e
            weight[1] = along / square
            weight[0] = 1.0 - weight[1]
            return min(weight[0], weight[1])
        total, least = 0.0, NEVER
        for s in range(3):
            i, j = face[f, (s + 1) % 3], face[f, (s + 2) % 3]
            x = corner[i, 1] * corner[j, 2] - corner[i, 2] * corner[j, 1]
            y = corner[i, 2] * corner[j, 0] - corner[i, 0] * corner[j, 2]
            z = corner[i, 0] * corner[j, 1] - corner[i, 1] * corner[j, 0]
            weight[s] = x * n[f, 0] + y * n[f, 1] + z * n[f, 2]
            total += weight[s]
        for s in range(3):
            weight[s] /= total
            least = min(least, weight[s])
        return least

    @part
    def weigh(polytope, simplex, size):  # type: ignore[no-untyped-def]
        """Make the nearest face the simplex: its normal, and its corners with weights that mix to its nearest point.

        Of faces in one plane it is the one that holds that point.
        """
        nearest = nearest_face(polytope)
        best, most = nearest, -NEVER
        for f in range(polytope.used[1]):
            if polytope.offset[f] <= polytope.offset[nearest] + BEYOND * size:
                least = write_weights(polytope, f, simplex.weight)
                if least > most:
                    best, most = f, least
        write_weights(polytope, best, simplex.weight)
        total = 0.0
        for s in range(D):
            simplex.weight[s] = max(simplex.weight[s], 0.0)
            total += simplex.weight[s]
        for s in range(D):
            simplex.weight[s] /= total
            simplex.normal[s] = polytope.normal[best, s]
            copy_row(simplex.pressure[s], polytope.pressure[polytope.face[best, s]])

    @part
    def depth(curves, simplex, polytope, size):  # type: ignore[no-untyped-def]
        """The depth of the simplex's target, known to be strictly inside, and the gap that is left."""
        polytope.used[0] = polytope.used[1] = 0
        for i in range(D):
            add_corner(polytope, simplex.corner[i], simplex.pressure[i])
        add_corner(polytope, simplex.point, simplex.fresh)
        for f in range(D + 1):
            for i in range(D):
                polytope.face[f, i] = i if i < f else i + 1
            polytope.seen[f] = False
            orient(polytope, f)
        polytope.used[1] = D + 1
        best, low = NEVER, 0.0
        while True:
            nearest = nearest_face(polytope)
            low = polytope.offset[nearest]
            if best - low <= DEPTH_GAP * size or polytope.used[0] == len(polytope.corner):
                break
            for c in range(D):
                simplex.normal[c] = polytope.normal[nearest, c]
            ask(curves, simplex)
            reach = 0.0
            for c in range(D):
                reach += simplex.normal[c] * simplex.point[c]
            best = min(best, reach)
            if reach - low <= BEYOND * size:
                break
            for f in range(polytope.used[1]):
                beyond = -polytope.offset[f]
                for c in range(D):
                    beyond += polytope.normal[f, c] * simplex.point[c]
                polytope.seen[f] = f == nearest or beyond > BEYOND * size
            add_corner(polytope, simplex.point, simplex.fresh)
            if not expand(polytope, polytope.used[0] - 1):
                break
        weigh(polytope, simplex, size)
        return low, max(best - low, 0.0)

    return depth, weigh


@cache
def signed_distance_part(D: int, ask: Any, sharpen: Any) -> Any:
    """`signed_distance` for sets in D components, of what `ask` and `sharpen` do with their kind of support."""
    nearest = nearest_part(D, ask)
    depth, weigh = depth_parts(D, ask)
    nudges = NUDGES[D]

    @part
    def move(simplex, along, length):  # type: ignore[no-untyped-def]
        for c in range(D):
            simplex.target[c] += nudges[along][c] * length

    @part
    def minus_depth(support, simplex, polytope, size, low, gap):  # type: ignore[no-untyped-def]
        """Minus the depth of the target, by a sharper normal than the face's, and the gap that is left.

        From within, Newton's method may go on to where a plane is furthest, not nearest: then the face stays.
        """
        sharpen(support, simplex, FAR * FAR)
        ask(support, simplex)
        reach = 0.0
        for c in range(D):
            reach += simplex.normal[c] * simplex.point[c]
        if reach > low + gap:
            weigh(polytope, simplex, size)
            reach = low
        return -reach if reach > TOUCHING * size else 0.0, gap

    @part
    def signed_distance(support, simplex, polytope, size):  # type: ignore[no-untyped-def]
        """The distance of the simplex's target from the set, minus its depth if inside, and the gap that is left.

        A target on a chord of the set, as symmetric arms have them, may be inside or on the boundary. Its neighbours
        tell.
        """
        distance, gap, inside = nearest(support, simplex, size)
        if inside:
            low, gap = depth(support, simplex, polytope, size)
            return minus_depth(support, simplex, polytope, size, low, gap)
        if distance != 0.0 or not size > 0.0:  # what is no number is no zero
            return distance, gap
        for along in range(D):
            move(simplex, along, NUDGE * size)
            for c in range(D):
                simplex.normal[c] = nudges[along][c]
            _, _, inside = nearest(support, simplex, size)
            low = gap = 0.0
            if inside:
                low, gap = depth(support, simplex, polytope, size)
            move(simplex, along, -NUDGE * size)
            if low > 4.0 * NUDGE * size:
                return minus_depth(support, simplex, polytope, size, low, gap + NUDGE * size)
        return 0.0, 0.0

    return signed_distance
