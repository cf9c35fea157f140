"""Newton's step for the balance of one arm: the residual, and solutions with its slope J, in O(N).

The balance of element i is `R_i = a_i(z_i, p) + λ q_i`, the reaction of its section and what it carries of the loads,
at the load factor λ, in the unknown components z. With motions as spatial twists η (see `engine.elements`),

    η_{i+1} = η_i + B_i dz_i,    dR_i = A_i dz_i + C_iᵀ (dW_i + K(W_i) (η_i + B'_i dz_i)),

where W_i is the wrench beyond, C_i takes it to the frame in which it is taken, and B'_i moves that frame (0 at
"start"). If what lies beyond node i + 1 is in balance, `dW = S η_{i+1} + s`; elimination from the tip keeps that form:

    L = A + Cᵀ (S B + K B'),  G = Cᵀ (S + K),  S ← S - S B L⁻¹ G,

and what loads inside of the element add. L is factored without pivoting between components, so its pivots are those of
J: the number of positive ones is that of unstable directions where J is symmetric. Rows of S that belong to forces
are zero where no load follows the body.
"""

import numpy as np

from torcharm.engine.carried_load import add_load_at_end, add_load_inside, add_own_weight, clear_share
from torcharm.engine.compilation import inlined_part, part
from torcharm.engine.elements import write_lever, write_link, write_motion
from torcharm.engine.sections import write_rates, write_section

SINGULAR = 64 * np.finfo(np.float64).eps
"""Of the largest number in its row: a pivot so small is rounding, and stands for a direction without stiffness, in
which steps are 0."""
PLANE_SIZE, PLANE_COLUMNS = 3, 2
"""Numbers of a twist in the plane, and those that are unknown without shear: loops over so few are written out."""


@part
def write_shape(arms, loads, room, b, twist, slopes):  # type: ignore[no-untyped-def]
    """Write poses and motions, and the sections' reactions at their pressures, for twists (N, K).

    Args:
        slopes: whether the slopes by pressure are wanted.
    """
    for k in range(loads.base.shape[1]):
        room.node[0, k] = loads.base[b, k]
    room.sections.stiffness[0] = room.sections.stiffness[1] = 0.0
    for segment in range(len(arms.first_node) - 1):
        first, last = arms.first_node[segment], arms.first_node[segment + 1]
        share = 1.0 / (last - first)
        for i in range(first, last):
            write_motion(arms, room.node, i, room.node, i + 1, room.move, i, twist, share)
            if loads.middle:
                write_motion(arms, room.node, i, room.frame, i, room.half_move, i, twist, 0.5 * share)
                write_lever(arms, room.frame, i, room.lever, i)
            else:
                write_lever(arms, room.node, i, room.lever, i)
            write_section(arms, room.drive, room.sections, b, segment, i, twist)
            if slopes:
                write_rates(arms, room.drive, room.sections, b, segment, i, twist)
        for k in range(room.end.shape[1]):
            room.end[segment, k] = room.node[last, k]
        write_link(arms, room.node, last, b, segment)


@part
def first_loaded_row(arms, loads):  # type: ignore[no-untyped-def]
    """The first row of S that may not be zero: that of the moments, unless a load follows the body."""
    for q in range(len(loads.follows)):
        if loads.follows[q]:
            return 0
    return 2 if arms.size == 3 else 3


@part
def write_balance(arms, loads, room, b, twist, factor, linear_shift, angular_shift):  # type: ignore[no-untyped-def]
    """Write the residual, and factor its slope J less a shift on its diagonal, where `write_shape` was before.

    Args:
        twist: (N, K), with which the shape was written.
        factor: λ on all loads.
        linear_shift, angular_shift: on the diagonal of J in linear and in angular components, 0 for J itself.
    """
    if arms.size == PLANE_SIZE and len(arms.unknown) == PLANE_COLUMNS:
        _sweep(arms, loads, room, b, twist, factor, linear_shift, angular_shift, PLANE_SIZE, PLANE_COLUMNS)
    else:
        _sweep(arms, loads, room, b, twist, factor, linear_shift, angular_shift, arms.size, len(arms.unknown))


