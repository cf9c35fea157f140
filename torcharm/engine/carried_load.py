"""Loads carried along one arm: wrenches about the world's origin, and how they change as the arm moves.

A force F at p and a moment M are the wrench `(F, M + p×F)` about the origin. As p moves and the body turns by ω, a
dead load's changes by `(0, dp×F)`, a following one's by `(ω×F, ω×M + dp×F + p×(ω×F))`. Where a load sits decides which
elements carry it, and how: see `statics.external_load`, whose rule this is.
"""

from typing import NamedTuple

from jaxtyping import Bool, Float64

from torcharm.engine.arrays import Array
from torcharm.engine.compilation import part
from torcharm.engine.elements import write_centroid, write_motion
from torcharm.engine.references import by_reference


@by_reference
class Share(NamedTuple):
    """What loads add to a wrench W: `dW = by_start η + by_own dz` where an element's start moves by η, its twist dz."""

    wrench: Float64[Array, "K"]  # about the world's origin [N, N·m]
    by_start: Float64[Array, "K K"]
    by_own: Float64[Array, "K C"]


@by_reference
class Spot(NamedTuple):
    """Scratch of where a load sits."""

    pose: Float64[Array, "2 P"]  # of the load, and of the middle of what its element carries of it
    move: Float64[Array, "2 K C"]  # motions of these by the element's unknowns
    place: Float64[Array, "D"]  # where it is taken to act [m]
    slide: Float64[Array, "D C"]  # motion of that place by the element's unknowns
    turn: Float64[Array, "K-D C"]  # how the body turns there
    load: Float64[Array, "2 3"]  # force and moment along the world's axes
    change: Float64[Array, "K"]  # of a wrench
    follows: Bool[Array, "1"]  # whether it turns with the body


@part
def clear_share(share):  # type: ignore[no-untyped-def]
    """Nothing is added."""
    for r in range(len(share.wrench)):
        share.wrench[r] = 0.0
        for c in range(share.by_start.shape[1]):
            share.by_start[r, c] = 0.0
        for c in range(share.by_own.shape[1]):
            share.by_own[r, c] = 0.0


@part
def _write_change(arms, spot, x, y, z, turn_x, turn_y, turn_z):  # type: ignore[no-untyped-def]
    """Write the change of a load's wrench where its place moves by (x, y, z) and its body turns."""
    load, place, change = spot.load, spot.place, spot.change
    if arms.size == 3:
        change[0] = change[1] = 0.0
        change[2] = x * load[0, 1] - y * load[0, 0]
        if spot.follows[0]:
            change[0], change[1] = -turn_z * load[0, 1], turn_z * load[0, 0]
            change[2] += place[0] * change[1] - place[1] * change[0]
        return
    change[0] = change[1] = change[2] = 0.0
    change[3] = y * load[0, 2] - z * load[0, 1]
    change[4] = z * load[0, 0] - x * load[0, 2]
    change[5] = x * load[0, 1] - y * load[0, 0]
    if spot.follows[0]:
        change[0] = turn_y * load[0, 2] - turn_z * load[0, 1]
        change[1] = turn_z * load[0, 0] - turn_x * load[0, 2]
        change[2] = turn_x * load[0, 1] - turn_y * load[0, 0]
        change[3] += turn_y * load[1, 2] - turn_z * load[1, 1] + place[1] * change[2] - place[2] * change[1]
        change[4] += turn_z * load[1, 0] - turn_x * load[1, 2] + place[2] * change[0] - place[0] * change[2]
        change[5] += turn_x * load[1, 1] - turn_y * load[1, 0] + place[0] * change[1] - place[1] * change[0]


