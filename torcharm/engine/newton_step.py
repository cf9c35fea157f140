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
from torcharm.engine.copies import copy_row
from torcharm.engine.elements import write_lever, write_link, write_motion
from torcharm.engine.sections import write_rates, write_section
from torcharm.engine.stack import small_matrix, small_vector

SINGULAR = 64 * np.finfo(np.float64).eps
"""Of the largest number in its row: a pivot so small is rounding, and stands for a direction without stiffness, in
which steps are 0."""
# Numbers of a twist, those that are unknown without shear or torsion, and the first row of moments, before which S is
# zero under dead loads: loops over so few are written out, which is several times as fast.
PLANE_SIZE, PLANE_COLUMNS, PLANE_ROW = 3, 2, 2
SPACE_SIZE, SPACE_COLUMNS, SPACE_ROW = 6, 3, 3


@part
def write_shape(arms, loads, balance, b, twist, slopes):  # type: ignore[no-untyped-def]
    """Write poses and motions, and the sections' reactions at their pressures, for twists (N, K).

    Args:
        slopes: whether the slopes by pressure are wanted.
    """
    copy_row(balance.node[0], loads.base[b])
    balance.sections.stiffness[0] = balance.sections.stiffness[1] = 0.0
    for segment in range(len(arms.first_node) - 1):
        first, last = arms.first_node[segment], arms.first_node[segment + 1]
        share = 1.0 / (last - first)
        for i in range(first, last):
            write_motion(arms, balance.node, i, balance.node, i + 1, balance.move, i, twist, share)
            if loads.middle:
                write_motion(arms, balance.node, i, balance.frame, i, balance.half_move, i, twist, 0.5 * share)
                write_lever(arms, balance.frame, i, balance.lever, i)
            else:
                write_lever(arms, balance.node, i, balance.lever, i)
            write_section(arms, balance.drive, balance.sections, b, segment, i, twist)
            if slopes:
                write_rates(arms, balance.drive, balance.sections, b, segment, i, twist)
        copy_row(balance.end[segment], balance.node[last])
        write_link(arms, balance.node, last, b, segment)


@part
def first_loaded_row(arms, loads):  # type: ignore[no-untyped-def]
    """The first row of S that may not be zero: that of the moments, unless a load follows the body."""
    for q in range(len(loads.follows)):
        if loads.follows[q]:
            return 0
    return 2 if arms.size == 3 else 3


@part
def write_balance(arms, loads, balance, b, twist, factor, linear_shift, angular_shift):  # type: ignore[no-untyped-def]
    """Write the residual, and factor its slope J less a shift on its diagonal, where `write_shape` was before.

    Args:
        twist: (N, K), with which the shape was written.
        factor: λ on all loads.
        linear_shift, angular_shift: on the diagonal of J in linear and in angular components, 0 for J itself.
    """
    shifts, first_row, columns = (linear_shift, angular_shift), first_loaded_row(arms, loads), len(arms.unknown)
    if first_row == PLANE_ROW and columns == PLANE_COLUMNS:
        _sweep(arms, loads, balance, b, twist, factor, shifts, PLANE_SIZE, PLANE_COLUMNS, PLANE_ROW)
    elif first_row == SPACE_ROW and columns == SPACE_COLUMNS:
        _sweep(arms, loads, balance, b, twist, factor, shifts, SPACE_SIZE, SPACE_COLUMNS, SPACE_ROW)
    else:
        _sweep(arms, loads, balance, b, twist, factor, shifts, arms.size, columns, first_row)


