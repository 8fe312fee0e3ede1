"""The train's picture, and the ghost of where an estimator believes it is."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.rendering.drawing.canvas import Canvas
from castor_envs.rendering.drawing.palette import BEAM, ESTIMATE, INK
from castor_envs.rendering.drawing.path import evenly
from castor_envs.rendering.drawing.view import View
from castor_envs.rendering.figure import RobotFigure
from castor_envs.vehicles.train import TrainDescription

BEAM_WIDTH = 0.022  # m; a description does not say how wide a frame is


class TrainFigure:
    """Draws one train at any axle poses."""

    def __init__(self, train: TrainDescription) -> None:
        self._modules = [RobotFigure(module, compact=True) for module in train.modules]
        self._lengths = [frame.length for frame in train.frames]
        self._names = train.frame_names
        self.friction = train.modules[0].contact.friction

    def checked(self, poses: Array, frames: Any, estimate: Array | None, sliding: ArrayLike | None) -> list[Array]:
        """Return the frames' shapes as arrays; raises ValueError for wrong shapes and for what is not finite."""
        axles = len(self._modules)
        if poses.shape != (axles, 3) or not np.all(np.isfinite(poses)):
            raise ValueError(f"pose must be finite, of shape ({axles}, 3), got shape {poses.shape}: {poses}")
        if estimate is not None and np.shape(estimate) != poses.shape:
            raise ValueError(f"estimate must have shape {poses.shape}, got {np.shape(estimate)}")
        if sliding is not None and np.shape(sliding) != (2 * axles,):
            raise ValueError(f"sliding must have shape ({2 * axles},), got {np.shape(sliding)}")
        shapes = [np.asarray(frame, dtype=float) for frame in frames]
        if len(shapes) != len(self._names):
            raise ValueError(f"frames must be {len(self._names)} polylines, got {len(shapes)}")
        for name, shape in zip(self._names, shapes, strict=True):
            if shape.ndim != 2 or shape.shape[1] != 2 or len(shape) < 2 or not np.all(np.isfinite(shape)):
                raise ValueError(
                    f"frame {name} must be two or more finite points (k, 2), got shape {shape.shape}: {shape}"
                )
        return shapes

    def draw(
        self, canvas: Canvas, view: View, poses: Array, frames: Sequence[Array], sliding: ArrayLike | None
    ) -> None:
        """Draw the train at poses (N, 3), its frames along polylines (k, 2) in N; sliding (2N,): which wheels slide."""
        width = max(BEAM_WIDTH * view.scale, 5 * view.unit)
        for frame in frames:
            canvas.line(view.pixel(frame), INK, width + 2.4 * view.unit)
        for frame in frames:
            canvas.line(view.pixel(frame), BEAM, width)
        slides = np.reshape(np.zeros(2 * len(poses), dtype=bool) if sliding is None else sliding, (-1, 2))
        for module, pose, pair in zip(self._modules, poses, slides, strict=True):
            module.draw(canvas, view, pose, [0.0], pair)

    def draw_ghost(self, canvas: Canvas, view: View, poses: Array) -> None:
        """Draw dashed outlines of the axles at poses (N, 3), joined by dashed frames."""
        for length, front, rear in zip(self._lengths, poses[:-1], poses[1:], strict=True):
            curve = view.pixel(frame_curve(rear, front, length))
            extent = float(np.sum(np.hypot(*np.diff(curve, axis=0).T)))
            dashes = max(3, round(extent / (17 * view.unit)))
            points = evenly(curve, extent / (12 * dashes))
            for k in range(0, len(points), 12):
                canvas.line(points[k : k + 7], ESTIMATE, 4 * view.unit)
        for module, pose in zip(self._modules, poses, strict=True):
            module.draw_ghost(canvas, view, pose)


def frame_curve(rear: Array, front: Array, length: float) -> Array:
    """Return points (k, 2) of the cubic Hermite curve between axle poses (3,), as fast at its ends as it is long.

    That is the straight frame where the axles stand as a straight frame puts them, and near the bent beam elsewhere.
    """
    s = np.linspace(0.0, 1.0, 25)[:, None]
    leaving, arriving = (length * np.array([np.cos(psi), np.sin(psi)]) for psi in (rear[2], front[2]))
    return (
        (2 * s**3 - 3 * s**2 + 1) * rear[:2]
        + (s**3 - 2 * s**2 + s) * leaving
        + (3 * s**2 - 2 * s**3) * front[:2]
        + (s**3 - s**2) * arriving
    )
