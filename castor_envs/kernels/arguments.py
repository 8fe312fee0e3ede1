"""What kernels take: arrays and numbers, declared where a kernel is used."""

import math
from typing import Any, NamedTuple

import numpy as np


class Argument(NamedTuple):
    """What a kernel takes at a place: an array, contiguous in C's order, or a number (no dimension)."""

    dtype: np.dtype
    dimensions: int = 0


LINE = 64
"""Bytes of a line of memory."""

INTEGER, REAL = Argument(np.dtype(np.int64)), Argument(np.dtype(np.float64))


def array(dtype: Any, dimensions: int) -> Argument:
    """Return the argument that is an array."""
    return Argument(np.dtype(dtype), dimensions)


def in_lanes(dtype: Any, lanes: int) -> np.dtype:
    """Return what holds a number, or a record, of each of so many lanes: reals once a lane, integers once for all.

    Reals of a record stand in rows of 8 bytes a lane.
    """
    dtype = np.dtype(dtype)
    if dtype.names is None:
        return np.dtype((dtype, (lanes,))) if dtype.kind == "f" else dtype
    formats, offsets, place, row = [in_lanes(dtype[name], lanes) for name in dtype.names], [], 0, 8 * lanes
    for kind in formats:
        if kind.subdtype is not None:
            place += -place % row
        offsets.append(place)
        place += kind.itemsize
    names = list(dtype.names)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": place + -place % row})


def aligned(shape: tuple[int, ...], dtype: Any = float) -> Any:
    """Return zeros that begin with a line of memory, so that a register of lanes is in one line."""
    dtype = np.dtype(dtype)
    size = math.prod(shape) * dtype.itemsize
    room = np.zeros(size + LINE, dtype=np.uint8)
    start = -room.ctypes.data % LINE
    return room[start : start + size].view(dtype).reshape(shape)
