"""Replays a log through the full simulation, in short windows from measured states, and measures the gap.

A window begins at a reference pose: the simulated robot is put there, with its castors as their pivot encoders read
(corrected for the robot's effects on sensors), and driven as logged until a later reference pose. The gap is the
simulated motion minus the reference's, and the simulated counts minus the logged ones.

Two ways to drive. "commands": the logged commands go through the simulated motors, as on the robot; the gap then
contains every error of the description, also in how wheels follow commands. "counts": wheels turn as their encoders
counted, whatever torque it takes, and steering motors follow the pivot encoders; the gap then contains only errors in
how turning becomes motion.

Positions without headings need the most likely path of the body through all of them: a window begins with its heading.
That heading knows of later positions too, so gaps across the way are rather too small; no gap of heading is measured.

A log does not hold the motors' integrators and the deflection of contacts at the start of a window. Both, and the
velocities, are carried over from the window before, while body and castors are reset to the measured state: forces
between wheels that disagree last for about two metres. The first window, and the first after a break in the log, is
preceded by a run of `WARM_UP` seconds.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from castor_envs.effects.catalogue import readings
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, inverse, relative_pose
from castor_envs.logs.log import Log, poses_taken, positions_taken
from castor_envs.motion.kinematics import Geometry, forward
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.sensors.encoders import castor_angles
from castor_envs.vehicles.robot import RobotDescription
from estimators.likelihood.rolling import GAP

Drive = Literal["commands", "counts"]

WINDOW = 5.0
"""s: errors grow with the way, while the noise of two reference poses does not, so longer windows show more of them."""

WARM_UP = 0.5
"""s: ten times the settling time of a motor."""

REMEMBERED = 10.0
"""s of a log before a window that is given to effects on sensors: latency and backlash depend on earlier samples."""

LONGEST = 2.0
"""Longest duration, in windows, to which a window is extended to end at a reference pose."""

HANDED_ON = ("speed", "integral", "stretch_long", "stretch_lat")
"""State variables of wheels that are carried over from window to window."""

HEAVY = 1e6
"""kg m2: the spin inertia of a wheel whose speed is prescribed, so large that the floor does not affect it."""

PARTS = 10
"""Parts of a sample, in each of which such a wheel's speed is constant: at a sudden change it would slide."""

SMOOTHED = 5
"""Samples over which parabolas are fitted for speeds."""


HandedOn = dict[int, tuple[Array, NDArray[np.void]]]
"""By sample, the quantities carried over to the next window: the body's twist (3,) and the wheels' records."""


@dataclass(frozen=True, eq=False)
class Replay:
    """The gaps of N windows. drive: how the simulation was driven; notes: remarks on this for the user.

    start, end (N,): s, on the log's clock. motion (N, 3): simulated, from start to end, in the body's frame at the
    start: along (forward), across (to the left), m, turned, rad. body (N, 3): simulated less measured motion; NaN where
    the reference is unknown, of turning alone where it has no heading. wheels (N, driven wheels): m of roll, by the
    radius described, and pivots (N, pivot encoders): rad, that the simulated encoders read beyond the measured.
    handed_on: of each window.
    """

    drive: Drive
    notes: tuple[str, ...]
    start: Array
    end: Array
    motion: Array
    body: Array
    wheels: Array
    pivots: Array
    wheel_names: tuple[str, ...]
    pivot_names: tuple[str, ...]
    handed_on: tuple[HandedOn, ...] = ()

    @property
    def driven(self) -> Array:
        """How far the body's origin moved in the simulation (N,), m."""
        return np.asarray(np.hypot(self.motion[:, 0], self.motion[:, 1]))

    def summary(self) -> dict[str, Any]:
        """Return plain data for JSON: root mean squares over windows, mm and mrad; null where nothing was measured."""
        names, gaps = (*self.wheel_names, *self.pivot_names), np.column_stack([self.wheels, self.pivots])
        units = ["mm"] * len(self.wheel_names) + ["mrad"] * len(self.pivot_names)
        return {
            "drive": self.drive,
            "notes": list(self.notes),
            "window_s": float(np.mean(self.end - self.start)),
            "windows": len(self.start),
            "windows_with_reference": int(np.isfinite(self.body[:, 0]).sum()),
            "driven_m": float(np.sum(self.driven)),
            "position_rms_mm": _root(np.sum(self.body[:, :2] ** 2, axis=1)),
            "along_rms_mm": _root(self.body[:, 0] ** 2),
            "across_rms_mm": _root(self.body[:, 1] ** 2),
            "heading_rms_mrad": _root(self.body[:, 2] ** 2),
            "wheels_rms_mm": _root(self.wheels**2),
            "pivots_rms_mrad": _root(self.pivots**2),
            "channels": [
                {"name": name, "unit": unit, "rms": _root(gap**2), "mean": 1e3 * float(np.mean(gap))}
                for name, unit, gap in zip(names, units, gaps.T, strict=True)
            ],
        }

    def expected(self, position: float, heading: float | None) -> dict[str, float | None]:
        """Return the gap that noise of reference poses alone causes: `position` (m) along each axis and `heading`
        (rad), None of positions alone.

        Root mean squares as in the summary: of two poses, of which the first also says which way the motion went; of
        positions alone that of the way from one to the other.
        """
        known = np.where(np.isfinite(self.body[:, 0]), self.driven, np.nan)
        aside = 2 * position**2 + 0 * known if heading is None else (heading * known) ** 2
        return {
            "position_rms_mm": _root(4 * position**2 + aside),
            "heading_rms_mrad": None if heading is None else _root(2 * heading**2 + 0 * known),
        }


