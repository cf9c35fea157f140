"""A study with every key that there is: made from the tables' own descriptions, defaults and examples."""

import textwrap
from collections.abc import Iterator
from types import NoneType
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
    return f"{HEAD}\n" + "\n".join(_Writer().table(StudyTable, "", "", used=True)) + "\n"


class _Writer:
    """Writes tables, each model's keys where the model comes first."""

    def __init__(self) -> None:
        self._known: set[type] = set()

    def table(self, model: type[Table], path: str, brackets: str, used: bool) -> Iterator[str]:
        """The lines of a table: its heading, its keys, and the tables in it."""
        self._known.update(model.__mro__)  # a model with all keys of another stands for that, too
        mark = "" if used else "#"
        if path:
            yield ""
            yield from _comment(model.__doc__ or "")
            yield f"{mark}{brackets}{path}{brackets.translate({91: 93})}"
        inner: list[str] = []
        for key, field in sorted(model.model_fields.items(), key=lambda item: not _is_required(item[1])):
            new = [one for one in _models(field) if one not in self._known]
            if new:
                inner += self._tables(new, key, field, path, used)
            if field.examples or not new:
                yield from _entry(key, field, mark, instead=bool(new))
        yield from inner

    def _tables(self, models: list[type[Table]], key: str, field: FieldInfo, path: str, used: bool) -> Iterator[str]:
        """A key's tables: of a list each model once, or else one model, the others as comments."""
        listed = _is_list(field)
        optional = not field.is_required() and field.default is None
        for index, model in enumerate(models):
            shown = used and not optional and model.stands_alone and (listed or index == 0)
            yield from self.table(model, f"{path}.{key}".removeprefix("."), "[[" if listed else "[", shown)


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


def _models(field: FieldInfo) -> list[type[Table]]:
    """The models of which a key's tables may be, each once."""
    return list(dict.fromkeys(_found(field.annotation)))


def _found(kind: Any) -> Iterator[type[Table]]:
    if isinstance(kind, type) and issubclass(kind, Table):
        yield kind
    for part in get_args(kind):
        yield from _found(part)


def _is_list(field: FieldInfo) -> bool:
    kind = field.annotation
    given = [part for part in get_args(kind) if part is not NoneType]
    return get_origin(given[0] if NoneType in get_args(kind) and len(given) == 1 else kind) is list