@part
def _add(arms, spot, share, scale, portion):  # type: ignore[no-untyped-def]
    """Add a portion of a load: its wrench as it is, and its changes times a scale."""
    load, place, size = spot.load, spot.place, arms.size
    factor = scale * portion
    if size == 3:
        share.wrench[0] += portion * load[0, 0]
        share.wrench[1] += portion * load[0, 1]
        share.wrench[2] += portion * (load[1, 2] + place[0] * load[0, 1] - place[1] * load[0, 0])
        for c in range(3):
            x, y = (-place[1], place[0]) if c == 2 else (1.0 if c == 0 else 0.0, 1.0 if c == 1 else 0.0)
            _write_change(arms, spot, x, y, 0.0, 0.0, 0.0, 1.0 if c == 2 else 0.0)
            for r in range(3):
                share.by_start[r, c] += factor * spot.change[r]
    else:
        for k in range(3):
            share.wrench[k] += portion * load[0, k]
        share.wrench[3] += portion * (load[1, 0] + place[1] * load[0, 2] - place[2] * load[0, 1])
        share.wrench[4] += portion * (load[1, 1] + place[2] * load[0, 0] - place[0] * load[0, 2])
        share.wrench[5] += portion * (load[1, 2] + place[0] * load[0, 1] - place[1] * load[0, 0])
        for c in range(6):
            e_x, e_y, e_z = 1.0 if c % 3 == 0 else 0.0, 1.0 if c % 3 == 1 else 0.0, 1.0 if c % 3 == 2 else 0.0
            if c < 3:
                _write_change(arms, spot, e_x, e_y, e_z, 0.0, 0.0, 0.0)
            else:
                x, y = e_y * place[2] - e_z * place[1], e_z * place[0] - e_x * place[2]
                _write_change(arms, spot, x, y, e_x * place[1] - e_y * place[0], e_x, e_y, e_z)
            for r in range(6):
                share.by_start[r, c] += factor * spot.change[r]
    for c in range(len(arms.unknown)):
        if size == 3:
            _write_change(arms, spot, spot.slide[0, c], spot.slide[1, c], 0.0, 0.0, 0.0, spot.turn[0, c])
        else:
            t_x, t_y, t_z = spot.turn[0, c], spot.turn[1, c], spot.turn[2, c]
            s_x, s_y, s_z = spot.slide[0, c], spot.slide[1, c], spot.slide[2, c]
            _write_change(arms, spot, s_x, s_y, s_z, t_x, t_y, t_z)
        for r in range(size):
            share.by_own[r, c] += factor * spot.change[r]


@part
def _take_load(arms, loads, spot, b, q, pose, i):  # type: ignore[no-untyped-def]
    """Write force and moment of a load at a pose, and its place."""
    spot.follows[0] = loads.follows[q]
    wrench, offset = loads.wrench, loads.offset
    if arms.size == 3:
        f_x, f_y = wrench[b, q, 0], wrench[b, q, 1]
        if loads.follows[q]:
            f_x, f_y = pose[i, 0] * f_x - pose[i, 1] * f_y, pose[i, 1] * f_x + pose[i, 0] * f_y
        spot.load[0, 0], spot.load[0, 1], spot.load[1, 2] = f_x, f_y, wrench[b, q, 2]
        spot.place[0] = pose[i, 2] + pose[i, 0] * offset[b, q, 0] - pose[i, 1] * offset[b, q, 1]
        spot.place[1] = pose[i, 3] + pose[i, 1] * offset[b, q, 0] + pose[i, 0] * offset[b, q, 1]
        return
    for k in range(3):
        spot.place[k] = pose[i, 9 + k]
        for j in range(3):
            spot.place[k] += pose[i, 3 * k + j] * offset[b, q, j]
        if loads.follows[q]:
            force = moment = 0.0
            for j in range(3):
                force += pose[i, 3 * k + j] * wrench[b, q, j]
                moment += pose[i, 3 * k + j] * wrench[b, q, 3 + j]
            spot.load[0, k], spot.load[1, k] = force, moment
        else:
            spot.load[0, k], spot.load[1, k] = wrench[b, q, k], wrench[b, q, 3 + k]


@part
def _clear_motion(arms, spot):  # type: ignore[no-untyped-def]
    """The place moves, and its body turns, with the start of the element alone."""
    for c in range(len(arms.unknown)):
        for d in range(len(spot.place)):
            spot.slide[d, c] = 0.0
        for d in range(spot.turn.shape[0]):
            spot.turn[d, c] = 0.0