class _Seen(NamedTuple):
    """Poses of the body by the reference: times within a log (k,), s; poses (k, 3); and which have a heading (k,)."""

    time: Array
    pose: Array
    headed: NDArray[np.bool_]


class _Window(NamedTuple):
    """start, end: s. first, last (3,): poses of the body at both by the reference, NaN where one is unknown. headed:
    whether the reference has both headings."""

    start: float
    end: float
    first: Array
    last: Array
    headed: bool = True


def replay(
    robot: RobotDescription,
    log: Log,
    window: float = WINDOW,
    *,
    clock: ArrayLike = (0.0, 0.0),
    mount: ArrayLike = (0.0, 0.0, 0.0),
    path: Array | None = None,
    like: Replay | None = None,
    anew: ArrayLike = (),
) -> Replay:
    """Return the gap between the simulation of a robot, with the effects in its file, and a log.

    By the commands where the log has them. window: s, at least, but at most half the log; each ends at the first
    reference pose after that. clock: (ahead, rate): the reference in the log's row of time t was taken at t + ahead +
    rate (t - t_0). mount: the tracked point and its direction in B, x, y (m), psi (rad). Both in addition to the
    robot's effects on the reference. path (K, 3 or more): the most likely poses of the body, which give headings to
    positions that have none; None: these are not used. like: a replay of the same log by the same robot, of which the
    windows are taken over that are not simulated `anew` (N,), as where only another part of the floor differs.
    Raises InputError where castors have no pivot encoder, and for logs without a window.
    """
    if window <= 0:
        raise ValueError(f"a window lasts more than 0 s, got {window}")
    window = min(window, float(log.t[-1] - log.t[0]) / 2)
    measured = _Measured(robot, log)
    if (sample := float(measured.t[1] - measured.t[0])) > window:
        raise InputError(f"samples are {sample:g} s apart, and a replay takes windows of {window:g} s; sample faster")
    drive, notes = measured.drive(robot)
    poses = _poses_in(robot, log, clock, mount, path)
    windows = _windows(poses, measured, window, notes)
    if not windows:
        raise InputError(f"the log has no {window:g} s without a gap to replay; give a longer one or shorter windows")
    moved = np.array([relative_pose(stretch.first, stretch.last) for stretch in windows])
    moved[[not stretch.headed for stretch in windows], 2] = np.nan
    known: list[_Run | None] = [None] * len(windows)
    if like is not None:
        taken_over = zip(like.motion, like.wheels, like.pivots, like.handed_on, strict=True)
        known = [None if again else run for run, again in zip(taken_over, np.asarray(anew), strict=True)]
    runs = list(_Simulation(robot, measured, drive).runs(windows, known))
    motion, wheels, pivots = (np.array([run[k] for run in runs]) for k in range(3))
    return Replay(
        drive=drive,
        notes=tuple(notes),
        start=np.array([stretch.start for stretch in windows]),
        end=np.array([stretch.end for stretch in windows]),
        motion=motion,
        body=motion - moved,
        wheels=wheels,
        pivots=pivots,
        wheel_names=tuple(f"wheel_{robot.wheel_names[k]}" for k in robot.driven_wheels),
        pivot_names=tuple(f"pivot_{i + 1}" for i in robot.pivot_encoders),
        handed_on=tuple(run[3] for run in runs),
    )


