"""Checks of single values in a study file, and the one line that says what is wrong with one."""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import NoneType, UnionType
from typing import Annotated, Any, ClassVar, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError

from torcharm.inputs import hint


def refuse(text: str, key: str = "") -> PydanticCustomError:
    """An error about the value in hand, or about one of its keys."""
    return PydanticCustomError("study", "{text}", {"text": text, "key": key})


def shown_value(value: object) -> str:
    """A value much as it stands in the file, cut to a readable length."""
    try:
        if isinstance(value, dict):
            text = f"a table with {', '.join(value)}" if value else "an empty table"
        elif isinstance(value, str | bool | list):
            text = json.dumps(value, ensure_ascii=False, default=str)
        else:
            text = str(value)
    except ValueError:  # Python writes out no integer of more than 4300 digits
        text = "a very large number"
    return text if len(text) <= 60 else f"{text[:57]}..."


@dataclass(frozen=True)
class Check(BeforeValidator):
    """A check of a value before pydantic's own.

    Attributes:
        words: what it allows, for messages and for the reference of all keys.
        allowed: the words that it may be, if it is one of some.
    """

    words: str = ""
    allowed: Sequence[str] = ()


def must_be(what: str, good: Callable[[Any], object], allowed: Sequence[str] = ()) -> Check:
    """A value that passes a test, and in words what it must be; the word that was meant is told, if one is near."""

    def check(value: Any) -> Any:
        if not good(value):
            raise refuse(f"must be {what}, got {shown_value(value)}{hint(value, allowed)}")
        return value

    return Check(check, words=what, allowed=allowed)


def one_of(allowed: Sequence[str]) -> Check:
    """One of the words allowed."""
    words = f"one of {', '.join(allowed)}" if len(allowed) > 1 else f'the word "{allowed[0]}"'
    return must_be(words, lambda value: isinstance(value, str) and value in allowed, allowed)


def entries(*forms: Sequence[str]) -> Check:
    """A list with an entry for each name of one of some forms."""
    what = ", or ".join(f"a list of {len(form)}, [{', '.join(form)}]" for form in forms)
    return must_be(what, lambda value: isinstance(value, list) and len(value) in map(len, forms))


def filled(what: str) -> Check:
    """A list with at least one entry."""
    return must_be(what, lambda value: isinstance(value, list) and value)


def either(what: str, *kinds: type) -> Check:
    """A value of one of some kinds."""
    return must_be(what, lambda value: isinstance(value, kinds) and not isinstance(value, bool))


def checked(mistake: Callable[[Any], str | None]) -> AfterValidator:
    """A value as it was read, unless a function tells what is wrong with it."""

    def check(value: Any) -> Any:
        if (words := mistake(value)) is not None:
            raise refuse(words)
        return value

    return AfterValidator(check)


def chosen(choose: Callable[[Any], str], forms: Mapping[str, Any]) -> Any:
    """The type of a value of one of some forms, which a function chooses by name.

    pydantic puts the names into the path of an error, and the brackets tell them from keys there.
    """
    tagged = tuple(Annotated[form, Tag(f"<{name}>")] for name, form in forms.items())
    return Annotated[Union[tagged], Discriminator(lambda value: f"<{choose(value)}>")]  # noqa: UP007


def one_or_list(one: Any, many: Any) -> Any:
    """The type of one value or of a list."""
    return chosen(lambda value: "list" if isinstance(value, list) else "other", {"list": many, "other": one})


def one_key(*keys: str) -> BeforeValidator:
    """A table with exactly one of some keys."""

    def check(value: Any) -> Any:
        found = [key for key in keys if isinstance(value, dict) and key in value]
        if isinstance(value, dict) and len(found) != 1:
            got = f"{' and '.join(found)} together" if found else f"none in {shown_value(value)}"
            raise refuse(f"must have one of {', '.join(keys)}, got {got}")
        return value

    return BeforeValidator(check)


def by_key(models: "Mapping[str, type[Table]]") -> Any:
    """The type of a table of one of some models, which is chosen by the key that it has of theirs."""

    def name(value: Any) -> str:
        return next((key for key in models if isinstance(value, dict) and key in value), next(iter(models)))

    return Annotated[chosen(name, models), one_key(*models)]


def by_kinds(*models: "type[Table]") -> Any:
    """The type of a table of one of some models, which its kind chooses: of those that the models allow."""
    kinds = {kind: model for model in models for kind in _kinds_of(model)}

    def check(value: Any) -> Any:
        if not isinstance(value, dict):
            raise refuse(f"must be a table with a kind ({', '.join(kinds)}), got {shown_value(value)}")
        if "kind" not in value:
            raise refuse(f"missing; must be one of {', '.join(kinds)}; got {shown_value(value)}", "kind")
        kind = value["kind"]
        if not isinstance(kind, str) or kind not in kinds:
            is_path = "file" in kinds and str(kind).endswith(".toml")
            meant = f'; of a file: {{ kind = "file", path = {shown_value(kind)} }}' if is_path else hint(kind, kinds)
            raise refuse(f"must be one of {', '.join(kinds)}, got {shown_value(kind)}{meant}", "kind")
        return value

    return Annotated[chosen(lambda value: str(value["kind"]), kinds), BeforeValidator(check)]


def _kinds_of(model: "type[Table]") -> Sequence[str]:
    return next(part.allowed for part in model.model_fields["kind"].metadata if isinstance(part, Check))


