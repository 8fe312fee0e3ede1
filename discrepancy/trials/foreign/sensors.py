"""How encoders of foreign simulators are read: effects on sensors and time, at the simulation's own fine steps.

Written independently from the definitions of the effects in `castor_envs.effects`; none of their sensor models is
called. A stage is called with one sample period after the other, as the simulator has computed it: times (m,) and
angles (m, w + n) of wheels and castors, rad, the sample in the last row. The first call has the start alone.
"""

import math
from collections.abc import Callable

import numpy as np

from castor_envs.effects.clocks import AllLatency, ClockOffset, ClockSkew, EncoderLatency, SampleJitter
from castor_envs.effects.encoders import (
    LostRemainders,
    PivotBacklash,
    PivotEccentricity,
    PivotGain,
    TickLoss,
    TickLossBursts,
    WheelEccentricity,
)
from castor_envs.effects.reference import ReferenceLeverX, ReferenceLeverY, ReferenceYaw
from castor_envs.effects.wiring import CastorOrder, EncoderReversed, EncodersSwapped
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.foreign.build import Build

Stage = Callable[[Array, Array], Array]
NOT_SENSED = (
    *("wheel_radius", "all_wheel_radius", "counts_per_rev", "track", "pivot_offset", "pivot_position_x"),
    *("pivot_position_y", "pivot_bias", "load_radius", "slip_stiffness", "slip_stiffness_lateral", "contact_creep"),
    *("floor_slope", "bump", "friction_patch", "sample_jitter", "clock_skew", "clock_offset"),
    *("reference_yaw", "reference_lever_x", "reference_lever_y"),
)
"""Effects that foreign simulators apply elsewhere than in a stage between angles and encoders."""


class Sensors:
    """The encoders of a robot with its effects, read sample by sample through all stages."""

    def __init__(self, robot: RobotDescription) -> None:
        self.build = Build.of(robot)
        self._stages = [stage for effect in robot.effects if (stage := stage_of(effect, self.build)) is not None]

    def push(self, t: Array, angle: Array) -> Array:
        """Return the angles (m, w + n) that encoders see in the period that ends with the next sample."""
        for stage in self._stages:
            angle = stage(t, angle)
        return angle

    def pivots(self, angle: Array, *, rounded: bool = True) -> Array:
        """Return the counts (..., pivot encoders), within a turn, of angles (..., w + n)."""
        sensed = np.isfinite(self.build.pivot_counts)
        turn = self.build.pivot_counts[sensed]
        counts = (angle[..., len(self.build.radius) :] + self.build.zero)[..., sensed] * turn / (2 * math.pi)
        return np.mod(np.round(counts) if rounded else counts, turn)

    def wheels(self, angle: Array, phase: Array, *, rounded: bool = True) -> Array:
        """Return cumulative counts (..., driven wheels) of angles (..., w + n); phase (driven wheels,) in counts."""
        driven = self.build.driven
        counts = angle[..., driven] * self.build.counts[driven] / (2 * math.pi) + phase
        return np.round(counts) if rounded else counts


def measured_angles(build: Build, counts: Array) -> Array:
    """Return the castor angles (n,) that a robot computes from its pivot counts (pivot encoders,)."""
    theta, sensed = build.angle.copy(), np.isfinite(build.pivot_counts)
    theta[sensed] = counts * 2 * math.pi / build.pivot_counts[sensed] - build.zero[sensed]
    return theta


def reading_times(robot: RobotDescription, t: Array) -> Array:
    """Return when (K,) the encoders are read for the rows of times t (K,): uneven with jitter."""
    times = np.array(t, dtype=float)
    for effect in robot.effects:
        if isinstance(effect, SampleJitter):
            half = np.diff(t, prepend=t[0]) / 2
            shift = effect.value * np.random.default_rng(effect.seed).standard_normal(len(t))
            times += np.clip(shift, -half, half)
    return times


def reference_times(robot: RobotDescription, t: Array) -> Array:
    """Return when (K,) the reference in the rows of times t (K,) was taken."""
    for effect in robot.effects:
        match effect:
            case ClockSkew():
                t = t + effect.value * t
            case ClockOffset():
                t = t + effect.value
    return t


