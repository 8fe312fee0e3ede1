"""Pictures of a robot on its floor, seen from above."""

import math
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.canvas import Canvas, Color, Shape, import_pygame
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.outlines import CastorOutline, bar, castor_outlines, chassis_outline, nose, placed
from castor_envs.robot import RobotDescription

Array = NDArray[np.float64]

# Okabe and Ito's palette, which the colour-blind tell apart, on a quiet ground.
TRUTH: Color = (0, 114, 178)
TRUE_PATH: Color = (112, 178, 220)
ESTIMATE: Color = (213, 94, 0)
SLIDING: Color = (240, 228, 66)
SLIPPERY: Color = (86, 180, 233)
ROUGH: Color = (230, 159, 0)
REFERENCE: Color = (105, 108, 114)
INK: Color = (52, 56, 62)
FADED: Color = (125, 129, 135)
ARENA: Color = (250, 249, 247)
OUTSIDE: Color = (239, 238, 233)
GRID: Color = (230, 228, 222)
AXES: Color = (200, 197, 190)
CABLE: Color = (84, 74, 68)
DECK: Color = (178, 207, 228)
TYRE: Color = (38, 41, 46)
IDLE_TYRE: Color = (118, 122, 128)
METAL: Color = (160, 166, 174)
WHITE: Color = (255, 255, 255)

GRID_STEP = 0.5  # m


