"""The robot's picture, and the ghost of where an estimator believes it is."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.rendering.drawing.canvas import Canvas
from castor_envs.rendering.drawing.palette import (
    DECK,
    ESTIMATE,
    IDLE_TYRE,
    INK,
    METAL,
    SLIDING,
    TRUTH,
    TYRE,
    WHITE,
    Color,
)
from castor_envs.rendering.drawing.path import evenly
from castor_envs.rendering.drawing.view import View
from castor_envs.rendering.outlines import CastorOutline, castor_outlines, chassis_outline, inset, nose, placed
from castor_envs.vehicles.robot import RobotDescription


class RobotFigure:
    """Draws one robot at any pose; `compact`, with a chassis that only just covers the wheels of its fixed castors."""

    def __init__(self, robot: RobotDescription, compact: bool = False) -> None:
        self._robot = robot
        self.friction = robot.contact.friction
        self._chassis, self._nose = chassis_outline(robot, compact), nose(robot, compact)

    def checked(self, pose: Array, castor_angles: Any, estimate: Array | None, sliding: ArrayLike | None) -> Any:
        """Return the castor angles; raises ValueError if the pose is not three finite numbers."""
        if pose.shape != (3,) or not np.all(np.isfinite(pose)):
            raise ValueError(f"pose must be three finite numbers, got {pose}")
        return castor_angles

    def draw(
        self, canvas: Canvas, view: View, pose: Array, castor_angles: ArrayLike, sliding: ArrayLike | None
    ) -> None:
        """Draw the robot at pose (3,) with castor_angles (n,), rad; sliding (w,) says which wheels slide."""
        hull = view.pixel(placed(self._chassis, pose))
        # The deck lets the floor show through: which cable or patch a wheel is on.
        canvas.layer([(hull, TRUTH, 255), (inset(hull, 2.5 * view.unit), DECK, 150)])
        canvas.polygon(view.pixel(placed(self._nose, pose)), TRUTH)
        slides = np.broadcast_to(False if sliding is None else np.asarray(sliding, dtype=bool), len(self._robot.wheels))
        colors = [
            SLIDING if slide else TYRE if wheel.driven else IDLE_TYRE
            for wheel, slide in zip(self._robot.wheels, slides, strict=True)
        ]
        for outline in castor_outlines(self._robot, castor_angles):
            tyres, colors = colors[: len(outline.tyres)], colors[len(outline.tyres) :]
            _draw_castor(canvas, view, outline, tyres, pose)
        _draw_origin(canvas, view, pose, TRUTH)

    def draw_ghost(self, canvas: Canvas, view: View, pose: Array) -> None:
        """Draw a dashed outline of the robot at pose (3,): the robot itself shows between the dashes."""
        hull = view.pixel(placed(self._chassis, pose))
        perimeter = float(np.sum(np.hypot(*(np.roll(hull, -1, axis=0) - hull).T)))
        dashes = max(8, round(perimeter / (19 * view.unit)))
        outer = evenly(np.concatenate([hull, hull[:1]]), perimeter / (12 * dashes))[: 12 * dashes]
        inner = inset(outer, 2.5 * view.unit)
        for k in range(0, len(outer), 12):
            dash = slice(k, k + 7)
            canvas.polygon(np.concatenate([outer[dash], inner[dash][::-1]]), ESTIMATE)
        triangle = view.pixel(placed(self._nose, pose))
        canvas.line([*triangle, triangle[0]], ESTIMATE, 2 * view.unit)
        _draw_origin(canvas, view, pose, ESTIMATE)


def _draw_castor(canvas: Canvas, view: View, castor: CastorOutline, tyres: list[Color], pose: Array) -> None:
    def part(shape: Array, color: Color, edge: Color = INK) -> None:
        points = view.pixel(placed(shape, pose))
        canvas.polygon(points, edge)
        canvas.polygon(inset(points, 1.2 * view.unit), color)

    for shape, color, rollers in zip(castor.tyres, tyres, castor.rollers, strict=True):
        part(shape, color, TYRE)
        for roller in rollers:
            canvas.polygon(view.pixel(placed(roller, pose)), METAL)
    for shape in castor.frame:
        part(shape, METAL)
    if castor.pivot_radius > 0:
        center = view.pixel(placed(castor.pivot, pose))
        radius = max(castor.pivot_radius * view.scale, 2.5 * view.unit)
        canvas.disc(center, radius, INK)
        canvas.disc(center, max(0.6 * radius, radius - 1.5 * view.unit), WHITE)
    if castor.pointer is not None:
        part(castor.pointer, WHITE)


def _draw_origin(canvas: Canvas, view: View, pose: Array, color: Color) -> None:
    center = view.pixel(pose[:2])
    canvas.disc(center, 5 * view.unit, WHITE)
    canvas.disc(center, 3.5 * view.unit, color)
