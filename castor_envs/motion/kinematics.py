"""Rolling kinematics, stated once: estimators, controllers and diagnosis all use it. Arithmetic broadcasts.

A wheel at (-offset, lateral) in the frame of a castor that pivots at p, angle theta against the body, on a
body with twist (v_x, v_y, omega) in B: the pivot moves at u = v + omega x p, the castor turns at Omega =
omega + theta_dot, and

    rolled distance rate   r phi_dot = u . e - Omega lateral  (+ tan(roller angle) * side velocity, omni
    wheels)
    no side slip                   0 = u . n - Omega offset   (standard wheels)

with e = (cos theta, sin theta) the rolling direction and n = (-sin theta, cos theta) its left. Doebbler II.D uses both
without writing them out.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.errors import Declined
from castor_envs.geometry.arrays import Array, vectors
from castor_envs.vehicles.robot import Fixes, Gyro, RobotDescription
from castor_envs.vehicles.tolerances import Tolerances
from castor_envs.vehicles.train import TrainDescription
from castor_envs.vehicles.weight import chassis

NUMBERS = {
    "pivot": 2,
    "offset": 1,
    "pivot_zero": 1,
    "angle": 1,
    "lateral": 1,
    "radius": 1,
    "roller": 1,
    "mass": 0,
    "inertia": 0,
    "center": 1,
    "castor_mass": 1,
    "castor_inertia": 1,
    "slip_stiffness": 1,
    "max_wheel_torque": 0,
}
"""Numbers of a geometry, and how many axes each has behind the leading ones."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """The numbers of one robot, or of many of one layout, as arrays with any leading axes.

    n castors, w wheels (castor by castor). pivot (..., n, 2), offset (..., n), pivot_zero (..., n), angle (..., n) of
    fixed castors; lateral, radius, roller (..., w), roller the tangent of the roller angle. mass, inertia (...) and
    center (..., 2) of the chassis with its fixed castors, castor_mass and castor_inertia (..., n) of others, 0 of
    fixed ones; slip_stiffness (..., 2), along and across, over a wheel's load; max_wheel_torque (...). Layout, equal
    for all robots of one geometry: wheel_castor (w,), counts_per_rev (w,) and pivot_counts_per_rev (n,) with NaN where
    there is no encoder, standard (w,) for wheels without rollers, fixed and driven (n,) by steering. gyro, fixes and
    tolerances: as the description states them, None where it states none.
    """

    pivot: Array
    offset: Array
    pivot_zero: Array
    angle: Array
    lateral: Array
    radius: Array
    roller: Array
    wheel_castor: NDArray[np.intp]
    counts_per_rev: Array
    pivot_counts_per_rev: Array
    standard: NDArray[np.bool_]
    fixed: NDArray[np.bool_]
    driven: NDArray[np.bool_]
    sample_period: float
    mass: Array
    inertia: Array
    center: Array
    castor_mass: Array
    castor_inertia: Array
    slip_stiffness: Array
    max_wheel_torque: Array
    gyro: Gyro | None = None
    fixes: Fixes | None = None
    tolerances: Tolerances | None = None

    @classmethod
    def of(cls, robot: "RobotDescription | Sequence[RobotDescription] | Geometry") -> "Geometry":
        """Return the geometry of a robot, of a sequence of robots (one leading axis), or the geometry itself.

        Raises ValueError if robots of a sequence differ in layout, encoders, sample period, gyro, fixes or
        tolerances, Declined for a train.
        """
        if isinstance(robot, Geometry):
            return robot
        if isinstance(robot, RobotDescription):
            return _of_robot(robot)
        if isinstance(robot, TrainDescription):
            raise Declined(f"serves a single robot, and {robot.name!r} is a train")
        members = [_of_robot(member) for member in robot]
        first = members[0]
        layout = ("wheel_castor", "counts_per_rev", "pivot_counts_per_rev", "standard", "fixed", "driven")
        same = ("sample_period", "gyro", "fixes", "tolerances")
        for member in members[1:]:
            for name in layout:
                if not np.array_equal(getattr(member, name), getattr(first, name), equal_nan=name.endswith("per_rev")):
                    raise ValueError(f"robots of one batch must agree in {name}")
            for name in same:
                if getattr(member, name) != getattr(first, name):
                    raise ValueError(f"robots of one batch must agree in {name}")
        return cls._stacked(members)

    @classmethod
    def rolling(cls, robots: Sequence[RobotDescription]) -> "Geometry":
        """Return the geometry of robots of one layout, (k, ...), for their motion alone: sensors are the first's."""
        return cls._stacked([_of_robot(robot) for robot in robots])

    @classmethod
    def _stacked(cls, members: Sequence["Geometry"]) -> "Geometry":
        stacked = {name: np.stack([getattr(member, name) for member in members]) for name in NUMBERS}
        return dataclasses.replace(members[0], **stacked)

    @property
    def n_castors(self) -> int:
        """How many castors each robot has."""
        return self.pivot.shape[-2]

    @cached_property
    def trailing(self) -> NDArray[np.bool_]:
        """Which castors (..., n) the floor turns: behind their pivot, on at least one wheel without rollers."""
        held = np.bincount(self.wheel_castor, weights=self.standard, minlength=self.n_castors) > 0
        return (self.offset > 0) & held

    @cached_property
    def sensed(self) -> NDArray[np.intp]:
        """The castors with a pivot encoder, by their indices."""
        return np.flatnonzero(~np.isnan(self.pivot_counts_per_rev))

    @cached_property
    def known_angle(self) -> Array:
        """The angles (..., n) of fixed castors, rad; NaN of others."""
        return np.where(self.fixed, self.angle, np.nan)

    @cached_property
    def trail(self) -> Array:
        """The offsets (..., n) of castors that the floor turns, m; NaN of others."""
        return np.where(self.trailing, self.offset, np.nan)

    @cached_property
    def reach(self) -> float:
        """The largest distance of one robot's wheels from B's origin, m."""
        return float(np.max(np.hypot(*self.pivot.T) + self.offset) + np.max(np.abs(self.lateral)))

    @cached_property
    def left_of_pivot(self) -> Array:
        """The pivots (..., n, 2) turned by +90 degrees about B's origin, m: their velocities at 1 rad/s."""
        return left_of(self.pivot)

    def side_slip_of_fixed(self, twist: ArrayLike) -> Array:
        """Return how fast (m/s) each fixed castor (..., n) slips sideways at a twist (..., 3); 0 where it may."""
        slip = inverse(self, self.angle, np.zeros_like(self.angle), twist).side_slip
        wheel, held = self._standard_of_castor
        return np.where(self.fixed & held, slip[..., wheel], 0.0)

    @cached_property
    def _standard_of_castor(self) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
        """Of each castor (n,) a wheel without rollers, and whether it has one."""
        on = (self.wheel_castor == np.arange(self.n_castors)[:, None]) & self.standard
        return np.argmax(on, axis=1), np.any(on, axis=1)

    def expand(self, axes: int) -> "Geometry":
        """Return the geometry with `axes` new axes of length 1 behind its leading ones, to broadcast over runs."""
        if self.offset.ndim == 1:
            return self  # it has no leading axes
        changed = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        for name, ndim in NUMBERS.items():
            array = changed[name]
            split = array.ndim - ndim
            changed[name] = array.reshape(array.shape[:split] + (1,) * axes + array.shape[split:])
        return Geometry(**changed)