@part
def add_load_at_end(arms, loads, spot, share, b, q, pose, i, scale):  # type: ignore[no-untyped-def]
    """Add a load that moves with the end of an element, the pose of row i, to what lies beyond that end."""
    _take_load(arms, loads, spot, b, q, pose, i)
    _clear_motion(arms, spot)
    _add(arms, spot, share, scale, 1.0)


@part
def _slide_of(arms, slide, move, m, place, sign):  # type: ignore[no-untyped-def]
    """Add the motion of a place on a body, which moves as `move[m]`, to a slide (D, C)."""
    for c in range(len(arms.unknown)):
        if arms.size == 3:
            slide[0, c] += sign * (move[m, 0, c] - move[m, 2, c] * place[1])
            slide[1, c] += sign * (move[m, 1, c] + move[m, 2, c] * place[0])
        else:
            w_x, w_y, w_z = move[m, 3, c], move[m, 4, c], move[m, 5, c]
            slide[0, c] += sign * (move[m, 0, c] + w_y * place[2] - w_z * place[1])
            slide[1, c] += sign * (move[m, 1, c] + w_z * place[0] - w_x * place[2])
            slide[2, c] += sign * (move[m, 2, c] + w_x * place[1] - w_y * place[0])


@part
def add_load_inside(arms, loads, balance, b, q, i, twist, part_of_arc, scale):  # type: ignore[no-untyped-def]
    """Add a load inside of element i to what lies before the element, and to what its own section carries.

    At "middle" its section carries the share φ that lies before the load, from the middle of that share: as a wrench
    about the origin, φ of the load at the place `p - p_{φ/2} + p_frame`.
    """
    spot, fraction = balance.spot, loads.fraction[q]
    dimension = len(spot.place)
    first = spot.pose.shape[1] - dimension
    _clear_motion(arms, spot)
    for m in range(2 if loads.middle else 1):
        share = fraction * part_of_arc if m == 0 else 0.5 * fraction * part_of_arc
        write_motion(arms, balance.node, i, spot.pose, m, spot.move, m, twist, share)
        _slide_of(arms, spot.slide, spot.move, m, spot.pose[m, first:], 1.0 - 2.0 * m)
        if m == 0:
            _take_load(arms, loads, spot, b, q, spot.pose, m)
            for c in range(len(arms.unknown)):
                for d in range(spot.turn.shape[0]):
                    spot.turn[d, c] = spot.move[m, dimension + d, c]
            _add(arms, spot, balance.beyond, scale, 1.0)
    if not loads.middle:
        _add(arms, spot, balance.section, scale, 1.0)
        return
    _slide_of(arms, spot.slide, balance.half_move, i, balance.frame[i, first:], 1.0)
    for d in range(dimension):
        spot.place[d] += balance.frame[i, first + d] - spot.pose[1, first + d]
    _add(arms, spot, balance.section, scale, fraction)


@part
def add_own_weight(arms, loads, balance, b, segment, i, twist, part_of_arc, scale):  # type: ignore[no-untyped-def]
    """Add an element's weight at its centroid, of which its section carries all, or at "middle" the outer half."""
    spot = balance.spot
    for k in range(3):
        spot.load[0, k] = spot.load[1, k] = 0.0
    spot.load[0, 1], spot.follows[0] = -loads.weight[b, segment], False
    _clear_motion(arms, spot)
    write_centroid(arms, balance.node, i, spot.place, spot.slide, twist, part_of_arc)
    _add(arms, spot, balance.beyond, scale, 1.0)
    if not loads.middle:
        _add(arms, spot, balance.section, scale, 1.0)
        return
    write_centroid(arms, balance.frame, i, spot.place, spot.slide, twist, 0.5 * part_of_arc)
    _slide_of(arms, spot.slide, balance.half_move, i, spot.place, 1.0)
    _add(arms, spot, balance.section, scale, 0.5)
