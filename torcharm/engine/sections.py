"""The cross-sections of one arm: reactions of its actuators at an element, with their slopes.

An actuator at (y, z) has the length `l_α = l + z κ_y - y κ_z` and the lever `u = (1, z, -y)` of `(f_x, m_y, m_z)`:
`Σ u f_α + k κ/l_α`, with the bending stiffness k at its pressure. With torsion `m_x = κ_x (Σ f_α ρ²/l_α - C/l)`,
`ρ² = y² + z²`, by virtual work on true lengths for small κ_x ρ/l. See `statics.cross_section`.
"""

import math
from typing import NamedTuple

from jaxtyping import Float64

from torcharm.engine.arrays import Array
from torcharm.engine.compilation import inlined_part, part
from torcharm.engine.forces import _TRACE, MUSCLE, POLYNOMIAL, muscle
from torcharm.engine.references import by_reference
from torcharm.engine.tables import BENDING_CELLS, CURVIEST
from torcharm.statics.cross_section import STRAIGHT

SQUEEZED = 1e-6
"""Of its neutral length: where an actuator's length is held for material curvatures, as of `rod.material_curvature`."""


@by_reference
class Drive(NamedTuple):
    """M actuators at their pressures."""

    row: Float64[Array, "M I"]  # coefficients by powers of strain of polynomials' forces, and of what is added [N]
    row_slope: Float64[Array, "M I"]  # the same, differentiated by pressure [N/kPa]
    scale: Float64[Array, "M"]  # factors on the forces that are no polynomials
    stiffening: Float64[Array, "M"]  # and on bending moments
    pressure: Float64[Array, "M"]  # [kPa]
    log_pressure: Float64[Array, "M"]
    bending: Float64[Array, "M"]  # bending stiffness [N·m²]
    shrunk: Float64[Array, "M"]  # the inverse of neutral lengths [1/m]
    level: Float64[Array, "sampled E 4"]  # at the strains of sampled models' grids: f, ∂f/∂ε, and both by pressure


@by_reference
class Sections(NamedTuple):
    """Reactions at N elements."""

    reaction: Float64[Array, "N C"]  # [N, N·m]
    slope: Float64[Array, "N C C"]  # by the element's own unknowns
    rate: Float64[Array, "N C M"]  # by pressures; zero for the actuators of other segments
    stiffness: Float64[Array, "2"]  # largest sums over a section of |∂f/∂ε| [N], and of that times the offset [N·m]


@part
def set_pressure(arms, drive, pressures, b, factor):  # type: ignore[no-untyped-def]
    """Take the pressures of row b, times a factor."""
    table, built = arms.models.table, len(arms.force_scale) > 0
    for a in range(len(drive.pressure)):
        p = pressures[b, a] * factor
        drive.pressure[a] = p
        drive.shrunk[a] = 1.0 / arms.neutral[b, a]
        scale = arms.force_scale[b, a] if built else 1.0
        drive.scale[a] = arms.models.scale[a] * scale
        drive.stiffening[a] = arms.bending_scale[b, a] if built else 1.0
        drive.bending[a] = drive.stiffening[a] * (arms.active[a] * p + arms.passive[a])
        if built or arms.models.kind[a] == POLYNOMIAL:
            for i in range(table.shape[2]):
                total = slope = 0.0
                for j in range(table.shape[1] - 1, -1, -1):
                    slope = slope * p + total
                    total = total * p + (table[a, j, i] + arms.added[b, a, j, i] if built else table[a, j, i])
                drive.row[a, i], drive.row_slope[a, i] = scale * total, scale * slope
        if arms.models.kind[a] == POLYNOMIAL:
            continue
        if arms.models.kind[a] == MUSCLE:
            drive.log_pressure[a] = math.log(max(p, _TRACE))
        else:
            _set_level(arms.tables, drive.level, a, p)


@part
def _cell(knots, s, value):  # type: ignore[no-untyped-def]
    """The cell of row s of a grid that holds a value, or is nearest to it, by bisection."""
    low, high = 0, knots.shape[1] - 1
    while high - low > 1:
        middle = (low + high) // 2
        if knots[s, middle] <= value and knots[s, middle] < knots[s, knots.shape[1] - 1]:
            low = middle
        else:
            high = middle
    return low


