"""Trajectories to drive: squares of UMBmark, calibration pivoting, figure eight, random wander.

A trajectory is a chain of legs of constant motion in the body's frame (straight, turn, arc), each leg a
one-parameter motion of SE(2) and so exact in closed form. Legs are grouped into runs: a run starts and ends
at rest and follows a trapezoidal speed profile over its whole length.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.errors import InputError, shortened
from castor_envs.geometry.arrays import Array, vectors

Direction = Literal["ccw", "cw"]
Corners = Literal["turn", "fixed", "rounded"]

#: Radius that makes a rounded 1.5 m square 5.727 m long, the length that Doebbler's percentages imply.
CORNER_RADIUS = 0.159


@dataclass(frozen=True)
class Leg:
    """`length` units of motion along `motion`: the displacement (x, y in B, m; psi, rad) a unit of length."""

    motion: tuple[float, float, float]
    length: float

    def __post_init__(self):
        try:
            x, y, psi = self.motion
            # A sum is finite where all its parts are.
            sound = self.length >= 0.0 and math.isfinite(x + y + psi + self.length)
        except (TypeError, ValueError):
            sound = False
        if not sound:
            raise InputError(
                f"a leg needs a motion of three finite numbers and a finite length of at least 0, not "
                f"{shortened(repr((self.motion, self.length)), 60)}"
            )


@dataclass(frozen=True)
class Run:
    """Legs driven in one go, from rest to rest: speed and acceleration in units of length a second (squared)."""

    legs: tuple[Leg, ...]
    speed: float
    acceleration: float

    def __post_init__(self):
        _check_positive(speed=self.speed, acceleration=self.acceleration)
        if not all(isinstance(leg, Leg) for leg in self.legs) or not self.length > 0:
            raise InputError(f"a run needs legs of some length, not {shortened(repr(self.legs), 60)}")

    @cached_property
    def length(self) -> float:
        """Length of all legs."""
        return sum(leg.length for leg in self.legs)

    @cached_property
    def peak(self) -> float:
        """Highest speed reached: short runs never reach `speed`."""
        return min(self.speed, math.sqrt(self.length * self.acceleration))

    @cached_property
    def duration(self) -> float:
        """Time taken, s."""
        return self.length / self.peak + self.peak / self.acceleration

    def progress(self, t: Array) -> tuple[Array, Array]:
        """Return the length covered and the speed at times t since the run's start."""
        return _progress(t, self.length, self.peak, self.acceleration, self.duration)


def _progress(t: Array, length: Any, peak: Any, acceleration: Any, duration: Any) -> tuple[Array, Array]:
    """Return the length covered and the speed at times t since the start of one run, or of one for each time."""
    ramp = peak / acceleration
    t = np.minimum(np.maximum(t, 0.0), duration)
    left = duration - t
    speed = np.minimum(peak, acceleration * np.minimum(t, left))
    rising = 0.5 * acceleration * t**2
    steady = peak * (t - 0.5 * ramp)
    falling = length - 0.5 * acceleration * left**2
    return np.where(t < ramp, rising, np.where(left < ramp, falling, steady)), speed


class _Tables(NamedTuple):
    """Of all runs: length, peak, acceleration and duration, (4, r); the lengths covered before them, and the first of
    their legs, (r + 1,). Of all legs: where they begin along the whole way, (l,), the poses there and motions, (l, 3).
    """

    runs: Array
    before: Array
    first: NDArray[np.intp]
    begins: Array
    poses: Array
    motions: Array


