"""A robot's or a train's file as a drawing: castors, wheels, which way each rolls forward, and where turning is about.

Drawn with all castors at theta = 0, where axles stand behind their pivots at -x: so that a wrong sign, a wrong order of
castors or millimetres given as metres are seen.
"""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Polygon

from castor_envs.errors import shortened
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry, unit
from castor_envs.motion.mobility import Mobility
from castor_envs.rendering.drawing import palette
from castor_envs.rendering.outlines import TYRE_WIDTH, CastorOutline, castor_outlines, chassis_outline, placed
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.robot import Castor, RobotDescription
from castor_envs.vehicles.train import TrainDescription

MM = 1e3
MOST_OF_TITLE = 60
"""Characters of a name that fit above the drawing."""
_TEXT: dict[str, Any] = {
    "ha": "center",
    "va": "center",
    "fontsize": "small",
    "bbox": {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 1},
    "zorder": 8,
}
NOTES = {
    "arrow": "arrow on a wheel: counts rise when it rolls this way; grey wheel: no motor, no encoder",
    "pivot": "blue dot: pivot, with the way its counts rise; yellow: offset; all castors are drawn at theta = 0",
    "center": "dashed, or a cross: where the robot can turn about, as its fixed wheels may not slip sideways",
}


def layout_figure(vehicle: Vehicle) -> Figure:
    """Return the drawing, axes in mm, x to the right and y up."""
    figure = Figure(figsize=(8.0, 8.6))
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0.1, 0.13, 0.88, 0.82))
    axes.set_aspect("equal")
    axes.set_title(shortened(vehicle.name, MOST_OF_TITLE), parse_math=False)
    axes.set_xlabel("x, forward (mm)")
    axes.set_ylabel("y, left (mm)")
    axes.grid(color=_rgb(palette.GRID), linewidth=0.5)
    axes.set_axisbelow(True)
    if isinstance(vehicle, TrainDescription):
        _draw_train(axes, vehicle)
        _frame(axes)
        notes = ["arrow"]
    else:
        _draw_robot(axes, vehicle, np.zeros(3))
        _frame(axes)
        _draw_axes(axes, vehicle)
        turns = any(castor.steering != "fixed" for castor in vehicle.castors)
        notes = ["arrow", *["pivot"] * turns, *["center"] * _draw_center(axes, vehicle)]
    figure.text(0.5, 0.005, "\n".join(NOTES[note] for note in notes), ha="center", va="bottom", fontsize="small")
    return figure


def _draw_train(axes: Axes, train: TrainDescription) -> None:
    behind = np.concatenate([[0.0], np.cumsum([frame.length for frame in train.frames])])
    for name, frame, x in zip(train.frame_names, train.frames, -behind[1:], strict=True):
        axes.plot([MM * x, MM * (x + frame.length)], [0, 0], color=_rgb(palette.BEAM), linewidth=3, zorder=2)
        middle = np.array([x + frame.length / 2, 0.06 * frame.length])
        _write(axes, middle, f"frame {name}, {MM * frame.length:g}", palette.BEAM)
    for number, (module, x) in enumerate(zip(train.modules, -behind, strict=True), start=1):
        _draw_robot(axes, module, np.array([x, 0.0, 0.0]), axle=number)


def _draw_robot(axes: Axes, robot: RobotDescription, pose: Array, axle: int | None = None) -> None:
    """Draw a robot at a pose. axle: its number, if it is an axle of a train."""
    _polygon(axes, placed(chassis_outline(robot, compact=axle is not None), pose), palette.DECK, alpha=0.35)
    names = [name if axle is None else f"{axle}{name[1:]}" for name in robot.wheel_names]
    outlines = castor_outlines(robot, np.zeros(len(robot.castors)))
    geometry = Geometry.of(robot)
    angles = np.where(geometry.fixed, geometry.angle, 0.0).tolist()
    for number, (castor, outline, angle) in enumerate(zip(robot.castors, outlines, angles, strict=True), start=1):
        own, names = names[: len(castor.wheels)], names[len(castor.wheels) :]
        frame = np.array([*placed(np.array(castor.pivot), pose), pose[2] + angle])
        _draw_castor(axes, castor, outline, pose, frame, own)
        if axle is None:
            trail = f", offset {MM * castor.offset:g}" if castor.offset else ""
            _label(axes, castor, robot, f"castor {number}\n{castor.steering}{trail}")


def _draw_axes(axes: Axes, robot: RobotDescription) -> None:
    """Draw the body's own axes at its origin."""
    size = 0.2 * float(np.max(np.hypot(*chassis_outline(robot).T)))
    for angle, name in ((0.0, "x"), (np.pi / 2, "y")):
        _arrow(axes, np.zeros(2), size * unit(angle), palette.TRUTH)
        _write(axes, 1.3 * size * unit(angle), name, palette.TRUTH)


