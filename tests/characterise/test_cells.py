"""Cells: moments, and what stands for no value."""

from datetime import UTC, datetime

import pytest

from torcharm.characterise.cells import has_value, is_number, number
from torcharm.units import is_absolute, unit_named

NOON = datetime(2024, 5, 1, 12, 0, 1, 500_000, tzinfo=UTC).timestamp()
DAY = 12 * 3600 + 1.5


@pytest.mark.parametrize(
    ("cell", "seconds"),
    [
        ("2024-05-01 12:00:01.5", NOON),
        ("2024-05-01T12:00:01,5Z", NOON),
        ("2024-05-01T14:00:01.5+02:00", NOON),
        ("2024-05-01T08:30:01.5-0330", NOON),
        ("12:00:01.5", DAY),
    ],
)
def test_moments_are_seconds(cell, seconds):
    assert is_number(cell)
    assert number(cell, ".") == pytest.approx(seconds, abs=1e-6)


@pytest.mark.parametrize("cell", ["01.05.2024 12:00:01", "2024-05-01", "12:00:01.5.2", "a:b:c", "2024-05 12:00:00"])
def test_what_is_no_moment(cell):
    assert not is_number(cell)


@pytest.mark.parametrize("cell", ["", " ", "nan", "NaN", "N/A", "#N/A", "---", "OVLD", "OL", "null", "*"])
def test_words_for_no_value(cell):
    assert not has_value(cell)
    assert number(cell, ".") != number(cell, ".")


@pytest.mark.parametrize("cell", ["0", "-1", "x", "inf", "1.2.3", "Force"])
def test_other_words_and_numbers_are_values(cell):
    assert has_value(cell)


@pytest.mark.parametrize(
    ("text", "unit", "absolute"),
    [
        ("barg", "bar", False),
        ("bara", "bar", True),
        ("psia", "psi", True),
        ("PSIG", "psi", False),
        ("kPa abs", "kPa", True),
        ("kPa gauge", "kPa", False),
        ("bar ü", "bar", False),
        ("mbar absolute", "mbar", True),
        ("Pa", "Pa", False),
        ("hPa", "mbar", False),
        ("a", None, False),
        ("data", None, False),
    ],
)
def test_gauge_and_absolute_units(text, unit, absolute):
    assert unit_named(text, "pressure") == unit
    assert is_absolute(text) == absolute
