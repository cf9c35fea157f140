"""Figures as SVG within a page: alike each time, small, and with identifiers that no other figure has."""

import io
import re

import matplotlib
from markupsafe import Markup, escape
from matplotlib.contour import ContourSet
from matplotlib.figure import Figure

DOTS = 144
"""Per inch of what is kept as an image: shades of maps and bodies in space, which as outlines are megabytes."""
THEMED = {"#000000": "currentColor", "#ffffff": "var(--paper)", "#882255": "var(--wine)", "#555555": "var(--link)"}
"""Colours that would not be seen in the dark, and what the page's style has for them."""
NO_METADATA = dict.fromkeys(("Date", "Creator", "Format", "Type"))


def themed(colour: str) -> str:
    """A colour such as #0072B2 as the page has it in the light and in the dark."""
    return THEMED.get(colour.lower(), colour)


def inline_svg(figure: Figure, name: str, words: str) -> Markup:
    """The figure as an `<svg>` element, whose texts are outlines, as they have the same width then on every machine.

    Its identifiers begin with a name that no other figure of the page has; words are for who cannot see it.
    """
    for axes in figure.axes:
        for artist in axes.collections:
            if axes.name == "3d" or (isinstance(artist, ContourSet) and artist.filled):
                artist.set_rasterized(True)
    file = io.StringIO()
    with matplotlib.rc_context({"svg.fonttype": "path", "svg.hashsalt": name}):
        figure.savefig(file, format="svg", facecolor="none", dpi=DOTS, metadata=NO_METADATA)
    text = file.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<!--.*?-->|<metadata>.*?</metadata>|<style.*?</style>", "", text, flags=re.DOTALL)
    referred = set(re.findall(r'(?:href="#|url\(#)([^")]+)', text))
    text = re.sub(r' id="([^"]*)"', lambda found: found[0] if found[1] in referred else "", text)
    text = re.sub(r'( id="|href="#|url\(#)', rf"\g<1>{name}-", text)
    text = re.sub(r"(?<=(?:fill|roke): )#[0-9a-f]{6}", lambda found: themed(found[0]), text)
    text = re.sub(r"\s*\n\s*", "\n", text)
    wide = 96 * figure.get_figwidth()
    start = f'<svg role="img" aria-label="{escape(words)}" style="max-width:{wide:.0f}px"'
    text = re.sub(r"<svg[^>]*?(viewBox=\"[^\"]*\")[^>]*>", lambda found: f"{start} {found[1]}>", text, count=1)
    return Markup(text)
