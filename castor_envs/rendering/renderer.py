"""The renderer of robots and of trains."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.floor import Floor
from castor_envs.rendering.caption import draw_error
from castor_envs.rendering.drawing.view import View
from castor_envs.rendering.figure import RobotFigure
from castor_envs.rendering.scene import Mode, Scene, finite_or_none
from castor_envs.rendering.train_figure import TrainFigure
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.train import TrainDescription


class Renderer:
    """Draws a robot or a train on a floor, the path it took, and where an estimator believes it is.

    vehicle: drawn as it is described; of a train, the paths of its first and last axle. floor: in N. mode: "rgb_array"
    returns pictures and needs no display; "human" shows them in a window, at most `fps` a second, until the user closes
    it. size: width and height, pixels. arena: the part of N that is shown at least, x_min, x_max, y_min, y_max, m.
    known: False where the poses that are drawn are estimates, as the legend then says. The same calls make the same
    pixels.

    Raises InputError for an invalid mode, size or arena, and gymnasium.error.DependencyNotInstalled without pygame.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        floor: Floor,
        mode: Mode,
        fps: int,
        size: tuple[int, int] = (800, 800),
        arena: tuple[float, float, float, float] = (-2.0, 2.0, -2.0, 2.0),
        known: bool = True,
    ) -> None:
        self.vehicle, self.floor, self.mode, self.fps = vehicle, floor, mode, fps
        self._figure = TrainFigure(vehicle) if isinstance(vehicle, TrainDescription) else RobotFigure(vehicle)
        self._scene = Scene(vehicle.name, floor, self._figure.friction, mode, fps, size, arena, known)

    @property
    def view(self) -> View:
        """Where the places of N are in the picture."""
        return self._scene.view

    def look_at(self, arena: tuple[float, float, float, float]) -> None:
        """Show at least another part of N, as `arena`, from the next picture on, with the paths so far."""
        self._scene.look_at(arena)

    def reset(self) -> None:
        """Forget all paths, for a new episode."""
        self._scene.reset()

    def draw(
        self,
        pose: ArrayLike,
        shape: Any,
        *,
        estimate: ArrayLike | None = None,
        target: ArrayLike | None = None,
        time: float = 0.0,
        sliding: ArrayLike | None = None,
    ) -> NDArray[np.uint8] | None:
        """Draw the next picture and return it (height, width, 3); in mode "human" show it and return None.

        pose: true x, y, psi in N, (3,) of a robot's body, (N, 3) of a train's axles, front first. shape: of a robot its
        castor angles theta (n,), rad, those of fixed castors being ignored; of a train the true shape of each frame,
        front frame first, as a polyline (k, 2) in N from its rear axle to its front axle. estimate: the pose an
        estimator believes in, of the shape of `pose`; one that is not finite is not drawn. target: the pose that the
        robot or the front axle is to follow (3,), whose path is kept as the others are, or the whole path to follow
        (k, 3). time: s. sliding (w,): which wheels slide.

        Raises ValueError for a pose that is not finite or of a wrong shape; of trains for wrong shapes of the others
        too.
        """
        pose = np.asarray(pose, dtype=float)
        shape = self._figure.checked(pose, shape, None if estimate is None else np.asarray(estimate), sliding)
        drawn_estimate, scene = finite_or_none(estimate), self._scene
        self.lengthen(pose, estimate, target)
        if scene.dismissed:
            return None

        scene.start()
        self._figure.draw(scene.canvas, self.view, pose, shape, sliding)
        if drawn_estimate is not None:
            self._figure.draw_ghost(scene.canvas, self.view, drawn_estimate)
            draw_error(scene.canvas, self.view, pose, drawn_estimate)
        return scene.finish(time, sliding is not None)

    def lengthen(self, pose: ArrayLike, estimate: ArrayLike | None = None, target: ArrayLike | None = None) -> None:
        """Extend the paths as `draw` does, without drawing: for what happens between two pictures."""
        axles, drawn_estimate = np.atleast_2d(np.asarray(pose, dtype=float)), finite_or_none(estimate)
        front = None if drawn_estimate is None else np.atleast_2d(drawn_estimate)[0]
        self._scene.lengthen(axles[0], front, target, rear=axles[-1] if len(axles) > 1 else None)

    def close(self) -> None:
        """Close the window, if one is open."""
        self._scene.close()