@inlined_part
def _sweep(arms, loads, room, b, twist, factor, linear_shift, angular_shift, size, columns):  # type: ignore[no-untyped-def]
    """As `write_balance`, of twists of so many numbers, of which so many are unknown."""
    first_row = first_loaded_row(arms, loads)
    room.pivots[0] = room.pivots[1] = 0
    for r in range(size):
        room.wrench[r] = 0.0
        for c in range(size):
            room.spread[r, c] = 0.0
    q = len(loads.element) - 1
    for segment in range(len(arms.first_node) - 2, -1, -1):
        first, last = arms.first_node[segment], arms.first_node[segment + 1]
        share, weighs = 1.0 / (last - first), loads.weight[b, segment] != 0.0
        for i in range(last - 1, first - 1, -1):
            while q >= 0 and loads.element[q] == i and loads.fraction[q] >= 1.0:
                clear_share(room.beyond)
                if loads.before_link[q] and i == last - 1:
                    add_load_at_end(arms, loads, room.spot, room.beyond, b, q, room.end, segment, factor)
                else:
                    add_load_at_end(arms, loads, room.spot, room.beyond, b, q, room.node, i + 1, factor)
                _take_share(room)
                q -= 1
            inside = weighs or (q >= 0 and loads.element[q] == i)
            if inside:
                clear_share(room.beyond)
                clear_share(room.section)
            if weighs:
                add_own_weight(arms, loads, room, b, segment, i, twist, share, factor)
            while q >= 0 and loads.element[q] == i:
                add_load_inside(arms, loads, room, b, q, i, twist, share, factor)
                q -= 1
            _write_residual(room, i, factor, inside, size, columns)
            _write_slopes(room, i, first_row, loads.middle, inside, size, columns)
            _shift(arms, room, i, linear_shift, angular_shift)
            _factor(room, i, columns)
            _eliminate(room, i, first_row, size, columns)
            if inside:
                _take_share(room)


@part
def first_angular(arms):  # type: ignore[no-untyped-def]
    """The first column of a twist that turns."""
    return 2 if arms.size == 3 else 3


@part
def _shift(arms, room, i, linear_shift, angular_shift):  # type: ignore[no-untyped-def]
    for c in range(len(arms.unknown)):
        room.factor[i, c, c] -= linear_shift if arms.unknown[c] < first_angular(arms) else angular_shift


@part
def factor_section(arms, room, i, linear_shift, angular_shift):  # type: ignore[no-untyped-def]
    """Factor the slope of one section's reaction, less a shift on its diagonal: all there is of J without load."""
    for c in range(len(arms.unknown)):
        for e in range(len(arms.unknown)):
            room.factor[i, c, e] = room.sections.slope[i, c, e]
    _shift(arms, room, i, linear_shift, angular_shift)
    _factor(room, i, len(arms.unknown))


@part
def _take_share(room):  # type: ignore[no-untyped-def]
    """Add what loads add to the wrench and to S."""
    for r in range(len(room.wrench)):
        room.wrench[r] += room.beyond.wrench[r]
        for c in range(len(room.wrench)):
            room.spread[r, c] += room.beyond.by_start[r, c]


@inlined_part
def _write_residual(room, i, factor, inside, size, columns):  # type: ignore[no-untyped-def]
    """Write what a section carries, its residual, and K of the wrench that it carries."""
    turned, total = room.turned, room.sum
    for r in range(size):
        total[r] = room.wrench[r]
        if inside:
            total[r] += room.section.wrench[r]
    for c in range(columns):
        carried = 0.0
        for r in range(size):
            carried += room.lever[i, r, c] * total[r]
        room.carried[i, c] = carried
        room.residual[i, c] = room.sections.reaction[i, c] + factor * carried
    if size == 3:
        turned[0, 0] = turned[0, 1] = turned[1, 0] = turned[1, 1] = turned[2, 2] = 0.0
        turned[0, 2], turned[1, 2] = factor * total[1], -factor * total[0]
        turned[2, 0], turned[2, 1] = -factor * total[1], factor * total[0]
        return
    for r in range(3):
        for c in range(3):
            turned[r, c] = 0.0
        turned[r, 3 + r] = turned[3 + r, r] = turned[3 + r, 3 + r] = 0.0
    for k in range(2):  # the cross products by force, twice, and by moment
        row, x, y, z = 3 * k, factor * total[3 * k], factor * total[3 * k + 1], factor * total[3 * k + 2]
        turned[row, 4], turned[row, 5] = -z, y
        turned[row + 1, 3], turned[row + 1, 5] = z, -x
        turned[row + 2, 3], turned[row + 2, 4] = -y, x
    x, y, z = factor * total[0], factor * total[1], factor * total[2]
    turned[3, 1], turned[3, 2] = -z, y
    turned[4, 0], turned[4, 2] = z, -x
    turned[5, 0], turned[5, 1] = -y, x


