"""What to think of equilibria and of what is found along them, in words."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor


def status_word(words: Sequence[str], *flags: Tensor) -> str | NDArray[Any]:
    """The word of the last flag (*batch) that is not set, or the first word if all are: one, or an array of them.

    Args:
        words: one for each flag, behind that for none.
        flags: each of which counts for more than those before it.
    """
    code = np.zeros(flags[0].shape, int)
    for rank, flag in enumerate(flags, 1):
        code = np.where(flag.numpy(force=True), code, rank)
    return words[int(code)] if code.ndim == 0 else np.array(words)[code]
