"""The encoders of a robot as a state's counts hold them: their angles, and what sensors with effects read of them."""

import numpy as np
from numpy.typing import NDArray

from castor_envs.effects.catalogue import radii_of, readings
from castor_envs.effects.clocks import AllLatency, EncoderLatency
from castor_envs.effects.encoders import PivotBacklash
from castor_envs.effects.parts import channel
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Motion
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription

AVERAGING = 0.1
"""s: over such times the disagreement of wheels in a fitted state is averaged where creep is predicted from it. As the
state follows the prediction again, noise in it would go round for ever: fits then end at log evidences that scatter by
1.5 to 6 nats on eight logs of 60 s at 20 Hz, and with this by up to 1.5 on six of them. The log evidence of ten logs
rises by 186 in all with 0.05 s, by 407 with 0.1 s, and by 434 to 447 with 0.14 to 0.3 s."""

FOLLOWS = 1e-6
"""Part of a backlash within which of its end a shaft counts as turning its encoder."""

HELD = 2.0
"""Standard deviation of where a shaft is, by how far it is within a backlash. Log evidences of five fits of nearly the
same backlash (0.3 and twice 0.64 rad of a single castor, 20 s) then scatter by 1 to 2 nats (standard deviation); where
it is the same everywhere, by 3 to 9, and are lower by 10 to 31. With 1, some fits end far from these."""


LOBES = 16
"""Rows to each side by which an excess is resampled: one that is slow becomes larger by 2 % at most, with 8 rows by 4
%."""


