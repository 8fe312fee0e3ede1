"""Effects on time: what is read late, early or unevenly, and clocks that disagree."""

import math
from functools import partial
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from castor_envs.description import CONFIG, Seed
from castor_envs.effects.parts import all_channels, channel, on_channels, pivot_encoders, wheel_encoders
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect, Number, SensorModel
from castor_envs.vehicles.robot import RobotDescription

Latency = Annotated[float, Field(ge=-0.1, le=1.0)]


class Past:
    """Angles sampled so far, to be read at other times: interpolated linearly; before the first sample nothing moved.

    back: how far (s) before the newest sample an angle may be asked for.
    """

    def __init__(self, back: float) -> None:
        self._back = back
        self._t = np.zeros(0)
        self._angle = np.zeros((0, 0))

    def since(self, t: Array) -> Array:
        """Return the time between each new sample (k,) and the sample before it, s; 0 for the very first sample."""
        return np.diff(t, prepend=self._t[-1:] if len(self._t) else t[:1])

    def at(self, taken: Array, t: Array, angle: Array) -> Array:
        """Add samples at t (k,); return the angles (k, c) as they stood at the times `taken` (k,), s.

        Each angle is read when its own sample arrives, without later ones: beyond that sample, it is extrapolated from
        the last two samples so far.
        """
        first = len(self._t)
        self._t = np.concatenate([self._t, t])
        self._angle = np.concatenate([self._angle, angle]) if first else angle.copy()
        new = np.arange(first, len(self._t))
        k = np.minimum(np.searchsorted(self._t, taken, side="right") - 1, new)
        known = (k >= 0) & (new > 0)
        begin = np.where(known, np.minimum(k, new - 1), 0)
        end = np.where(known, begin + 1, 0)
        step = np.where(known, self._t[end] - self._t[begin], 1.0)
        rate = (self._angle[end] - self._angle[begin]) / step[:, None]
        k = np.where(known, k, 0)
        seen = self._angle[k] + rate * (taken - self._t[k])[:, None]
        needed = int(np.searchsorted(self._t, self._t[-1] - self._back, side="right")) - 1
        needed = int(np.clip(needed, 0, max(len(self._t) - 2, 0)))
        self._t, self._angle = self._t[needed:], self._angle[needed:]
        return seen


def late(robot: RobotDescription, channels: list[int], latency: float) -> SensorModel:
    """Return a model that sees some channels as they were `latency` s before."""
    return on_channels(robot, channels, partial(_before, latency, Past(latency)))


