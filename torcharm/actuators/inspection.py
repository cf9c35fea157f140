"""What may be believed of a model from how it is written, and which models are the same."""

from dataclasses import fields, is_dataclass
from functools import cached_property
from typing import Any

import numpy as np

PLAIN = (bool, int, float, complex, str, bytes, type(None))
"""Values that are the same wherever they are equal."""


def written_out(model: object, name: str, of: str = "force") -> bool:
    """Whether a model's member `name`, which says something of its `of`, was written for the one that it has.

    A class that overrides `force` alone inherits what its parent wrote of another force. So a member counts only if
    the class that defines it is the one that defines the force, or one derived from it; and if the force
    was set on the object itself, only if the member was, too. Members that a model merely forwards to
    another object (by `__getattr__`) do not count.
    """
    own, kind = getattr(model, "__dict__", {}), type(model)
    defining, declaring = _definitions(kind, of), _definitions(kind, name)
    if of in own and of not in getattr(kind, "__dataclass_fields__", {}):
        return name in own and not declaring
    if not defining or getattr(model, name, None) is None:
        return False
    if declaring:
        return declaring[0] <= defining[0]
    return name in own and len(defining) == 1  # set in a constructor: whose, cannot be told once a class overrides


def _definitions(kind: type, name: str) -> tuple[int, ...]:
    """Which of a class and its bases, from the most derived, define a member: as a field, or not as abstract."""
    found, classes = [], kind.__mro__
    for place, one in enumerate(classes):
        field, *inherited = (vars(each).get("__dataclass_fields__", {}).get(name) for each in classes[place:])
        if field is not None and not any(field is other for other in inherited):
            found.append(place)
        elif name in vars(one) and not vars(one).get("_is_protocol", False):
            found += [place] * (not getattr(vars(one)[name], "__isabstractmethod__", False))
    return tuple(found)


def follows(model: object, kind: type, *names: str) -> bool:
    """Whether a model is of a class, and these members are the class's own: not overridden, nor set on the object."""
    own = getattr(model, "__dict__", {})
    return isinstance(model, kind) and all(
        getattr(type(model), name) is getattr(kind, name) and name not in own for name in names
    )


def same_model(one: object, other: object) -> bool:
    """Whether two models may be evaluated as one: the same object, or dataclasses of one class and of equal data.

    Plain data: numbers, texts, tuples of them and dataclasses of these, all attributes counted and not only fields.
    Tensors, functions and all other objects are the same only if they are one object, whatever `==` says of them: two
    parameters of equal value are two parameters.
    """
    if one is other:
        return True
    kind = type(one)
    if kind is not type(other):
        return False
    if kind in PLAIN or isinstance(one, np.generic):
        return bool(one == other)
    if isinstance(one, (tuple, list)) and isinstance(other, (tuple, list)):
        return len(one) == len(other) and all(map(same_model, one, other))
    if isinstance(one, dict) and isinstance(other, dict):
        return one.keys() == other.keys() and all(same_model(value, other[key]) for key, value in one.items())
    return is_dataclass(kind) and same_model(_data(one), _data(other))


def holds_numbers_only(value: object) -> bool:
    """Whether a model is one of this package's, of plain data throughout: then nothing in it asks for a gradient."""
    kind = type(value)
    if kind in PLAIN:
        return True
    if kind is tuple:
        return all(map(holds_numbers_only, value))  # type: ignore[call-overload]
    if not (kind.__module__.startswith("torcharm.") and is_dataclass(kind)):
        return False
    return all(map(holds_numbers_only, _data(value).values()))


def _data(model: Any) -> dict[str, Any]:
    """The attributes of a dataclass, but for what it derives from them and keeps."""
    kept = {
        name: value
        for name, value in getattr(model, "__dict__", {}).items()
        if not isinstance(getattr(type(model), name, None), cached_property)
    }
    for field in fields(model):  # those in slots
        if field.name not in kept:
            kept[field.name] = getattr(model, field.name, None)
    return kept
