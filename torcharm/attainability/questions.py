"""Questions to a person whose numbers make sense in other units only."""

import math
from collections.abc import Sequence
from itertools import combinations

from torch import Tensor

from torcharm.actuators import LinearBending, is_passive
from torcharm.arm import ArmDesign
from torcharm.arm_series import with_slices

LONGEST = 5.0
"""A length of an arm or a shape [m] beyond which metres were hardly meant."""
FARTHEST = 20.0
"""A place of a pose [m], as far from the origin, beyond which metres were hardly meant: one out of reach is no question
of units, but of its plan alone."""
MOST_TURN = 4 * math.pi
"""A bend of a whole segment [rad], two turns, beyond which radians were hardly meant."""
LEAST_LIMIT = 0.03
"""Of the highest pressure that was characterised, below which a limit was hardly meant in kilopascals."""
LEAST_PRESSURE = 2.0
"""A limit [kPa] below which air hardly drives anything, whatever was characterised: of a chamber that is the limit
itself."""
WIDEST = 1.0
"""An offset across an arm [m] beyond which metres were hardly meant."""
HEAVIEST = 20.0
"""A mass [kg] beyond which kilograms were hardly meant."""
MOST_HEADING = 2 * math.pi
"""A heading [rad], a turn, beyond which radians were hardly meant."""
SAME_PLACE = 1e-6
"""A distance [m] within which two actuators are at one place."""
PER_ELEMENT = 0.3
"""By which share the length of a shape may differ from an element's of the arm to be taken for it."""


def question(segments: Sequence[ArmDesign], twists: Tensor, nodes: Sequence[int]) -> str | None:
    """Whether a design, or a shape for it, is in other units; None: they make sense.

    Args:
        segments: of one design.
        twists: (N, 3 or 6) of all segments.
        nodes: of each segment.
    """
    return (
        question_about_arm(segments)
        or question_about_shape(twists)
        or _question_about_fit(segments, twists, nodes)
        or question_about_limits(segments)
    )


def question_about_shape(twists: Tensor) -> str | None:
    """Whether twists (..., N, 3 or 6) of one segment are in other units; None: they make sense."""
    length, turn = twists[..., 0].detach(), twists.detach()[..., 2 if twists.shape[-1] == 3 else 3 :]
    bend = turn.norm(dim=-1).mean(-1)  # along the shape
    if bool((length.abs() > LONGEST).any()):
        return f"lengths of up to {length.abs().max():g} m: are they in millimetres?"
    if bool((bend > MOST_TURN).any()):
        most = float(bend.max())
        return f"a bend of {most:g} rad, {most / (2 * math.pi):.3g} turns: are curvatures in degrees?"
    return None


def question_about_arm(segments: Sequence[ArmDesign]) -> str | None:
    """Whether an arm's lengths and offsets are in other units; None: they make sense."""
    for segment in segments:
        length, offset = segment.length.detach(), segment.offsets.detach().norm(dim=-1)
        if bool((length > LONGEST).any()):
            return f"length: {length.max():g} m: is it in millimetres?"
        beyond = offset > length
        if bool(beyond.any()):
            name = "radii" if segment.dimension == 2 else "offsets"
            return f"{name}: {offset[beyond].max():g} m, more than the arm is long: are they in millimetres?"
        heavy = question_about_mass(float(segment.mass.detach().max()))
        if heavy is not None:
            return f"mass: {heavy}"
    return None


def question_about_mass(mass: float) -> str | None:
    """Whether a mass [kg] is in other units; None: it makes sense."""
    if mass <= HEAVIEST:
        return None
    return f"{mass:g} kg: the unit is kilogram, {mass:g} g is written '{mass:g} g'; is it in grams?"


def question_about_lengths(lengths: Sequence[float], most: float = LONGEST) -> str | None:
    """Whether lengths [m] beyond so many metres are in other units; None: they make sense."""
    longest = max(lengths, key=abs)
    if abs(longest) <= most:
        return None
    return f"{longest:g} m, beyond {most:g} m: is it in millimetres? {longest:g} mm is written '{longest:g} mm'."