@part
def hermite(x, width, f0, d0, f1, d1):  # type: ignore[no-untyped-def]
    """Value and slope at x of the cubic with values and slopes at 0 and at a width; beyond both, of its tangents."""
    if x <= 0.0:
        return f0 + d0 * x, d0
    if x >= width:
        return f1 + d1 * (x - width), d1
    rise = (f1 - f0) / width
    c = (3.0 * rise - 2.0 * d0 - d1) / width
    d = (d0 + d1 - 2.0 * rise) / (width * width)
    return f0 + x * (d0 + x * (c + x * d)), d0 + x * (2.0 * c + 3.0 * x * d)


@part
def _set_level(tables, level, a, p):  # type: ignore[no-untyped-def]
    """Write a sampled model's values at its strains at one pressure."""
    s = tables.force[a]
    j = _cell(tables.pressure, s, p)
    x, width = p - tables.pressure[s, j], tables.pressure[s, j + 1] - tables.pressure[s, j]
    value = tables.value
    for e in range(tables.strain.shape[1]):
        for k in range(2):
            f, slope = hermite(
                x, width, value[s, e, j, k], value[s, e, j, 2 + k], value[s, e, j + 1, k], value[s, e, j + 1, 2 + k]
            )
            level[a, e, k], level[a, e, 2 + k] = f, slope


@part
def _at_level(tables, level, a, strain, k):  # type: ignore[no-untyped-def]
    """Columns k and k + 1 of `level` between its strains."""
    s = tables.force[a]
    e = _cell(tables.strain, s, strain)
    x, width = strain - tables.strain[s, e], tables.strain[s, e + 1] - tables.strain[s, e]
    return hermite(x, width, level[a, e, k], level[a, e, k + 1], level[a, e + 1, k], level[a, e + 1, k + 1])


@part
def bending_moment(tables, a, curvature, rest, pressure):  # type: ignore[no-untyped-def]
    """`rest τ_0 + pressure τ_1` of a sampled bending law at a material curvature, and its slope."""
    cells = BENDING_CELLS / (2.0 * CURVIEST)
    at = (curvature + CURVIEST) * cells
    j = int(min(max(at, 0.0), BENDING_CELLS - 1.0)) if at == at else 0
    x, width, value, t = curvature + CURVIEST - j / cells, 1.0 / cells, tables.moment, tables.bent[a]
    f0 = rest * value[t, j, 0] + pressure * value[t, j, 2]
    d0 = rest * value[t, j, 1] + pressure * value[t, j, 3]
    f1 = rest * value[t, j + 1, 0] + pressure * value[t, j + 1, 2]
    d1 = rest * value[t, j + 1, 1] + pressure * value[t, j + 1, 3]
    return hermite(x, width, f0, d0, f1, d1)


@part
def _own_moment(arms, drive, a, curvature):  # type: ignore[no-untyped-def]
    """The moment of a sampled bending law at the actuator's pressure, and its slope by material curvature."""
    own = drive.stiffening[a]
    return bending_moment(arms.tables, a, curvature, own, own * drive.pressure[a])


@inlined_part
def axial_force(arms, drive, a, strain):  # type: ignore[no-untyped-def]
    """f and ∂f/∂ε of an actuator at its pressure."""
    total = slope = 0.0
    if arms.models.kind[a] == POLYNOMIAL or len(arms.force_scale) > 0:
        for i in range(drive.row.shape[1] - 1, -1, -1):
            slope = slope * strain + total
            total = total * strain + drive.row[a, i]
    if arms.models.kind[a] == POLYNOMIAL:
        return total, slope
    if arms.models.kind[a] != MUSCLE:
        force, force_slope = _at_level(arms.tables, drive.level, a, strain, 0)
        return total + drive.scale[a] * force, slope + drive.scale[a] * force_slope
    pull, pull_slope, _ = muscle(strain, drive.pressure[a], drive.log_pressure[a])
    return total - drive.scale[a] * pull, slope - drive.scale[a] * pull_slope


@part
def axial_force_rate(arms, drive, a, strain):  # type: ignore[no-untyped-def]
    """∂f/∂p of an actuator at its pressure."""
    total = 0.0
    if arms.models.kind[a] == POLYNOMIAL or len(arms.force_scale) > 0:
        for i in range(drive.row.shape[1] - 1, -1, -1):
            total = total * strain + drive.row_slope[a, i]
    if arms.models.kind[a] == POLYNOMIAL:
        return total
    if arms.models.kind[a] != MUSCLE:
        rate, _ = _at_level(arms.tables, drive.level, a, strain, 2)
        return total + drive.scale[a] * rate
    _, _, rate = muscle(strain, drive.pressure[a], drive.log_pressure[a])
    return total - drive.scale[a] * rate


