"""What comes from an agent: checked before it is used."""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import InputError, shortened
from castor_envs.geometry.arrays import Array


def finite(values: ArrayLike, shape: tuple[int, ...] | None, title: str) -> Array:
    """Return an array of finite real numbers; raises InputError for anything else or another shape."""
    try:
        given = np.asarray(values)
    except ValueError:
        raise InputError(f"{title} must have shape {shape}, got {shortened(repr(values), 60)}") from None
    if given.dtype.kind not in "biuf":
        raise InputError(f"{title} must be real numbers, got an array of {given.dtype}")
    array = given.astype(float, copy=False)
    if array.shape != shape:
        raise InputError(f"{title} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{title} must be finite, got {array}")
    return array