def _of_robot(robot: RobotDescription) -> Geometry:
    castors, wheels = robot.castors, robot.wheels

    mass, inertia, center = chassis(robot)

    def numbers(values: list[float | None]) -> Array:
        return np.array([np.nan if value is None else value for value in values], dtype=float)

    return Geometry(
        pivot=np.array([castor.pivot for castor in castors], dtype=float),
        offset=np.array([castor.offset for castor in castors]),
        pivot_zero=np.array([castor.pivot_zero for castor in castors]),
        angle=np.array([castor.angle for castor in castors]),
        lateral=np.array([wheel.lateral for wheel in wheels]),
        radius=np.array([wheel.radius for wheel in wheels]),
        roller=np.array([np.tan(wheel.roller_angle) for wheel in wheels]),
        wheel_castor=np.array(robot.wheel_castors),
        counts_per_rev=numbers([wheel.counts_per_rev for wheel in wheels]),
        pivot_counts_per_rev=numbers([castor.pivot_counts_per_rev for castor in castors]),
        standard=np.array([wheel.grip == "standard" for wheel in wheels]),
        fixed=np.array([castor.steering == "fixed" for castor in castors]),
        driven=np.array([castor.steering == "driven" for castor in castors]),
        sample_period=robot.sample_period,
        mass=np.array(mass),
        inertia=np.array(inertia),
        center=center,
        castor_mass=np.array([0.0 if castor.steering == "fixed" else castor.mass for castor in castors]),
        castor_inertia=np.array([0.0 if castor.steering == "fixed" else castor.inertia for castor in castors]),
        slip_stiffness=np.array([robot.contact.slip_stiffness_long, robot.contact.slip_stiffness_lat]),
        max_wheel_torque=np.array(robot.max_wheel_torque),
        gyro=robot.gyro,
        fixes=robot.fixes,
        tolerances=robot.tolerances,
    )


def unit(angle: ArrayLike) -> Array:
    """Return (cos, sin) of an angle along a new last axis."""
    angle = np.asarray(angle, dtype=float)
    return vectors(np.cos(angle), np.sin(angle))


def left_of(vector: Array) -> Array:
    """Return plane vectors (..., 2) turned by +90 degrees."""
    return vectors(-vector[..., 1], vector[..., 0])


def _dot(a: Array, b: Array) -> Array:
    """Return the products (...) of plane vectors (..., 2); `np.sum` along two numbers takes much longer."""
    return a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1]


