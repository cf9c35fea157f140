"""The page: sections laid out by a template that escapes all texts, under a policy that lets nothing reach out."""

import base64
import hashlib
import platform
import unicodedata
from collections.abc import Callable
from importlib import resources
from importlib.metadata import version
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from torcharm.report.content import Evaluated
from torcharm.report.sections import SECTIONS

FILES = ("style.css", "copy.js")
PACKAGES = ("torcharm", "torch", "numba", "numpy")
"""Whose versions the report tells."""


def study_report(evaluated: Evaluated, advance: Callable[[], object] = lambda: None) -> str:
    """The whole report as HTML, the same for the same input.

    Args:
        evaluated: a study and its results, one or more.
        advance: called after each of `SECTIONS`.

    Raises:
        ValueError: there are no results.
    """
    if not evaluated.results:
        raise ValueError("results: must be one or more, got none")
    sections = []
    for make in SECTIONS:
        sections.append(make(evaluated))
        advance()
    style, script = (resources.files("torcharm.report").joinpath(name).read_text("utf-8") for name in FILES)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return _template().render(
        evaluated=evaluated,
        versions=[*((name, version(name)) for name in PACKAGES), ("Python", platform.python_version())],
        sections=[section for section in sections if section is not None],
        style=Markup(style),
        script=Markup(script),
        # The page's own script runs, and no other one, even if a name were ever read as one.
        policy=f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'; "
        "base-uri 'none'; form-action 'none'",
    )


def _template() -> Any:
    options: dict[str, Any] = {"trim_blocks": True, "lstrip_blocks": True, "undefined": StrictUndefined}
    loader = PackageLoader("torcharm.report", "")
    return Environment(loader=loader, autoescape=True, finalize=_printable, **options).get_template("report.html.j2")


def _printable(value: Any) -> Any:
    """A text without control characters, which HTML does not allow, and without halves of characters."""
    if not isinstance(value, str) or isinstance(value, Markup):
        return value
    return "".join(
        "\ufffd" if unicodedata.category(one) in ("Cc", "Cs") and one not in "\n\t" else one for one in value
    )
