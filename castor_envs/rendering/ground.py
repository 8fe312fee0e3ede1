"""The floor's picture: patches, grid, cables, and which way it slopes."""

import math

import numpy as np

from castor_envs.floor import Floor, Patch
from castor_envs.geometry.se2 import rotate
from castor_envs.rendering.drawing.canvas import Canvas
from castor_envs.rendering.drawing.palette import ARENA, AXES, CABLE, FADED, GRID, INK, ROUGH, SLIPPERY, WHITE
from castor_envs.rendering.drawing.view import View
from castor_envs.rendering.outlines import bar, placed

GRID_STEP = 0.5  # m; ten times as much where the lines would merge


def draw_floor(canvas: Canvas, view: View, floor: Floor, friction: float) -> None:
    """Draw a floor; `friction` is what holds outside the patches."""
    x_min, x_max, y_min, y_max = view.arena
    canvas.polygon(view.pixel([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]), ARENA)
    for patch in floor.patches:
        _draw_patch(canvas, view, patch, friction)
    _draw_grid(canvas, view)
    for patch in floor.patches:
        # Off the middle: that is where paths run.
        aside = np.array([-0.5, 0.55]) * patch.size / 2
        x, y = view.pixel(placed(aside, (*patch.center, patch.angle)))
        canvas.text(f"µ {patch.on(friction):.2g}", (x, y), 15 * view.unit, FADED, "center")
    for cable in floor.cables:
        half = np.array([math.cos(cable.direction), math.sin(cable.direction)]) * cable.length / 2
        ends = view.pixel([cable.center - half, cable.center + half])
        canvas.line(ends, CABLE, max(cable.diameter * view.scale, 3 * view.unit))
    if floor.slope != (0.0, 0.0):
        _draw_slope(canvas, view, floor)


def _draw_patch(canvas: Canvas, view: View, patch: Patch, friction: float) -> None:
    """Tint a patch, the more the more it differs: blue and hatched where it is slippery, orange where it is rough."""
    half_length, half_width = patch.size[0] / 2, patch.size[1] / 2
    frame = (*patch.center, patch.angle)
    corners = np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * (half_length, half_width)
    there = patch.on(friction)
    difference = min(1.0, abs(math.log(max(there, 1e-3) / friction)) / math.log(4))
    slippery = there < friction
    color = SLIPPERY if slippery else ROUGH
    canvas.layer([(view.pixel(placed(corners, frame)), color, round(30 + 40 * difference))])
    if not slippery:
        return
    ends, gap = half_length + half_width, 14 * view.unit / view.scale
    # Of a patch that reaches far beyond the picture, only what is seen is hatched.
    edges = view.place([(0, 0), (view.size[0], 0), view.size, (0, view.size[1])])
    along, across = rotate(edges - np.array(patch.center), -patch.angle).T
    first, last = np.min(along) - gap, np.max(along) + gap
    begin, end = max(-ends, np.min(along - across) - gap), min(ends, np.max(along - across) + gap)
    bars = []
    for k in range(math.ceil((begin + ends) / gap), math.ceil((end + ends) / gap)):
        shift = k * gap - ends
        low, high = max(-half_length, shift - half_width, first), min(half_length, shift + half_width, last)
        if low < high:
            a, b = view.pixel(placed(np.array([(low, low - shift), (high, high - shift)]), frame))
            bars.append((bar(a, b, 1.5 * view.unit), color, 80))
    if bars:
        canvas.layer(bars)


def _draw_grid(canvas: Canvas, view: View) -> None:
    width, bottom = view.size[0], view.bottom
    step = GRID_STEP
    while step * view.scale < 10 * view.unit:
        step *= 10
    (left, lowest), (right, highest) = view.place([(0, bottom), (width, 0)])
    for k in range(math.ceil(left / step), math.floor(right / step) + 1):
        x, _ = view.pixel((k * step, 0.0))
        canvas.line([(x, 0), (x, bottom)], AXES if k == 0 else GRID, view.unit)
    for k in range(math.ceil(lowest / step), math.floor(highest / step) + 1):
        _, y = view.pixel((0.0, k * step))
        canvas.line([(0, y), (width, y)], AXES if k == 0 else GRID, view.unit)


def _draw_slope(canvas: Canvas, view: View, floor: Floor) -> None:
    """Draw an arrow downhill, and how steep it is, into the upper right corner."""
    u, width = view.unit, view.size[0]
    rise = math.hypot(*floor.slope)
    down = np.array([-floor.slope[0], floor.slope[1]]) / rise
    side = np.array([-down[1], down[0]])
    center = np.array([width - 40 * u, 40 * u])
    canvas.disc(center, 27 * u, AXES)
    canvas.disc(center, 25.5 * u, WHITE)
    canvas.line([center - 17 * u * down, center + 8 * u * down], INK, 3 * u)
    neck = center + 6 * u * down
    canvas.polygon([center + 19 * u * down, neck + 8 * u * side, neck - 8 * u * side], INK)
    canvas.text(f"downhill {100 * rise:.2g} %", (width - 76 * u, 40 * u), 15 * u, FADED, "right")
