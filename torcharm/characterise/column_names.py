"""What the names of columns tell: which quantity each may hold, in which unit, and which way it counts."""

import re

from torcharm.characterise.delimited import Sheet
from torcharm.characterise.headers import BRACKETS, Header, base
from torcharm.units import LENGTH, MEASURED, unit_named

NAMES = {
    "time": r"timestamp|\btime|elapsed(?! cycle)|millis|micros|zeit|\bx value",
    "strain": r"strain|dehnung|stauchung",
    "contraction": r"contraction|shortening|kontraktion|verkürzung",
    "extension": r"extension|displacement|elongation|crosshead|stroke|position|travel|weg\b|traverse|verlängerung",
    "length": r"length|height|länge\b|höhe\b",
    "force": r"force|load|kraft",
    "pressure": r"pressure|druck(?!kraft)",
}
"""What the names of columns hold, in lower case and without units."""
_SYMBOLS = {"time": ("t",), "strain": ("ε", "eps", "epsilon"), "force": ("f",), "pressure": ("p",)}
"""What they are called alone."""
_SET_POINT = re.compile(r"set ?point|target|command|demand|desired|reference|\bref\b|\bset\b|\bsp\b|soll")
"""What was asked for is no measurement."""
_TOLD_BY_UNIT = ("time", "force", "pressure")
"""Quantities whose units are those of nothing else that a bench records."""
STRESS = r"stress|spannung|modul"
"""What testers give in units of pressure, and is none."""
_COMPRESSIVE = re.compile(r"compressi|stauchung|druckkraft")
"""What a tester names so is positive where it squeezes: such strains and extensions shorten, such forces push."""
_LENGTHENING = re.compile(r"extension|elongation|verlängerung|tensile|tension|dehnung")
"""What is positive where longer; strokes and positions count either way."""
_PREFERRED_ALONE = ("time", "extension", "force")
"""Of which the column of that name alone is taken among several: others, such as a cycle's time, follow it."""
_AMBIGUOUS = ("min", "h", "1", "-", "in")
"""What names a unit in brackets, or in a row of units, but may mean something else as a word of a name."""


def is_compressive(name: str) -> bool:
    """Whether a name says that what is positive squeezes."""
    return _COMPRESSIVE.search(name.lower()) is not None


def is_sure(quantity: str, name: str) -> bool:
    """Whether a quantity or a name says which way a stretch counts: contraction, length, compressive, tensile."""
    return (
        quantity in ("contraction", "length") or is_compressive(name) or _LENGTHENING.search(name.lower()) is not None
    )


def candidates(sheet: Sheet, header: Header, quantity: str) -> list[int]:
    """Columns of numbers that may hold a quantity: by name, those named so alone first; or else by unit."""
    numeric = [i for i in range(sheet.form.width) if sheet.form.numeric[i] and not _is_foreign(header, i, quantity)]
    bases = {i: base(header.names[i]) for i in numeric}
    own = {i: name for i, name in bases.items() if not _SET_POINT.search(name)}
    symbols = _SYMBOLS.get(quantity, ())
    found = [i for i, name in own.items() if re.search(NAMES[quantity], name) or name in symbols]
    if len(found) > 1 and quantity in _PREFERRED_ALONE:
        alone = [i for i in found if re.fullmatch(f"(?:{NAMES[quantity]})s?", own[i])]
        return alone if len(alone) == 1 else found
    if quantity == "strain":  # those that are lengths of the gauge go last
        found = [i for i in found if not any(unit in LENGTH for unit in named_units(header, i, quantity)[0])] or found
    if found or quantity not in _TOLD_BY_UNIT:
        return found
    others = [STRESS, *(pattern for other, pattern in NAMES.items() if other != quantity)]
    return [i for i in own if named_units(header, i, quantity)[0] and not any(re.search(p, own[i]) for p in others)]


def named_units(header: Header, index: int, quantity: str) -> tuple[list[str], str]:
    """The units of a quantity that a column's header names, and what stands in a unit's place but is none."""
    texts = header.unit_texts(index)
    found = [unit for text in texts if (unit := unit_named(text, quantity))]
    if not found:
        found = units_among_words(header.names[index], quantity)
    return list(dict.fromkeys(found)), "" if found or not texts else texts[0]


def units_among_words(name: str, quantity: str) -> list[str]:
    """The units of a quantity among a name's words that stand in no brackets."""
    words = re.sub(f"(?:{NAMES[quantity]})(?:s(?![a-z]))?", _own_unit, name.lower())
    words = re.sub(r"[_,;/]", " ", BRACKETS.sub(" ", words))
    return [unit for w in words.split() if w not in _AMBIGUOUS and (unit := unit_named(w, quantity))]


def _own_unit(name: re.Match[str]) -> str:
    """The name of a quantity if it is a unit, too, as a microcontroller's `millis` is; else a blank."""
    return name[0] if name[0] in ("millis", "micros") else " "


def _is_foreign(header: Header, index: int, quantity: str) -> bool:
    """Whether a column's header names a unit of another quantity, and none of this."""
    texts = header.unit_texts(index)
    return not any(unit_named(t, quantity) for t in texts) and any(unit_named(t, q) for t in texts for q in MEASURED)
