"""Rows of numbers copied from one array to another, which kernels do without making arrays."""

from torcharm.engine.compilation import part


@part
def copy_row(out, given):  # type: ignore[no-untyped-def]
    """Write a row of numbers."""
    for k in range(len(out)):
        out[k] = given[k]


@part
def copy_rows(out, given):  # type: ignore[no-untyped-def]
    """Write rows of numbers, as those of twists (N, K)."""
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[i, k] = given[i, k]