class Renderer:
    """Draws a robot on a floor, the path it took, and where an estimator believes it is.

    robot: drawn as described (`castor_envs.outlines`). floor: in N. mode: "rgb_array" returns pictures and needs no display;
    "human" shows them in a window, `fps` a second. size: width and height, pixels. arena: the part of N that is shown at
    least, x_min, x_max, y_min, y_max, m.

    Raises InputError for impossible values, and for mode "human" where no window can be opened;
    gymnasium.error.DependencyNotInstalled without pygame.
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
        x_min, x_max, y_min, y_max = arena
        if mode not in ("human", "rgb_array"):
            raise InputError(f"render mode must be 'human' or 'rgb_array', got {mode!r}")
        if not (x_min < x_max and y_min < y_max):
            raise InputError(f"arena must be x_min < x_max, y_min < y_max, got {arena}")
        if min(size) < 64:
            raise InputError(f"a picture needs at least 64 x 64 pixels, got {size}")
        self.robot, self.floor, self.mode, self.fps = robot, floor, mode, fps
        self._unit = min(size) / 800
        self._strip = 48 * self._unit
        margin = 12 * self._unit
        width, height = size[0], size[1] - self._strip
        #: Pixels a metre.
        self.scale = min((width - 2 * margin) / (x_max - x_min), (height - 2 * margin) / (y_max - y_min))
        self._middle = np.array([(x_min + x_max) / 2, (y_min + y_max) / 2])
        self._center = np.array([width / 2, height / 2])
        self._arena = arena
        self._canvas = Canvas(size, OUTSIDE)
        self._window: Any = None
        self._dismissed = False
        self._chassis, self._nose = chassis_outline(robot), nose(robot)
        self._draw_floor()
        self._canvas.keep()
        self.reset()

    def reset(self) -> None:
        """Forget all paths."""
        self._truth: list[Array] = []
        self._estimate: list[Array] = []
        self._reference: list[Array] = []

    def pixel(self, points: ArrayLike) -> Array:
        """Return where points (..., 2) of N are in the picture: x to the right and y down, in pixels."""
        return self._center + (np.asarray(points, dtype=float) - self._middle) * (self.scale, -self.scale)

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
        """Draw the next picture and return it (height, width, 3), or show it and return None in mode "human".

        pose (3,): true x, y, psi of the body in N. castor_angles (n,): theta, rad; those of fixed castors are ignored.
        estimate (3,): the pose an estimator believes in; not finite is not drawn. reference: the pose to follow (3,), whose
        path is kept as the others are, or the whole path (k, 3). time: s. sliding (w,): which wheels slide.
        """
        pose = np.asarray(pose, dtype=float)
        believed = None if estimate is None else np.asarray(estimate, dtype=float)
        if believed is not None and not np.all(np.isfinite(believed)):
            believed = None
        self._lengthen(self._truth, pose)
        if believed is not None:
            self._lengthen(self._estimate, believed)
        if reference is not None:
            way = np.asarray(reference, dtype=float)
            if way.ndim == 2:
                self._reference = list(way[:, :2] * self.scale)
            else:
                self._lengthen(self._reference, way)
        if self._dismissed:
            return None

        self._canvas.restart()
        self._draw_paths()
        self._draw_robot(pose, castor_angles, sliding)
        if believed is not None:
            self._draw_ghost(believed)
        self._draw_strip(time, pose, believed, sliding is not None)
        if self.mode == "rgb_array":
            return self._canvas.pixels()
        self._show()
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            import_pygame().display.quit()
            self._window = None

    def _show(self) -> None:
        pygame = import_pygame()
        if self._window is None or pygame.display.get_surface() is not self._window:
            try:
                pygame.display.init()
                self._window = pygame.display.set_mode(self._canvas.size)
            except pygame.error as error:
                raise InputError(
                    f"render mode 'human' found no display to open a window on ({error}); 'rgb_array' needs none"
                ) from None
            pygame.display.set_caption(f"castor-envs: {self.robot.name}")
            self._clock = pygame.time.Clock()
        self._window.blit(self._canvas.finished(), (0, 0))
        pygame.display.flip()
        if any(event.type == pygame.QUIT for event in pygame.event.get()):
            # The user closed the window: the run goes on without pictures.
            self._dismissed = True
            self.close()
            return
        self._clock.tick(self.fps)

    def _lengthen(self, path: list[Array], pose: Array) -> None:
        """Let a path go on to `pose`; a corner that no eye would miss makes way for the next."""
        place = pose[:2] * self.scale
        if path:
            ahead = place - path[-1]
            if np.hypot(*ahead) < 0.25:
                return
            if len(path) > 1:
                behind = path[-1] - path[-2]
                whole = place - path[-2]
                aside = abs(whole[0] * behind[1] - whole[1] * behind[0]) / max(float(np.hypot(*whole)), 1e-9)
                if np.hypot(*behind) < 8.0 and aside < 0.25 and ahead @ behind > 0:
                    path.pop()
        path.append(place)

    def _draw_floor(self) -> None:
        canvas, u = self._canvas, self._unit
        x_min, x_max, y_min, y_max = self._arena
        canvas.polygon(self.pixel([(x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)]), ARENA)
        for patch in self.floor.patches:
            self._draw_patch(patch.center, patch.size, patch.angle, patch.friction)
        self._draw_grid()
        for patch in self.floor.patches:
            canvas.text(f"µ {patch.friction:.2g}", tuple(self.pixel(patch.center)), 15 * u, FADED, "center")
        for cable in self.floor.cables:
            way = np.array([math.cos(cable.direction), math.sin(cable.direction)]) * cable.length / 2
            ends = self.pixel([cable.center - way, cable.center + way])
            canvas.line(ends, CABLE, max(cable.diameter * self.scale, 3 * u))
        canvas.text(self.robot.name, (16 * u, 24 * u), 15 * u, FADED)
        if self.floor.slope != (0.0, 0.0):
            self._draw_slope()

    def _draw_patch(self, center: tuple[float, float], size: tuple[float, float], angle: float, friction: float) -> None:
        """Tint a patch: blue and hatched where it is slippery for this robot, orange where rough."""
        usual = self.robot.contact.friction
        half = np.array(size) / 2
        corners = placed(np.array([(1, 1), (-1, 1), (-1, -1), (1, -1)]) * half, (*center, angle))
        change = min(1.0, abs(math.log(max(friction, 1e-3) / usual)) / math.log(4))
        color = SLIPPERY if friction < usual else ROUGH
        self._canvas.layer([(self.pixel(corners), color, round(40 + 60 * change))])
        if friction < usual:
            step = 14 * self._unit / self.scale
            for start in np.arange(-half.sum(), half.sum(), step):
                # the part of y = x - start, in the patch's own axes, that lies inside it
                low, high = max(-half[0], start - half[1]), min(half[0], start + half[1])
                if low < high:
                    ends = placed(np.array([(low, low - start), (high, high - start)]), (*center, angle))
                    a, b = self.pixel(ends)
                    self._canvas.layer([(bar(a, b, 1.5 * self._unit), color, 90)])

    def _draw_grid(self) -> None:
        width, height = self._canvas.size
        step = GRID_STEP
        while step * self.scale < 10 * self._unit:
            step *= 10
        low = self._middle - self._center / self.scale
        high = self._middle + self._center / self.scale
        for axis in (0, 1):
            for k in range(math.ceil(low[axis] / step), math.floor(high[axis] / step) + 1):
                x, y = self.pixel((k * step, k * step))
                ends = [(x, 0), (x, height)] if axis == 0 else [(0, y), (width, y)]
                self._canvas.line(ends, GRID if k else AXES, self._unit)

    def _draw_slope(self) -> None:
        """Draw an arrow downhill and the gradient in the upper right corner."""
        u, (width, _) = self._unit, self._canvas.size
        steepness = math.hypot(*self.floor.slope)
        down = np.array([-self.floor.slope[0], self.floor.slope[1]]) / steepness
        side = np.array([-down[1], down[0]])
        center = np.array([width - 40 * u, 40 * u])
        self._canvas.disc(center, 27 * u, WHITE)
        self._canvas.disc(center, 27 * u, AXES, ring=1.5 * u)
        self._canvas.line([center - 17 * u * down, center + 8 * u * down], INK, 3 * u)
        tip = [center + 19 * u * down, center + 6 * u * down + 8 * u * side, center + 6 * u * down - 8 * u * side]
        self._canvas.polygon(tip, INK)
        words = f"downhill {100 * steepness:.2g} %"
        self._canvas.text(words, (width - 76 * u, 40 * u), 15 * u, FADED, "right")

    def _draw_paths(self) -> None:
        canvas, u = self._canvas, self._unit
        if len(self._reference) > 1:
            for dot in _evenly(self.pixel(np.array(self._reference) / self.scale), 9 * u):
                canvas.disc(dot, 1.7 * u, REFERENCE)
        canvas.line(self.pixel(np.array(self._truth) / self.scale), TRUE_PATH, 6 * u)
        canvas.disc(self.pixel(self._truth[0] / self.scale), 6 * u, WHITE)
        canvas.disc(self.pixel(self._truth[0] / self.scale), 6 * u, TRUTH, ring=2.5 * u)
        if self._estimate:
            canvas.line(self.pixel(np.array(self._estimate) / self.scale), ESTIMATE, 2 * u)

    def _draw_robot(self, pose: Array, castor_angles: ArrayLike, sliding: ArrayLike | None) -> None:
        hull = self.pixel(placed(self._chassis, pose))
        inner = _inset(hull, 2.5 * self._unit)
        self._canvas.layer([(hull, TRUTH, 255), (inner, DECK, 150)])
        self._canvas.polygon(self.pixel(placed(self._nose, pose)), TRUTH)
        slides = np.zeros(len(self.robot.wheels), bool) if sliding is None else np.asarray(sliding, dtype=bool)
        first = 0
        for castor, outline in zip(self.robot.castors, castor_outlines(self.robot, castor_angles), strict=True):
            colors = [
                SLIDING if slides[first + k] else TYRE if wheel.driven else IDLE_TYRE
                for k, wheel in enumerate(castor.wheels)
            ]
            self._draw_castor(outline, colors, pose)
            first += len(castor.wheels)
        self._draw_origin(pose, TRUTH)

    def _draw_castor(self, outline: CastorOutline, colors: list[Color], pose: Array) -> None:
        canvas = self._canvas

        def outlined(part: Array, fill: Color, edge: Color = INK) -> None:
            points = self.pixel(placed(part, pose))
            canvas.polygon(points, edge)
            canvas.polygon(_inset(points, 1.2 * self._unit), fill)

        for part, color, rollers in zip(outline.tyres, colors, outline.rollers, strict=True):
            outlined(part, color, TYRE)
            for roller in rollers:
                canvas.polygon(self.pixel(placed(roller, pose)), METAL)
        for part in outline.frame:
            outlined(part, METAL)
        if outline.pointer is not None:
            center = self.pixel(placed(outline.pivot, pose))
            canvas.disc(center, outline.pivot_radius * self.scale, INK)
            canvas.disc(center, outline.pivot_radius * self.scale - 1.5 * self._unit, WHITE)
            outlined(outline.pointer, WHITE)

    def _draw_ghost(self, pose: Array) -> None:
        """Draw where the estimator believes the robot is: a dashed outline, so that the robot shows through."""
        hull = _evenly(self.pixel(placed(self._chassis, pose)), 1.5 * self._unit, closed=True)
        inner = _inset(hull, 2.5 * self._unit)
        shapes: list[Shape] = []
        dash = 7
        for k in range(0, len(hull), 2 * dash):
            part = slice(k, k + dash + 1)
            shapes.append((np.concatenate([hull[part], inner[part][::-1]]), ESTIMATE, 255))
        self._canvas.layer(shapes)
        tip = self.pixel(placed(self._nose, pose))
        self._canvas.line([*tip, tip[0]], ESTIMATE, 2 * self._unit)
        self._draw_origin(pose, ESTIMATE)

    def _draw_origin(self, pose: Array, color: Color) -> None:
        center = self.pixel(pose[:2])
        self._canvas.disc(center, 5 * self._unit, WHITE)
        self._canvas.disc(center, 3.5 * self._unit, color)

    def _draw_strip(self, time: float, pose: Array, estimate: Array | None, with_sliding: bool) -> None:
        """Write time, legend and scale under the picture."""
        canvas, u = self._canvas, self._unit
        width, height = canvas.size
        top, y = height - self._strip, height - self._strip / 2
        canvas.polygon([(0, top), (width, top), (width, height), (0, height)], WHITE)
        canvas.line([(0, top), (width, top)], AXES, u)
        canvas.text(f"{time:.2f} s", (16 * u, y), 18 * u, INK)

        length = _round_length(140 * u / self.scale)
        right, left = width - 16 * u, width - 16 * u - length * self.scale
        canvas.line([(left, y + 8 * u), (right, y + 8 * u)], INK, 3 * u)
        for end in (left, right):
            canvas.line([(end, y + 3 * u), (end, y + 13 * u)], INK, 2 * u)
        canvas.text(f"{length:g} m", ((left + right) / 2, y - 7 * u), 14 * u, INK, "center")

        entries: list[tuple[str, Color, float]] = [("true path", TRUE_PATH, 6)]
        if self._estimate:
            entries.append(("estimate", ESTIMATE, 2))
        if self._reference:
            entries.append(("reference", REFERENCE, 0))
        if self.floor.cables:
            entries.append(("cable", CABLE, 3))
        x = 112 * u
        for words, color, thickness in entries:
            if thickness:
                canvas.line([(x, y), (x + 24 * u, y)], color, thickness * u)
            else:
                for k in range(3):
                    canvas.disc((x + (3 + 9 * k) * u, y), 1.7 * u, color)
            x += 32 * u + canvas.text(words, (x + 32 * u, y), 14 * u, INK) + 16 * u
        if with_sliding:
            canvas.polygon([(x, y - 5 * u), (x + 22 * u, y - 5 * u), (x + 22 * u, y + 5 * u), (x, y + 5 * u)], TYRE)
            canvas.polygon([(x + 1.5 * u, y - 3.5 * u), (x + 20.5 * u, y - 3.5 * u), (x + 20.5 * u, y + 3.5 * u), (x + 1.5 * u, y + 3.5 * u)], SLIDING)
            canvas.text("sliding", (x + 30 * u, y), 14 * u, INK)


def _inset(polygon: Array, distance: float) -> Array:
    """Return a smooth polygon (k, 2) whose corners are moved inwards; which way is inwards follows from its area's sign."""
    along = np.roll(polygon, -1, axis=0) - np.roll(polygon, 1, axis=0)
    along /= np.maximum(np.hypot(*along.T)[:, None], 1e-9)
    x, y = polygon.T
    sense = np.sign(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
    return polygon + sense * distance * np.stack([-along[:, 1], along[:, 0]], axis=1)


def _evenly(path: Array, step: float, closed: bool = False) -> Array:
    """Return points (k, 2) along a path, `step` apart; along a closed one, about `step` apart and an even number."""
    if closed:
        path = np.concatenate([path, path[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    at = np.arange(0.0, length[-1], step)
    if closed:
        at = np.linspace(0.0, length[-1], 2 * (len(at) // 2), endpoint=False)
    return np.stack([np.interp(at, length, path[:, 0]), np.interp(at, length, path[:, 1])], axis=1)


def _round_length(about: float) -> float:
    """Return 1, 2 or 5 times a power of ten, the largest that is not longer than `about`."""
    power = 10.0 ** math.floor(math.log10(about))
    return max(factor * power for factor in (1, 2, 5) if factor * power <= about * (1 + 1e-9))