def joined(replays: Sequence[Replay]) -> Replay:
    """Return the windows of several replays of one robot as one; `start` and `end` are each log's own."""
    if len({part.drive for part in replays}) != 1:
        raise ValueError("replays of one drive can be joined")
    arrays = ("start", "end", "motion", "body", "wheels", "pivots")
    return dataclasses.replace(
        replays[0],
        notes=tuple(dict.fromkeys(note for part in replays for note in part.notes)),
        handed_on=tuple(window for part in replays for window in part.handed_on),
        **{name: np.concatenate([getattr(part, name) for part in replays]) for name in arrays},
    )


def _smooth(angle: Array) -> Array:
    from scipy.signal import savgol_filter  # slow to import

    return np.asarray(savgol_filter(angle, SMOOTHED, 2, axis=0), float) if len(angle) >= SMOOTHED else angle


class _Sensing:
    """Encoders of a robot with its effects: angles (K, w + n) of wheels and castors, rad, as its description converts
    their counts."""

    def __init__(self, robot: RobotDescription) -> None:
        described, built = Geometry.of(robot.as_described()), Geometry.of(robot.as_built())
        self._robot, self._w = robot, len(robot.wheels)
        self._gain = np.nan_to_num(built.counts_per_rev / described.counts_per_rev, nan=1.0)
        self._zero = built.pivot_zero - described.pivot_zero

    def read(self, t: Array, angle: Array) -> Array:
        """Return true angles as the encoders read them."""
        wheel, castor = readings(self._robot, t, angle[:, : self._w], angle[:, self._w :])
        return np.column_stack([wheel * self._gain, castor + self._zero])

    def undone(self, t: Array, angle: Array) -> Array:
        """Return angles as encoders read them with wrong counts per turn, zeros and wiring put right."""
        wheel, castor = angle[:, : self._w] / self._gain, angle[:, self._w :] - self._zero
        plain = self._robot.as_described()
        for effect in reversed(self._robot.effects):
            if effect.wiring:  # done twice, it is undone
                wheel, castor = readings(plain.with_effects(effect), t, wheel, castor)
        return np.column_stack([wheel, castor])


class _Measured:
    """A log on an even clock. t (K,). true (K, w + n): angles of wheels and castors, as estimated from the encoders,
    rad, unwrapped; read: as the encoders read them. twist (K, 3). command (K, driven wheels) and steering (K, driven
    castors): rad/s, or None. unbroken (K - 1,): steps that are in no gap (`GAP`) of the log."""

    def __init__(self, robot: RobotDescription, log: Log) -> None:
        """robot: with its effects. Raise InputError for castors without an encoder."""
        described, geometry, w = Geometry.of(robot.as_described()), Geometry.of(robot.as_built()), len(robot.wheels)
        blind = np.flatnonzero(~geometry.fixed & np.isnan(geometry.pivot_counts_per_rev))
        if blind.size:
            raise InputError(f"castor {blind[0] + 1} turns but has no pivot encoder: where it starts is not measured")
        period = float(np.median(np.diff(log.t)))
        t = log.t[0] + period * np.arange(int((log.t[-1] - log.t[0]) / period + 1e-3) + 1)
        driven, sensed = list(robot.driven_wheels), list(robot.pivot_encoders)
        seen = np.column_stack([np.zeros((len(log), w)), np.unwrap(castor_angles(described, log.pivot), axis=0)])
        seen[:, driven] = log.wheel * (2 * np.pi / described.counts_per_rev[driven])
        read = np.column_stack([np.interp(t, log.t, column) for column in seen.T])
        read[:, w:][:, sensed] -= 2 * np.pi * np.round(read[0, w:][sensed] / (2 * np.pi))  # within half a turn of 0

        # Encoder readings are true but for the robot's effects; effects that cannot be inverted are small and evaluated
        # at the smoothed angles.
        sensing = _Sensing(robot)
        plain = true = sensing.undone(t, read)
        for _ in range(2):
            about = _smooth(true)
            true = plain - (sensing.undone(t, sensing.read(t, about)) - about)
        rates = np.gradient(_smooth(true), t, axis=0)
        self.twist = forward(geometry, true[:, w:], rates[:, w:], rates[:, :w])
        before = np.searchsorted(log.t, t + 1e-3 * period, side="right") - 1
        self.command, self.steering = (
            None if part is None or not np.isfinite(part).any() else part[before]
            for part in (log.command, log.steering_command if len(robot.driven_castors) else None)
        )
        self.unbroken = np.diff(log.t)[np.minimum(before[:-1], len(log) - 2)] < GAP * period
        self.t, self.true, self.read = t, true, read

    def drive(self, robot: RobotDescription) -> tuple[Drive, list[str]]:
        """Return how to drive a robot, and notes about it."""
        if self.command is None:
            return "counts", ["the log has no commands: wheels turn as their encoders counted"]
        if robot.driven_castors and self.steering is None:
            return "commands", ["the log has no steering commands: steering motors follow the pivots' counts"]
        return "commands", []


