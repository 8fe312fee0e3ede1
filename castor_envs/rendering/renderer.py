"""The renderer of the environments."""

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.rendering.canvas import Canvas, import_pygame
from castor_envs.rendering.caption import draw_caption, draw_error
from castor_envs.rendering.figure import Figure
from castor_envs.rendering.ground import draw_floor
from castor_envs.rendering.palette import ESTIMATE, FADED, OUTSIDE, REFERENCE, TRUE_PATH, TRUTH, WHITE
from castor_envs.rendering.path import Path, evenly
from castor_envs.rendering.view import View
from castor_envs.robot import RobotDescription


class Renderer:
    """Draws a robot on a floor, the path it took, and where an estimator believes it is.

    robot: drawn as it is described. floor: in N. mode: "rgb_array" returns pictures and needs no display; "human" shows
    them in a window, at most `fps` a second, until the user closes it. size: width and height, pixels. arena: the part
    of N that is shown at least, x_min, x_max, y_min, y_max, m. The same calls make the same pixels.

    Raises InputError for a mode, size or arena that is none, and gymnasium.error.DependencyNotInstalled without pygame.
    """

    def __init__(
        self,
        robot: RobotDescription,
        floor: Floor,
        mode: Literal["human", "rgb_array"],
        fps: int,
        size: tuple[int, int] = (800, 800),
        arena: tuple[float, float, float, float] = (-2.0, 2.0, -2.0, 2.0),
    ) -> None:
        if mode not in ("human", "rgb_array"):
            raise InputError(f"render mode must be 'human' or 'rgb_array', got {mode!r}")
        self.robot, self.floor, self.mode, self.fps = robot, floor, mode, fps
        self.view = View(size, arena)
        self._canvas = Canvas(size, OUTSIDE)
        self._figure = Figure(robot)
        self._window: Any = None
        self._clock: Any = None
        self._dismissed = False
        draw_floor(self._canvas, self.view, floor, robot.contact.friction)
        self._canvas.text(robot.name, (16 * self.view.unit, 24 * self.view.unit), 15 * self.view.unit, FADED)
        self._canvas.keep()
        self.reset()

    def reset(self) -> None:
        """Forget all paths, for a new episode."""
        pixel = 1.0 / self.view.scale
        self._truth, self._estimate, self._reference = Path(pixel), Path(pixel), Path(pixel)

    def draw(
        self,
        pose: ArrayLike,
        castor_angles: ArrayLike,
        *,
        estimate: ArrayLike | None = None,
        reference: ArrayLike | None = None,
        time: float = 0.0,
        sliding: ArrayLike | None = None,
    ) -> NDArray[np.uint8] | None:
        """Draw the next picture and return it (height, width, 3); in mode "human" show it and return None.

        pose (3,): true x, y, psi of the body in N. castor_angles (n,): theta, rad; those of fixed castors are ignored.
        estimate (3,): the pose an estimator believes in; one that is not finite is not drawn. reference: the pose to
        follow (3,), whose path is kept as the other two are, or the whole path to follow (k, 3). time: s. sliding (w,):
        which wheels slide. Raises ValueError if `pose` is not three finite numbers.
        """
        pose = np.asarray(pose, dtype=float)
        if pose.shape != (3,) or not np.all(np.isfinite(pose)):
            raise ValueError(f"pose must be three finite numbers, got {pose}")
        believed = None if estimate is None else np.asarray(estimate, dtype=float)
        if believed is not None and not np.all(np.isfinite(believed)):
            believed = None
        self._truth.lengthen(pose[:2])
        if believed is not None:
            self._estimate.lengthen(believed[:2])
        if reference is not None:
            self._follow(np.asarray(reference, dtype=float))
        if self._dismissed:
            return None

        canvas, view = self._canvas, self.view
        canvas.restart()
        self._draw_paths()
        self._figure.draw(canvas, view, pose, castor_angles, sliding)
        if believed is not None:
            self._figure.draw_ghost(canvas, view, believed)
            draw_error(canvas, view, pose, believed)
        shown = {
            "true path": True,
            "estimate": len(self._estimate) > 0,
            "reference": len(self._reference) > 0,
            "sliding": sliding is not None,
            "cable": len(self.floor.cables) > 0,
        }
        draw_caption(canvas, view, time, {name for name, is_shown in shown.items() if is_shown})
        if self.mode == "rgb_array":
            return canvas.pixels()
        self._show()
        return None

    def close(self) -> None:
        """Close the window, if one is open."""
        if self._window is not None:
            import_pygame().display.quit()
            self._window = None

    def _follow(self, reference: NDArray[np.float64]) -> None:
        if reference.ndim == 2:
            self._reference = Path(1.0 / self.view.scale)
        for row in np.atleast_2d(reference):
            if np.all(np.isfinite(row[:2])):
                self._reference.lengthen(row[:2])

    def _draw_paths(self) -> None:
        canvas, view = self._canvas, self.view
        u = view.unit
        if len(self._reference) > 1:
            for dot in evenly(view.pixel(self._reference.corners), 9 * u):
                canvas.disc(dot, 1.7 * u, REFERENCE)
        truth = view.pixel(self._truth.corners)
        canvas.line(truth, TRUE_PATH, 6 * u)
        canvas.disc(truth[0], 6 * u, TRUTH)
        canvas.disc(truth[0], 3.5 * u, WHITE)
        if len(self._estimate):
            canvas.line(view.pixel(self._estimate.corners), ESTIMATE, 2 * u)

    def _show(self) -> None:
        pygame = import_pygame()
        if self._window is None or pygame.display.get_surface() is not self._window:
            try:
                pygame.display.init()
                self._window = pygame.display.set_mode(self.view.size)
            except pygame.error as error:
                raise InputError(
                    f"render mode 'human' found no display for its window ({error}); 'rgb_array' needs none"
                ) from None
            pygame.display.set_caption(f"castor-envs: {self.robot.name}")
            self._clock = pygame.time.Clock()
        self._window.blit(self._canvas.finished(), (0, 0))
        pygame.display.flip()
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            self._dismissed = True
            self.close()
        else:
            self._clock.tick(self.fps)
