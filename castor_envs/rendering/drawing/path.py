"""A path that grows, kept as a polyline of few corners."""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array


class Path:
    """Corners of a path in N.

    pixel: the size of a pixel, m. Places that would not change the picture visibly do not become corners.
    """

    def __init__(self, pixel: float) -> None:
        self._pixel = pixel
        self._corners: list[Array] = []

    def __len__(self) -> int:
        return len(self._corners)

    @property
    def corners(self) -> Array:
        """The corners (k, 2) in N, m."""
        return np.array(self._corners).reshape(-1, 2)

    def lengthen(self, place: ArrayLike) -> None:
        """Extend the path in a straight line to a place (2,) in N."""
        place = np.array(place, dtype=float)
        if self._corners:
            ahead = (place - self._corners[-1]) / self._pixel
            if np.hypot(*ahead) < 0.25:
                return
            if len(self._corners) > 1:
                behind = (self._corners[-1] - self._corners[-2]) / self._pixel
                chord = ahead + behind
                aside = abs(chord[0] * behind[1] - chord[1] * behind[0]) / max(float(np.hypot(*chord)), 1e-9)
                # Short steps only, or many slight bends in a row would add up.
                if np.hypot(*behind) < 8.0 and aside < 0.25 and ahead @ behind > 0:
                    self._corners.pop()
        self._corners.append(place)


def evenly(polyline: Array, step: float) -> Array:
    """Return points (k, 2) along a polyline (n, 2), `step` apart from its start; not above some 5000."""
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(polyline, axis=0).T))])
    at = np.arange(0.0, length[-1] + 1e-9, max(step, length[-1] / 5000))
    return np.stack([np.interp(at, length, polyline[:, 0]), np.interp(at, length, polyline[:, 1])], axis=1)
