"""What kernels take: arrays and numbers, declared where a kernel is used."""

from typing import Any, NamedTuple

import numpy as np


class Argument(NamedTuple):
    """What a kernel takes at a place: an array, contiguous in C's order, or a number (no dimension)."""

    dtype: np.dtype
    dimensions: int = 0


INTEGER, REAL = Argument(np.dtype(np.int64)), Argument(np.dtype(np.float64))


def array(dtype: Any, dimensions: int) -> Argument:
    """Return the argument that is an array."""
    return Argument(np.dtype(dtype), dimensions)