@dataclass(frozen=True)
class Trajectory:
    """Runs driven one after the other from the pose `start` (x, y, psi)."""

    name: str
    runs: tuple[Run, ...]
    start: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self):
        if not self.runs or not all(isinstance(run, Run) for run in self.runs):
            raise InputError(f"trajectory {self.name!r} needs runs, not {shortened(repr(self.runs), 60)}")
        if len(self.start) != 3 or not all(map(math.isfinite, self.start)):
            raise InputError(f"trajectory {self.name!r}: start is x, y and psi, not {shortened(repr(self.start), 60)}")

    @property
    def duration(self) -> float:
        """Time taken, s."""
        return float(self._run_starts[-1])

    @property
    def path_length(self) -> float:
        """Length of the path of the body's origin, m."""
        return sum(leg.length * math.hypot(*leg.motion[:2]) for run in self.runs for leg in run.legs)

    @cached_property
    def _run_starts(self) -> Array:
        return np.concatenate([[0.0], np.cumsum([run.duration for run in self.runs])])

    @cached_property
    def _tables(self) -> _Tables:
        pose, before, first = self.start, [0.0], [0]
        begins, poses, motions = [], [], []
        for run in self.runs:
            at = before[-1]
            for leg in run.legs:
                begins.append(at)
                poses.append(pose)
                motions.append(leg.motion)
                at, pose = at + leg.length, _end(pose, leg.motion, leg.length)
            before.append(before[-1] + run.length)
            first.append(len(begins))
        runs = [(run.length, run.peak, run.acceleration, run.duration) for run in self.runs]
        many = np.array(runs).T, np.array(before), np.array(first), np.array(begins)
        return _Tables(*many, np.array(poses, dtype=float), np.array(motions, dtype=float))

    def breakpoints(self) -> Array:
        """Return the times at which the motion is not smooth: ends of runs, ramps and legs."""
        times = [0.0]
        for run, start in zip(self.runs, self._run_starts, strict=False):
            ramp = run.peak / run.acceleration
            times += [start, start + ramp, start + run.duration - ramp, start + run.duration]
            at = 0.0
            for leg in run.legs[:-1]:
                at += leg.length
                times.append(start + _time_at(run, at))
        return np.unique(times)

    def at(self, t: ArrayLike) -> tuple[Array, Array]:
        """Return pose (..., 3) in N and twist (..., 3) in B at times t (...), s; at rest before and after."""
        tables, (leg, along, speed) = self._tables, self._on_leg(np.asarray(t, dtype=float))
        motion = tables.motions[leg]
        return moved(tables.poses[leg], motion * along[..., None]), motion * speed[..., None]

    def twist_at(self, t: float) -> Array:
        """Return the twist (3,) in B at one time, s: that of `at`, in half the time."""
        leg, _, speed = self._on_leg(np.asarray(t, dtype=float))
        return self._tables.motions[leg] * speed[..., None]

    def _on_leg(self, t: Array) -> tuple[NDArray[np.intp], Array, Array]:
        """Return the legs (...), of all, at times t (...), the lengths covered on them, and the speeds."""
        tables, runs = self._tables, len(self.runs)
        run = np.minimum(np.maximum(np.searchsorted(self._run_starts, t, side="right") - 1, 0), runs - 1)
        covered, speed = _progress(t - self._run_starts[run], *tables.runs[:, run])
        first, before = tables.first[run], tables.before[run]
        if len(tables.begins) == runs:
            return first, covered, speed
        begun = np.searchsorted(tables.begins, before + covered, side="right") - 1
        leg = np.minimum(np.maximum(begun, first), tables.first[run + 1] - 1)
        return leg, covered - (tables.begins[leg] - before), speed


def _time_at(run: Run, length: float) -> float:
    """Return when a run has covered `length`, s since its start."""
    ramp = run.peak / run.acceleration
    ramp_length = 0.5 * run.acceleration * ramp**2
    if length < ramp_length:
        return math.sqrt(2 * length / run.acceleration)
    if length > run.length - ramp_length:
        return run.duration - math.sqrt(2 * (run.length - length) / run.acceleration)
    return ramp + (length - ramp_length) / run.peak


def moved(pose: ArrayLike, displacement: ArrayLike) -> Array:
    """Return poses (..., 3) after constant body motion by (x, y, psi) (..., 3): the exponential map of SE(2)."""
    pose, displacement = np.asarray(pose, dtype=float), np.asarray(displacement, dtype=float)
    turn = displacement[..., 2]
    chord = np.sinc(turn / (2 * np.pi))
    direction = pose[..., 2] + turn / 2
    x, y = displacement[..., 0] * chord, displacement[..., 1] * chord
    c, s = np.cos(direction), np.sin(direction)
    return vectors(pose[..., 0] + c * x - s * y, pose[..., 1] + s * x + c * y, pose[..., 2] + turn)


Three = tuple[float, float, float]


def _end(pose: Three, motion: Three, length: float) -> Three:
    """Return where a leg ends that begins at a pose: `moved` of one."""
    x, y, half = motion[0] * length, motion[1] * length, motion[2] * length / 2
    chord = math.sin(half) / half if half else 1.0
    c, s = chord * math.cos(pose[2] + half), chord * math.sin(pose[2] + half)
    return pose[0] + c * x - s * y, pose[1] + s * x + c * y, pose[2] + 2 * half


