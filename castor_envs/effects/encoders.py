"""Effects on what the encoders read: gains, eccentric discs, backlash, lost counts, and curves learned from logs."""

import math
from bisect import bisect_right
from collections.abc import Callable
from functools import partial
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from pydantic.dataclasses import dataclass

from castor_envs.description import CONFIG, Duration, DurationOrNone, RateOrNone, Seed
from castor_envs.effects.parts import (
    channel,
    on_channels,
    pivot_channel,
    pivot_encoders,
    sample_by_sample,
    wheel_channel,
    wheel_encoders,
)
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect, Number, SensorModel, ThereOrNot
from castor_envs.vehicles.robot import RobotDescription

Fraction = Annotated[float, Field(ge=-0.5, le=0.5)]
Direction = Literal["forward", "backward", "both"]
Phase = Annotated[float, Field(ge=-math.pi, le=math.pi)]
QUARTERS = (0.0, math.pi / 2)  # sines of these two phases add up to a sine of any phase
MANY = 1000  # bursts before a log that are skipped together; the begins of fewer are summed one by one
CLEAR = 1e-6  # part of a count by which angles at a limit keep clear of it: sums of counts are rounded
Of = Literal["own angle", "castor angle", "speed"]
"""What a curve depends on: the encoder's own angle or its castor's (rad, of one turn), or how fast it turns (rad/s)."""


def losing(lost: Callable[[Array, Array], Array]) -> Callable[[Array, Array], Array]:
    """Return a function that subtracts from angles (k, c) all that was lost so far.

    lost(durations (k,), angles turned (k, c)): what is lost in each sample (k, c), rad.
    """
    return partial(_less_lost, lost, [])


def _less_lost(
    lost: Callable[[Array, Array], Array], last: list[tuple[Array, Array, Array]], t: Array, angle: Array
) -> Array:
    since, before, gone = last[0] if last else (t[:1], angle[:1], np.zeros_like(angle[:1]))
    newly = lost(np.diff(t, prepend=since), np.diff(angle, axis=0, prepend=before))
    total = np.cumsum(np.concatenate([gone, newly]), axis=0)[1:]
    last[:] = [(t[-1:], angle[-1:].copy(), total[-1:])]
    return angle - total


def _scaled(gain: float, t: Array, angle: Array) -> Array:
    return gain * angle


def _off_centre(value: float, phase: float, t: Array, angle: Array) -> Array:
    return angle + value * np.sin(angle - phase)


