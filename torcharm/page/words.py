"""What a page says of an answer, as HTML: whatever comes from a study is escaped."""

import math
from collections.abc import Iterator
from dataclasses import replace
from html import escape

from torcharm.inputs import three_digits
from torcharm.page.answers import Answer
from torcharm.page.scene import BLACK, COLOURS, VERMILLION
from torcharm.study import Settings
from torcharm.study.words import CHANGE, HELD_OUTSIDE, MEANINGS, allowed
from torcharm.wrench_sets.node_distances import counted

TOP = "margin:0 0.6em;line-height:1.45;font-size:0.85em;overflow-wrap:anywhere;"


def results(found: Answer) -> str:
    """The verdict, why, what to know before trusting it, and the numbers with their units."""
    ink = BLACK if found.verdict == "held" else VERMILLION
    parts = [
        f'<div style="font-size:1.25em;font-weight:700;color:rgb{ink}">{escape(found.verdict)}</div>',
        f"<div>{escape(_meaning(found))}</div>",
    ]
    parts += [f"<div>{escape(said)}</div>" for said in (found.reason, *_explained(found)) if said]
    parts += [f'<div style="color:rgb{VERMILLION}">{escape(warning)}</div>' for warning in found.warnings]
    rows = "".join(
        f'<tr><td style="padding-right:0.8em">{escape(name)}</td><td style="text-align:right">{escape(value)}</td>'
        f'<td style="padding-left:0.3em">{escape(unit)}</td></tr>'
        for name, value, unit in _numbers(found)
    )
    return f'<div style="{TOP}">{"".join(parts)}<table style="margin-top:0.3em">{rows}</table></div>'


def _explained(found: Answer) -> Iterator[str]:
    """What would else puzzle."""
    if "change from the base" in found.reason:
        yield f"{CHANGE.capitalize()}."
    if found.verdict == "held" and found.margins.min() < 0:
        yield f"{HELD_OUTSIDE.capitalize()}."


def _meaning(found: Answer) -> str:
    """What the verdict means, with the tolerance of this arm."""
    tolerance = found.found.tolerance
    near = allowed(replace(tolerance, tip=float(tolerance.lengths(found.arm)[0])))
    return {"held": f"{near}; stable", "missed": f"not {near}"}.get(found.verdict) or MEANINGS[found.verdict]


def _numbers(found: Answer) -> list[tuple[str, str, str]]:
    """Names, values and units."""
    one = found.found
    assert one.tip_error is not None
    assert one.tip_rotation_error is not None
    assert one.shape_error is not None
    worst, least = int(found.margins.argmin()), float(found.margins.min())
    return [
        ("tip off", three_digits(1e3 * float(one.tip_error)), "mm"),
        ("tip turned", three_digits(math.degrees(float(one.tip_rotation_error))), "°"),
        ("shape off, mean", three_digits(1e3 * float(one.shape_error)), "mm"),
        (f"least margin, node {worst + 1}", _signed(least), "N"),
        (f"margin of node {found.state.node + 1}", _signed(float(found.margins[found.state.node])), "N"),
    ]


def _signed(value: float) -> str:
    """Three digits, of numbers that may be below 0."""
    return f"-{three_digits(-value)}" if -math.inf < value < 0 else three_digits(value)


def legend() -> str:
    """What the colours of the arm mean."""
    stops = ", ".join(
        f"rgb({', '.join(str(round(255 * part)) for part in COLOURS(share)[:3])})"
        for share in (0.0, 0.25, 0.5, 0.75, 1.0)
    )
    return (
        f'<div style="{TOP}"><div style="display:flex;align-items:center;gap:0.5em;padding-right:0.8em">no pressure'
        f'<span style="flex:1;height:0.8em;background:linear-gradient(to right, {stops})"></span>its limit</div></div>'
    )


def explanation(settings: Settings) -> str:
    """What else there is to know of the picture and the numbers."""
    return (
        f'<div style="{TOP}">'
        "<div>Grey shade and black line: the shape that is asked for. Actuators and nodes count from 1.</div>"
        "<div>Margin: how far inside of what pressures can give a node lies what it needs at that shape; below 0 it "
        f"lacks that much, force and moment together, {escape(counted(settings.weights))}.</div></div>"
    )


def ended() -> str:
    """What is left to say once the server has ended."""
    return (
        f'<div style="{TOP}"><div style="font-size:1.25em;font-weight:700;color:rgb{VERMILLION}">This page has ended'
        "</div><div>torcharm explore was stopped in its terminal: start it again, and reload this page.</div></div>"
    )


def note(text: str) -> str:
    """A sentence about what was done."""
    return f'<div style="{TOP}">{escape(text)}</div>' if text else ""