def _before(latency: float, past: Past, t: Array, angle: Array) -> Array:
    return past.at(t - latency, t, angle)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class EncoderLatency(Effect[RobotDescription]):
    """One encoder is read `value` (s) late: a wheel's, or the castor's pivot encoder where `wheel` is left out.

    Between samples by interpolation; before the start the robot stood still. Below 0 it is read early, extrapolated
    from the last two samples.
    """

    name: Literal["encoder_latency"] = "encoder_latency"
    castor: Number
    wheel: Number | None = None
    value: Latency
    title = "latency of one encoder"
    unit = "s"
    step = 1e-3
    tolerance = 2e-4  # s: a bus or a timer of 5 kHz
    least = 0.0  # no buffer predicts the future
    check = "Check this encoder's filter, bus and the order in which the encoders are read."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["EncoderLatency", ...]:
        """Return an instance for each encoder."""
        places = [*wheel_encoders(robot), *((i, None) for i in pivot_encoders(robot))]
        return tuple(cls(castor=i, wheel=j, value=cls.step) for i, j in places)

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that sees this encoder late."""
        return late(robot, [channel(robot, self.castor, self.wheel, self.name)], self.value)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class AllLatency(Effect[RobotDescription]):
    """All encoders are read `value` (s) late, as `encoder_latency` of each."""

    name: Literal["all_latency"] = "all_latency"
    value: Latency
    title = "latency of all encoders"
    unit = "s"
    step = 1e-3
    tolerance = 2e-4  # s: a bus or a timer of 5 kHz
    least = 0.0  # no buffer predicts the future
    timing = True
    check = "Check what the log's time stamps mean, and the buffers between encoders and log."
    indistinguishable_from = ("all_latency", "clock_offset")

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["AllLatency", ...]:
        """Return an instance if the robot has encoders."""
        return (cls(value=cls.step),) if all_channels(robot) else ()

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that sees every encoder late."""
        return late(robot, all_channels(robot), self.value)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class SampleJitter(Effect[RobotDescription]):
    """All encoders are read together at t + value (s) times white noise of standard deviation 1, drawn from `seed`.

    Never more than half a sample early or late, so samples keep their order.
    """

    name: Literal["sample_jitter"] = "sample_jitter"
    value: Annotated[float, Field(ge=0.0, le=0.1)]
    seed: Seed = 0
    title = "jitter of sampling"
    unit = "s"
    step = 1e-3
    tolerance = 3e-4  # s: a timer of an operating system
    timing = True
    check = "Look at the differences of time stamps; give the sampling task a fixed period and priority."

    @staticmethod
    def deviation(value: Array, period: float) -> Array:
        """Return the standard deviations (s) of times at which encoders are read with jitter of these values (s),
        period (s) apart: smaller than the values, as none is more than half a sample early or late."""
        ends = period / 2 / value
        outside = np.array([math.erfc(end) for end in (ends / math.sqrt(2)).ravel()]).reshape(ends.shape)
        density = np.exp(-(ends**2) / 2) * math.sqrt(2 / math.pi)
        return value * np.sqrt(1 - outside - ends * density + ends**2 * outside)

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["SampleJitter", ...]:
        """Return an instance if the robot has encoders."""
        return (cls(value=cls.step),) if all_channels(robot) else ()

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that sees every encoder a little early or late."""
        read = partial(self._read, np.random.default_rng(self.seed), Past(0.0))
        return on_channels(robot, all_channels(robot), read)

    def _read(self, random: np.random.Generator, past: Past, t: Array, angle: Array) -> Array:
        half = past.since(t) / 2
        return past.at(t + np.clip(self.value * random.standard_normal(len(t)), -half, half), t, angle)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ClockSkew(Effect[RobotDescription]):
    """The reference's clock runs slow: the reference in a log's row of time t was taken at (1 + value) t."""

    name: Literal["clock_skew"] = "clock_skew"
    value: Annotated[float, Field(ge=-0.1, le=0.1)]
    title = "skew of the reference's clock"
    unit = "s/s"
    step = 1e-4
    tolerance = 3e-5  # crystals are good to 20 to 50 parts in a million
    timing = True
    check = "Let both clocks stamp one event at the start and one at the end of a long run; check the sample period."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["ClockSkew", ...]:
        """Return a single instance."""
        return (cls(value=cls.step),)

    def reference_time(self, t: Array) -> Array:
        """Return (1 + value) t."""
        return (1.0 + self.value) * t


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ClockOffset(Effect[RobotDescription]):
    """The reference comes too early in the log: that in the row of time t was taken at t + value (s)."""

    name: Literal["clock_offset"] = "clock_offset"
    value: Annotated[float, Field(ge=-10.0, le=10.0)]
    title = "offset of the reference's clock"
    unit = "s"
    step = 1e-3
    tolerance = 2e-4  # s: a bus or a timer of 5 kHz
    timing = True
    check = "Let both clocks stamp one event, as a tap on the robot; check when the reference system stamps its poses."
    indistinguishable_from = ("all_latency", "clock_offset")

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["ClockOffset", ...]:
        """Return a single instance."""
        return (cls(value=cls.step),)

    def reference_time(self, t: Array) -> Array:
        """Return t + value."""
        return t + self.value
