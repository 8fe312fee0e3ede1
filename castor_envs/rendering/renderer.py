"""The renderer of robots."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.floor import Floor
from castor_envs.rendering.caption import draw_error
from castor_envs.rendering.figure import Figure
from castor_envs.rendering.scene import Mode, Scene, finite_or_none
from castor_envs.vehicles.robot import RobotDescription


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
        mode: Mode,
        fps: int,
        size: tuple[int, int] = (800, 800),
        arena: tuple[float, float, float, float] = (-2.0, 2.0, -2.0, 2.0),
    ) -> None:
        self.robot, self.floor, self.mode, self.fps = robot, floor, mode, fps
        self._scene = Scene(robot.name, floor, robot.contact.friction, mode, fps, size, arena)
        self.view = self._scene.view
        self._figure = Figure(robot)

    def reset(self) -> None:
        """Forget all paths, for a new episode."""
        self._scene.reset()

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
        believed = finite_or_none(estimate)
        scene = self._scene
        scene.lengthen(pose, believed, reference)
        if scene.dismissed:
            return None

        scene.start()
        self._figure.draw(scene.canvas, self.view, pose, castor_angles, sliding)
        if believed is not None:
            self._figure.draw_ghost(scene.canvas, self.view, believed)
            draw_error(scene.canvas, self.view, pose, believed)
        return scene.finish(time, sliding is not None)

    def close(self) -> None:
        """Close the window, if one is open."""
        self._scene.close()