def _remainders(count: float, t: Array, turned: Array) -> Array:
    return turned - np.trunc(turned / count) * count


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class PivotGain(Effect[RobotDescription]):
    """A pivot encoder reads (1 + value) theta: too many degrees for each degree turned, counted from theta = 0."""

    name: Literal["pivot_gain"] = "pivot_gain"
    castor: Number
    value: Fraction
    title = "gain of a pivot encoder"
    unit = "1"
    step = 1e-3
    tolerance = 2e-5  # relative: gears and discs have whole numbers
    check = "Turn the castor by ten full turns and read its pivot; check the gear or belt between pivot and encoder."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["PivotGain", ...]:
        """Return an instance for each castor with a pivot encoder."""
        return tuple(cls(castor=i, value=cls.step) for i in pivot_encoders(robot))

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that scales theta."""
        channel = pivot_channel(robot, self.castor, self.name)
        return on_channels(robot, [channel], partial(_scaled, 1.0 + self.value))


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class PivotEccentricity(Effect[RobotDescription]):
    """A pivot encoder's disc sits off its centre: it reads theta + value sin(theta - phase)."""

    name: Literal["pivot_eccentricity"] = "pivot_eccentricity"
    castor: Number
    value: Fraction
    phase: Phase = 0.0
    title = "eccentric pivot encoder"
    unit = "rad"
    step = 1e-3
    tolerance = 2e-4  # rad: 2 um off centre at a radius of 10 mm
    check = "Turn the castor by quarter turns against a protractor; check the encoder disc's or magnet's centring."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["PivotEccentricity", ...]:
        """Return two instances for each castor with a pivot encoder, a quarter turn apart."""
        return tuple(cls(castor=i, value=cls.step, phase=phase) for i in pivot_encoders(robot) for phase in QUARTERS)

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that adds the sine of theta."""
        channel = pivot_channel(robot, self.castor, self.name)
        return on_channels(robot, [channel], partial(_off_centre, self.value, self.phase))


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class WheelEccentricity(Effect[RobotDescription]):
    """A wheel or its encoder's disc sits off its centre: at angle phi it reads phi + value sin(phi - phase).

    phi is the angle turned since the start of the run.
    """

    name: Literal["wheel_eccentricity"] = "wheel_eccentricity"
    castor: Number
    wheel: Number
    value: Fraction
    phase: Phase = 0.0
    title = "eccentric wheel"
    unit = "rad"
    step = 1e-3
    tolerance = 5e-4  # rad: 5 um off centre at a radius of 10 mm
    check = "Spin the wheel against a dial gauge; check its hub and its encoder's centring."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["WheelEccentricity", ...]:
        """Return two instances for each wheel with an encoder, a quarter turn apart."""
        places = [(*place, phase) for place in wheel_encoders(robot) for phase in QUARTERS]
        return tuple(cls(castor=i, wheel=j, value=cls.step, phase=phase) for i, j, phase in places)

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that adds the sine of the wheel's angle."""
        channel = wheel_channel(robot, self.castor, self.wheel, self.name)
        return on_channels(robot, [channel], partial(_off_centre, self.value, self.phase))


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class PivotBacklash(Effect[RobotDescription]):
    """A pivot encoder's gear has backlash: turned left it reads half of `value` (rad) too little, right too much.

    Turned back, it stands still for `value`, then follows. The run starts in the middle of the backlash.
    """

    name: Literal["pivot_backlash"] = "pivot_backlash"
    castor: Number
    value: Annotated[float, Field(ge=0.0, le=1.0)]
    title = "backlash of a pivot encoder"
    unit = "rad"
    step = 1e-3
    tolerance = 1e-4  # rad: encoders mostly sit on the shaft itself
    check = "Rock the castor by hand and watch its pivot's counts; check the encoder's gear, belt and coupling."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["PivotBacklash", ...]:
        """Return an instance for each castor with a pivot encoder."""
        return tuple(cls(castor=i, value=cls.step) for i in pivot_encoders(robot))

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that follows theta at half the backlash."""
        channel = pivot_channel(robot, self.castor, self.name)
        return on_channels(robot, [channel], partial(self._follow, []))

    def _follow(self, before: list[float], t: Array, theta: Array) -> Array:
        """Return what is read of theta (k, 1), rad; before: what was read last, where anything was."""
        half, read = self.value / 2, []
        for angle in theta[:, 0].tolist():
            before[:] = [min(max(before[0], angle - half), angle + half) if before else angle]
            read += before
        return np.array(read).reshape(theta.shape)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class TickLoss(Effect[RobotDescription]):
    """A wheel's encoder loses the fraction `value` of what the wheel turns in samples faster than `above` (rad/s).

    Only while it turns in one `direction`, forward being the castor's rolling direction, or in both. The speed is the
    mean over a sample.
    """

    name: Literal["tick_loss"] = "tick_loss"
    castor: Number
    wheel: Number
    value: Annotated[float, Field(ge=0.0, le=0.5)]
    above: RateOrNone
    direction: Direction = "forward"
    title = "counts lost at speed"
    unit = "1"
    step = 1e-2
    tolerance = 1e-4  # counts are lost or they are not
    check = (
        "Spin the wheel fast and slowly by the same turns, both ways; check the encoder's cable, supply and input rate."
    )

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["TickLoss", ...]:
        """Return an instance for each wheel with an encoder and each direction, above a quarter of its top speed.

        Losses in both directions are sought in logs, as is the speed.
        """
        above = robot.max_wheel_speed / 4
        ways: tuple[Direction, ...] = ("forward", "backward")
        return tuple(
            cls(castor=i, wheel=j, value=cls.step, above=above, direction=way)
            for i, j in wheel_encoders(robot)
            for way in ways
        )

    def where(self) -> tuple[str, ...]:
        """Return the wheel, the way it turns, and how fast."""
        way = "either way" if self.direction == "both" else self.direction
        return (*super().where(), f"{way}, above {self.above:.3g} rad/s")

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that leaves out what was lost so far."""
        return on_channels(robot, [wheel_channel(robot, self.castor, self.wheel, self.name)], losing(self._lost))

    def _lost(self, durations: Array, turned: Array) -> Array:
        """Return the angles (k, 1), rad, that are lost of those turned (k, 1) in samples of durations (k,), s."""
        return np.where(self._way(turned) * turned > self.above * durations[:, None], self.value * turned, 0.0)

    def _way(self, turned: Array) -> Array | float:
        """Return 1 or -1, by which angles (...,) that wheels turn are positive where counts may be lost."""
        if self.direction == "both":
            return np.where(turned < 0, -1.0, 1.0)
        return 1.0 if self.direction == "forward" else -1.0

    def turned(self, durations: Array, read: Array, likely: Array, count: float) -> Array:
        """Return the angles (k,), rad, that the wheel turns in samples in which its encoder reads `read` (k,), rad.

        An angle near the limit may be read in full or after a loss: then it is the nearest to what is likely (k,), rad.
        durations (k,): of the samples, s. count: angle of one count, rad, by less than which rounding changes what is
        read.
        """
        way = self._way(read)
        kept, limit = way * read, self.above * durations
        full = kept / (1 - self.value)
        nearer = np.abs(way * likely - full) < np.abs(way * likely - kept)
        loses = (kept + count > (1 - self.value) * limit) & ((kept - count > limit) | nearer)
        clear = CLEAR * count
        return way * np.where(loses, np.maximum(full, limit + clear), np.minimum(kept, limit - clear))


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class TickLossBursts(Effect[RobotDescription]):
    """A wheel's encoder loses the fraction `value` of what the wheel turns in bursts: `width` (s) every `period` (s).

    The first burst begins at `start` (s), each further burst `period` after the one before; with a `seed` the intervals
    are drawn, uniformly from 0 to twice the period. A burst that covers part of a sample loses that part.
    """

    name: Literal["tick_loss_bursts"] = "tick_loss_bursts"
    castor: Number
    wheel: Number
    value: Annotated[float, Field(ge=0.0, le=1.0)]
    period: Annotated[float, Field(ge=1e-3, le=1e9)]
    width: Duration
    start: DurationOrNone = 0.0
    seed: Seed | None = None
    title = "counts lost in bursts"
    unit = "1"
    step = 0.1
    tolerance = 1e-2  # counts are lost or they are not
    check = "Look for a loose plug or cable; watch the counts while shaking it and while other devices switch on."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["TickLossBursts", ...]:
        """Return no instance: the times at which counts are lost have to be found in logs first."""
        return ()

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that leaves out what was lost so far."""
        channel = wheel_channel(robot, self.castor, self.wheel, self.name)
        random = None if self.seed is None else np.random.default_rng(self.seed)
        return on_channels(
            robot, [channel], sample_by_sample(partial(self._read, random, [self.start], [], np.zeros(1)))
        )

    def _read(
        self,
        random: np.random.Generator | None,
        bursts: list[float],
        before: list[tuple[float, Array]],
        lost: Array,
        t: float,
        angle: Array,
    ) -> Array:
        """Return what is read of an angle (1,), rad, at t, s. bursts: when they begin, from the last one that counts.
        before: time and angle of the last sample. lost: so far, rad."""
        if not before and random is None and t - self.start > MANY * self.period:  # nothing is lost before
            bursts[:] = [self.start + self.period * math.floor((t - self.start) / self.period - 1.0)]
        while bursts[-1] < t:
            bursts.append(bursts[-1] + self.period * (1.0 if random is None else random.uniform(0.0, 2.0)))
        if before:
            since, turned = before[0][0], angle - before[0][1]
            del bursts[: max(0, bisect_right(bursts, since) - 1)]
            begins = np.array(bursts)
            edges = np.minimum(begins[:-1] + self.width, begins[1:])
            shared = np.clip(np.minimum(edges, t) - np.maximum(begins[:-1], since), 0.0, None).sum()
            lost += self.value * turned * (shared / (t - since))
        else:
            del bursts[:-2]
        before[:] = [(t, angle)]
        return angle - lost


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class LostRemainders(Effect[RobotDescription]):
    """A wheel's counts are cut to whole ones, toward zero, sample by sample, and what is left over is lost.

    It is there or not: its value is always 1.
    """

    name: Literal["lost_remainders"] = "lost_remainders"
    castor: Number
    wheel: Number
    value: ThereOrNot = 1.0
    title = "remainders lost between samples"
    unit = "1"
    step = 1.0
    tolerance = 3e-3  # present or absent
    discrete = True
    binary = True
    check = "Look in the motor driver's code for increments or speeds cut to whole counts each period."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["LostRemainders", ...]:
        """Return an instance for each wheel with an encoder."""
        return tuple(cls(castor=i, wheel=j, value=cls.step) for i, j in wheel_encoders(robot))

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that leaves out the remainders so far."""
        channel = wheel_channel(robot, self.castor, self.wheel, self.name)
        per_rev = robot.wheels[channel].counts_per_rev
        assert per_rev is not None  # as the wheel has a channel
        count = 2 * math.pi / per_rev
        return on_channels(robot, [channel], losing(partial(_remainders, count)))


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class LearnedTerm(Effect[RobotDescription]):
    """One encoder reads too much by the fraction `value` f(`of`) of what it turns: a wheel's, or the castor's pivot
    encoder where `wheel` is left out.

    f is piecewise linear through its `values` at `knots`: periodic over a turn, or constant beyond the outermost
    speeds. Its argument is taken half-way through a sample.
    """

    name: Literal["learned_term"] = "learned_term"
    castor: Number
    wheel: Number | None = None
    value: Annotated[float, Field(ge=-10.0, le=10.0)] = 1.0
    of: Of
    knots: tuple[Annotated[float, Field(ge=-1e6, le=1e6)], ...]
    values: tuple[Annotated[float, Field(ge=-10.0, le=10.0)], ...]
    title = "a term learned from logs"
    unit = "1"
    step = 1e-3
    tolerance = 1e-3  # no robot in good order needs one
    check = "Look at the curve for what changes in this encoder or its wheel at these angles or speeds."

    @model_validator(mode="after")
    def _one_value_a_knot(self) -> Self:
        if not 2 <= len(self.knots) == len(self.values) <= 1000:
            raise ValueError("`knots` and `values` need as many numbers each, 2 to 1000")
        if np.any(np.diff(self.knots) <= 0) or (self.of != "speed" and np.ptp(self.knots) >= 2 * math.pi):
            raise ValueError("`knots` must increase, and angles lie within one turn")
        return self

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["LearnedTerm", ...]:
        """Return no instance: what a curve depends on has to be found in logs first."""
        return ()

    def where(self) -> tuple[str, ...]:
        """Return the encoder, and what the curve depends on."""
        return (*super().where(), *(["pivot"] if self.wheel is None else []), f"by {self.of}")

    def curve(self, of: Array) -> Array:
        """Return the fraction read too much at angles or speeds `of` (...), those that the curve depends on."""
        period = None if self.of == "speed" else 2 * math.pi
        return self.value * np.interp(of, self.knots, self.values, period=period)

    def sensor_model(self, robot: RobotDescription) -> SensorModel:
        """Return a model that adds up what was read too much so far."""
        return partial(self._read, channel(robot, self.castor, self.wheel, self.name), [])

    def _read(
        self, column: int, last: list[tuple[Array, Array, float]], t: Array, wheel: Array, castor: Array
    ) -> tuple[Array, Array]:
        """Return what is read of all angles. last: time and angles of the last sample, and the excess so far, rad."""
        angles, w = np.concatenate([wheel, castor], axis=1), wheel.shape[1]
        since, before, gone = last[0] if last else (t[:1], angles[:1], 0.0)
        course = np.concatenate([before, angles])
        turned, middle = np.diff(course[:, column]), (course[1:] + course[:-1]) / 2
        if self.of == "speed":
            step = np.diff(t, prepend=since)
            of = turned / np.where(step > 0, step, 1.0)
        else:
            of = middle[:, column if self.of == "own angle" else w + self.castor - 1]
        excess = np.cumsum([gone, *(self.curve(of) * turned)])[1:]
        last[:] = [(t[-1:], angles[-1:].copy(), float(excess[-1]))]
        angles[:, column] += excess
        return angles[:, :w], angles[:, w:]