@inlined_part
def _write_slopes(room, i, first_row, middle, inside, size, columns):  # type: ignore[no-untyped-def]
    """Write L in `factor`, G in `feed`, and in `pull` how the element's own unknowns change the wrench before it."""
    turned = room.turned
    for r in range(first_row, size):
        for c in range(columns):
            total = 0.0
            for k in range(size):
                total += room.spread[r, k] * room.move[i, k, c]
            room.pull[i, r, c] = total
    for e in range(columns):
        for c in range(columns):
            total = room.sections.slope[i, e, c]
            for r in range(first_row, size):
                total += room.lever[i, r, e] * room.pull[i, r, c]
            room.factor[i, e, c] = total
    if middle:
        for r in range(size):
            for c in range(columns):
                total = 0.0
                for k in range(size):
                    total += turned[r, k] * room.half_move[i, k, c]
                for e in range(columns):
                    room.factor[i, e, c] += room.lever[i, r, e] * total
    for r in range(first_row, size):
        for k in range(size):
            turned[r, k] += room.spread[r, k]
    if inside:
        for r in range(size):
            for k in range(size):
                turned[r, k] += room.section.by_start[r, k]
            for c in range(columns):
                for e in range(columns):
                    room.factor[i, e, c] += room.lever[i, r, e] * room.section.by_own[r, c]
                room.pull[i, r, c] += room.beyond.by_own[r, c]
    for e in range(columns):
        for k in range(size):
            total = 0.0
            for r in range(size):
                total += room.lever[i, r, e] * turned[r, k]
            room.feed[i, e, k] = total


@inlined_part
def _factor(room, i, columns):  # type: ignore[no-untyped-def]
    """Factor L in place, without pivoting; the diagonal takes the inverse pivots, 0 for those that are zero."""
    matrix = room.factor
    for c in range(columns):
        largest = 0.0
        for k in range(columns):
            largest = max(largest, abs(matrix[i, c, k]))
        for k in range(c):  # the row by the pivots above it
            lower = matrix[i, c, k] * matrix[i, k, k]
            matrix[i, c, k] = lower
            for e in range(k + 1, columns):
                matrix[i, c, e] -= lower * matrix[i, k, e]
        pivot = matrix[i, c, c]
        if abs(pivot) <= SINGULAR * largest:
            room.pivots[1] += 1
            matrix[i, c, c] = 0.0
        else:
            room.pivots[0] += pivot > 0.0
            matrix[i, c, c] = 1.0 / pivot


@inlined_part
def _eliminate(room, i, first_row, size, columns):  # type: ignore[no-untyped-def]
    """Make `feed` of G the product L⁻¹ G, and take the element's own unknowns out of S."""
    matrix, feed = room.factor, room.feed
    for c in range(columns):
        for e in range(c):
            for k in range(size):
                feed[i, c, k] -= matrix[i, c, e] * feed[i, e, k]
    for c in range(columns - 1, -1, -1):
        for k in range(size):
            total = feed[i, c, k]
            for e in range(c + 1, columns):
                total -= matrix[i, c, e] * feed[i, e, k]
            feed[i, c, k] = total * matrix[i, c, c]
    for r in range(first_row, size):
        for k in range(size):
            total = room.spread[r, k]
            for c in range(columns):
                total -= room.pull[i, r, c] * feed[i, c, k]
            room.spread[r, k] = total


@part
def solve(arms, loads, room, change):  # type: ignore[no-untyped-def]
    """Replace a right-hand side (N, C) by `J⁻¹` times it; J as factored by `write_balance`."""
    if arms.size == PLANE_SIZE and len(arms.unknown) == PLANE_COLUMNS:
        _solve_sweep(arms, loads, room, change, PLANE_SIZE, PLANE_COLUMNS)
    else:
        _solve_sweep(arms, loads, room, change, arms.size, len(arms.unknown))


@inlined_part
def _solve_sweep(arms, loads, room, change, size, columns):  # type: ignore[no-untyped-def]
    """As `solve`, of twists of so many numbers, of which so many are unknown."""
    nodes = change.shape[0]
    first_row, matrix, total = first_loaded_row(arms, loads), room.factor, room.sum
    for r in range(size):
        total[r] = 0.0
    for i in range(nodes - 1, -1, -1):
        for c in range(columns):
            right = change[i, c]
            for r in range(first_row, size):
                right -= room.lever[i, r, c] * total[r]
            for e in range(c):
                right -= matrix[i, c, e] * change[i, e]
            change[i, c] = right
        for c in range(columns - 1, -1, -1):
            right = change[i, c]
            for e in range(c + 1, columns):
                right -= matrix[i, c, e] * change[i, e]
            right *= matrix[i, c, c]
            change[i, c] = right
            for r in range(first_row, size):
                total[r] += room.pull[i, r, c] * right
    for r in range(size):
        total[r] = 0.0
    for i in range(nodes):
        for c in range(columns):
            right = change[i, c]
            for k in range(size):
                right -= room.feed[i, c, k] * total[k]
            change[i, c] = right
        for k in range(size):
            moved = total[k]
            for c in range(columns):
                moved += room.move[i, k, c] * change[i, c]
            total[k] = moved
