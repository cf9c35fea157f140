"""Solutions with the slope J of the balance of arms at given shapes, as the implicit function theorem asks for."""

from torcharm.engine.compilation import part
from torcharm.engine.newton_step import solve, write_balance, write_shape
from torcharm.engine.sections import set_pressure


@part
def solve_rows(arms, loads, pressures, twists, rows, first, last, balance, right):  # type: ignore[no-untyped-def]
    """Replace right-hand sides by J⁻¹ times them, under all of the load.

    Args:
        pressures: (B, M) [kPa].
        twists: (B, N, K).
        rows: (b,) which of the B arms.
        first, last: of the rows, without the last.
        right: (b, X, N, C).
    """
    for at in range(first, last):
        b = rows[at]
        set_pressure(arms, balance.drive, pressures, b, 1.0)
        write_shape(arms, loads, balance, b, twists[b], False)
        write_balance(arms, loads, balance, b, twists[b], 1.0, 0.0, 0.0)
        for x in range(right.shape[1]):
            solve(arms, loads, balance, right[at, x])