def reference_poses(robot: RobotDescription, pose: Array) -> Array:
    """Return the poses (K, 3) that the reference shows for true poses: of another point, on turned axes."""
    x, y, heading = pose.T
    for effect in robot.effects:
        match effect:
            case ReferenceYaw():
                heading = heading + effect.value
            case ReferenceLeverX():
                x, y = x + effect.value * np.cos(heading), y + effect.value * np.sin(heading)
            case ReferenceLeverY():
                x, y = x - effect.value * np.sin(heading), y + effect.value * np.cos(heading)
    return np.column_stack([x, y, heading])


def stage_of(effect: Effect, build: Build) -> Stage | None:
    """Return a new stage that applies an effect to the angles that encoders see; None for an effect without one.

    Raises InputError for an effect that foreign simulators do not have.
    """
    w = len(build.radius)
    match effect:
        case PivotGain():
            return _on_channel(w + build.place(effect.castor), lambda angle: (1 + effect.value) * angle)
        case PivotEccentricity():
            channel = w + build.place(effect.castor)
            return _on_channel(channel, lambda angle: angle + effect.value * np.sin(angle - effect.phase))
        case WheelEccentricity():
            channel = build.wheel(effect.castor, effect.wheel)
            return _on_channel(channel, lambda angle: angle + effect.value * np.sin(angle - effect.phase))
        case EncoderReversed():
            return _on_channel(_channel(build, effect.castor, effect.wheel), np.negative)
        case EncodersSwapped():
            return _exchanged(build, [build.wheel(effect.castor, 1)], [build.wheel(effect.castor, 2)])
        case CastorOrder():
            first, second = (_of_castor(build, castor) for castor in (effect.castor, effect.exchanged_with))
            return _exchanged(build, first, second)
        case EncoderLatency():
            return Late([_channel(build, effect.castor, effect.wheel)], effect.value)
        case AllLatency():
            return Late(list(range(w + len(build.offset))), effect.value)
        case PivotBacklash():
            return Play(w + build.place(effect.castor), effect.value / 2)
        case TickLoss():
            sign = 1.0 if effect.direction == "forward" else -1.0
            return LostTicks(build.wheel(effect.castor, effect.wheel), effect.value, sign, effect.above)
        case LostRemainders():
            channel = build.wheel(effect.castor, effect.wheel)
            return Truncated(channel, 2 * math.pi / build.counts[channel])
        case TickLossBursts():
            channel = build.wheel(effect.castor, effect.wheel)
            return Bursts(channel, effect.value, effect.start, effect.period, effect.width, effect.seed)
    if effect.name not in NOT_SENSED:
        raise InputError(f"effect {effect.name!r}: simulators other than pymunk have no such effect; leave it out")
    return None


class Late:
    """Channels as they were `latency` s before; early channels (latency below 0) are extrapolated from the last two
    samples."""

    def __init__(self, channels: list[int], latency: float) -> None:
        self._channels, self._latency = channels, latency
        self._t, self._angle = np.empty(0), np.empty((0, len(channels)))

    def __call__(self, t: Array, angle: Array) -> Array:
        """Return the angles of a period."""
        angle = angle.copy()
        last = (self._t[-1], self._angle[-1]) if len(self._t) else (t[0], angle[0, self._channels])
        self._t, self._angle = np.append(self._t, t), np.vstack([self._angle, angle[:, self._channels]])
        newest, rate = self._t[-1], np.zeros(len(self._channels))
        if newest > last[0]:
            rate = (self._angle[-1] - last[1]) / (newest - last[0])
        read_at = t - self._latency
        for j, channel in enumerate(self._channels):
            beyond = rate[j] * np.maximum(read_at - newest, 0.0)
            angle[:, channel] = np.interp(read_at, self._t, self._angle[:, j]) + beyond
        kept = max(0, int(np.searchsorted(self._t, newest - self._latency)) - 1)
        self._t, self._angle = self._t[kept:], self._angle[kept:]
        return angle


class Play:
    """A channel behind a gear with play of `half` (rad) to either side; it starts in the middle."""

    def __init__(self, channel: int, half: float) -> None:
        self._channel, self._half = channel, half
        self._stands: float | None = None

    def __call__(self, t: Array, angle: Array) -> Array:
        """Return the angles of a period."""
        angle = angle.copy()
        stands = float(angle[0, self._channel]) if self._stands is None else self._stands
        for k, true in enumerate(angle[:, self._channel].tolist()):
            stands = min(max(stands, true - self._half), true + self._half)
            angle[k, self._channel] = stands
        self._stands = stands
        return angle