@inlined_part
def _sweep(arms, loads, balance, b, twist, factor, shifts, size, columns, first_row):  # type: ignore[no-untyped-def]
    """As `write_balance`, of twists of so many numbers, of which so many are unknown; S is 0 before its first row."""
    beyond = balance.beyond
    wrench, spread = small_vector(), small_matrix()  # W at full load, and S
    balance.pivots[0] = balance.pivots[1] = 0
    for r in range(size):
        wrench[r] = 0.0
        for c in range(size):
            spread[r, c] = 0.0
    q = len(loads.element) - 1
    for segment in range(len(arms.first_node) - 2, -1, -1):
        first, last = arms.first_node[segment], arms.first_node[segment + 1]
        share, weighs = 1.0 / (last - first), loads.weight[b, segment] != 0.0
        for i in range(last - 1, first - 1, -1):
            while q >= 0 and loads.element[q] == i and loads.fraction[q] >= 1.0:
                clear_share(beyond)
                if loads.before_link[q] and i == last - 1:
                    add_load_at_end(arms, loads, balance.spot, beyond, b, q, balance.end, segment, factor)
                else:
                    add_load_at_end(arms, loads, balance.spot, beyond, b, q, balance.node, i + 1, factor)
                _take_share(beyond, wrench, spread, size)
                q -= 1
            inside = weighs or (q >= 0 and loads.element[q] == i)
            if inside:
                clear_share(beyond)
                clear_share(balance.section)
            if weighs:
                add_own_weight(arms, loads, balance, b, segment, i, twist, share, factor)
            while q >= 0 and loads.element[q] == i:
                add_load_inside(arms, loads, balance, b, q, i, twist, share, factor)
                q -= 1
            turned, matrix, pull = small_matrix(), small_matrix(), small_matrix()
            _write_residual(balance, i, wrench, turned, factor, inside, size, columns)
            _write_slopes(balance, i, spread, turned, matrix, pull, first_row, loads.middle, inside, size, columns)
            for c in range(columns):
                matrix[c, c] -= shifts[0] if arms.unknown[c] < first_angular(arms) else shifts[1]
            _factor(balance.pivots, matrix, columns)
            feed = small_matrix()
            _write_feed(balance, i, turned, matrix, feed, first_row, size, columns)
            _eliminate(spread, pull, feed, first_row, size, columns)
            for c in range(columns):
                for e in range(columns):
                    balance.factor[i, c, e] = matrix[c, e]
                for k in range(size):
                    balance.feed[i, c, k] = feed[c, k]
                for r in range(first_row, size):
                    balance.pull[i, r, c] = pull[r, c]
            if inside:
                _take_share(beyond, wrench, spread, size)


@part
def first_angular(arms):  # type: ignore[no-untyped-def]
    """The first column of a twist that turns."""
    return 2 if arms.size == 3 else 3


@part
def factor_section(arms, balance, i, linear_shift, angular_shift):  # type: ignore[no-untyped-def]
    """Factor the slope of one section's reaction, less a shift on its diagonal: all there is of J without load."""
    columns, matrix = len(arms.unknown), small_matrix()
    for c in range(columns):
        for e in range(columns):
            matrix[c, e] = balance.sections.slope[i, c, e]
        matrix[c, c] -= linear_shift if arms.unknown[c] < first_angular(arms) else angular_shift
    _factor(balance.pivots, matrix, columns)
    for c in range(columns):
        for e in range(columns):
            balance.factor[i, c, e] = matrix[c, e]


@inlined_part
def _take_share(share, wrench, spread, size):  # type: ignore[no-untyped-def]
    """Add what loads add to the wrench and to S."""
    for r in range(size):
        wrench[r] += share.wrench[r]
        for c in range(size):
            spread[r, c] += share.by_start[r, c]


@inlined_part
def _write_residual(balance, i, wrench, turned, factor, inside, size, columns):  # type: ignore[no-untyped-def]
    """Write what a section carries, its residual, and K of the wrench that it carries in `turned`."""
    total = small_vector()
    for r in range(size):
        total[r] = wrench[r]
        if inside:
            total[r] += balance.section.wrench[r]
    for c in range(columns):
        carried = 0.0
        for r in range(size):
            carried += balance.lever[i, r, c] * total[r]
        balance.carried[i, c] = carried
        balance.residual[i, c] = balance.sections.reaction[i, c] + factor * carried
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
def _write_slopes(balance, i, spread, turned, matrix, pull, first_row, middle, inside, size, columns):  # type: ignore[no-untyped-def]
    """Write L in `matrix`, in `pull` how the element's own unknowns change the wrench before it; S joins `turned`."""
    for r in range(first_row, size):
        for c in range(columns):
            total = 0.0
            for k in range(size):
                total += spread[r, k] * balance.move[i, k, c]
            pull[r, c] = total
    for e in range(columns):
        for c in range(columns):
            total = balance.sections.slope[i, e, c]
            for r in range(first_row, size):
                total += balance.lever[i, r, e] * pull[r, c]
            matrix[e, c] = total
    if middle:
        for r in range(size):
            for c in range(columns):
                total = 0.0
                for k in range(size):
                    total += turned[r, k] * balance.half_move[i, k, c]
                for e in range(columns):
                    matrix[e, c] += balance.lever[i, r, e] * total
    for r in range(first_row, size):
        for k in range(size):
            turned[r, k] += spread[r, k]
    if inside:
        for r in range(size):
            for k in range(size):
                turned[r, k] += balance.section.by_start[r, k]
            for c in range(columns):
                for e in range(columns):
                    matrix[e, c] += balance.lever[i, r, e] * balance.section.by_own[r, c]
                pull[r, c] += balance.beyond.by_own[r, c]


