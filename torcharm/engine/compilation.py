"""Loops as machine code, by numba."""

import os
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from inspect import unwrap
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

SOURCES = ("inputs", "geometry", "actuators", "arm", "arm_series", "load", "statics", "engine")
"""Modules and packages in which constants of compiled code may stand: a change of one compiles the engine anew."""


def kernel(function: F) -> F:
    """Compiled at the first call, and kept on disk. It holds no references to arrays, which saves half of the time.

    So it cannot make arrays: scratch to work in is an argument.
    """
    return _compiled(function, "KernelCompiler", cache=True, _nrt=False)


def part(function: F) -> F:
    """A part of kernels, compiled once for all that call it."""
    return _compiled(function, "PartCompiler", **_OF_PARTS)


def inlined_part(function: F) -> F:
    """A part that becomes part of what calls it: there loops are written out whose lengths are given by constants."""
    return _compiled(function, "InlinedCompiler", **_OF_PARTS)


_OF_PARTS: dict[str, Any] = {"cache": False, "_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def _compiled(function: F, compiler: str, **options: Any) -> F:
    import numba

    from torcharm.engine import code_parts
    from torcharm.engine.code_cache import guard

    config: Any = numba.config
    # numba takes code from disk unless the function's own file has changed; that of what it calls may have
    chosen, folder = config.CACHE_DIR, folder_of_code()
    # no fast mathematics, not even products and sums rounded once: a cross product of parallel vectors has to be 0
    every: dict[str, Any] = {"nogil": True, "error_model": "numpy", **options}
    every["pipeline_class"] = getattr(code_parts, compiler)
    every["cache"] = every["cache"] and folder is not None
    try:
        config.CACHE_DIR = folder or chosen
        compiled: F = numba.njit(**every)(unwrap(function))  # what checks signatures in tests cannot be compiled
        if hasattr(compiled, "_set_uuid"):  # not a plain function, as where numba is told not to compile
            compiled._set_uuid(_name(unwrap(function)))
        if every["cache"]:
            guard(compiled)
        if every.get("no_cpython_wrapper"):
            code_parts.once_for_all_numbers(compiled)
        return compiled
    finally:
        config.CACHE_DIR = chosen


def _name(function: Callable[..., Any]) -> str:
    """Of a compiled function, the same in every process.

    By it numba tells apart what a function holds that is made by another one, and so whether it is on disk: by chance
    it would be another one in each process.
    """
    held = [_name_of_held(cell.cell_contents) for cell in function.__closure__ or ()]
    own = function.__module__, function.__qualname__, function.__code__.co_firstlineno
    whole = repr((version_of_sources(), *own, held))
    return sha256(whole.encode()).hexdigest()


def _name_of_held(value: Any) -> str:
    if hasattr(value, "_uuid"):
        return str(value._uuid)
    return f"{value.__module__}.{value.__qualname__}" if callable(value) else repr(value)


@cache
def folder_of_code() -> str | None:
    """Where code of these sources is kept: where numba is told to, beside them, or with the user's; None: nowhere."""
    told = os.environ.get("NUMBA_CACHE_DIR")
    for place in (told, Path(__file__).parents[1] / "__pycache__", Path("~/.cache/torcharm").expanduser()):
        if not place:
            continue
        folder = Path(place) / f"torcharm-{version_of_sources()}"
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with TemporaryFile(dir=folder):
                return str(folder)
        except OSError:
            continue
    return None


@cache
def version_of_sources() -> str:
    """Of the sources that code is made of: the engine's, and those of all that it imports."""
    digest, package = sha256(), Path(__file__).parents[1]
    for name in SOURCES:
        for path in sorted([*package.glob(f"{name}.py"), *package.glob(f"{name}/*.py")]):
            digest.update(path.read_bytes())
    return digest.hexdigest()[:16]