class _Losing:
    """A wheel whose encoder loses a part of the turn: the losses of all periods so far add up."""

    def __init__(self, channel: int) -> None:
        self._channel, self._lost = channel, 0.0
        self._before: tuple[float, float] | None = None

    def __call__(self, t: Array, angle: Array) -> Array:
        """Return the angles of a period."""
        angle, true = angle.copy(), angle[:, self._channel]
        since, start = (float(t[0]), float(true[0])) if self._before is None else self._before
        lost = self._lost + self._loses(t, true, since, start)
        angle[:, self._channel] = true - lost
        self._lost, self._before = float(lost[-1]), (float(t[-1]), float(true[-1]))
        return angle

    def _loses(self, t: Array, true: Array, since: float, start: float) -> Array:
        """Return what is lost from the start of a period, at `since` (s) and angle `start`, to each of its times."""
        raise NotImplementedError


class LostTicks(_Losing):
    """Loses a share of the turn in periods faster than `above`, rad/s, in one sense of rotation."""

    def __init__(self, channel: int, share: float, sign: float, above: float) -> None:
        super().__init__(channel)
        self._share, self._sign, self._above = share, sign, above

    def _loses(self, t: Array, true: Array, since: float, start: float) -> Array:
        fast = self._sign * (true[-1] - start) > self._above * (t[-1] - since)
        return (self._share if fast else 0.0) * (true - start)


class Truncated(_Losing):
    """Truncates the turn of a period to whole counts of `count` rad, toward zero, in the period's last row."""

    def __init__(self, channel: int, count: float) -> None:
        super().__init__(channel)
        self._count = count

    def _loses(self, t: Array, true: Array, since: float, start: float) -> Array:
        lost, turned = np.zeros(len(true)), true[-1] - start
        lost[-1] = turned - math.trunc(turned / self._count) * self._count
        return lost


class Bursts(_Losing):
    """Loses a share of the turn in bursts of `width` s, the first at `start`.

    They begin `period` s after one another or, with a seed, after uniform draws from 0 to twice that. A physics step is
    lost if its middle lies in a burst.
    """

    def __init__(self, channel: int, share: float, start: float, period: float, width: float, seed: int | None) -> None:
        super().__init__(channel)
        self._share, self._period, self._width = share, period, width
        self._random = None if seed is None else np.random.default_rng(seed)
        self._begins = [start]

    def _loses(self, t: Array, true: Array, since: float, start: float) -> Array:
        while self._begins[-1] <= t[-1]:
            later = 1.0 if self._random is None else self._random.uniform(0.0, 2.0)
            self._begins.append(self._begins[-1] + self._period * later)
        middle = t - np.diff(t, prepend=since) / 2
        last = np.searchsorted(self._begins, middle, side="right") - 1
        losing = (last >= 0) & (middle - np.array(self._begins)[last] < self._width)
        return np.cumsum(self._share * losing * np.diff(true, prepend=start))


def _on_channel(channel: int, read: Callable[[Array], Array]) -> Stage:
    def stage(t: Array, angle: Array) -> Array:
        angle = angle.copy()
        angle[:, channel] = read(angle[:, channel])
        return angle

    return stage


def _exchanged(build: Build, first: list[int], second: list[int]) -> Stage:
    """Return a stage in which two groups of channels are exchanged."""
    counts = np.concatenate([build.counts, build.pivot_counts])
    zero = np.concatenate([np.zeros(len(build.radius)), build.zero])
    to, source = first + second, second + first

    def stage(t: Array, angle: Array) -> Array:
        angle = angle.copy()
        angle[:, to] = (angle[:, source] + zero[source]) * counts[source] / counts[to] - zero[to]
        return angle

    return stage


def _channel(build: Build, castor: int, wheel: int | None) -> int:
    return len(build.radius) + build.place(castor) if wheel is None else build.wheel(castor, wheel)


def _of_castor(build: Build, castor: int) -> list[int]:
    """Return all channels with encoders of a castor."""
    place = build.place(castor)
    wheels = np.flatnonzero((build.castor == place) & np.isfinite(build.counts)).tolist()
    return [*wheels, *([len(build.radius) + place] if np.isfinite(build.pivot_counts[place]) else [])]
