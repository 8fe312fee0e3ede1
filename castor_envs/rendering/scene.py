"""What the pictures of robots and of trains share: floor, paths, caption, and where they are shown."""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.rendering.caption import draw_caption
from castor_envs.rendering.drawing.canvas import Canvas
from castor_envs.rendering.drawing.palette import (
    ESTIMATE,
    FADED,
    FAINT_PATH,
    OUTSIDE,
    TARGET,
    TRUE_PATH,
    TRUTH,
    WHITE,
)
from castor_envs.rendering.drawing.path import Path, evenly
from castor_envs.rendering.drawing.view import View
from castor_envs.rendering.drawing.window import Window
from castor_envs.rendering.ground import draw_floor

Mode = Literal["human", "rgb_array"]


class Scene:
    """A floor with paths on it and a caption below, on which a vehicle is drawn: `lengthen`, `start`, draw, `finish`.

    name: of the vehicle. friction: what holds outside the floor's patches. The rest is as in `Renderer`.

    Raises InputError for an invalid mode, size or arena, and gymnasium.error.DependencyNotInstalled without pygame.
    """

    def __init__(
        self,
        name: str,
        floor: Floor,
        friction: float,
        mode: Mode,
        fps: int,
        size: tuple[int, int],
        arena: tuple[float, float, float, float],
        known: bool = True,
    ) -> None:
        if mode not in ("human", "rgb_array"):
            raise InputError(f"render mode must be 'human' or 'rgb_array', got {mode!r}")
        self._name, self._floor, self._friction, self._mode, self._size = name, floor, friction, mode, size
        self._known = known
        self._window = Window(f"castor-envs: {name}", size, fps)
        self.look_at(arena)
        self.reset()

    @property
    def dismissed(self) -> bool:
        """Whether the user closed the window: nothing more is to be drawn."""
        return self._window.dismissed

    def look_at(self, arena: tuple[float, float, float, float]) -> None:
        """Show another part of N, with the paths so far."""
        self.view = View(self._size, arena)
        self.canvas = Canvas(self._size, OUTSIDE)
        draw_floor(self.canvas, self.view, self._floor, self._friction)
        self.canvas.text(self._name, (16 * self.view.unit, 24 * self.view.unit), 15 * self.view.unit, FADED)
        self.canvas.keep()

    def reset(self) -> None:
        """Forget all paths, for a new episode."""
        pixel = 1.0 / self.view.scale
        self._truth, self._rear = Path(pixel), Path(pixel)
        self._estimate, self._target = Path(pixel), Path(pixel)

    def lengthen(
        self,
        truth: ArrayLike,
        estimate: ArrayLike | None,
        target: ArrayLike | None,
        rear: ArrayLike | None = None,
    ) -> None:
        """Extend the paths to places in N, (2,) or longer: only x and y count.

        rear: of a second true path, drawn fainter. target: a place, or a whole path (k, 2) that replaces the last.
        """
        for path, place in ((self._truth, truth), (self._rear, rear), (self._estimate, estimate)):
            if place is not None:
                path.lengthen(np.asarray(place, dtype=float)[:2])
        if target is not None:
            self._follow(np.asarray(target, dtype=float))

    def start(self) -> None:
        """Start a picture: the floor and the paths so far."""
        self.canvas.restart()
        self._draw_paths()

    def finish(self, time: float, sliding: bool) -> NDArray[np.uint8] | None:
        """Write the caption and return the picture (height, width, 3); in mode "human" show it and return None.

        time: s. sliding: whether the picture distinguishes sliding wheels.
        """
        shown = {
            "true path": self._known,
            "estimate": not self._known or len(self._estimate) > 0,
            "target path": len(self._target) > 0,
            "sliding": sliding,
            "cable": len(self._floor.cables) > 0,
        }
        draw_caption(self.canvas, self.view, time, {name for name, is_shown in shown.items() if is_shown})
        if self._mode == "rgb_array":
            return self.canvas.pixels()
        self._window.show(self.canvas.finished())
        return None

    def close(self) -> None:
        """Close the window, if one is open."""
        self._window.close()

    def _follow(self, target: Array) -> None:
        if target.ndim == 2:
            self._target = Path(1.0 / self.view.scale)
        for row in np.atleast_2d(target):
            if np.all(np.isfinite(row[:2])):
                self._target.lengthen(row[:2])

    def _draw_paths(self) -> None:
        canvas, view = self.canvas, self.view
        u = view.unit
        if len(self._target) > 1:
            for dot in evenly(view.pixel(self._target.corners), 9 * u):
                canvas.disc(dot, 1.7 * u, TARGET)
        if len(self._rear):
            canvas.line(view.pixel(self._rear.corners), FAINT_PATH, 4 * u)
        truth = view.pixel(self._truth.corners)
        canvas.line(truth, *((TRUE_PATH, 6 * u) if self._known else (ESTIMATE, 2 * u)))
        canvas.disc(truth[0], 6 * u, TRUTH)
        canvas.disc(truth[0], 3.5 * u, WHITE)
        if len(self._estimate):
            canvas.line(view.pixel(self._estimate.corners), ESTIMATE, 2 * u)


def finite_or_none(estimate: ArrayLike | None) -> Array | None:
    """Return an estimate as an array, or None if there is none that could be drawn."""
    values = None if estimate is None else np.asarray(estimate, dtype=float)
    return values if values is not None and np.all(np.isfinite(values)) else None
