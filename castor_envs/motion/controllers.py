"""The kinematics-based controller: from the motion wanted and the castor angles measured to motor commands."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.kinematics import Geometry, castor_rates, inverse, pivot_velocity
from castor_envs.vehicles.robot import RobotDescription

STANDSTILL = 1e-6  # m/s: a pivot slower than this has no direction to steer to


class Commands(NamedTuple):
    """Commands for one sample period: driven wheels (...,) and driven castors (...,), both in rad/s."""

    wheel: Array
    steering: Array


def trailing_angles(geometry: Geometry, twist: ArrayLike) -> Array:
    """Return the castor angles (..., n) of castors that have long trailed at a body twist (..., 3); 0 where at rest."""
    u = pivot_velocity(geometry, np.asarray(twist, dtype=float))
    moving = np.hypot(u[..., 0], u[..., 1]) > STANDSTILL
    return np.where(geometry.fixed, geometry.angle, np.where(moving, np.arctan2(u[..., 1], u[..., 0]), 0.0))


class KinematicController:
    """Maps a body twist to wheel and steering rates by the rolling constraints (Doebbler II.D), open loop in the pose.

    Commands hold for a sample period, in which castors go on turning: they are computed for the angles that the
    castors will have in its middle. Driven castors without an offset (swerve, tricycle) are steered to their pivot's
    direction of travel, or to its opposite if that is nearer.
    """

    def __init__(self, robot: RobotDescription) -> None:
        self._geometry = Geometry.of(robot)
        self._period = robot.sample_period
        self._steering_limit = robot.max_steering_speed
        self._driven_wheels = np.array(robot.driven_wheels, dtype=np.intp)
        self._driven_castors = np.array(robot.driven_castors, dtype=np.intp)

    def commands(self, castor_angle: ArrayLike, twist: ArrayLike) -> Commands:
        """Return commands for measured castor angles (n,) and the twist (3,) in B wanted in mid-period."""
        geometry, theta = self._geometry, np.asarray(castor_angle, dtype=float)
        twist = np.asarray(twist, dtype=float)
        steered = self._steering_rates(theta, twist)
        middle = theta + 0.5 * self._period * self._rates(theta, twist, steered)
        rate = self._rates(middle, twist, steered)
        wheel = inverse(geometry, middle, rate, twist).rate
        return Commands(wheel[self._driven_wheels], rate[self._driven_castors])

    def _rates(self, theta: Array, twist: Array, steered: Array) -> Array:
        """Return castor rates (n,): of rolling where the castor trails, else `steered`; within the motors' limit."""
        rate = np.where(self._geometry.trailing, castor_rates(self._geometry, theta, twist), steered)
        limit = np.where(self._geometry.driven, self._steering_limit, np.inf)
        return np.clip(rate, -limit, limit)

    def _steering_rates(self, theta: Array, twist: Array) -> Array:
        """Return the rates (n,) that turn driven castors to their pivots' direction of travel in a period; else 0."""
        u = pivot_velocity(self._geometry, twist)
        away = np.arctan2(u[:, 1], u[:, 0]) - theta
        nearest = away - np.pi * np.round(away / np.pi)
        turning = self._geometry.driven & (np.hypot(u[:, 0], u[:, 1]) > STANDSTILL)
        return np.where(turning, nearest / self._period, 0.0)
