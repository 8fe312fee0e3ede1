"""The robot in plan: outlines of chassis, castors and wheels, from its description, as polygons (k, 2) in B, m.

A description does not say what the chassis looks like or how wide tyres are. The chassis is drawn as the smooth hull
of the discs that its castors sweep, tyres 0.6 of their radius wide; nothing but pictures uses either. Modules of a
train, whose castors are fixed and whose neighbours are near, have a compact chassis: their wheels' hull and a rim.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry, left_of, unit
from castor_envs.vehicles.robot import Castor, RobotDescription

TYRE_WIDTH = 0.6  # of the wheel's radius
COMPACT_RIM = 0.12  # how far a compact chassis reaches beyond its wheels, of their smallest radius
PIVOT_RADIUS = 0.32  # of the castor's largest wheel radius


@dataclass(frozen=True, eq=False)
class CastorOutline:
    """One castor.

    pivot (2,) and pivot_radius: of its bearing, radius 0 on fixed castors, m. tyres: one polygon a wheel. rollers: for
    each wheel, a few of its rollers if it is an omni wheel. frame: axle and fork. pointer: to the rolling direction,
    where no fork shows it.
    """

    pivot: Array
    pivot_radius: float
    tyres: tuple[Array, ...]
    rollers: tuple[tuple[Array, ...], ...]
    frame: tuple[Array, ...]
    pointer: Array | None


def hull_of_discs(centers: ArrayLike, radii: ArrayLike, points: int = 180) -> Array:
    """Return the outline (points, 2), counter-clockwise, of the convex hull of discs: centers (n, 2), radii (n,).

    Each point is where the hull's tangent has the next direction of a full turn.
    """
    centers, radii = np.asarray(centers, dtype=float), np.asarray(radii, dtype=float)
    normal = unit(2 * np.pi * (np.arange(points) + 0.5) / points)
    outermost = np.argmax(normal @ centers.T + radii, axis=1)
    return centers[outermost] + radii[outermost, None] * normal


def bar(start: ArrayLike, end: ArrayLike, width: float) -> Array:
    """Return a bar from `start` to `end` (2,) with round ends."""
    return hull_of_discs(np.stack([start, end]), [width / 2, width / 2], points=24)


def tyre(center: ArrayLike, length: float, width: float) -> Array:
    """Return a rectangle (k, 2) along x with rounded corners."""
    corner = 0.3 * width
    x, y = length / 2 - corner, width / 2 - corner
    corners = np.array([(x, y), (-x, y), (-x, -y), (x, -y)])
    return np.asarray(center) + hull_of_discs(corners, [corner] * 4, points=24)


def swept_radius(castor: Castor) -> float:
    """Return the radius of the disc about its pivot that a castor's wheels sweep, m."""
    return max(
        math.hypot(castor.offset + wheel.radius, abs(wheel.lateral) + TYRE_WIDTH * wheel.radius / 2)
        for wheel in castor.wheels
    )


def chassis_outline(robot: RobotDescription, compact: bool = False) -> Array:
    """Return the chassis (k, 2)."""
    return hull_of_discs(*_covered(robot, compact))


def nose(robot: RobotDescription, compact: bool = False) -> Array:
    """Return the triangle (3, 2) at the chassis' front that shows which way x points."""
    centers, radii = _covered(robot, compact)
    reach = centers[:, 0] + radii
    front = float(np.max(reach))
    y = float(np.mean(centers[reach > front - 1e-9, 1]))
    size = 0.25 * math.sqrt(_area(chassis_outline(robot, compact)) / math.pi)
    return np.array(
        [(front + 0.5 * size, y), (front - 0.5 * size, y + 0.6 * size), (front - 0.5 * size, y - 0.6 * size)]
    )


