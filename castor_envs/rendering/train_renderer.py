"""The renderer of trains."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.rendering.caption import draw_mean_error
from castor_envs.rendering.scene import Mode, Scene, finite_or_none
from castor_envs.rendering.train_figure import TrainFigure
from castor_envs.vehicles.train import TrainDescription


class TrainRenderer:
    """Draws a train on a floor, the paths of its first and last axle, and where an estimator believes its axles are.

    train: drawn as it is described. The rest is as in `Renderer`, errors too.
    """

    def __init__(
        self,
        train: TrainDescription,
        floor: Floor,
        mode: Mode,
        fps: int,
        size: tuple[int, int] = (800, 800),
        arena: tuple[float, float, float, float] = (-2.0, 2.0, -2.0, 2.0),
    ) -> None:
        self.train, self.floor, self.mode, self.fps = train, floor, mode, fps
        self._scene = Scene(train.name, floor, train.modules[0].contact.friction, mode, fps, size, arena)
        self.view = self._scene.view
        self._figure = TrainFigure(train)

    def reset(self) -> None:
        """Forget all paths, for a new episode."""
        self._scene.reset()

    def draw(
        self,
        poses: ArrayLike,
        frames: Sequence[ArrayLike],
        *,
        estimate: ArrayLike | None = None,
        reference: ArrayLike | None = None,
        time: float = 0.0,
        sliding: ArrayLike | None = None,
    ) -> NDArray[np.uint8] | None:
        """Draw the next picture and return it (height, width, 3); in mode "human" show it and return None.

        poses (N, 3): true x, y, psi of the axles in N, front first. frames: the true shape of each frame, front frame
        first, as a polyline (k, 2) in N from its rear axle to its front axle. estimate (N, 3): the axle poses an
        estimator believes in; not drawn unless all are finite. reference: the pose that the front axle is to follow
        (3,), whose path is kept as the others are, or the whole path to follow (k, 3). time: s. sliding (2N,): which
        wheels slide, axle by axle, left then right.

        Raises ValueError if `poses`, `frames`, `estimate` or `sliding` has a wrong shape, or `poses` or `frames` is not
        finite.
        """
        axles = self.train.n_axles
        poses = np.asarray(poses, dtype=float)
        if poses.shape != (axles, 3) or not np.all(np.isfinite(poses)):
            raise ValueError(f"poses must be finite, of shape ({axles}, 3), got shape {poses.shape}: {poses}")
        if estimate is not None and np.shape(estimate) != poses.shape:
            raise ValueError(f"estimate must have shape {poses.shape}, got {np.shape(estimate)}")
        if sliding is not None and np.shape(sliding) != (2 * axles,):
            raise ValueError(f"sliding must have shape ({2 * axles},), got {np.shape(sliding)}")
        shapes = self._polylines(frames)
        believed = finite_or_none(estimate)
        scene = self._scene
        scene.lengthen(poses[0], None if believed is None else believed[0], reference, rear=poses[-1])
        if scene.dismissed:
            return None

        scene.start()
        self._figure.draw(scene.canvas, self.view, poses, shapes, sliding)
        if believed is not None:
            self._figure.draw_ghost(scene.canvas, self.view, believed)
            draw_mean_error(scene.canvas, self.view, poses, believed)
        return scene.finish(time, sliding is not None)

    def close(self) -> None:
        """Close the window, if one is open."""
        self._scene.close()

    def _polylines(self, frames: Sequence[ArrayLike]) -> list[Array]:
        """Return the frames' shapes as arrays, checked."""
        shapes = [np.asarray(frame, dtype=float) for frame in frames]
        if len(shapes) != len(self.train.frames):
            raise ValueError(f"frames must be {len(self.train.frames)} polylines, got {len(shapes)}")
        for name, shape in zip(self.train.frame_names, shapes, strict=True):
            if shape.ndim != 2 or shape.shape[1] != 2 or len(shape) < 2 or not np.all(np.isfinite(shape)):
                raise ValueError(
                    f"frame {name} must be two or more finite points (k, 2), got shape {shape.shape}: {shape}"
                )
        return shapes
