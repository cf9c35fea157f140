"""Units that people write, in study files, options, tables and recordings, and how large one of each is.

Each quantity has one table of factors to the unit in which torcharm reads numbers without one, the first of each.
"""

import math
import re

LENGTH = {"m": 1.0, "cm": 0.01, "mm": 1e-3, "µm": 1e-6, "in": 0.0254}
ANGLE = {"rad": 1.0, "deg": math.pi / 180, "°": math.pi / 180, "turn": 2 * math.pi}
PRESSURE = {"kPa": 1.0, "Pa": 1e-3, "MPa": 1e3, "bar": 100.0, "mbar": 0.1, "psi": 6.894757293168361}
MASS = {"kg": 1.0, "g": 1e-3, "lb": 0.45359237, "oz": 0.028349523125}
AREA = {"m²": 1.0, "cm²": 1e-4, "mm²": 1e-6, "cm^2": 1e-4, "mm^2": 1e-6}
FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": 9.80665, "gf": 9.80665e-3, "lbf": 4.4482216152605}
MOMENT = {"N·m": 1.0, "N*m": 1.0, "N m": 1.0, "Nm": 1.0, "N·mm": 1e-3, "N*mm": 1e-3, "N mm": 1e-3, "Nmm": 1e-3}
SHARE = {"1": 1.0, "%": 0.01}
TIME = {"ms": 1.0, "s": 1e3, "µs": 1e-3, "ns": 1e-6, "min": 6e4, "h": 3.6e6}
STRAIN = {"mm/mm": 1.0, "%": 0.01, "‰": 1e-3, "µε": 1e-6}

MEASURED = {
    "time": TIME,
    "strain": STRAIN | LENGTH,
    "contraction": STRAIN | LENGTH,
    "extension": LENGTH | STRAIN,
    "length": LENGTH,
    "force": FORCE | {"cN": 0.01, "daN": 10.0, "ozf": 4.4482216152605 / 16},
    "pressure": PRESSURE
    | {"atm": 101.325, "kgf/cm²": 98.0665, "mmHg": 101.325 / 760, "inHg": 3.386389, "mmH2O": 9.80665e-3}
    | {"cmH2O": 0.0980665, "inH2O": 0.249089},
}
"""The units of what columns of recordings and of data sheets' tables hold, by the names of columns."""

_SPELLINGS = {
    "ms": ("msec", "msecs", "millis", "millisecond", "milliseconds"),
    "s": ("sec", "secs", "second", "seconds", "sek"),
    "µs": ("us", "usec", "micros", "microsecond", "microseconds"),
    "min": ("mins", "minute", "minutes"),
    "h": ("hr", "hour", "hours"),
    "psi": ("lbf/in²", "lbf/in2"),
    "kPa": ("kilopascal", "kilopascals", "kn/m²", "kn/m2"),
    "bar": ("bars",),
    "MPa": ("megapascal", "megapascals", "n/mm²", "n/mm2"),
    "Pa": ("pascal", "pascals", "n/m²", "n/m2"),
    "mbar": ("hpa", "millibar"),
    "kgf/cm²": ("kgf/cm2", "kgf/cm^2", "kg/cm²", "kg/cm2"),
    "mmHg": ("torr",),
    "N": ("newton", "newtons"),
    "kgf": ("kg", "kp"),
    "gf": ("g",),
    "lbf": ("lb", "lbs", "pound", "pounds"),
    "in": ("inch", "inches", '"'),
    "m": ("metre", "metres", "meter", "meters"),
    "mm": ("millimetre", "millimetres", "millimeter", "millimeters"),
    "cm": ("centimetre", "centimetres", "centimeter", "centimeters"),
    "µm": ("um", "micron", "microns", "micrometre", "micrometres", "micrometer", "micrometers"),
    "%": ("percent", "pct"),
    "‰": ("mm/m", "promille"),
    "mm/mm": ("m/m", "in/in", "1", "-", "strain"),
    "µε": ("ue", "ustrain", "microstrain"),
}
_BY_SPELLING = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings}
_BY_CASE_ALONE = {"MN"}
"""What is another unit than the same letters in lower case, and no unit here."""
_GAUGE = re.compile(r"(.+?)[ _]?(?:g|gauge|gage|rel\.?|ü)", re.IGNORECASE)
_ABSOLUTE = re.compile(r"(.+?)[ _]?(?:a|abs\.?|absolute?)", re.IGNORECASE)
"""Units of pressure above that of the surroundings, which all of torcharm's are, and above none."""


def unit_named(text: str, quantity: str) -> str | None:
    """The unit of a measured quantity that a text stands for, in any usual spelling; None: it stands for none."""
    found = _spelt(text, MEASURED[quantity])
    if found is None and quantity == "pressure":
        above = _GAUGE.fullmatch(text.strip()) or _ABSOLUTE.fullmatch(text.strip())
        found = _spelt(above[1], MEASURED[quantity]) if above else None
    return found


def is_absolute(text: str) -> bool:
    """Whether a text stands for a unit of pressures above none, as "bara", "psia" or "kPa abs" do."""
    above = _ABSOLUTE.fullmatch(text.strip())
    table = MEASURED["pressure"]
    return above is not None and _spelt(text, table) is None and _spelt(above[1], table) is not None


def micro(text: str) -> str:
    """The text, in which the Greek letter μ that looks like the sign of 1e-6 is that sign, µ."""
    return text.replace("\u03bc", "\u00b5")


def _spelt(text: str, table: dict[str, float]) -> str | None:
    text = micro(text.strip()).removesuffix(".")
    if text in table or text in _BY_CASE_ALONE:
        return text if text in table else None
    low = text.lower()
    found = _BY_SPELLING.get(low) or next((unit for unit in table if unit.lower() == low), None)
    return found if found in table else None
