"""What the first line of a pressure log says: units of time and pressure, and a first sample glued to it."""

import re
from collections.abc import Mapping

MILLISECONDS = {
    **dict.fromkeys(("ms", "msec", "msecs", "millis", "millisecond", "milliseconds"), 1.0),
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1000.0),
    **dict.fromkeys(("us", "µs", "μs", "usec", "micros", "microsecond", "microseconds"), 0.001),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), 60_000.0),
    **dict.fromkeys(("h", "hr", "hour", "hours"), 3_600_000.0),
}
"""One of each unit of time that a log may name, in ms; names in lower case."""
KILOPASCALS_NAMED = {
    **dict.fromkeys(("psi", "psig"), 6.894757293168361),
    **dict.fromkeys(("kpa", "kpag", "kilopascal", "kilopascals"), 1.0),
    **dict.fromkeys(("bar", "barg", "bars"), 100.0),
    **dict.fromkeys(("mpa", "megapascal", "megapascals"), 1000.0),
    **dict.fromkeys(("pa", "pascal", "pascals"), 0.001),
    **dict.fromkeys(("mbar", "hpa", "millibar"), 0.1),
    "atm": 101.325,
    **dict.fromkeys(("kgf/cm2", "kgf/cm²", "kgf/cm^2"), 98.0665),
    **dict.fromkeys(("torr", "mmhg"), 101.325 / 760),
}
"""The same of pressure, in kPa."""
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_GLUED = re.compile(rf'^(?P<head>.*?[^\d.+-])(?P<row>"{_NUMBER}"\s*,\s*"{_NUMBER}"|{_NUMBER}\s*,\s*{_NUMBER})\s*$')
_BRACKETS = re.compile(r"\(([^()]*)\)|\[([^\[\]]*)\]")
_QUANTITY = re.compile(r"(?:timestamp|time|pressure)(?:s(?![a-z]))?")
_SPELT = ("min", "h")
"""What names a unit in brackets, but may mean something else as a bare word."""


def split_header(line: str) -> tuple[str, str | None]:
    """The header in a log's first line, and the first sample if that is glued to it."""
    glued = _GLUED.match(line)
    if glued and any(character.isalpha() for character in glued["head"]):
        return glued["head"], glued["row"]
    return line, None


def named_units(header: str) -> tuple[tuple[str, float] | None, tuple[str, float] | None]:
    """The units of time and of pressure that a header names, each with its size in ms or kPa; None where it names none.

    A unit stands in brackets, as in `Pressure (kPa)`, or is a word of its own, as in `pressure_kPa`.

    Raises:
        ValueError: brackets hold what is no unit, or different units of one quantity are named.
    """
    cells = header.lower().replace('"', "").split(",")
    places = cells if len(cells) == 2 else [header.lower()] * 2
    time, pressure = _named("time", places[0], MILLISECONDS), _named("pressure", places[1], KILOPASCALS_NAMED)
    for text in _bracketed(header.lower()):
        if text not in MILLISECONDS and text not in KILOPASCALS_NAMED:
            allowed = ", ".join(("ms", "s", "psi", "kPa", "bar", "MPa", "Pa", "mbar"))
            raise ValueError(f"units in brackets must be among {allowed}, got {text[:60]!r}")
    if len(cells) == 2:
        for quantity, cell, others in (("time", cells[0], KILOPASCALS_NAMED), ("pressure", cells[1], MILLISECONDS)):
            if any(text in others for text in _bracketed(cell)):
                raise ValueError(f"the columns must be time and pressure, got a {quantity} {cell.strip()[:60]!r}")
    return time, pressure


def _named(quantity: str, text: str, units: Mapping[str, float]) -> tuple[str, float] | None:
    found = [name for name in _bracketed(text) if name in units]
    if not found:
        words = re.findall(r"[^\W\d_]+", _QUANTITY.sub(" ", _BRACKETS.sub(" ", text)))
        found = [word for word in words if word in units and word not in _SPELT]
    if len({units[name] for name in found}) > 1:
        raise ValueError(f"must name one unit of {quantity}, got {' and '.join(found)[:60]}")
    return (found[0], units[found[0]]) if found else None


def _bracketed(text: str) -> list[str]:
    return [(round_ or square).strip() for round_, square in _BRACKETS.findall(text)]