def umbmark(
    direction: Direction = "ccw",
    corners: Corners = "turn",
    *,
    side: float = 1.5,
    speed: float = 0.25,
    acceleration: float = 0.5,
    turn_speed: float = math.radians(45),
    turn_acceleration: float = math.radians(90),
    corner_radius: float = CORNER_RADIUS,
) -> Trajectory:
    """Return the square of UMBmark (Borenstein and Feng 1994), back to the start pose.

    corners: "turn" stops and turns by 90 deg at each corner, the last one included; "fixed" keeps the heading and
    drives the sides ahead, sideways, back and sideways (omnidirectional robots); "rounded" drives arcs of
    `corner_radius` without stopping, starting in the middle of a side. Lengths in m, speeds in m/s and rad/s.
    """
    _check_positive(
        side=side,
        speed=speed,
        acceleration=acceleration,
        turn_speed=turn_speed,
        turn_acceleration=turn_acceleration,
    )
    if direction not in ("ccw", "cw"):
        raise InputError(f"direction must be 'ccw' or 'cw', got {direction!r}")
    sense = 1.0 if direction == "ccw" else -1.0
    if corners == "turn":
        ahead = Run((Leg((1.0, 0.0, 0.0), side),), speed, acceleration)
        turn = Run((Leg((0.0, 0.0, sense), math.pi / 2),), turn_speed, turn_acceleration)
        runs = (ahead, turn) * 4
    elif corners == "fixed":
        ways = ((1.0, 0.0, 0.0), (0.0, sense, 0.0), (-1.0, 0.0, 0.0), (0.0, -sense, 0.0))
        runs = tuple(Run((Leg(way, side),), speed, acceleration) for way in ways)
    elif corners == "rounded":
        if not 0 < corner_radius < side / 2:
            raise InputError(f"corner_radius must lie between 0 and half the side, got {corner_radius}")
        straight = side - 2 * corner_radius
        half = Leg((1.0, 0.0, 0.0), straight / 2)
        arc = Leg((1.0, 0.0, sense / corner_radius), corner_radius * math.pi / 2)
        runs = (Run((half, arc, *((Leg((1.0, 0.0, 0.0), straight), arc) * 3), half), speed, acceleration),)
    else:
        raise InputError(f"corners must be 'turn', 'fixed' or 'rounded', got {corners!r}")
    return Trajectory(f"UMBmark square, {direction}, {corners}", runs)


def _check_positive(**values: float) -> None:
    for name, value in values.items():
        if not (isinstance(value, int | float | np.number) and 0 < value < math.inf):
            raise InputError(f"{name} must be a finite number above 0, got {value!r}")


def pivoting(
    pivot: tuple[float, float],
    direction: Direction = "ccw",
    *,
    angle: float = 2 * math.pi,
    speed: float = math.radians(30),
    acceleration: float = math.radians(30),
) -> Trajectory:
    """Return the calibration motion: the body turns by `angle` (rad) about the pivot (m in B) of a held castor."""
    sense = 1.0 if direction == "ccw" else -1.0
    motion = (sense * pivot[1], -sense * pivot[0], sense)
    return Trajectory(f"pivoting, {direction}", (Run((Leg(motion, angle),), speed, acceleration),))


def chained(name: str, trajectories: Sequence[Trajectory]) -> Trajectory:
    """Return the runs of trajectories one after the other, each from where the last one ends."""
    return Trajectory(name, tuple(run for trajectory in trajectories for run in trajectory.runs))


def figure_eight(*, radius: float = 0.5, speed: float = 0.25, acceleration: float = 0.5) -> Trajectory:
    """Return two full circles, one to each side, driven forward without stopping."""
    circles = tuple(Leg((1.0, 0.0, side / radius), 2 * math.pi * radius) for side in (1.0, -1.0))
    return Trajectory("figure eight", (Run(circles, speed, acceleration),))


RANDOM, LONGEST_RANDOM = 20.0, 35.0
"""s: random trajectories of environments take at least and at most so long; the last run, a turn, takes up to 11 s."""


def wander(
    random: np.random.Generator,
    *,
    duration: float = 60.0,
    holonomic: bool = True,
    turning: bool = True,
    speed: float = 0.25,
    acceleration: float = 0.5,
    arena: float = 2.0,
) -> Trajectory:
    """Return random runs of at least `duration` s that stay within `arena` m of the start (centre of the body).

    Each is a random arc, or with `turning` False a straight line at the heading of the start; robots that cannot move
    sideways (`holonomic` False) start each one with a turn on the spot if it would leave the arena.
    """
    runs: list[Run] = []
    pose, time = (0.0, 0.0, 0.0), 0.0
    while time < duration:
        way = random.uniform(-np.pi, np.pi) if holonomic else 0.0
        turn = random.uniform(-1.5, 1.5) if turning else 0.0
        leg = Leg((math.cos(way), math.sin(way), turn), random.uniform(0.3, 1.2))
        if math.hypot(*pose[:2]) + leg.length > arena and _leaves(arena, pose, leg):
            if holonomic:
                continue
            leg = Leg((0.0, 0.0, 1.0), random.uniform(0.5, 2.5))
        run = Run((leg,), speed, acceleration)
        runs.append(run)
        pose, time = _end(pose, leg.motion, leg.length), time + run.duration
    return Trajectory("random wander", tuple(runs))


def _leaves(arena: float, pose: Three, leg: Leg) -> bool:
    """Return whether a leg that begins at a pose goes farther than `arena` from the origin, looked at in 20 places."""
    places = (_end(pose, leg.motion, leg.length * k / 19) for k in range(20))
    return any(math.hypot(x, y) > arena for x, y, _ in places)