def _draw_castor(
    axes: Axes, castor: Castor, outline: CastorOutline, pose: Array, frame: Array, names: list[str]
) -> None:
    """Draw a castor of a robot at `pose`; frame: its pivot, and the direction in which it rolls."""
    for shape in outline.frame:
        _polygon(axes, placed(shape, pose), palette.METAL)
    for wheel, shape, rollers, name in zip(castor.wheels, outline.tyres, outline.rollers, names, strict=True):
        _polygon(axes, placed(shape, pose), palette.TYRE if wheel.driven else palette.IDLE_TYRE)
        for roller in rollers:
            _polygon(axes, placed(roller, pose), palette.METAL)
        center = placed(np.array([-castor.offset, wheel.lateral]), frame)
        if wheel.driven:
            _arrow(axes, center, 1.9 * wheel.radius * unit(frame[2]), palette.ESTIMATE)
        aside = TYRE_WIDTH * wheel.radius * unit(frame[2] + np.pi / 2) * (1 if wheel.lateral > 0 else -1)
        color = palette.ESTIMATE if wheel.driven else palette.FADED
        _write(axes, center + aside, f"{name}: r {MM * wheel.radius:g}", color)
    if castor.steering == "fixed":
        return
    if castor.offset:
        ends = MM * placed(np.array([(0.0, 0.0), (-castor.offset, 0.0)]), frame)
        axes.plot(*ends.T, color=_rgb(palette.SLIDING), linewidth=1.5, zorder=5)
    x, y = MM * frame[:2]
    axes.plot([x], [y], "o", color=_rgb(palette.TRUTH), markersize=6, zorder=6)
    if castor.pivot_counts_per_rev is not None:
        size = 1.6 * MM * max(wheel.radius for wheel in castor.wheels)
        axes.add_patch(Arc((x, y), size, size, theta1=20, theta2=110, color=_rgb(palette.TRUTH), zorder=6))
        end = np.array([x, y]) / MM + size / 2 / MM * unit(np.radians(110))
        _arrow(axes, end, 0.12 * size / MM * unit(np.radians(200)), palette.TRUTH)


def _draw_center(axes: Axes, robot: RobotDescription) -> bool:
    """Draw where the robot can turn about; return whether that is a point or a line."""
    center = Mobility.of(robot).center
    if center is None:
        return False
    point, along = center
    if along is None:
        axes.plot(*(MM * point), "+", color=_rgb(palette.ROUGH), markersize=16, zorder=7)
    else:
        axes.axline(tuple(MM * point), tuple(MM * (point + along)), color=_rgb(palette.ROUGH), linestyle="--", zorder=1)
    return True


def _polygon(axes: Axes, points: Array, color: palette.Color, alpha: float = 1.0) -> None:
    axes.add_patch(Polygon(MM * points, facecolor=_rgb(color), edgecolor=_rgb(palette.INK), linewidth=0.6, alpha=alpha))
    axes.update_datalim(MM * points)


def _arrow(axes: Axes, start: Array, by: Array, color: palette.Color) -> None:
    end, begin = tuple(MM * (start + by)), tuple(MM * start)
    axes.annotate("", end, begin, arrowprops={"arrowstyle": "-|>", "color": _rgb(color), "linewidth": 1.5}, zorder=7)


def _label(axes: Axes, castor: Castor, robot: RobotDescription, words: str) -> None:
    """Write beside a castor, on its side away from the middle of the robot."""
    away = np.array(castor.pivot) - np.mean([other.pivot for other in robot.castors], axis=0)
    away = away / np.hypot(*away) if np.hypot(*away) > 0 else unit(np.pi / 4)
    at = tuple(MM * np.array(castor.pivot))
    line = {"arrowstyle": "-", "color": _rgb(palette.FADED), "linewidth": 0.8}
    axes.annotate(words, at, tuple(70 * away), textcoords="offset points", arrowprops=line, weight="bold", **_TEXT)


def _write(axes: Axes, at: Array, words: str, color: palette.Color) -> None:
    axes.annotate(words, tuple(MM * at), color=_rgb(color), **_TEXT)


def _frame(axes: Axes) -> None:
    """Show what is drawn with room for what is written around it."""
    low, high = np.array(axes.dataLim.min), np.array(axes.dataLim.max)
    middle, half = (low + high) / 2, 0.7 * float(np.max(high - low))
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)


def _rgb(color: palette.Color) -> tuple[float, float, float]:
    red, green, blue = color
    return red / 255, green / 255, blue / 255