@inlined_part
def _factor(pivots, matrix, columns):  # type: ignore[no-untyped-def]
    """Factor L in place, without pivoting; the diagonal takes the inverse pivots, 0 for those that are zero."""
    for c in range(columns):
        largest = 0.0
        for k in range(columns):
            largest = max(largest, abs(matrix[c, k]))
        for k in range(c):  # the row by the pivots above it
            lower = matrix[c, k] * matrix[k, k]
            matrix[c, k] = lower
            for e in range(k + 1, columns):
                matrix[c, e] -= lower * matrix[k, e]
        pivot = matrix[c, c]
        if abs(pivot) <= SINGULAR * largest:
            pivots[1] += 1
            matrix[c, c] = 0.0
        else:
            pivots[0] += pivot > 0.0
            matrix[c, c] = 1.0 / pivot


@inlined_part
def _write_feed(balance, i, turned, matrix, feed, first_row, size, columns):  # type: ignore[no-untyped-def]
    """Write `L⁻¹ G` in `feed`."""
    for c in range(columns):
        for k in range(size):
            total = 0.0
            for r in range(size):
                total += balance.lever[i, r, c] * turned[r, k]
            for e in range(c):
                total -= matrix[c, e] * feed[e, k]
            feed[c, k] = total
    for c in range(columns - 1, -1, -1):
        for k in range(size):
            total = feed[c, k]
            for e in range(c + 1, columns):
                total -= matrix[c, e] * feed[e, k]
            feed[c, k] = total * matrix[c, c]


@inlined_part
def _eliminate(spread, pull, feed, first_row, size, columns):  # type: ignore[no-untyped-def]
    """Take the element's own unknowns out of S."""
    for r in range(first_row, size):
        for k in range(size):
            total = spread[r, k]
            for c in range(columns):
                total -= pull[r, c] * feed[c, k]
            spread[r, k] = total


@part
def solve(arms, loads, balance, change):  # type: ignore[no-untyped-def]
    """Replace a right-hand side (N, C) by `J⁻¹` times it; J as factored by `write_balance`."""
    first_row, columns = first_loaded_row(arms, loads), len(arms.unknown)
    if first_row == PLANE_ROW and columns == PLANE_COLUMNS:
        _solve_sweep(balance, change, PLANE_SIZE, PLANE_COLUMNS, PLANE_ROW)
    elif first_row == SPACE_ROW and columns == SPACE_COLUMNS:
        _solve_sweep(balance, change, SPACE_SIZE, SPACE_COLUMNS, SPACE_ROW)
    else:
        _solve_sweep(balance, change, arms.size, columns, first_row)


@inlined_part
def _solve_sweep(balance, change, size, columns, first_row):  # type: ignore[no-untyped-def]
    """As `solve`; sizes as of `_sweep`."""
    nodes, own, total = change.shape[0], small_vector(), small_vector()
    for r in range(size):
        total[r] = 0.0
    for i in range(nodes - 1, -1, -1):
        for c in range(columns):
            right = change[i, c]
            for r in range(first_row, size):
                right -= balance.lever[i, r, c] * total[r]
            for e in range(c):
                right -= balance.factor[i, c, e] * own[e]
            own[c] = right
        for c in range(columns - 1, -1, -1):
            right = own[c]
            for e in range(c + 1, columns):
                right -= balance.factor[i, c, e] * own[e]
            own[c] = right * balance.factor[i, c, c]
            change[i, c] = own[c]
            for r in range(first_row, size):
                total[r] += balance.pull[i, r, c] * own[c]
    for r in range(size):
        total[r] = 0.0
    for i in range(nodes):
        for c in range(columns):
            right = change[i, c]
            for k in range(size):
                right -= balance.feed[i, c, k] * total[k]
            own[c] = change[i, c] = right
        for k in range(size):
            moved = total[k]
            for c in range(columns):
                moved += balance.move[i, k, c] * own[c]
            total[k] = moved
