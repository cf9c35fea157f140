"""The engine's balance at given shapes, as kernels that tests call: residuals, pivots and rates."""

from torcharm.engine.compilation import kernel, part
from torcharm.engine.implicit import solve_rows
from torcharm.engine.newton_step import write_balance, write_shape
from torcharm.engine.sections import set_pressure


@part
def write_arm(arms, loads, pressures, twists, b, factor, room, slopes):  # type: ignore[no-untyped-def]
    """Write arm b's shape and balance, and its slopes by pressure if they are wanted."""
    set_pressure(arms, room.drive, pressures, b, 1.0)
    write_shape(arms, loads, room, b, twists[b], slopes)
    write_balance(arms, loads, room, b, twists[b], factor, 0.0, 0.0)


@kernel
def balances(arms, loads, pressures, twists, factor, room, residual, pivots):  # type: ignore[no-untyped-def]
    """The residuals of B arms at given shapes.

    Args:
        pressures: (B, M) [kPa].
        twists: (B, N, K).
        factor: λ on all loads.
        residual: (B, N, C) is written [N, N·m].
        pivots: (B, 2) is written: numbers of positive pivots of J, and of zero ones.
    """
    for b in range(len(pressures)):
        write_arm(arms, loads, pressures, twists, b, factor, room, False)
        for i in range(residual.shape[1]):
            for c in range(residual.shape[2]):
                residual[b, i, c] = room.residual[i, c]
        pivots[b, 0], pivots[b, 1] = room.pivots[0], room.pivots[1]


@kernel
def solutions(arms, loads, pressures, twists, rows, room, right):  # type: ignore[no-untyped-def]
    """As `solve_rows`, of all rows."""
    solve_rows(arms, loads, pressures, twists, rows, 0, len(rows), room, right)


@kernel
def rates(arms, loads, pressures, twists, factor, room, by_pressure, by_load):  # type: ignore[no-untyped-def]
    """Write ∂R/∂p (B, M, N, C) [N, N·m by kPa] and ∂R/∂λ (B, N, C), at shapes as of `balances`."""
    for b in range(len(pressures)):
        write_arm(arms, loads, pressures, twists, b, factor, room, True)
        for i in range(by_load.shape[1]):
            for c in range(by_load.shape[2]):
                by_load[b, i, c] = room.carried[i, c]
                for a in range(by_pressure.shape[1]):
                    by_pressure[b, a, i, c] = room.sections.rate[i, c, a]