def _windows(poses_seen: _Seen, measured: _Measured, window: float, notes: list[str]) -> list[_Window]:
    """Return windows one after another: from reference pose to reference pose where these lie close enough, else of the
    length asked for."""
    t, unknown = measured.t, np.full(3, np.nan)
    times, poses, headed = poses_seen
    if len(times) < 2:
        notes.append("no reference poses: only what the encoders count is compared")
    elif not headed.all():
        notes.append("where the reference has no heading, windows begin with that of the most likely path")
    slack, needed = 0.5 * (t[1] - t[0]), [part for part in (measured.command, measured.steering) if part is not None]
    windows, begin = [], float(times[0]) if len(times) else float(t[0])
    while begin + window <= t[-1] + slack:
        posed = np.flatnonzero(np.abs(times - begin) < 1e-9)
        later = np.flatnonzero((times >= begin + window - slack) & (times <= begin + LONGEST * window))
        if len(posed) and len(later):
            first, last = posed[0], later[0]
            stretch = _Window(
                begin, float(times[last]), poses[first], poses[last], bool(headed[first] and headed[last])
            )
        else:
            end = float(min(begin + window, t[-1]))
            ahead = times[(times > begin + slack) & (times <= end)]
            if len(ahead) and not len(posed):  # go on where a pose is known, with a shorter window before it
                end = float(ahead[0])
            stretch = _Window(begin, end, unknown, unknown)
        first, last = _samples(t, stretch)
        commanded = all(np.isfinite(part[first:last]).all() for part in needed)
        if last > first and measured.unbroken[first:last].all() and commanded:
            windows.append(stretch)
        begin = stretch.end
    return windows


def _poses_in(robot: RobotDescription, log: Log, clock: ArrayLike, mount: ArrayLike, path: Array | None) -> _Seen:
    """Return the poses of the body by the reference; see `replay`."""
    ahead, rate = np.asarray(clock, dtype=float)
    rows = poses_taken(log) if path is None else positions_taken(log)
    if log.reference is None or not len(rows):
        return _Seen(np.zeros(0), np.zeros((0, 3)), np.zeros(0, dtype=bool))
    times = log.t[rows] + ahead + rate * (log.t[rows] - log.t[0])
    for effect in robot.effects:
        times = effect.reference_time(times)
    inside = (times >= log.t[0] - 1e-9) & (times <= log.t[-1] + 1e-9)
    tracked, headed = log.reference[rows[inside]], np.isfinite(log.reference[rows[inside], 2])
    if path is not None:
        pose = np.column_stack([np.interp(times[inside], log.t, column) for column in path[:, :3].T])
        for effect in robot.effects:
            pose = effect.reference_pose(pose)
        heading = pose[:, 2] + np.asarray(mount, float)[2]
        tracked = np.column_stack([tracked[:, :2], np.where(headed, tracked[:, 2], heading)])
    shown = compose(tracked, inverse(mount))
    body = shown
    for _ in range(4 if len(shown) else 0):  # one is enough for another point, another scale takes more
        seen = body
        for effect in robot.effects:
            seen = effect.reference_pose(seen)
        body = compose(body, relative_pose(seen, shown))
    return _Seen(np.clip(times[inside], log.t[0], log.t[-1]), body, headed)


def _samples(t: Array, window: _Window) -> tuple[int, int]:
    """Return the samples that a window lies between."""
    period = t[1] - t[0]
    first = int(np.floor((window.start - t[0]) / period + 1e-6))
    return first, min(int(np.ceil((window.end - t[0]) / period - 1e-6)), len(t) - 1)


_Run = tuple[Array, Array, Array, HandedOn]
"""The body's motion (3,) in a window, the excess of encoder readings, wheels (m) and pivots (rad), and what is handed
on to the next window."""


