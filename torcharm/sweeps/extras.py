"""Packages that only sweeps need, imported when a sweep first needs them."""

from importlib import import_module
from typing import Any

COMMAND = "pip install 'torcharm[sweep]'"


def extra(name: str, command: str = COMMAND) -> Any:
    """A module of a package that torcharm does not require.

    Raises:
        ValueError: it is not installed or cannot be loaded; the message says how to install it.
    """
    try:
        return import_module(name)
    except ImportError as error:
        package, missing = name.split(".")[0], isinstance(error, ModuleNotFoundError)
        why = "is not installed" if missing else f"cannot be loaded ({error})"
        raise ValueError(f"sweep: needs the package {package}, which {why}: {command}") from None