def listed(key: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The path of a value and itself, or those of each of a list."""
    if isinstance(value, list):
        yield from ((field_path([key, index]), one) for index, one in enumerate(value))
    else:
        yield key, value


@dataclass(frozen=True)
class Needed:
    """That a key, left out by default, is required unless others stand in its place, as its description says."""


class Table(BaseModel):
    """A table of the file: unknown and missing keys are found before any value is looked at.

    The text below a key is its description; there are examples if it is required or left out by default.
    """

    stands_alone: ClassVar[bool] = True
    """Whether the table that its examples make can be read as it is: one that names a file cannot."""
    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False, use_attribute_docstrings=True
    )

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            raise refuse(f"must be a table, got {shown_value(value)}")
        allowed = list(cls.model_fields)
        for key in value:
            if key not in allowed:
                raise refuse(f"unknown key{hint(key, allowed) or ';'} allowed: {', '.join(allowed)}", key)
        for key, field in cls.model_fields.items():
            if field.is_required() and key not in value:
                raise refuse(f"missing; must be {allowed_words(field)}", key)
        return value


def allowed_words(field: FieldInfo) -> str:
    """What a key may be, in words, from its checks, its type and its bounds."""
    return _words(field.annotation, field.metadata)


def _words(kind: Any, metadata: Sequence[Any]) -> str:
    flat = [part for one in metadata for part in (one.metadata if isinstance(one, FieldInfo) else (one,))]
    if get_origin(kind) in (Union, UnionType) and NoneType in get_args(kind):
        (kind,) = (choice for choice in get_args(kind) if choice is not NoneType)
    if get_origin(kind) is Annotated:
        kind, *own = get_args(kind)
        return _words(kind, [*flat, *own])
    words = next((part.words for part in flat if isinstance(part, Check) and part.words), _TYPES.get(kind, ""))
    if get_origin(kind) is list and (each := _words(get_args(kind)[0], ())) not in ("", _TYPES[float]):
        words = f"{words}, each {each}" if words else f"a list of {each}"
    bounds = [
        text.format(**{key: getattr(part, key)}) for part in flat for key, text in _BOUNDS.items() if hasattr(part, key)
    ]
    return f"{words}, {' and '.join(bounds)}" if bounds else words


_TYPES = {float: "a number", int: "a whole number", bool: "true or false", str: "a text in quotes"}
_BOUNDS = {"gt": "above {gt:g}", "ge": "at least {ge:g}", "lt": "below {lt:.15g}", "le": "at most {le:.15g}"}

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Seed = Annotated[int, Field(ge=0, lt=2**32)]
Name = Annotated[
    str,
    must_be(
        "a text of one line that is not blank",
        lambda value: isinstance(value, str) and value.strip() and value.isprintable(),
    ),
]
ENDS = entries(("lowest", "highest"))
ORDERED = checked(lambda ends: None if ends[0] < ends[1] else f"must be [lowest, highest], got {shown_value(ends)}")
Range = Annotated[list[float], ENDS, ORDERED]

# Messages

_ALLOWED = dict(zip(("float_type", "int_type", "bool_type", "string_type"), _TYPES.values(), strict=True))
_ALLOWED |= {"list_type": "a list", "finite_number": "a finite number"}
_COMPARED = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")
_ALLOWED |= dict(zip(_COMPARED, _BOUNDS.values(), strict=True))
"""By pydantic's names of errors."""


def validated(kind: Any, value: Any, within: Sequence[int | str] = ()) -> Any:
    """What is read from a value of some type at a path.

    Raises:
        ValueError: `path: what is allowed, what was given` of the first mistake.
    """
    try:
        return TypeAdapter(kind).validate_python(value)
    except ValidationError as error:
        mistake = error.errors(include_url=False)[0]
    context = mistake.get("ctx", {})
    keys = [part for part in mistake["loc"] if not str(part).startswith("<")]
    path = [*within, *keys, *filter(None, [context.get("key")])]
    raise ValueError(one_line(f"{field_path(path)}: {_what_is_wrong(mistake, context)}{_whose(keys, value)}"))


def _what_is_wrong(mistake: ErrorDetails, context: Mapping[str, Any]) -> str:
    if mistake["type"] == "study":
        return str(context["text"])
    if mistake["type"] not in _ALLOWED:
        return f"{mistake['msg']}, got {shown_value(mistake['input'])}"
    return f"must be {_ALLOWED[mistake['type']].format(**context)}, got {shown_value(mistake['input'])}"


def field_path(keys: Sequence[int | str]) -> str:
    """`arm[1].length[2]` from ("arm", 0, "length", 1)."""
    parts = [f"[{key + 1}]" if isinstance(key, int) else f".{_bare(key)}" for key in keys]
    return "".join(parts).removeprefix(".")


def _bare(key: str) -> str:
    return key if re.fullmatch(r"[\w-]+", key) else json.dumps(key, ensure_ascii=False)


def _whose(keys: Sequence[int | str], raw: Mapping[str, Any]) -> str:
    """The name of the arm or task that a path leads into, so that nobody has to count."""
    if len(keys) < 2 or not isinstance(keys[1], int) or keys[-1] == "name":
        return ""
    entry = raw[str(keys[0])][keys[1]]
    name = entry.get("name") if isinstance(entry, dict) else None
    return f" (in {shown_value(name)})" if isinstance(name, str) else ""


def one_line(text: str) -> str:
    """The text with its white space folded."""
    return " ".join(text.split())


@contextmanager
def within(path: str, name: str = "") -> Iterator[None]:
    """Put a path before the field that a ValueError names."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{path}.{error}{name and f' (in {shown_value(name)})'}") from None