def question_about_pose(place: Sequence[float], heading: float | None = None) -> str | None:
    """Whether a pose, of a place [m] and perhaps a heading [rad], is in other units; None: it makes sense."""
    far, away = [], math.hypot(*place)
    if away > FARTHEST:
        far.append((f"{away:.3g} m from the origin", "millimetres", f"'{place[0]:g} mm'"))
    if heading is not None and abs(heading) > MOST_HEADING:
        far.append((f"a heading of {heading:g} rad", "degrees", f"'{heading:g} deg'"))
    if not far:
        return None
    said, units, written = (" and ".join(words) for words in zip(*far, strict=True))
    return f"{said}: {'is it' if len(far) == 1 else 'are they'} in {units}? Write {written} then."


def question_about_places(segments: Sequence[ArmDesign]) -> str | None:
    """Whether two driven actuators are at one place of a single design, by mistake; None: they are not."""
    for segment, own in with_slices(segments):
        places = segment.offsets.detach()
        driven = [index for index, model in enumerate(segment.actuators) if not is_passive(model)]
        for one, other in combinations(driven, 2):
            if float((places[one] - places[other]).norm()) < SAME_PLACE:
                y, z = (1e3 * places[one]).tolist()
                where = f"{y:g} mm" if segment.dimension == 2 else f"({y:g}, {z:g}) mm"
                return (
                    f"actuators {own.start + one + 1} and {own.start + other + 1} are both at {where} from the "
                    "centreline: was a sign or another place meant?"
                )
    return None


def note_on_bending(segments: Sequence[ArmDesign]) -> str | None:
    """Which actuators, from 1, have a bending stiffness that was assumed; None: none has."""
    models = [model for segment in segments for model in segment.actuators]
    assumed = {
        index: model.bending_stiffness
        for index, model in enumerate(models, 1)
        if isinstance(model.bending_stiffness, LinearBending) and model.bending_stiffness.assumed
    }
    if not assumed:
        return None
    values = ", ".join(dict.fromkeys(f"{float(one.stiffness):.3g}" for one in assumed.values()))
    which = "all actuators" if len(assumed) == len(models) > 1 else f"actuators {', '.join(map(str, assumed))}"
    return (
        f"the bending stiffness of {which} is assumed, {values} N·m²: errors of bent shapes rest on it; torcharm fit "
        "--bending or bending_stiffness in a study sets one"
    )


def question_about_limits(segments: Sequence[ArmDesign]) -> str | None:
    """Whether the pressure limits of actuators that are driven are in other units; None: they make sense."""
    for segment in segments:
        limits = segment.max_pressure.detach().reshape(-1, segment.actuator_count)
        for model, own in zip(segment.actuators, limits.unbind(-1), strict=True):
            known, driven = float(model.pressure_range[1]), own[own > 0]
            if is_passive(model) or not len(driven):
                continue
            limit = float(driven.min())
            if limit < LEAST_LIMIT * known:
                unit = "bar" if 100 * limit > LEAST_LIMIT * known else "MPa"
                return (
                    f"max_pressure: {limit:g} kPa is {100 * limit / known:.2g} % of the {known:g} kPa that were "
                    f"characterised: is it in {unit}?"
                )
            if limit < LEAST_PRESSURE:
                return f"max_pressure: {limit:g} kPa: the unit is kilopascal, {limit:g} bar is written '{limit:g} bar'"
    return None


def _question_about_fit(segments: Sequence[ArmDesign], twists: Tensor, nodes: Sequence[int]) -> str | None:
    """Whether a shape's length is that of one element of the arm; None: it is not."""
    for segment, own in zip(segments, twists.detach().split(list(nodes), -2), strict=True):
        count, length = own.shape[-2], float(own[..., 0].mean())
        whole = float(segment.length.detach().mean())
        if count > 3 and abs(length * count / whole - 1) < PER_ELEMENT:
            return (
                f"each of {count} rows has l = {length:g} m, an element's part of {whole:g} m: "
                "l and κ are those of the whole arm, were they divided by the number of nodes?"
            )
    return None
