"""What comes from an agent: checked before it is used."""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array


def finite(values: ArrayLike, shape: tuple[int, ...] | None, title: str) -> Array:
    """Return an array of finite numbers; raises InputError for anything else or another shape."""
    array = np.asarray(values, dtype=float)
    if array.shape != shape:
        raise InputError(f"{title} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{title} must be finite, got {array}")
    return array
