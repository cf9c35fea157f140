"""Packages that torcharm does not require, imported when a part of it first needs them."""

from importlib import import_module
from typing import Any

COMMAND = "pip install 'torcharm[{}]'"


def extra(name: str, part: str, command: str = COMMAND) -> Any:
    """A module of a package that torcharm does not require.

    Args:
        name: of the module.
        part: of torcharm that needs it, which is the name of its extra, too.
        command: that installs it, with {} where the part is named.

    Raises:
        ValueError: it is not installed or cannot be loaded; the message says how to install it.
    """
    try:
        return import_module(name)
    except ImportError as error:
        package, missing = name.split(".")[0], isinstance(error, ModuleNotFoundError)
        why = "is not installed" if missing else f"cannot be loaded ({error})"
        raise ValueError(f"{part}: needs the package {package}, which {why}: {command.format(part)}") from None
