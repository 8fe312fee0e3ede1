"""Steps between samples of a known motion: what happened in each (`Motion`), by how much contacts slipped (`Slip`), and
integrals over steps, to fourth order in their length where steps are even.
"""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array

EVEN = 1.1
"""Steps are integrated to fourth order where both neighbours last as long, up to this ratio; others to second order."""


@dataclass(frozen=True, eq=False)
class Motion:
    """The true motion at K samples; the properties describe the K - 1 steps between them.

    t (K,): s, increasing. pose (K, 3): of B in N, m and rad, unwrapped. wheel_angle (K, w): since the start, rad; NaN
    for wheels without encoder. castor_angle (K, n): theta, rad, unwrapped. consistent_wheels: whether disagreement
    between the wheels' angles is ignored: where the motion is known from a log alone, such disagreement is mostly
    noise. averaging: s, standard deviation of the times over which such disagreement is averaged (`averaged`).
    """

    t: Array
    pose: Array
    wheel_angle: Array
    castor_angle: Array
    consistent_wheels: bool = False
    averaging: float = 0.0

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
        return even_steps(self.t)

    @cached_property
    def half_way(self) -> Array:
        """Castor angles half-way through the steps (K - 1, n), rad."""
        return half_way(self.castor_angle, self.even)

    @cached_property
    def heading(self) -> Array:
        """Headings of the body half-way through the steps (K - 1,), rad."""
        return (self.pose[1:, 2] + self.pose[:-1, 2]) / 2

    @cached_property
    def body(self) -> Array:
        """How far the body moves and turns in each step, in B half-way through it (K - 1, 3), m and rad."""
        return body_motion(self.pose, self.even)

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

    def averaged(self, rates: Array) -> Array:
        """Return rates in every step (K - 1, ...), averaged over `averaging`, and over three steps at least."""
        return smoothed(rates, max(round(2 * (self.averaging / float(np.median(self.period))) ** 2), 1))

    def acceleration_of(self, course: Array) -> Array:
        """Return the second derivative in each step (K - 1, ...) of what is known at every sample, `course` (K, ...).

        From smoothed first differences, by central differences: changes faster than about four steps are lost.
        """
        period = self.period.reshape(-1, *(1,) * (course.ndim - 1))
        rate = smoothed(np.diff(course, axis=0) / period)
        return np.gradient(rate, self.middle, axis=0) if len(rate) > 1 else np.zeros_like(rate)

    def in_body(self, vector: Array) -> Array:
        """Return vectors (K - 1, 2), one in each step, turned from N into B as it stands half-way through the step."""
        c, s = np.cos(self.heading), np.sin(self.heading)
        return np.column_stack([c * vector[:, 0] + s * vector[:, 1], c * vector[:, 1] - s * vector[:, 0]])


