"""Loops as machine code: numba, where it is installed."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, TypeVar

from torcharm._inputs import check_flag

F = TypeVar("F", bound=Callable[..., Any])


def check_compiled(compiled: bool) -> bool:
    """The flag, if it is one, and there is something to compile with.

    Raises:
        ValueError: it is none, or numba is not installed.
    """
    check_flag("compiled", compiled)
    if compiled and find_spec("numba") is None:
        raise ValueError("compiled: must be False where numba is not installed (\"pip install 'torcharm[compiled]'\")")
    return compiled


def jit(function: F) -> F:
    """Compiled at the first call, and kept on disk; a division by zero is no error, as in NumPy."""
    from numba import njit

    return njit(cache=True, nogil=True, error_model="numpy")(function)


def jit_part(function: F) -> F:
    """The same of what compiled functions of one file call: kept with them, and called from nowhere else."""
    from numba import njit

    return njit(nogil=True, error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)
