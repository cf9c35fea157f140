"""Loops as machine code: numba, where it is installed."""

from collections.abc import Callable
from importlib import import_module
from importlib.util import find_spec
from inspect import unwrap
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


def jit(function: F, **options: bool) -> F:
    """Compiled at the first call, and kept on disk; a division by zero is no error, as in NumPy."""
    numba: Any = import_module("numba")  # loads when it is first asked for
    own = unwrap(function)  # signatures that are checked at run time are wrapped
    return numba.njit(**{"cache": True, "nogil": True, "error_model": "numpy"} | options)(own)


def jit_part(function: F) -> F:
    """The same of what a file's compiled functions call: kept with these, and not to be called from Python."""
    return jit(function, cache=False, no_cpython_wrapper=True, no_cfunc_wrapper=True)
