"""A study with every key that there is: made from the tables' own descriptions, defaults and examples."""

import textwrap
from collections.abc import Iterator
from typing import Any, get_args, get_origin

from pydantic.fields import FieldInfo

from torcharm.characterise.toml_text import toml_value
from torcharm.study.fields import Needed, Table, allowed_words
from torcharm.study.tables import StudyTable

WIDTH = 110
"""Of comments."""
HEAD = """\
# Every key that a study may have: what it means, what it may be, and what it is by default.
#
# A line that begins with # and no space after it is left out: remove the # to use it. Where it stands below a line
# or a table of the same key, it is an alternative: put the # there instead.
"""


def key_reference() -> str:
    """The text of a study that is valid as it is and holds every key, those that exclude others as comments."""
    return f"{HEAD}\n" + "\n".join(_table(StudyTable, "", "", True, set())) + "\n"


def _table(model: type[Table], path: str, brackets: str, used: bool, known: set[type]) -> Iterator[str]:
    """The lines of a table: its heading, its keys, and the tables in it; each model's keys where it comes first."""
    known.update(model.__mro__)  # a model with all keys of another stands for that, too
    mark = "" if used else "#"
    if path:
        yield ""
        yield from _comment(model.__doc__ or "")
        yield f"{mark}{brackets}{path}{brackets.translate({91: 93})}"
    inner: list[str] = []
    for key, field in sorted(model.model_fields.items(), key=lambda item: not _is_required(item[1])):
        new = [one for one in dict.fromkeys(_models(field.annotation)) if one not in known]
        is_list = any(get_origin(kind) is list for kind in (field.annotation, *get_args(field.annotation)))
        stands = used and (field.is_required() or field.default is not None)
        for index, one in enumerate(new):  # of a list each, or else the first, and the others as comments
            shown = stands and one.stands_alone and (is_list or index == 0)
            inner += _table(one, f"{path}.{key}".removeprefix("."), "[[" if is_list else "[", shown, known)
        if field.examples or not new:
            yield from _entry(key, field, mark, instead=bool(new))
    yield from inner


def _entry(key: str, field: FieldInfo, mark: str, instead: bool) -> Iterator[str]:
    """A key's meaning, its value by default or else by the first example, and other examples as comments.

    Args:
        instead: whether a table serves instead, so that all examples are alternatives.
    """
    examples = list(field.examples or ())
    if _is_required(field):
        default, values = "Required.", [] if instead else examples[:1]
        others = examples[len(values) :]
    elif field.default is None:
        default, values, others = "Left out by default.", [], examples
    else:
        default, values, others = f"Default: {toml_value(field.default)}.", [field.default], examples
    allowed = allowed_words(field)
    words = f"{allowed[:1].upper()}{allowed[1:]}. " if allowed else ""
    yield from _comment(field.description or "")
    yield from _comment(f"{words}{default}")
    yield from (f"{mark}{key} = {toml_value(value)}" for value in values)
    yield from (f"#{key} = {toml_value(value)}" for value in others)


def _is_required(field: FieldInfo) -> bool:
    return field.is_required() or any(isinstance(part, Needed) for part in field.metadata)


def _comment(text: str) -> list[str]:
    return textwrap.wrap(text, WIDTH, initial_indent="# ", subsequent_indent="# ", break_long_words=False)


def _models(kind: Any) -> Iterator[type[Table]]:
    """The models of which a key's tables may be."""
    if isinstance(kind, type) and issubclass(kind, Table):
        yield kind
    for part in get_args(kind):
        yield from _models(part)
