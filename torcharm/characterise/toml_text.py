"""Values as TOML text. Floats are written so that they read back exactly."""

import json
from collections.abc import Mapping
from typing import Any


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
