"""Arrays in named tuples: a field's annotation says their kind and shape, of which room for them is made."""

from collections import Counter
from collections.abc import Callable, Mapping
from functools import lru_cache, partial
from typing import Any, TypeVar

import numpy as np

Array = np.ndarray[Any, np.dtype[Any]]  # jaxtyping takes no NDArray[Any], which is a type alias as of numpy 2.5
T = TypeVar("T")
Sizes = tuple[tuple[str, int], ...]


def make(kind: type[T], sizes: Mapping[str, int], **given: Any) -> T:
    """A named tuple of zeros, and of tuples within that are made alike.

    Args:
        kind: a class whose fields are of such, or annotated as arrays, `Float64[Array, "N 1+M"]`.
        sizes: the numbers that the names in shapes stand for; {} if nothing is asked for, as if all were 0.
        given: fields that are there already.
    """
    makers = _makers(kind, tuple(sizes.items()), tuple(given))  # type: ignore[arg-type]  # a class can be hashed
    return kind(**given, **{name: make_one() for name, make_one in makers})


def row_of(record: T, b: int) -> T:
    """Of a named tuple of B arms one of them, as B = 1: its row of each field whose shape begins with B."""
    shapes = {name: getattr(one, "dim_str", "").split() for name, one in type(record).__annotations__.items()}
    rows = {name: getattr(record, name)[b : b + 1] for name, shape in shapes.items() if shape[:1] == ["B"]}
    return record._replace(**rows)  # type: ignore[attr-defined]  # named tuples have it


@lru_cache(maxsize=256)
def _makers(kind: Any, sizes: Sizes, given: tuple[str, ...]) -> list[tuple[str, Callable[[], Any]]]:
    """What makes each field that is not given."""
    return [(name, _maker(one, sizes)) for name, one in kind.__annotations__.items() if name not in given]


def _maker(annotation: Any, sizes: Sizes) -> Callable[[], Any]:
    if hasattr(annotation, "_fields"):
        return partial(make, annotation, dict(sizes))
    numbers = dict(sizes) or Counter()
    shape = tuple(eval(size, {}, numbers) for size in annotation.dim_str.split())
    return partial(np.zeros, shape, np.dtype(annotation.dtypes[0]))