class _Simulation:
    """A robot that is driven as in a log, from any of its samples on, and what its encoders then read."""

    def __init__(self, robot: RobotDescription, measured: _Measured, drive: Drive) -> None:
        self._measured, self._drive, self._sensing = measured, drive, _Sensing(robot)
        self._sample, self._parts = float(measured.t[1] - measured.t[0]), PARTS if drive == "counts" else 1
        self._period = self._sample / self._parts
        self._world = RobotWorld(dataclasses.replace(robot, sample_period=self._period), Floor())
        self._driven, self._steered = np.array(robot.driven_wheels), np.array(robot.driven_castors, dtype=np.intp)
        self._sensed, self._radius = list(robot.pivot_encoders), Geometry.of(robot.as_described()).radius
        samples, self._w = np.arange(len(measured.t)), len(robot.wheels)
        parts = np.linspace(0, samples[-1], self._parts * samples[-1] + 1)
        wheel, castor = np.split(measured.true, [self._w], axis=1)
        self._wheel = CubicSpline(samples, _smooth(wheel))(parts)
        self._castor = np.column_stack([np.interp(parts, samples, angle) for angle in castor.T])

    def runs(self, windows: Sequence[_Window], known: Sequence[_Run | None]) -> Iterator[_Run]:
        """Yield the run of each window; those `known` already are not simulated unless the one before was, from which
        they go on."""
        t, handed_on, simulated = self._measured.t, HandedOn(), False
        for window, before in zip(windows, known, strict=True):
            if before is not None and not simulated:
                handed_on = before[3]
                yield before
                continue
            simulated = before is None
            first, last = _samples(t, window)
            pose = np.where(np.isfinite(window.first), window.first, 0.0)
            if first not in handed_on:
                start = max(0, first - round(WARM_UP / self._sample))
                world = self._started(start, pose, self._measured.twist[start])
                for k in range(start, first):
                    self._advance(world, k)
                handed_on = {first: _moving(world)}
            twist, wheels = handed_on[first]
            world = self._started(first, pose, twist)
            for part in HANDED_ON:
                world.wheels[part] = wheels[part]
            states, handed_on = [], {}
            for k in range(first, last + 1):
                states.append((world.pose, np.concatenate([world.wheel_angles, world.castor_angles])))
                if k >= last - 1:  # the next window begins at one of these
                    handed_on[k] = _moving(world)
                if k < last:
                    self._advance(world, k)
            poses, angles = (np.array(part) for part in zip(*states, strict=True))
            began, ended = (_at(poses, (time - t[first]) / self._sample) for time in (window.start, window.end))
            yield relative_pose(began, ended), *self._excess(first, angles), handed_on

    def _started(self, at: int, pose: Array, twist: Array) -> RobotWorld:
        """Return the robot at a pose, its castors as at a sample, moving with a twist."""
        self._world.restart(self._measured.true[at, self._w :], pose, twist)
        if self._drive == "counts":
            self._world.wheels["inertia"][self._driven] = HEAVY
        return self._world

    def _advance(self, world: RobotWorld, k: int) -> None:
        """Drive from sample k to the next."""
        log = self._measured
        for i in range(k * self._parts, (k + 1) * self._parts):
            steering = (self._castor[i + 1] - world.castor_angles)[self._steered] / self._period
            if self._drive == "commands" and log.command is not None:
                steering = steering if log.steering is None else log.steering[k]
                world.advance(log.command[k], steering)
            else:
                rate = ((self._wheel[i + 1] - self._wheel[i]) / self._period)[self._driven]
                world.wheels["speed"][self._driven] = rate
                world.advance(rate, steering)

    def _excess(self, first: int, angles: Array) -> tuple[Array, Array]:
        """Return by how much simulated encoders of wheels (m) and pivots (rad) read more than measured ones from sample
        `first` on, in angles as simulated (n, w + n), those of wheels from 0 on."""
        t, true, read, w = self._measured.t, self._measured.true, self._measured.read, self._w
        since = int(np.searchsorted(t, t[first] - REMEMBERED))
        simulated = np.concatenate([true[since:first], angles + np.pad(true[first, :w], (0, angles.shape[1] - w))])
        shown = self._sensing.read(t[since : since + len(simulated)], simulated)
        excess = (shown[-1] - shown[first - since]) - (read[since + len(simulated) - 1] - read[first])
        return (excess[:w] * self._radius)[self._driven], excess[w:][self._sensed]


def _moving(world: RobotWorld) -> tuple[Array, NDArray[np.void]]:
    """Return the body's twist (3,) and the wheels' records."""
    return world.twist, world.wheels.copy()


def _at(poses: Array, sample: float) -> Array:
    """Return the pose between samples."""
    k = min(int(sample), len(poses) - 2)
    return poses[k] + (sample - k) * (poses[k + 1] - poses[k])


def _root(squares: Array) -> float | None:
    """Return 1000 times the root of the mean of finite values; None where there are none."""
    known = squares[np.isfinite(squares)]
    return float(1e3 * np.sqrt(np.mean(known))) if known.size else None
