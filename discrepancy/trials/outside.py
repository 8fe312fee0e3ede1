"""Effects outside the catalogue on what encoders read of true angles, or the reference of true poses; none changes the
physics."""

import numpy as np

from castor_envs.effects.parts import channel
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.hidden import Outside


class Misreading(Outside):
    """An encoder reads wrongly, in proportion to `value`."""

    def changed(self, robot: RobotDescription, t: Array, angle: Array, pose: Array) -> Array:
        """Return the angles that encoders see."""
        k, seen = channel(robot, self.castor, self.wheel, type(self).__name__), angle.copy()
        heading = pose[:, 2] + angle[:, len(robot.wheels) + self.castor - 1]
        seen[:, k] += self.value * self._excess(robot, t, angle[:, k], heading)
        return seen

    def _excess(self, robot: RobotDescription, t: Array, angle: Array, heading: Array) -> Array:
        """Return what the encoder reads too much (K,), rad for a unit, of angles (K,) on a castor of headings (K,)."""
        raise NotImplementedError


class ThermalGrowth(Misreading):
    """A wheel grows by the fraction `value` in the course of a minute, faster and faster."""

    def _excess(self, robot: RobotDescription, t: Array, angle: Array, heading: Array) -> Array:
        return _summed(-(((t[1:] - t[0]) / 60.0) ** 2) * np.diff(angle))


class Glitches(Misreading):
    """An encoder jumps by `value` rad, up or down, once in 6 s on average."""

    only = "encoders"

    def _excess(self, robot: RobotDescription, t: Array, angle: Array, heading: Array) -> Array:
        random = np.random.default_rng(self.seed)
        at, jumps = np.cumsum(random.exponential(6.0, 1000)), random.choice([-1.0, 1.0], 1000)
        return _summed(jumps)[np.searchsorted(at, t - t[0])]


class FlatSpot(Misreading):
    """Once a turn, on 0.4 rad of its tread, a wheel runs ahead by up to `value` rad and falls back again."""

    step = 1e-2

    def _excess(self, robot: RobotDescription, t: Array, angle: Array, heading: Array) -> Array:
        away = (angle - self.phase + np.pi) % (2 * np.pi) - np.pi
        return np.exp(-0.5 * (away / 0.2) ** 2)


class Wobble(Misreading):
    """A wheel wobbles on its axle: its distance from the castor's centre line changes by value sin(angle), m; where it
    stands further out it rolls more as the castor turns."""

    def _excess(self, robot: RobotDescription, t: Array, angle: Array, heading: Array) -> Array:
        radius = robot.as_built().wheels[self.wheel_in(robot)].radius
        return _summed(-np.sin((angle[1:] + angle[:-1]) / 2) * np.diff(heading) / radius)


class WeakStretch(Misreading):
    """An encoder misses the fraction `value` of its turn for 4 to 12 s, from 5 to 40 s after the start on."""

    step = 1e-2
    only = "encoders"

    def _excess(self, robot: RobotDescription, t: Array, angle: Array, heading: Array) -> Array:
        start, lasts = np.random.default_rng(self.seed).uniform((5.0, 4.0), (40.0, 12.0))
        return _summed(-np.diff(angle) * ((t[1:] - t[0] > start) & (t[1:] - t[0] < start + lasts)))


class SpeedSquared(Misreading):
    """A wheel's encoder reads too much by value times the square of its speed over 5 rad/s, in proportion."""

    def _excess(self, robot: RobotDescription, t: Array, angle: Array, heading: Array) -> Array:
        return _summed((np.diff(angle) / np.diff(t) / 5.0) ** 2 * np.diff(angle))


class StickyPivot(Misreading):
    """A pivot's encoder disc slips on its shaft by the fraction `value` of every turn faster than 1 rad/s."""

    step = 1e-2
    only = "pivots"

    def _excess(self, robot: RobotDescription, t: Array, angle: Array, heading: Array) -> Array:
        return _summed(-np.diff(angle) * (np.abs(np.diff(angle)) > np.diff(t)))


class SwingingPoint(Misreading):
    """The tracked point swings to and fro across the body, by `value` (m), once in 5 to 12 s."""

    only = "castors"

    def changed(self, robot: RobotDescription, t: Array, angle: Array, pose: Array) -> Array:
        """Return the angles as they are."""
        return angle

    def tracked(self, t: Array, pose: Array) -> Array:
        """Return the poses of the swinging point."""
        away = self.value * np.sin(2 * np.pi * t / np.random.default_rng(self.seed).uniform(5.0, 12.0))
        return compose(pose, np.column_stack([0 * t, away, 0 * t]))


KINDS = (ThermalGrowth, Glitches, FlatSpot, Wobble, WeakStretch, SpeedSquared, SwingingPoint, StickyPivot)


def _summed(steps: Array) -> Array:
    """Return sums of steps (K - 1,) up to each sample (K,)."""
    return np.append(0.0, np.cumsum(steps))
