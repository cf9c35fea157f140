"""TOML text to values, and values to TOML text. Floats are written so that they read back exactly."""

import json
import re
import tomllib
from collections.abc import Mapping
from typing import Any

_PLACE = re.compile(r"\s*\(at (?:(line \d+, column \d+)|end of document)\)$")
"""Where tomllib's errors say that a text is wrong."""


def read_toml(text: str, source: str) -> dict[str, Any]:
    """The tables of a TOML text; raises a ValueError of one line that names the source and the line."""
    try:
        return tomllib.loads(text)
    except RecursionError:
        raise ValueError(f"{source}: is not valid TOML: nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        why, place = " ".join(str(error).split()), _PLACE.search(str(error))
        where = (place[1] if place else "") or f"line {len(text.splitlines()) or 1}"
        cut = "" if place is None or place[1] else ", where the file ends: it is cut short"
        raise ValueError(f"{source}: {where}: is not valid TOML: {_PLACE.sub('', why)}{cut}") from None
    except ValueError:  # from Python, which reads no integer of more than 4300 digits
        raise ValueError(f"{source}: holds a number of too many digits") from None


def toml_entry(key: str, value: Any) -> str:
    """`key = value`; a list of lists or tables takes a line for each of them."""
    nested = isinstance(value, list | tuple) and any(isinstance(item, list | tuple | dict) for item in value)
    text = "[\n" + "".join(f"  {toml_value(item)},\n" for item in value) + "]" if nested else toml_value(value)
    return f"{_key(key)} = {text}"


def toml_value(value: Any) -> str:
    """A number, a truth, a text, a list or a table, on one line."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {toml_value(item)}" for key, item in value.items()) + " }"
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml_value(item) for item in value)}]"
    return repr(float(value)) if isinstance(value, float) else repr(int(value))


def _key(key: str) -> str:
    return key if key.isascii() and key.replace("_", "").isalnum() else toml_value(key)