def castor_outlines(robot: RobotDescription, castor_angles: ArrayLike) -> tuple[CastorOutline, ...]:
    """Return the castors at `castor_angles` (n,), theta in rad; those of fixed castors are ignored."""
    geometry = Geometry.of(robot)
    angles = np.where(geometry.fixed, geometry.angle, np.asarray(castor_angles, dtype=float))
    return tuple(_castor(castor, float(angle)) for castor, angle in zip(robot.castors, angles, strict=True))


def inset(polygon: Array, distance: float) -> Array:
    """Return a polygon (k, 2), of many corners or sharp ones, with its edge moved inwards by about `distance`."""
    along = np.roll(polygon, -1, axis=0) - np.roll(polygon, 1, axis=0)
    along /= np.maximum(np.hypot(*along.T)[:, None], 1e-9)
    return polygon + np.sign(_area(polygon)) * distance * left_of(along)


def placed(points: Array, pose: ArrayLike) -> Array:
    """Return points (..., 2) of a frame at `pose` (x, y, psi) in the frame that the pose is given in."""
    x, y, psi = (float(value) for value in np.asarray(pose, dtype=float))
    c, s = math.cos(psi), math.sin(psi)
    return points @ np.array([(c, s), (-s, c)]) + (x, y)


def _covered(robot: RobotDescription, compact: bool) -> tuple[Array, Array]:
    """Return the discs, centers (n, 2) and radii (n,), that the chassis covers."""
    if not compact:
        return np.array([c.pivot for c in robot.castors]), np.array([swept_radius(c) for c in robot.castors])
    outlines = castor_outlines(robot, np.zeros(len(robot.castors)))
    corners = np.concatenate([shape for outline in outlines for shape in outline.tyres])
    return corners, np.full(len(corners), COMPACT_RIM * min(wheel.radius for wheel in robot.wheels))


def _castor(castor: Castor, angle: float) -> CastorOutline:
    """Draw a castor in its own frame, x along its rolling direction from the pivot, and put it in B."""
    at = (*castor.pivot, angle)
    largest = max(wheel.radius for wheel in castor.wheels)
    pivot_radius = 0.0 if castor.steering == "fixed" else PIVOT_RADIUS * largest
    axle = [(-castor.offset, wheel.lateral) for wheel in castor.wheels]
    tyres, rollers = [], []
    for wheel, center in zip(castor.wheels, axle, strict=True):
        length, width = 2 * wheel.radius, TYRE_WIDTH * wheel.radius
        tyres.append(placed(tyre(center, length, width), at))
        lean = np.array([math.cos(wheel.roller_angle), math.sin(wheel.roller_angle)]) * 0.36 * width
        middles = [(center[0] + share * length, center[1]) for share in (-0.3, -0.1, 0.1, 0.3)]
        across = [bar(np.subtract(middle, lean), np.add(middle, lean), 0.12 * width) for middle in middles]
        rollers.append(tuple(placed(line, at) for line in across) if wheel.grip == "omni" else ())
    hub = 0.5 * TYRE_WIDTH * largest if len(axle) == 1 else 0.0
    left, right = (axle[0][0], axle[0][1] + 1.3 * hub), (axle[-1][0], axle[-1][1] - 1.3 * hub)
    frame = [bar(left, right, 0.36 * largest)]
    pointer = None
    if castor.steering != "fixed":
        frame.append(hull_of_discs([(-castor.offset, 0.0), (0.0, 0.0)], [0.8 * pivot_radius, pivot_radius], points=36))
        if castor.offset < 0.4 * largest:
            tip, base = 0.92 * largest - castor.offset, 1.2 * pivot_radius
            pointer = placed(np.array([(tip, 0.0), (base, 0.24 * largest), (base, -0.24 * largest)]), at)
    return CastorOutline(
        pivot=np.array(castor.pivot),
        pivot_radius=pivot_radius,
        tyres=tuple(tyres),
        rollers=tuple(rollers),
        frame=tuple(placed(part, at) for part in frame),
        pointer=pointer,
    )


def _area(polygon: Array) -> float:
    """Return a polygon's area, positive if it is counter-clockwise (in axes x right, y up)."""
    x, y = polygon.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))
