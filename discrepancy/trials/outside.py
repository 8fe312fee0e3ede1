"""Effects outside the catalogue, hidden in trials: the right verdict on them is "unexplained".

Each changes what encoders read of true angles, or the poses that the reference reports; none changes the physics.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from castor_envs.effects.parts import all_channels
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.hidden import Hidden


@dataclass(frozen=True, kw_only=True)
class Outside:
    """An effect outside the catalogue.

    channel: of its encoder, all wheels first, then all castors, in the robot file's order; ignored by those of the
    reference. value: the amplitude; at 0 the effect does nothing. step: a small typical amplitude.
    """

    channel: int
    value: float
    step: ClassVar[float] = 1e-3
    only: ClassVar[str] = "wheels"

    def changed(self, robot: RobotDescription, t: Array, angle: Array, pose: Array) -> Array:
        """Return the angles (K, w + n), rad, that encoders see for true angles (K, w + n) along a path (K, 3).

        A row depends only on the rows before it, so that samples may be passed one by one.
        """
        return angle

    def tracked(self, t: Array, pose: Array) -> Array:
        """Return the poses (K, 3) that the reference reports for true poses."""
        return pose


@dataclass(frozen=True, kw_only=True)
class ThermalGrowth(Outside):
    """A wheel grows by the fraction `value` in the course of a minute, faster and faster."""

    step = 1e-3

    def changed(self, robot: RobotDescription, t: Array, angle: Array, pose: Array) -> Array:
        """Return the wheel's angle, which grows less and less along the same path."""
        return _gained(angle, self.channel, lambda turned: -self.value * ((t[1:] - t[0]) / 60.0) ** 2 * turned)


@dataclass(frozen=True, kw_only=True)
class Glitches(Outside):
    """An encoder jumps by `value` rad, up or down, once in `every` s on average."""

    step = 1e-3
    only = "all"
    every: float = 6.0
    seed: int = 0

    def changed(self, robot: RobotDescription, t: Array, angle: Array, pose: Array) -> Array:
        """Return the angles with all jumps so far."""
        random = np.random.default_rng(self.seed)
        at = np.cumsum(random.exponential(self.every, 1000))
        size = np.cumsum(random.choice([-1.0, 1.0], 1000))
        seen = angle.copy()
        seen[:, self.channel] += self.value * np.append(0.0, size)[np.searchsorted(at, t)]
        return seen


@dataclass(frozen=True, kw_only=True)
class FlatSpot(Outside):
    """Once a turn, on `width` rad of its tread, a wheel runs ahead by up to `value` rad and falls back again."""

    step = 1e-2
    width: float = 0.4
    place: float = 0.0

    def changed(self, robot: RobotDescription, t: Array, angle: Array, pose: Array) -> Array:
        """Return the wheel's angle with a narrow bump a turn."""
        seen, away = angle.copy(), (angle[:, self.channel] - self.place + np.pi) % (2 * np.pi) - np.pi
        seen[:, self.channel] += self.value * np.exp(-0.5 * (away / (self.width / 2)) ** 2)
        return seen


@dataclass(frozen=True, kw_only=True)
class Wobble(Outside):
    """A wheel wobbles on its axle: its distance from the castor's centre line changes by value sin(angle), m."""

    step = 1e-3

    def changed(self, robot: RobotDescription, t: Array, angle: Array, pose: Array) -> Array:
        """Return the wheel's angle: where it stands further out it rolls more as the castor turns."""
        geometry, k = Geometry.of(robot.as_built()), self.channel
        theta = angle[:, len(geometry.radius) + geometry.wheel_castor[k]]
        turned = np.diff(pose[:, 2] + theta)
        middle = (angle[1:, k] + angle[:-1, k]) / 2
        return _gained(angle, k, lambda _: -self.value * np.sin(middle) * turned / geometry.radius[k])