@part
def held(length, neutral):  # type: ignore[no-untyped-def]
    """An actuator's length for its material curvature, and whether it is held there."""
    floor = SQUEEZED * neutral
    if abs(length) >= floor:
        return length, 1.0
    return (-floor if length < 0 else floor), 0.0


@part
def write_section(arms, drive, sections, b, segment, i, twist):  # type: ignore[no-untyped-def]
    """Write the reaction of element i of a segment, and its slopes by the unknowns; twists (N, K)."""
    if arms.size == 3:
        _planar_section(arms, drive, sections, b, segment, i, twist)
    else:
        _spatial_section(arms, drive, sections, b, segment, i, twist)


@part
def _planar_section(arms, drive, sections, b, segment, i, twist):  # type: ignore[no-untyped-def]
    length, curvature = twist[i, 0], twist[i, 2]
    force = moment = f_l = f_k = m_l = m_k = stiff = stiff_moment = 0.0
    for a in range(arms.first_actuator[segment], arms.first_actuator[segment + 1]):
        r, neutral = arms.y[b, a], arms.neutral[b, a]
        own = length - r * curvature
        shrunk = drive.shrunk[a]
        f, slope = axial_force(arms, drive, a, (own - neutral) * shrunk)
        stiff += abs(slope)
        stiff_moment += abs(r * slope)
        slope *= shrunk
        force += f
        moment -= r * f
        f_l += slope
        f_k -= r * slope
        m_k += r * r * slope
        safe, free = held(own, neutral)
        inverse = 1.0 / safe
        bent = drive.bending[a] * inverse
        moment += bent * curvature
        turned = free * bent * curvature * inverse
        m_l -= turned
        m_k += bent + r * turned
        if arms.tables.bent[a] >= 0:
            tau, tau_slope = _own_moment(arms, drive, a, curvature / safe)
            moment += tau
            turned = free * tau_slope * curvature / (safe * safe)
            m_l -= turned
            m_k += tau_slope / safe + r * turned
    m_l += f_k
    last = len(arms.unknown) - 1
    sections.reaction[i, 0], sections.reaction[i, last] = force, moment
    sections.slope[i, 0, 0], sections.slope[i, 0, last] = f_l, f_k
    sections.slope[i, last, 0], sections.slope[i, last, last] = m_l, m_k
    if last == 2:
        sections.reaction[i, 1] = -arms.shear[segment] * twist[i, 1]
        sections.slope[i, 1, 1] = -arms.shear[segment]
    sections.stiffness[0] = max(sections.stiffness[0], stiff)
    sections.stiffness[1] = max(sections.stiffness[1], stiff_moment)


