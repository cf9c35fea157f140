"""The engine's balance at given shapes, as kernels that tests call: residuals, pivots and rates."""

from torcharm.engine.compilation import kernel, part
from torcharm.engine.implicit import solve_rows
from torcharm.engine.newton_step import write_balance, write_shape
from torcharm.engine.sections import set_pressure


@part
def write_arm(arms, loads, pressures, twists, b, factor, balance, slopes):  # type: ignore[no-untyped-def]
    """Write arm b's shape and balance, and its slopes by pressure if they are wanted."""
    set_pressure(arms, balance.drive, pressures, b, 1.0)
    write_shape(arms, loads, balance, b, twists[b], slopes)
    write_balance(arms, loads, balance, b, twists[b], factor, 0.0, 0.0)


@kernel
def balances(arms, loads, pressures, twists, factor, balance, residual, pivots):  # type: ignore[no-untyped-def]
    """The residuals of B arms at given shapes.

    Args:
        pressures: (B, M) [kPa].
        twists: (B, N, K).
        factor: λ on all loads.
        residual: (B, N, C) is written [N, N·m].
        pivots: (B, 2) is written: numbers of positive pivots of J, and of zero ones.
    """
    for b in range(len(pressures)):
        write_arm(arms, loads, pressures, twists, b, factor, balance, False)
        for i in range(residual.shape[1]):
            for c in range(residual.shape[2]):
                residual[b, i, c] = balance.residual[i, c]
        pivots[b, 0], pivots[b, 1] = balance.pivots[0], balance.pivots[1]


@kernel
def solutions(arms, loads, pressures, twists, rows, balance, right):  # type: ignore[no-untyped-def]
    """As `solve_rows`, of all rows."""
    solve_rows(arms, loads, pressures, twists, rows, 0, len(rows), balance, right)


@kernel
def rates(arms, loads, pressures, twists, factor, balance, by_pressure, by_load):  # type: ignore[no-untyped-def]
    """Write ∂R/∂p (B, M, N, C) [N, N·m by kPa] and ∂R/∂λ (B, N, C), at shapes as of `balances`."""
    for b in range(len(pressures)):
        write_arm(arms, loads, pressures, twists, b, factor, balance, True)
        for i in range(by_load.shape[1]):
            for c in range(by_load.shape[2]):
                by_load[b, i, c] = balance.carried[i, c]
                for a in range(by_pressure.shape[1]):
                    by_pressure[b, a, i, c] = balance.sections.rate[i, c, a]
