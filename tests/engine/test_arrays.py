"""Room for arrays is made of what annotations say."""

from typing import NamedTuple

import numpy as np
import pytest
from jaxtyping import Bool, Float64, Int64

from torcharm.engine.arrays import Array, make


class Inner(NamedTuple):
    flag: Bool[Array, "1"]
    square: Float64[Array, "2*D-1 2*D"]


class Outer(NamedTuple):
    inner: Inner
    count: Int64[Array, "1+M D"]
    weight: Float64[Array, "unknown"]


def test_each_field_has_its_kind_and_shape_and_an_array_of_its_own():
    weight = np.ones(4)
    made = make(Outer, {"D": 3, "M": 5}, weight=weight)
    assert made.weight is weight
    assert made.count.shape == (6, 3)
    assert made.count.dtype == np.int64
    assert made.inner.flag.dtype == np.bool_
    assert made.inner.square.shape == (5, 6)
    assert not made.inner.square.any()
    assert make(Outer, {"D": 3, "M": 5}, weight=weight).count is not made.count


def test_nothing_takes_no_room_and_a_size_that_is_missing_is_named():
    assert make(Outer, {}, inner=None).weight.shape == (0,)
    with pytest.raises(NameError, match="unknown"):
        make(Outer, {"D": 3, "M": 5})
