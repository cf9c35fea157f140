"""Numbers of a study file that may be texts with a unit, such as "420 mm" or "30 deg"."""

import difflib
import re
from typing import Annotated, Any

from pydantic import Field

from torcharm.attainability.questions import question_about_mass, question_about_pose
from torcharm.study.fields import ENDS, ORDERED, Check, checked, either, entries, one_or_list, refuse, shown_value
from torcharm.units import ANGLE, AREA, FORCE, LENGTH, MASS, MOMENT, PRESSURE, SHARE, micro

_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(.*?)\s*")


def parsed(value: Any, units: dict[str, float]) -> Any:
    """The number that a text with one of the units stands for; what is no text stays what it is."""
    if not isinstance(value, str):
        return value
    found = _NUMBER.fullmatch(value)
    unit = micro(found[2]) if found else ""
    if found is None or unit not in units:
        raise refuse(f"must be {_in_unit_words(units)}, got {shown_value(value)}{_near_unit(unit, units)}")
    return float(found[1]) * units[unit]


def _near_unit(unit: str, units: dict[str, float]) -> str:
    """Which unit was meant, if one is near in letters of any case, to end a message with."""
    alike = {unit.lower(): unit for unit in units}
    near = difflib.get_close_matches(unit.lower(), alike, 1)
    return f"; did you mean {alike[near[0]]}?" if near else ""


def in_unit(units: dict[str, float]) -> Check:
    """A number, or a text of a number and one of the units."""
    return Check(lambda value: parsed(value, units), words=_in_unit_words(units))


def _in_unit_words(units: dict[str, float]) -> str:
    return f"a number [{next(iter(units))}] or a text of one and a unit ({', '.join(units)})"


Angle = Annotated[float, in_unit(ANGLE)]
Length = Annotated[float, in_unit(LENGTH)]
Mass = Annotated[float, in_unit(MASS), checked(question_about_mass)]
Area = Annotated[float, in_unit(AREA)]
Pressure = Annotated[float, in_unit(PRESSURE)]
NotNegativeForce = Annotated[float, Field(ge=0), in_unit(FORCE)]
NotNegativeShare = Annotated[float, Field(ge=0), in_unit(SHARE)]
PositiveAngle = Annotated[float, Field(gt=0), in_unit(ANGLE)]
PositiveLength = Annotated[float, Field(gt=0), in_unit(LENGTH)]
NotNegativeLength = Annotated[float, Field(ge=0), in_unit(LENGTH)]
PositivePressure = Annotated[float, Field(gt=0), in_unit(PRESSURE)]
NotNegativePressure = Annotated[float, Field(ge=0), in_unit(PRESSURE)]


def _one_or_each(number: Any, unit: str) -> Any:
    words = f"a number or a list of numbers [{unit}]"
    return Annotated[one_or_list(number, list[number]), either(words, int, float, str, list)]


Lengths: Any = _one_or_each(PositiveLength, "m")
Limits: Any = _one_or_each(NotNegativePressure, "kPa")
LengthRange = Annotated[list[Length], ENDS]
PressureRange = Annotated[list[Pressure], ENDS, ORDERED]


def each_in(*forms: dict[str, dict[str, float]]) -> Any:
    """The type of a list of numbers that each have a name and units of their own, in one of some forms."""

    def check(value: Any) -> Any:
        form = next(one for one in forms if len(one) == len(value))
        return [parsed(part, units) for part, units in zip(value, form.values(), strict=True)]

    lists = [f"[{', '.join(form)}]" for form in forms]
    own = [", ".join(dict.fromkeys(next(iter(units)) for units in form.values())) for form in forms]
    words = f"a list {', or '.join(lists)} of numbers [{own[0]}] or texts with a unit"
    # What is written last is checked first: the number of entries, then each entry's unit
    return Annotated[list[float], Check(check, words=words), entries(*map(list, forms))]


WRENCHES = {
    2: {"f_x": FORCE, "f_y": FORCE, "m": MOMENT},
    3: {"f_x": FORCE, "f_y": FORCE, "f_z": FORCE, "m_x": MOMENT, "m_y": MOMENT, "m_z": MOMENT},
}
"""By the dimension, the numbers of a load and their units."""
Load: Any = each_in(*WRENCHES.values())


def _ask_of_pose(value: Any) -> Any:
    """A pose in the plane, unless it makes sense in other units only; an angle with a unit is meant so."""
    if isinstance(value, list) and len(value) == 3:
        place = [parsed(part, LENGTH) for part in value[:2]]
        if all(isinstance(part, int | float) for part in place):
            question = question_about_pose(place, value[2] if isinstance(value[2], int | float) else None)
            if question is not None:
                raise refuse(question)
    return value


_PoseNumbers: Any = each_in({"x": LENGTH, "y": LENGTH, "θ": ANGLE})
PlanarPose: Any = Annotated[_PoseNumbers, Check(_ask_of_pose)]
Position: Any = Annotated[each_in({"x": LENGTH, "y": LENGTH, "z": LENGTH}), checked(question_about_pose)]
Twist: Any = each_in(
    {"l": LENGTH, "γ": LENGTH, "κ": ANGLE},
    {"l": LENGTH, "γ_y": LENGTH, "γ_z": LENGTH, "κ_x": ANGLE, "κ_y": ANGLE, "κ_z": ANGLE},
)
Offset: Any = each_in({"y": LENGTH, "z": LENGTH})
