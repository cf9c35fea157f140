"""Cells: moments against the standard library, units behind numbers, and what stands for no value."""

from datetime import UTC, datetime, timedelta, timezone

import pytest

from torcharm.characterise.cells import dress, has_value, is_number, number
from torcharm.units import is_absolute, unit_named

NOON = datetime(2024, 5, 1, 12, 0, 1, 500_000, tzinfo=UTC).timestamp()
DAY = 12 * 3600 + 1.5


@pytest.mark.parametrize(
    ("cell", "seconds"),
    [
        ("2024-05-01 12:00:01.5", NOON),
        ("2024-05-01T12:00:01,5Z", NOON),
        ("2024/5/1 12:0:1.5", NOON),
        ("01.05.2024 12:00:01.500", NOON),
        ("1.5.24 12:00:01.5", NOON),
        ("2024-05-01T14:00:01.5+02:00", NOON),
        ("2024-05-01T08:30:01.5-0330", NOON),
        ("12:00:01.5", DAY),
        ("12:00:01.5 PM", DAY),
        ("12:00:01.5 AM", 1.5),
        ("01:00:00 pm", 13 * 3600),
        ("02:01.5", 121.5),
        ("2024-05-01 12:01", NOON + 58.5),
        ("9:00:01.5", 9 * 3600 + 1.5),
        ("5/1/2024 12:00:01.5", DAY),  # May or January: the day is left out
    ],
)
def test_moments_are_seconds(cell, seconds):
    assert is_number(cell)
    assert number(cell, ".") == pytest.approx(seconds, abs=1e-6)


def test_moments_over_a_year_are_those_of_the_standard_library():
    for hours in range(0, 9000, 971):
        moment = datetime(2023, 12, 31, 23, 59, 59, tzinfo=timezone(timedelta(hours=-7))) + timedelta(hours=hours)
        assert number(moment.isoformat(), ",") == pytest.approx(moment.timestamp(), abs=1e-6)


@pytest.mark.parametrize("cell", ["2024-05-01", "12:00:01.5.2", "a:b:c", "2024-05 12:00:00", "12:01", "2:01 PM"])
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
    ("cell", "around"),
    [
        ("12.5 kPa", ("", " kPa")),
        ("-3,2N", ("", "N")),
        ("45 %", ("", " %")),
        ("p: 12.5 kPa", ("p: ", " kPa")),
        ("time_ms=7", ("time_ms=", "")),
        ("3 apples", ("", "")),
        ("7", ("", "")),
        ("Force", ("", "")),
    ],
)
def test_names_and_units_about_numbers(cell, around):
    assert dress(cell) == around


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
