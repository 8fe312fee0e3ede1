"""Where the places of N are in the picture."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array


@dataclass(frozen=True)
class View:
    """A view of an arena, from above.

    size: of the picture with the caption below it, width and height in pixels. arena: x_min, x_max, y_min, y_max, m;
    all of it is seen, in the middle, at one scale.
    """

    size: tuple[int, int]
    arena: tuple[float, float, float, float]

    def __post_init__(self):
        x_min, x_max, y_min, y_max = self.arena
        if not (x_min < x_max and y_min < y_max and all(map(math.isfinite, self.arena))):
            raise InputError(
                f"arena must be (x_min, x_max, y_min, y_max) with each min below its max, got {self.arena}"
            )
        if min(self.size) < 100:
            raise InputError(f"a picture needs at least 100 x 100 pixels, got {self.size}")

    @property
    def unit(self) -> float:
        """What is one pixel wide in a picture of 800 x 800, px: the measure of lines, letters and margins."""
        return max(min(self.size) / 800, 0.6)

    @property
    def bottom(self) -> float:
        """How far down the view reaches; the caption is below, px."""
        return self.size[1] - 48 * self.unit

    @property
    def scale(self) -> float:
        """Pixels a metre."""
        x_min, x_max, y_min, y_max = self.arena
        margin = 24 * self.unit
        return min((self.size[0] - margin) / (x_max - x_min), (self.bottom - margin) / (y_max - y_min))

    def pixel(self, points: ArrayLike) -> Array:
        """Return where points (..., 2) of N are: x to the right and y down, in pixels from the upper left corner."""
        x_min, x_max, y_min, y_max = self.arena
        middle = np.array([(x_min + x_max) / 2, (y_min + y_max) / 2])
        center = np.array([self.size[0] / 2, self.bottom / 2])
        return center + (np.asarray(points, dtype=float) - middle) * (self.scale, -self.scale)

    def place(self, pixels: ArrayLike) -> Array:
        """Return which points of N are seen at `pixels` (..., 2): the inverse of `pixel`."""
        origin = self.pixel((0.0, 0.0))
        return (np.asarray(pixels, dtype=float) - origin) / (self.scale, -self.scale)