@dataclass(frozen=True, eq=False)
class Slip:
    """By how much contacts slip in each of K - 1 steps, m.

    rolling (K - 1, w): by how much each wheel's contact moves further along its rolling direction than the wheel rolls.
    side (K - 1, n): by how much each castor's axle moves to the castor's left beyond what the castor's turning makes it
    move.
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
        return cls(
            *(np.zeros((len(motion.t) - 1, angle.shape[1])) for angle in (motion.wheel_angle, motion.castor_angle))
        )


def path_of(twist: Array) -> Array:
    """Return the poses (K, 3), from 0 on, between motions of a body (K - 1, 3), each at a constant twist, m and rad."""
    heading = np.concatenate([[0.0], np.cumsum(twist[:, 2])])
    middle = (heading[1:] + heading[:-1]) / 2
    way = (twist[:, 0] + 1j * twist[:, 1]) * np.sinc(twist[:, 2] / (2 * np.pi)) * np.exp(1j * middle)
    x, y = (np.concatenate([[0.0], np.cumsum(part)]) for part in (way.real, way.imag))
    return np.column_stack([x, y, heading])


def even_steps(t: Array) -> NDArray[np.bool_]:
    """Return which steps (K - 1,) between samples at t (K,) last as long as both their neighbours, up to `EVEN`."""
    period = np.diff(t)
    ratio = period[1:] / period[:-1]
    alike = np.maximum(ratio, 1 / ratio) < EVEN
    return np.concatenate([[False], alike]) & np.concatenate([alike, [False]])


def half_way(angle: Array, even: NDArray[np.bool_]) -> Array:
    """Return angles half-way through the steps (..., K - 1, n) from those at samples (..., K, n).

    even (K - 1,): the steps to integrate to fourth order in their length, not to second; likewise below.
    """
    middle = (angle[..., 1:, :] + angle[..., :-1, :]) / 2
    curved = angle[..., 3:, :] - angle[..., 2:-1, :] - angle[..., 1:-2, :] + angle[..., :-3, :]
    middle[..., 1:-1, :] -= _where_even(even, curved, 1) / 16
    return middle


def body_motion(pose: Array, even: NDArray[np.bool_]) -> Array:
    """Return the integral of the body's twist over every step (K - 1, 3), in B half-way through it, m and rad.

    pose (K, 3): at the samples, in N.
    """
    turn, heading = np.diff(pose[:, 2]), (pose[1:, 2] + pose[:-1, 2]) / 2
    way = (np.diff(pose[:, 0]) + 1j * np.diff(pose[:, 1])) * np.exp(-1j * heading) / np.sinc(turn / (2 * np.pi))
    body = np.column_stack([way.real, way.imag, turn])
    change = _where_even(even, body[2:] - body[:-2], 1) / 2
    faster, turning = change[:, 0] + 1j * change[:, 1], change[:, 2]
    swept = 1j * (turn[1:-1] * faster - turning * way[1:-1]) / 12
    body[1:-1, 0] -= swept.real
    body[1:-1, 1] -= swept.imag
    return body


def integrated(rows: Array, body: Array, even: NDArray[np.bool_]) -> Array:
    """Return the integral of rows times twist over every step (..., K - 1, r).

    rows (..., K - 1, r, 3): half-way through the steps. body (K - 1, 3): `body_motion`. The mean of a product over a
    step is the product of both means plus a term from how both change together.
    """
    integral = (rows @ body[..., None])[..., 0]
    bend = _where_even(even, rows[..., 2:, :, :] - 2 * rows[..., 1:-1, :, :] + rows[..., :-2, :, :], 2) / 24
    slope = _where_even(even, rows[..., 2:, :, :] - rows[..., :-2, :, :], 2) * (body[2:] - body[:-2])[:, None, :] / 48
    by_slope = slope[..., 0] + (slope[..., 1] + slope[..., 2])  # faster than `np.sum` along an axis of three
    integral[..., 1:-1, :] += (bend @ body[1:-1, :, None])[..., 0] + by_slope
    return integral


def _where_even(even: NDArray[np.bool_], inner: Array, behind: int) -> Array:
    """Return values of inner steps, (..., K - 3) with axes `behind`, 0 where `even` (K - 1,) is not."""
    return inner * even[1:-1].reshape(-1, *(1,) * behind)


def smoothed(course: Array, times: int = 1) -> Array:
    """Return values of successive steps (K - 1, ...), each averaged with its neighbours (1/4, 1/2, 1/4), so many
    times."""
    reach = min(times, math.ceil(4 * math.sqrt(times / 2)))  # four standard deviations
    weights = [math.comb(2 * times, times + k) / 4**times for k in range(reach + 1)]
    padded = np.concatenate([course[:1]] * reach + [course] + [course[-1:]] * reach)
    total = weights[0] * course
    for k in range(1, reach + 1):
        before, after = (padded[first : first + len(course)] for first in (reach - k, reach + k))
        total += weights[k] * (before + after)
    return total / (weights[0] + 2 * sum(weights[1:]))