@part
def _spatial_section(arms, drive, sections, b, segment, i, twist):  # type: ignore[no-untyped-def]
    size = len(arms.unknown)
    length, k_x, k_y, k_z = twist[i, 0], twist[i, 3], twist[i, 4], twist[i, 5]
    force = m_y = m_z = stiff = stiff_moment = 0.0
    ll = ly = lz = yy = yz = zz = 0.0  # slopes of forces by l, κ_y and κ_z
    bent = by_l = by_y = by_z = 0.0  # Σ k/l_α, and Σ k/l_α² u
    bend_y = bend_z = bend_yl = bend_zl = bend_yy = bend_yz = bend_zy = bend_zz = 0.0  # of sampled bending laws
    tilt = tilt_l = tilt_y = tilt_z = 0.0  # Σ f ρ²/l_α and its slopes
    for a in range(arms.first_actuator[segment], arms.first_actuator[segment + 1]):
        y, z, neutral = arms.y[b, a], arms.z[b, a], arms.neutral[b, a]
        own = length + z * k_y - y * k_z
        shrunk = drive.shrunk[a]
        f, slope = axial_force(arms, drive, a, (own - neutral) * shrunk)
        stiff += abs(slope)
        stiff_moment += (abs(y) + abs(z)) * abs(slope)
        slope *= shrunk
        force += f
        m_y += z * f
        m_z -= y * f
        ll += slope
        ly += z * slope
        lz -= y * slope
        yy += z * z * slope
        yz -= y * z * slope
        zz += y * y * slope
        safe, free = held(own, neutral)
        inverse = 1.0 / safe
        own_bent = drive.bending[a] * inverse
        bent += own_bent
        turned = free * own_bent * inverse
        by_l += turned
        by_y += z * turned
        by_z -= y * turned
        square = (y * y + z * z) * inverse
        tilt += f * square
        change = square * (slope - free * f * inverse)
        tilt_l += change
        tilt_y += z * change
        tilt_z -= y * change
        if arms.tables.bent[a] >= 0:
            # τ = T(|k|) k/|k|, isotropic; beside the secant T/|k| the slope along k has what T' differs by from it
            c_y, c_z = k_y / safe, k_z / safe
            square = c_y * c_y + c_z * c_z + STRAIGHT * STRAIGHT
            curve = math.sqrt(square)
            tau, tau_slope = _own_moment(arms, drive, a, curve)
            secant = tau / curve
            along, shorter = (tau_slope - secant) / square, free * (c_y * c_y + c_z * c_z)
            bend_y += secant * c_y
            bend_z += secant * c_z
            by_length = (along * shorter + free * secant) / safe
            t_y, t_z = along * c_y / safe, along * c_z / safe
            bend_yl -= by_length * c_y
            bend_zl -= by_length * c_z
            bend_yy += secant / safe + t_y * c_y - z * by_length * c_y
            bend_yz += t_y * c_z + y * by_length * c_y
            bend_zy += t_z * c_y - z * by_length * c_z
            bend_zz += secant / safe + t_z * c_z + y * by_length * c_z
    y_at, z_at = size - 2, size - 1
    reaction, out = sections.reaction, sections.slope
    reaction[i, 0] = force
    reaction[i, y_at], reaction[i, z_at] = m_y + bent * k_y + bend_y, m_z + bent * k_z + bend_z
    out[i, 0, 0], out[i, 0, y_at], out[i, 0, z_at] = ll, ly, lz
    out[i, y_at, 0], out[i, z_at, 0] = ly - k_y * by_l + bend_yl, lz - k_z * by_l + bend_zl
    out[i, y_at, y_at], out[i, y_at, z_at] = yy + bent - k_y * by_y + bend_yy, yz - k_y * by_z + bend_yz
    out[i, z_at, y_at], out[i, z_at, z_at] = yz - k_z * by_y + bend_zy, zz + bent - k_z * by_z + bend_zz
    if size > 3 and arms.unknown[size - 3] == 3:
        x_at = size - 3
        own_twist = arms.torsion[b, segment] / length
        reaction[i, x_at] = k_x * (tilt - own_twist)
        out[i, x_at, x_at] = tilt - own_twist
        out[i, x_at, 0] = k_x * (tilt_l + own_twist / length)
        out[i, x_at, y_at], out[i, x_at, z_at] = k_x * tilt_y, k_x * tilt_z
    if size > 4:
        for c in range(1, 3):
            reaction[i, c] = -arms.shear[segment] * twist[i, c]
            out[i, c, c] = -arms.shear[segment]
    sections.stiffness[0] = max(sections.stiffness[0], stiff)
    sections.stiffness[1] = max(sections.stiffness[1], stiff_moment)


@part
def write_rates(arms, drive, sections, b, segment, i, twist):  # type: ignore[no-untyped-def]
    """Write the slopes of element i's reaction by the pressures of its segment."""
    size = len(arms.unknown)
    planar = arms.size == 3
    length = twist[i, 0]
    for a in range(arms.first_actuator[segment], arms.first_actuator[segment + 1]):
        y, z, neutral = arms.y[b, a], arms.z[b, a], arms.neutral[b, a]
        k_y = 0.0 if planar else twist[i, arms.size - 2]
        k_z = twist[i, arms.size - 1]
        own = length + z * k_y - y * k_z
        rate = axial_force_rate(arms, drive, a, (own - neutral) / neutral)
        safe, _ = held(own, neutral)
        bent = drive.stiffening[a] * arms.active[a] / safe
        sections.rate[i, 0, a] = rate
        sections.rate[i, size - 1, a] = bent * k_z - y * rate
        if not planar:
            sections.rate[i, size - 2, a] = bent * k_y + z * rate
            if size > 3 and arms.unknown[size - 3] == 3:
                sections.rate[i, size - 3, a] = rate * (y * y + z * z) * twist[i, 3] / safe
        if arms.tables.bent[a] >= 0:
            c_y, c_z = k_y / safe, k_z / safe
            curve = c_z if planar else math.sqrt(c_y * c_y + c_z * c_z + STRAIGHT * STRAIGHT)
            moment, _ = bending_moment(arms.tables, a, curve, 0.0, drive.stiffening[a])
            if planar:
                sections.rate[i, size - 1, a] += moment
            else:
                sections.rate[i, size - 2, a] += moment / curve * c_y
                sections.rate[i, size - 1, a] += moment / curve * c_z
