"""What counts as numbers in what an estimator returns: in a run and in a check alike."""

from typing import Any

import numpy as np

from castor_envs.geometry.arrays import Array


def real_numbers(given: Any, shape: tuple[int, ...]) -> Array:
    """Return real numbers of any type and of a shape as float64, copied.

    Raises ValueError for anything else: "NoneType instead of (3,) numbers".
    """
    try:
        array = np.asarray(given)
    except (TypeError, ValueError):
        array = np.empty(shape, dtype=object)
    if array.dtype.kind == "c":
        raise ValueError(f"complex numbers instead of {shape} real ones")
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{type(given).__name__} instead of {shape} numbers")
    if array.shape != shape:
        raise ValueError(f"shape {array.shape} instead of {shape}")
    return array.astype(float)