def pivot_velocity(geometry: Geometry, twist: ArrayLike) -> Array:
    """Return the pivots' velocities in B, (..., n, 2), for body twists (..., 3) = (v_x, v_y, omega) in B."""
    twist = np.asarray(twist, dtype=float)
    return twist[..., None, :2] + twist[..., None, 2:] * geometry.left_of_pivot


def castor_rates(geometry: Geometry, castor_angle: ArrayLike, twist: ArrayLike) -> Array:
    """Return theta_dot (..., n) that keeps every wheel from slipping sideways; 0 where fixed, NaN where offset is 0.

    A castor on omni wheels alone is not turned by the floor: NaN unless fixed.
    """
    castor_angle, twist = np.asarray(castor_angle, dtype=float), np.asarray(twist, dtype=float)
    u = pivot_velocity(geometry, twist)
    sideways = _dot(u, left_of(unit(castor_angle)))
    turning = sideways / geometry.trail - twist[..., 2:]
    return np.where(geometry.fixed, 0.0, turning)


class WheelMotion(NamedTuple):
    """What the rolling constraints say: wheel rates (..., w), rad/s, and sideways contact velocity (..., w), m/s."""

    rate: Array
    side_slip: Array


def inverse(geometry: Geometry, castor_angle: ArrayLike, castor_rate: ArrayLike, twist: ArrayLike) -> WheelMotion:
    """Return the wheel motion for body twists (..., 3), castor angles and castor rates (..., n).

    `side_slip` is 0 for standard wheels wherever the motion satisfies their constraint.
    """
    castor_angle, castor_rate = np.asarray(castor_angle, dtype=float), np.asarray(castor_rate, dtype=float)
    twist = np.asarray(twist, dtype=float)
    u = pivot_velocity(geometry, twist)
    e = unit(castor_angle)
    turning = twist[..., 2:] + castor_rate
    of_wheel = geometry.wheel_castor
    along = _dot(u, e)[..., of_wheel] - turning[..., of_wheel] * geometry.lateral
    across = (_dot(u, left_of(e)) - turning * geometry.offset)[..., of_wheel]
    return WheelMotion((along + across * geometry.roller) / geometry.radius, across)


def constraint_matrix(geometry: Geometry, castor_angle: ArrayLike) -> tuple[Array, Array]:
    """Return the constraints as matrices: rows first the rolling of each wheel, then the side slip of each wheel.

    A (..., 2w, 3) times the twist, plus B (..., 2w) times the wheel's castor rate, is (r phi_dot, side slip): what
    `inverse` says, which is linear in both. But for B in its last column, A turns with the castors.
    """
    castor_angle = np.asarray(castor_angle, dtype=float)
    of_wheel, roller = geometry.wheel_castor, geometry.roller
    cos, sin = (np.take(of_castor, of_wheel, axis=-1) for of_castor in (np.cos(castor_angle), np.sin(castor_angle)))
    x, y, offset = geometry.pivot[..., of_wheel, 0], geometry.pivot[..., of_wheel, 1], geometry.offset[..., of_wheel]
    w, shape = len(of_wheel), np.broadcast_shapes(castor_angle.shape[:-1], geometry.offset.shape[:-1])
    a, b = np.empty((*shape, 2 * w, 3)), np.empty((*shape, 2 * w))
    a[..., w:, 0], a[..., w:, 1] = -sin, cos
    a[..., w:, 2] = x * cos + y * sin - offset
    b[..., w:] = -offset
    a[..., :w, 0], a[..., :w, 1] = cos, sin
    a[..., :w, 2] = x * sin - y * cos - geometry.lateral
    b[..., :w] = -geometry.lateral
    if np.any(roller):
        a[..., :w, :] += a[..., w:, :] * roller[..., None]
        b[..., :w] += b[..., w:] * roller
    return a, b


def forward(geometry: Geometry, castor_angle: ArrayLike, castor_rate: ArrayLike, wheel_rate: ArrayLike) -> Array:
    """Return the twist (..., 3) that fits wheel rates (..., w) and castor rates (..., n) best, by least squares.

    Rows: rolling of each wheel with an encoder, no side slip of each standard wheel, all in m/s and equally weighted.
    The rates of idle wheels are ignored. Where the wheels do not determine the motion (one free castor: the body may
    turn about its pivot), it is the smallest twist that fits.
    """
    castor_rate, wheel_rate = np.asarray(castor_rate, dtype=float), np.asarray(wheel_rate, dtype=float)
    a, b = constraint_matrix(geometry, castor_angle)
    rolled = wheel_rate * geometry.radius
    measured = np.concatenate([rolled, np.zeros_like(rolled)], axis=-1)
    of_wheel = np.concatenate([geometry.wheel_castor, geometry.wheel_castor])
    used = np.concatenate([~np.isnan(geometry.counts_per_rev), geometry.standard])
    right = (measured - b * castor_rate[..., of_wheel])[..., used]
    return np.einsum("...ij,...j->...i", np.linalg.pinv(a[..., used, :], rcond=1e-10), right)
