"""A sheet to draw on with pygame: smooth edges, no display needed, the same pixels for the same strokes.

Everything is drawn `OVERSAMPLING` times larger and scaled down at the end. Coordinates are pixels of the finished picture,
x to the right and y down, and need not be whole.
"""

import os
import warnings
from collections.abc import Sequence
from types import ModuleType
from typing import Any, Literal

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import ArrayLike, NDArray

Color = tuple[int, int, int]
Shape = tuple[ArrayLike, Color, int]

OVERSAMPLING = 2


def import_pygame() -> ModuleType:
    """Return pygame, imported without its greeting and without warnings of what it imports itself.

    Raises gymnasium.error.DependencyNotInstalled where there is none.
    """
    greeted = "PYGAME_HIDE_SUPPORT_PROMPT" in os.environ
    os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import pygame
    except ImportError as error:
        raise DependencyNotInstalled("rendering needs pygame: run `pip install pygame`") from error
    finally:
        if not greeted:
            del os.environ["PYGAME_HIDE_SUPPORT_PROMPT"]
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
        whole = self._whole(points)
        wide = max(1, round(width * OVERSAMPLING))
        if len(whole) > 1:
            self._pygame.draw.lines(self._large, color, False, whole, wide)
        if wide > 2 and whole:
            way = np.diff(np.array(whole, dtype=float), axis=0)
            way /= np.maximum(np.hypot(*way.T)[:, None], 1e-9)
            bends = np.flatnonzero(np.sum(way[1:] * way[:-1], axis=1) < 0.97) + 1
            for k in {0, len(whole) - 1, *bends.tolist()}:
                self._pygame.draw.circle(self._large, color, whole[k], wide / 2)

    def disc(self, center: ArrayLike, radius: float, color: Color, *, ring: float = 0.0) -> None:
        """Fill a disc; with `ring` only the outermost pixels, so many."""
        whole = self._whole([center])[0]
        large = max(1.0, radius * OVERSAMPLING)
        self._pygame.draw.circle(self._large, color, whole, large, round(ring * OVERSAMPLING))

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
        # Font objects do not outlive a pygame.quit() by whoever else uses pygame, so none is kept.
        pygame.font.init()
        path = os.path.join(os.path.dirname(pygame.__file__), pygame.font.get_default_font())
        drawn = pygame.font.Font(path, max(4, round(height * OVERSAMPLING))).render(words, True, color)
        width = drawn.get_width() / OVERSAMPLING
        left = at[0] - {"left": 0.0, "center": 0.5, "right": 1.0}[anchor] * width
        (corner,) = self._whole([(left, at[1] - drawn.get_height() / OVERSAMPLING / 2)])
        self._large.blit(drawn, corner)
        return width

    def _whole(self, points: ArrayLike) -> list[list[int]]:
        """Return points in whole pixels of the large sheet; those far outside are brought near, as SDL counts in short."""
        far = 4 * OVERSAMPLING * max(self.size)
        return np.rint(np.clip(np.asarray(points, dtype=float) * OVERSAMPLING, -far, far)).astype(int).tolist()
