"""What effects on contact, floor and place are predicted from: what truly happened, and by what contacts slipped."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate

if TYPE_CHECKING:
    from castor_envs.vehicles.robot import RobotDescription


EVEN = 1.1
"""Steps are integrated to fourth order where their neighbours last as long, up to this ratio; others to second."""


@dataclass(frozen=True, eq=False)
class Motion:
    """What truly happened at K samples: K - 1 steps, of which the properties tell.

    t (K,): s, increasing. pose (K, 3): of B in N, m and rad, unwrapped. wheel_angle (K, w): since the start, rad; NaN
    for wheels without encoder. castor_angle (K, n): theta, rad, unwrapped. agreeing: whether wheels are taken to agree
    with each other, whatever their angles say: where a log alone tells of the motion, the rest is mostly noise.
    """

    t: Array
    pose: Array
    wheel_angle: Array
    castor_angle: Array
    agreeing: bool = False

    @cached_property
    def period(self) -> Array:
        """How long each step takes (K - 1,), s."""
        return np.diff(self.t)

    @cached_property
    def middle(self) -> Array:
        """Times half-way through the steps (K - 1,), s."""
        return (self.t[1:] + self.t[:-1]) / 2

    @cached_property
    def even(self) -> NDArray[np.bool_]:
        """Which steps (K - 1,) last as long as both their neighbours, up to `EVEN`."""
        ratio = self.period[1:] / self.period[:-1]
        alike = np.maximum(ratio, 1 / ratio) < EVEN
        return np.concatenate([[False], alike]) & np.concatenate([alike, [False]])

    @cached_property
    def half_way(self) -> Array:
        """Castor angles half-way through the steps (K - 1, n), rad."""
        angle = self.castor_angle
        middle = (angle[1:] + angle[:-1]) / 2
        middle[1:-1] -= self.where_even(angle[3:] - angle[2:-1] - angle[1:-2] + angle[:-3]) / 16
        return middle

    @cached_property
    def heading(self) -> Array:
        """Headings of the body half-way through the steps (K - 1,), rad."""
        return (self.pose[1:, 2] + self.pose[:-1, 2]) / 2

    @cached_property
    def body(self) -> Array:
        """How far the body moves and turns in each step, in B half-way through it (K - 1, 3), m and rad."""
        turn = np.diff(self.pose[:, 2])
        way = self.in_body(np.diff(self.pose[:, :2], axis=0)) / np.sinc(turn / (2 * np.pi))[:, None]
        body = np.column_stack([way, turn])
        change = self.where_even(body[2:] - body[:-2]) / 2
        swept = turn[1:-1, None] * change[:, :2] - change[:, 2:] * way[1:-1]
        body[1:-1, :2] -= np.column_stack([-swept[:, 1], swept[:, 0]]) / 12
        return body

    @cached_property
    def turned(self) -> Array:
        """How far the castors turn against the body in each step (K - 1, n), rad."""
        return np.diff(self.castor_angle, axis=0)

    @cached_property
    def twist(self) -> Array:
        """The body's twist in each step (K - 1, 3), in B, m/s and rad/s, smoothed."""
        return smoothed(self.body / self.period[:, None])

    @cached_property
    def acceleration(self) -> Array:
        """The acceleration of the body's origin, turned into B, and of its heading (K - 1, 3), m/s2 and rad/s2."""
        rate = self.acceleration_of(self.pose)
        return np.column_stack([self.in_body(rate[:, :2]), rate[:, 2]])

    def acceleration_of(self, course: Array) -> Array:
        """Return the second derivative in each step (K - 1, ...) of what is known at every sample, `course` (K, ...).

        From smoothed first differences, by central differences: what is faster than about four steps is lost.
        """
        period = self.period.reshape(-1, *(1,) * (course.ndim - 1))
        rate = smoothed(np.diff(course, axis=0) / period)
        return np.gradient(rate, self.middle, axis=0) if len(rate) > 1 else np.zeros_like(rate)

    def where_even(self, inner: Array) -> Array:
        """Return values of inner steps (K - 3, ...), 0 where a step is not even."""
        return inner * self.even[1:-1].reshape(-1, *(1,) * (inner.ndim - 1))

    def in_body(self, vector: Array) -> Array:
        """Return vectors in N of every step (K - 1, 2) in B half-way through it."""
        c, s = np.cos(self.heading), np.sin(self.heading)
        return np.column_stack([c * vector[:, 0] + s * vector[:, 1], c * vector[:, 1] - s * vector[:, 0]])


@dataclass(frozen=True, eq=False)
class Slip:
    """By how much contacts slip in each of K - 1 steps, m.

    rolling (K - 1, w): by how much each wheel's contact moves further along its rolling direction than the wheel rolls.
    side (K - 1, n): by how much each castor's axle moves to its own left beyond what its turning makes it do.
    """

    rolling: Array
    side: Array

    def __add__(self, other: "Slip") -> "Slip":
        return Slip(self.rolling + other.rolling, self.side + other.side)

    def __sub__(self, other: "Slip") -> "Slip":
        return Slip(self.rolling - other.rolling, self.side - other.side)

    @classmethod
    def none(cls, motion: Motion) -> "Slip":
        """Return no slip in any step of a motion."""
        return cls(*(np.zeros((len(motion.t) - 1, own.shape[1])) for own in (motion.wheel_angle, motion.castor_angle)))


def contact_paths(robot: "RobotDescription", motion: Motion) -> Array:
    """Return how far contacts move in each step (K - 1, 2w), m: all along their rolling directions, then to the left.

    Along is what a wheel without slip rolls; to the left is 0 without slip, but for wheels on rollers. Even steps are
    integrated to fourth order in their length: wheels that disagree creep less than half-way values are off by.
    """
    from castor_envs.geometry.kinematics import Geometry, constraint_matrix  # built on robots, which have effects

    geometry = Geometry.of(robot)
    by_body, by_castor = constraint_matrix(geometry, motion.half_way)
    turned = motion.turned[:, np.tile(geometry.wheel_castor, 2)]
    path = (by_body @ motion.body[..., None])[..., 0] + by_castor * turned
    # The mean of a product over a step: mean times mean, and how both change together.
    bend = motion.where_even(by_body[2:] - 2 * by_body[1:-1] + by_body[:-2]) / 24
    change = motion.where_even(by_body[2:] - by_body[:-2]) * (motion.body[2:] - motion.body[:-2])[:, None, :] / 48
    path[1:-1] += (bend @ motion.body[1:-1, :, None])[..., 0] + change.sum(axis=-1)
    return path


def contact_places(robot: "RobotDescription", motion: Motion) -> Array:
    """Return where in N each wheel touches the floor at every sample (K, w, 2), m."""
    places = []
    for castor, angle in zip(robot.castors, motion.castor_angle.T, strict=True):
        for wheel in castor.wheels:
            arm = np.array(castor.pivot) + rotate(np.array([-castor.offset, wheel.lateral]), angle)
            places.append(motion.pose[:, :2] + rotate(arm, motion.pose[:, 2]))
    return np.stack(places, axis=1)


def smoothed(course: Array) -> Array:
    """Return values of successive steps (K - 1, ...), each a mean of itself (1/2) and its neighbours (1/4 each)."""
    padded = np.concatenate([course[:1], course, course[-1:]])
    return padded[1:-1] / 2 + (padded[2:] + padded[:-2]) / 4
