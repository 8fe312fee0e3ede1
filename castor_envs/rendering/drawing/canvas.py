"""A sheet to draw on with pygame: smooth edges, no display needed, the same pixels for the same strokes.

Everything is drawn `OVERSAMPLING` times larger and scaled down at the end. Coordinates are pixels of the finished
picture, x to the right and y down from its upper left corner, and need not be whole.
"""

import warnings
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import ArrayLike, NDArray

from castor_envs.rendering.drawing.palette import Color

Shape = tuple[ArrayLike, Color, int]

OVERSAMPLING = 2

_TURN = np.linspace(0.0, 2 * np.pi, 32, endpoint=False)
_CIRCLE = np.stack([np.cos(_TURN), np.sin(_TURN)], axis=1)


def import_pygame() -> ModuleType:
    """Return pygame, imported without the warnings of what it imports itself (its greeting Gymnasium has turned off).

    Raises gymnasium.error.DependencyNotInstalled where there is none.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import pygame
    except ImportError as error:
        raise DependencyNotInstalled("rendering needs pygame: run `pip install pygame`") from error
    return pygame


class Canvas:
    """A picture of `size` (width, height) pixels in the making.

    Colours are (red, green, blue); `alpha` runs from 0 (invisible) to 255.
    """

    def __init__(self, size: tuple[int, int], ground: Color) -> None:
        self._pygame = import_pygame()
        self.size = size
        large = (size[0] * OVERSAMPLING, size[1] * OVERSAMPLING)
        # A stated depth: the default is that of the window, where one is open.
        self._large = self._pygame.Surface(large, 0, 32)
        self._picture = self._pygame.Surface(size, 0, 32)
        self._large.fill(ground)
        self._kept = self._large.copy()

    def keep(self) -> None:
        """Keep what is drawn so far as the background of every picture to come."""
        self._kept.blit(self._large, (0, 0))

    def restart(self) -> None:
        """Go back to the background."""
        self._large.blit(self._kept, (0, 0))

    def finished(self) -> Any:
        """Return the picture as a pygame surface."""
        return self._pygame.transform.smoothscale(self._large, self.size, self._picture)

    def pixels(self) -> NDArray[np.uint8]:
        """Return the picture as an array (height, width, 3)."""
        data = self._pygame.image.tobytes(self.finished(), "RGB")
        return np.frombuffer(data, np.uint8).reshape(self.size[1], self.size[0], 3).copy()

    def polygon(self, points: ArrayLike, color: Color) -> None:
        """Fill a polygon (k, 2)."""
        self._pygame.draw.polygon(self._large, color, self._whole(points))

    def layer(self, shapes: Sequence[Shape]) -> None:
        """Blend polygons (points, color, alpha) in as one layer, in which later ones replace what they cover."""
        corners = [np.array(self._whole(points)) for points, _, _ in shapes]
        everything = np.concatenate(corners)
        low = np.maximum(everything.min(axis=0), 0)
        high = np.minimum(everything.max(axis=0) + 1, self._large.get_size())
        if np.any(high <= low):
            return
        sheet = self._pygame.Surface((high - low).tolist(), self._pygame.SRCALPHA, 32)
        for points, (_, color, alpha) in zip(corners, shapes, strict=True):
            self._pygame.draw.polygon(sheet, (*color, alpha), (points - low).tolist())
        self._large.blit(sheet, low.tolist())

    def line(self, points: ArrayLike, color: Color, width: float) -> None:
        """Draw a polyline (k, 2) with round ends and corners."""
        pixels = self._whole(points)
        half = max(0, round((width * OVERSAMPLING - 1) / 2))
        if len(pixels) > 1:
            # An odd width: pygame centres only those on the line.
            self._pygame.draw.lines(self._large, color, False, pixels, 2 * half + 1)
        if half > 0:
            way = np.diff(np.array(pixels, dtype=float), axis=0)
            way /= np.maximum(np.hypot(*way.T)[:, None], 1e-9)
            bends = np.flatnonzero(np.sum(way[1:] * way[:-1], axis=1) < 0.97) + 1
            for k in {0, len(pixels) - 1, *bends.tolist()}:
                self._round(pixels[k], half, color)

    def disc(self, center: ArrayLike, radius: float, color: Color) -> None:
        """Fill a disc."""
        (pixel,) = self._whole(np.reshape(center, (1, 2)))
        self._round(pixel, radius * OVERSAMPLING - 0.5, color)

    def text(
        self,
        words: str,
        at: tuple[float, float],
        height: float,
        color: Color,
        anchor: Literal["left", "center", "right"] = "left",
    ) -> float:
        """Write one line with its left end, middle or right end `at`; return its width in pixels."""
        pygame = self._pygame
        # Font objects do not outlive a pygame.quit(), which other users of pygame may call, so none is kept.
        pygame.font.init()
        path = Path(str(pygame.__file__)).parent / pygame.font.get_default_font()
        drawn = pygame.font.Font(path, max(4, round(height * OVERSAMPLING))).render(words, True, color)
        width = drawn.get_width() / OVERSAMPLING
        left = at[0] - {"left": 0.0, "center": 0.5, "right": 1.0}[anchor] * width
        (corner,) = self._whole([(left, at[1] - drawn.get_height() / OVERSAMPLING / 2)])
        self._large.blit(drawn, corner)
        return width

    def _round(self, center: list[int], radius: float, color: Color) -> None:
        """Fill a disc on the large sheet, as a polygon: pygame's circles stand half a pixel off their centre."""
        corners = np.rint(max(radius, 0.5) * _CIRCLE).astype(int) + center
        self._pygame.draw.polygon(self._large, color, corners.tolist())

    def _whole(self, points: ArrayLike) -> list[list[int]]:
        """Return in which pixels of the large sheet points (k, 2) lie; those far outside are brought nearer.

        Pygame multiplies two coordinates in 32 bits.
        """
        far = 20_000
        large = np.clip(np.asarray(points, dtype=float) * OVERSAMPLING, -far, far)
        return np.floor(large).astype(int).tolist()
