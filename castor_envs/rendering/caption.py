"""What is written about the picture: time, legend and scale below it, the estimate's error above them."""

import math

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.rendering.drawing.canvas import Canvas
from castor_envs.rendering.drawing.palette import AXES, CABLE, ESTIMATE, INK, SLIDING, TARGET, TRUE_PATH, TYRE, WHITE
from castor_envs.rendering.drawing.view import View

#: What the legend explains, in its order.
SYMBOLS = ("true path", "estimate", "target path", "sliding", "cable")


def draw_caption(canvas: Canvas, view: View, time: float, shown: set[str]) -> None:
    """Write the time (s), the legend of those SYMBOLS that are `shown`, as far as it fits, and a scale bar."""
    u, (width, height) = view.unit, view.size
    top, y = view.bottom, (view.bottom + height) / 2
    canvas.polygon([(0, top), (width, top), (width, height), (0, height)], WHITE)
    canvas.line([(0, top), (width, top)], AXES, u)
    x = 16 * u + max(82 * u, canvas.text(f"{time:.2f} s", (16 * u, y), 18 * u, INK)) + 14 * u

    length = round_length(140 * u / view.scale)
    right, left = width - 16 * u, width - 16 * u - length * view.scale
    canvas.line([(left, y + 8 * u), (right, y + 8 * u)], INK, 3 * u)
    for end in (left, right):
        canvas.line([(end, y + 3 * u), (end, y + 13 * u)], INK, 2 * u)
    canvas.text(f"{length:g} m", ((left + right) / 2, y - 7 * u), 14 * u, INK, "center")

    for name in SYMBOLS:
        if name in shown and x + (40 + 8 * len(name)) * u < left:
            _draw_symbol(canvas, name, x, y, u)
            x += 32 * u
            x += canvas.text(name, (x, y), 14 * u, INK) + 16 * u


def error_text(pose: Array, estimate: Array) -> str:
    """Say how far an estimate is from the true pose, both (3,), or (N, 3) of a train's axles: then on average."""
    off = 1000 * float(np.mean(np.hypot(*(estimate - pose)[..., :2].T)))
    if pose.ndim > 1:
        return f"estimate off by {off:.1f} mm, mean of {len(pose)} axles"
    turned = math.degrees(math.remainder(estimate[2] - pose[2], math.tau))
    return f"estimate off by {off:.1f} mm, {turned:+.2f}°"


def draw_error(canvas: Canvas, view: View, pose: Array, estimate: Array) -> None:
    """Write how far the estimate is from the true pose."""
    words = error_text(pose, estimate)
    canvas.text(words, (16 * view.unit, view.bottom - 18 * view.unit), 15 * view.unit, ESTIMATE)


def round_length(limit: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above `limit`."""
    power = 10.0 ** math.floor(math.log10(limit))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= limit)


def _draw_symbol(canvas: Canvas, name: str, x: float, y: float, u: float) -> None:
    line = [(x, y), (x + 24 * u, y)]
    match name:
        case "true path":
            canvas.line(line, TRUE_PATH, 6 * u)
        case "estimate":
            canvas.line(line, ESTIMATE, 2 * u)
        case "target path":
            for k in range(3):
                canvas.disc((x + (3 + 9 * k) * u, y), 1.7 * u, TARGET)
        case "sliding":
            canvas.line([(x + 5 * u, y), (x + 19 * u, y)], TYRE, 11 * u)
            canvas.line([(x + 5 * u, y), (x + 19 * u, y)], SLIDING, 8 * u)
        case "cable":
            canvas.line(line, CABLE, 3 * u)
