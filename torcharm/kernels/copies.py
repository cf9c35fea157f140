"""Copies by loops: numba's own bring code that words an error of shapes, which takes long to compile."""

from torcharm._arrays import Array
from torcharm.engine.compilation import inlined


@inlined
def put(target: Array, source: Array) -> None:
    """Set a vector."""
    for i in range(target.shape[0]):
        target[i] = source[i]


@inlined
def put_all(target: Array, source: Array) -> None:
    """Set a matrix."""
    for i in range(target.shape[0]):
        for j in range(target.shape[1]):
            target[i, j] = source[i, j]