class Channels:
    """The pivot and wheel encoders of a robot, in the order of a state's counts."""

    def __init__(self, robot: RobotDescription) -> None:
        self.geometry = Geometry.of(robot.as_built())
        self.sensed: NDArray[np.intp] = np.flatnonzero(~np.isnan(self.geometry.pivot_counts_per_rev))
        self.driven: NDArray[np.intp] = np.flatnonzero(~np.isnan(self.geometry.counts_per_rev))
        self.names = [f"pivot_{i + 1}" for i in self.sensed] + [f"wheel_{robot.wheel_names[k]}" for k in self.driven]
        pivots = self.geometry.pivot_counts_per_rev[self.sensed]
        self.per_rev = np.concatenate([pivots, self.geometry.counts_per_rev[self.driven]])

    def angles(self, counts: Array) -> tuple[Array, Array]:
        """Return the angles of wheels (K, w) and castors (K, n) at counts, rad; 0 of wheels without encoder."""
        geometry, s, rows = self.geometry, len(self.sensed), len(counts)
        angles = counts * 2 * np.pi / self.per_rev
        wheel = np.zeros((rows, len(geometry.radius)))
        castor = np.tile(np.where(geometry.fixed, geometry.angle, 0.0), (rows, 1))
        castor[:, self.sensed] = angles[:, :s] - geometry.pivot_zero[self.sensed]
        wheel[:, self.driven] = angles[:, s:]
        return wheel, castor

    def motion(self, log: Log, state: Array, consistent_wheels: bool = False) -> Motion:
        """Return the motion of a state (K, 3 + s + d); consistent_wheels: see `Motion`."""
        wheel, castor = self.angles(state[:, 3:])
        return Motion(log.t, state[:, :3], wheel, castor, consistent_wheels, AVERAGING)

    def read(self, robot: RobotDescription, log: Log, counts: Array) -> Array:
        """Return the readings (K, s + d), not rounded, of a robot's encoders for true counts of the robot built here;
        if its radii differ, its wheels turn by other angles."""
        geometry = self.geometry
        wheel, castor = self.angles(counts)
        turns = 2 * np.pi * np.round(castor[0] / (2 * np.pi))  # a log begins within half a turn of 0
        castor -= turns
        wheel, castor = readings(robot, log.t, self._rolled(robot, wheel, castor), castor)
        seen = np.column_stack(
            [(castor + turns)[:, self.sensed] + geometry.pivot_zero[self.sensed], wheel[:, self.driven]]
        )
        return seen * self.per_rev / (2 * np.pi)

    def unread(self, robot: RobotDescription, log: Log, seen: Array, counts: Array) -> Array:
        """Return a better approximation of the counts (K, s + d) for which a robot's encoders read `seen`, from
        approximate counts.

        The difference between `seen` and the reading of these counts is added; for a late encoder it is shifted by the
        latency, as otherwise the correction would be worse in quick motion.
        """
        return counts + self.undelayed(robot, log, seen - self.read(robot, log, counts))

    def undelayed(self, robot: RobotDescription, log: Log, excess: Array) -> Array:
        """Return an excess of readings (K, s + d), of late encoders at the times of what they read.

        Between samples it is resampled so that noise keeps its variance: the mean of two samples has half of it, and
        logs would seem likelier if encoders were late by half a period.
        """
        excess, rows = excess.copy(), np.arange(len(log.t))
        for column, latency in enumerate(self.latencies(robot)):
            if latency:
                excess[:, column] = _resampled(excess[:, column], np.interp(log.t + latency, log.t, rows))
        return excess

    def backlashes(self, robot: RobotDescription) -> list[tuple[int, PivotBacklash]]:
        """Return a robot's backlashes, each with the column of its encoder."""
        effects = [effect for effect in robot.effects if isinstance(effect, PivotBacklash)]
        return [(int(np.searchsorted(self.sensed, effect.castor - 1)), effect) for effect in effects]

    def play(self, robot: RobotDescription, log: Log, counts: Array, held: bool) -> Array:
        """Return the standard deviation (K, s + d), in counts, of readings by true counts that stand still while the
        shaft moves within a backlash; 0 of the others.

        held: no larger than `HELD` times how far within the backlash the shaft is. Else what is barely within, by
        noise, is as free as what is far within, now one sample, now another, and no fit converges; but from where it
        follows its reading, a shaft gets to its place within a backlash only if it is free.
        """
        found = np.zeros(counts.shape)
        for column, effect in self.backlashes(robot):
            wheel, castor = self.angles(counts)
            _, read = readings(robot.as_described().with_effects(effect), log.t, wheel, castor)
            half, even = effect.value / 2, effect.value / np.sqrt(12)
            depth = half - np.abs(castor - read)[:, effect.castor - 1]
            size = np.where(depth > FOLLOWS * half, np.minimum(HELD * depth, even) if held else even, 0.0)
            found[:, column] = np.hypot(found[:, column], size * self.per_rev[column] / (2 * np.pi))
        return found

    def latencies(self, robot: RobotDescription) -> Array:
        """Return the latency of every encoder (s + d,), s."""
        columns = [*(len(robot.wheels) + self.sensed), *self.driven]
        total = np.zeros(len(robot.wheels) + len(robot.castors))
        for effect in robot.effects:
            if isinstance(effect, AllLatency):
                total += effect.value
            elif isinstance(effect, EncoderLatency):
                total[channel(robot, effect.castor, effect.wheel, effect.name)] += effect.value
        return total[columns]

    def _rolled(self, robot: RobotDescription, wheel: Array, castor: Array) -> Array:
        """Return the angles of a robot's wheels (K, w) where the wheels of the robot built here turn by `wheel` (K,
        w)."""
        radii, mean = radii_of(robot), Geometry.of(robot.as_built()).radius
        if radii is None and np.array_equal(mean, self.geometry.radius):
            return wheel
        half_way = (castor[1:] + castor[:-1]) / 2
        turned = np.diff(wheel, axis=0) * self.geometry.radius / (mean if radii is None else radii(half_way))
        return np.concatenate([wheel[:1], wheel[:1] + np.cumsum(turned, axis=0)])


def _resampled(values: Array, place: Array) -> Array:
    """Return values (K,) at places between their rows (N,), by Lanczos's kernel over `LOBES` rows to each side, scaled
    so that white noise keeps its variance."""
    first = np.floor(place).astype(np.intp)
    rows = first[:, None] + np.arange(1 - LOBES, LOBES + 1)
    away = place[:, None] - rows
    weight = np.sinc(away) * np.sinc(away / LOBES) * (np.abs(away) < LOBES)
    weight /= np.linalg.norm(weight, axis=1, keepdims=True)
    return np.asarray(np.sum(weight * values[np.clip(rows, 0, len(values) - 1)], axis=1))