@dataclass(frozen=True, kw_only=True)
class WeakStretch(Outside):
    """An encoder misses the fraction `value` of its turn in a stretch of the run, `start` to `end` (s)."""

    step = 1e-2
    only = "all"
    start: float = 17.0
    end: float = 26.0

    def changed(self, robot: RobotDescription, t: Array, angle: Array, pose: Array) -> Array:
        """Return the angles less what was lost so far."""
        lost = (t[1:] > self.start) & (t[1:] < self.end)
        return _gained(angle, self.channel, lambda turned: -self.value * lost * turned)


@dataclass(frozen=True, kw_only=True)
class SpeedSquared(Outside):
    """A wheel's encoder reads too much by value times the square of its speed over 5 rad/s, in proportion."""

    step = 1e-3

    def changed(self, robot: RobotDescription, t: Array, angle: Array, pose: Array) -> Array:
        """Return the angles with what was read too much so far."""
        period = np.diff(t)
        return _gained(angle, self.channel, lambda turned: self.value * (turned / period / 5.0) ** 2 * turned)


@dataclass(frozen=True, kw_only=True)
class SwingingPoint(Outside):
    """The tracked point swings to and fro across the body, by `value` (m), once in `period` s."""

    step = 1e-3
    only = "reference"
    period: float = 7.3

    def tracked(self, t: Array, pose: Array) -> Array:
        """Return the poses of the swinging point."""
        away, seen = self.value * np.sin(2 * np.pi * t / self.period), pose.copy()
        seen[:, 0] -= away * np.sin(pose[:, 2])
        seen[:, 1] += away * np.cos(pose[:, 2])
        return seen


@dataclass(frozen=True, kw_only=True)
class StickyPivot(Outside):
    """A pivot's encoder disc slips on its shaft by the fraction `value` of every turn faster than 1 rad/s."""

    step = 1e-2
    only = "pivots"

    def changed(self, robot: RobotDescription, t: Array, angle: Array, pose: Array) -> Array:
        """Return the castor's angle less what slipped so far."""
        period = np.diff(t)
        return _gained(angle, self.channel, lambda turned: -self.value * (np.abs(turned) > period) * turned)


KINDS: tuple[type[Outside], ...] = (
    ThermalGrowth,
    Glitches,
    FlatSpot,
    Wobble,
    WeakStretch,
    SpeedSquared,
    SwingingPoint,
    StickyPivot,
)


def outsiders(robot: RobotDescription, random: np.random.Generator) -> Iterator[Hidden]:
    """Yield each kind once, in random order and at a random place of the robot, in the size of its step."""
    channels, w = all_channels(robot), len(robot.wheels)
    places = {
        "wheels": [k for k in channels if k < w],
        "pivots": [k for k in channels if k >= w],
        "all": channels,
        "reference": [0],
    }
    for kind in random.permutation(len(KINDS)):
        effect_class = KINDS[kind]
        if not places[effect_class.only]:
            continue
        options: dict[str, float | int] = {}
        if effect_class is Glitches:
            options = {"seed": int(random.integers(2**31))}
        elif effect_class is FlatSpot:
            options = {"place": float(random.uniform(-np.pi, np.pi))}
        elif effect_class is WeakStretch:
            start = float(random.uniform(5.0, 40.0))
            options = {"start": start, "end": start + float(random.uniform(4.0, 12.0))}
        elif effect_class is SwingingPoint:
            options = {"period": float(random.uniform(5.0, 12.0))}
        channel = int(random.choice(places[effect_class.only]))
        yield Hidden(effect_class(channel=channel, value=effect_class.step, **options))  # type: ignore[arg-type]


def _gained(angle: Array, channel: int, gain) -> Array:
    """Return angles (K, channels) in which a channel turns further by `gain(turned)` (K - 1,) in each step."""
    seen = angle.copy()
    seen[1:, channel] += np.cumsum(gain(np.diff(angle[:, channel])))
    return seen
