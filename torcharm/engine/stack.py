"""Small arrays on the stack: compiled functions keep them in registers where loops over them are written out.

Arrays in memory are written and read again at each step of a recursion, since one might be part of another; that takes
several times as long as the arithmetic.
"""

from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import config, types
from numba.core import cgutils
from numba.core.extending import intrinsic
from numba.np.arrayobj import make_array, populate_array

LARGEST = 6
"""Numbers of a twist in space."""


def _on_the_stack(*shape: int) -> Any:
    switches: Any = config
    if switches.DISABLE_JIT:
        return lambda: np.empty(shape)
    kind = types.Array(types.float64, len(shape), "C")

    @intrinsic
    def small_array(typing: Any) -> Any:
        def make(context: Any, builder: Any, signature: Any, _: Any) -> Any:
            place = cgutils.alloca_once(builder, ir.ArrayType(ir.DoubleType(), int(np.prod(shape))))
            whole = context.get_constant
            steps = [8 * int(np.prod(shape[k + 1 :])) for k in range(len(shape))]
            array = make_array(kind)(context, builder)
            populate_array(
                array,
                data=builder.bitcast(place, ir.DoubleType().as_pointer()),
                shape=[whole(types.intp, n) for n in shape],
                strides=[whole(types.intp, n) for n in steps],
                itemsize=whole(types.intp, 8),
                meminfo=None,
            )
            return array._getvalue()

        return kind(), make

    return small_array


small_vector = _on_the_stack(LARGEST)
small_matrix = _on_the_stack(LARGEST, LARGEST)
