"""Checks of single channels, times and reference poses, without any model of motion."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.columns import LogColumns
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight.findings import Mistake

SHORT = 10.0
"""s: a shorter log shows hardly anything."""

GAP = 3.0
"""Least gap between two samples, or two reference poses, that is reported, in median periods."""

PERIOD = 0.2
"""Largest relative difference of the sample period from the robot's without a remark."""

UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}

FAST, OFTEN = 3.0, 0.05
"""Multiple of max_wheel_speed that no wheel reaches; the part of steps above it from which on the fault is systematic,
not in single steps."""

WORDS = range(8, 33)
"""Widths, in bits, of counters that may wrap."""

FEWEST_ROWS = 10
"""Least number of rows with which noise can be distinguished from motion."""

FAR_OFF, LONGEST_GAP = 1e3, 86400.0
"""Largest factor between the period of samples and that of the robot file; most seconds between two samples, a day."""

FARTHEST = 1e3
"""m: patches and cables are searched on a grid of centimetres from the origin to the robot, which must stay small."""

MOVED = 0.05
"""m and rad: a reference that ranges further than this has moved, as no tracker is so noisy."""

MOST_PLACES = 3
"""Most places that are named of each kind."""


@dataclass(frozen=True)
class Named:
    """A log and what it is called."""

    name: str
    log: Log


def check_logs(logs: Mapping[str, Log]) -> None:
    """Raise InputError, with its name, for a log without information.

    That is one of hardly any rows, in which no encoder count changes (and of a train no relative pose: a standing one
    shows the noise of its gauges), or, of a robot, whose reference is far from its origin.
    """
    for name, log in logs.items():
        if len(log) < FEWEST_ROWS:
            raise InputError(
                f"{name}: has {len(log)} rows; a diagnosis needs at least {FEWEST_ROWS}, and less shows little "
                f"than {SHORT:g} s"
            )
        if log.rps is None:
            _check_reach(name, log)
        channels = [log.wheel, log.pivot, *([] if log.rps is None else [np.nan_to_num(log.rps)])]
        if any(np.any(np.ptp(part, axis=0) > 0) for part in channels):
            continue
        message = "shows no motion: no encoder count ever changes; leave it out, and record a log while driving"
        taken = log.reference[np.isfinite(log.reference).all(axis=1)] if log.reference is not None else np.zeros((0, 3))
        if len(taken) and np.any(np.ptp(taken, axis=0) > MOVED):
            message += " (the reference does move: if the robot did, its encoders are not connected)"
        raise InputError(f"{name}: {message}")


def _check_reach(name: str, log: Log) -> None:
    """Raise InputError for reference positions that are too far from the origin of their frame."""
    if log.reference is None:
        return
    far = np.where(np.isfinite(log.reference), np.abs(log.reference), 0.0)[:, :2]
    row, axis = np.unravel_index(int(np.argmax(far)), far.shape)
    if far[row, axis] > FARTHEST:
        raise InputError(
            f"{name}: ref_{'xy'[axis]} is {log.reference[row, axis]:g} m in row {row + 1}, and a diagnosis takes "
            f"positions within {FARTHEST:g} m of the origin; mend it, or subtract the place where the robot started"
        )


def dead_channels(robot: RobotDescription, logs: Sequence[Log]) -> frozenset[int]:
    """Return the channels, wheels before pivots, that never change in any log though others do."""
    counts = [np.concatenate([log.wheel, log.pivot], axis=1) for log in logs]
    still = np.all([np.ptp(part, axis=0) == 0 for part in counts], axis=0)
    return frozenset(np.flatnonzero(still).tolist()) if not still.all() else frozenset()


def time_mistakes(robot: RobotDescription, named_log: Named) -> Iterator[Mistake]:
    """Yield times in another unit than seconds, or that no single drive of this robot can have."""
    period = float(np.median(np.diff(named_log.log.t)))
    for unit, size in UNITS.items():
        if 0.2 < period / size / robot.sample_period < 5:
            yield Mistake(
                f"{named_log.name}: t is in {unit}, not in s: samples are {period:g} apart, and the robot file says "
                f"{robot.sample_period:g} s; divide t by {size:g}"
            )
            return
    if not 1 / FAR_OFF < period / robot.sample_period < FAR_OFF:
        yield Mistake(
            f"{named_log.name}: samples are {period:g} s apart, and the robot file says {robot.sample_period:g} s; "
            "correct t, or sample_period"
        )
        return
    longest = int(np.argmax(np.diff(named_log.log.t)))
    if (gap := float(np.diff(named_log.log.t)[longest])) > LONGEST_GAP:
        yield Mistake(
            f"{named_log.name}: nothing for {gap:g} s after row {longest + 1} (t {named_log.log.t[longest]:.6g} s); "
            "correct t, or split the log there"
        )


def not_finite(robot: RobotDescription, named_log: Named) -> Iterator[Mistake]:
    """Yield the first number of each column that is not finite."""
    columns = LogColumns.of(robot)
    parts = (
        (("t",), named_log.log.t[:, None]),
        (columns.wheel, named_log.log.wheel),
        (columns.pivot, named_log.log.pivot),
    )
    for names, values in parts:
        for j, name in enumerate(names):
            for k in np.flatnonzero(~np.isfinite(values[:, j]))[:1]:
                yield Mistake(
                    f"{named_log.name}: column {name!r}, row {k + 1}: {values[k, j]} is not finite; give a number"
                )


def wrapped_counts(robot: RobotDescription, named_log: Named) -> Iterator[Mistake]:
    """Yield wheels whose counter wraps at a power of two: steps that exceed the wheel's speed by the range of the
    counter."""
    for name, steps, limit in _wheels(robot, named_log.log):
        for bits in WORDS:
            size = 2.0**bits
            off = np.flatnonzero((np.abs(np.abs(steps) - size) <= limit) & (2 * limit < size))
            if off.size and np.ptp(_column(robot, named_log.log, name)) < size:
                k = off[0]
                yield Mistake(
                    f"{named_log.name}: {name} wraps at {size:.0f} ({bits} bits), {off.size} times, first in row "
                    f"{k + 2} (t {named_log.log.t[k + 1]:g} s), where it steps by {steps[k]:.0f}: unwrap it, counts "
                    "must go on"
                )
                break


def remarks(robot: RobotDescription, named_log: Named) -> Iterator[str]:
    """Yield the remarks on one log."""
    log, name = named_log.log, named_log.name
    steps = np.diff(log.t)
    period = float(np.median(steps))
    if log.t[-1] - log.t[0] < SHORT:
        yield f"{name}: only {log.t[-1] - log.t[0]:.3g} s long ({len(log)} rows): little is observable"
    if abs(period / robot.sample_period - 1) > PERIOD:
        yield f"{name}: samples are {period:.4g} s apart, the robot file says {robot.sample_period:.4g} s"
    gaps = np.flatnonzero(steps > GAP * period)
    if gaps.size:
        places = [f"{steps[k]:.3g} s after row {k + 1} (t {log.t[k]:.6g} s)" for k in gaps]
        yield f"{name}: {_times(gaps.size, 'gap')} between samples: {_places(places)}"
    yield from _still(robot, named_log)
    yield from _fast(robot, named_log)
    fractional = [
        column
        for column, values in zip(_names(robot), np.concatenate([log.wheel, log.pivot], axis=1).T, strict=True)
        if np.any(values != np.round(values))
    ]
    if fractional:
        yield f"{name}: {', '.join(fractional)}: not whole numbers, and so no counts as encoders give them"
    yield from _reference(named_log)


def _reference(named_log: Named) -> Iterator[str]:
    log, name = named_log.log, named_log.name
    taken = np.empty(0, dtype=np.intp)
    if log.reference is not None:
        taken = np.flatnonzero(np.isfinite(log.reference).all(axis=1))
    if taken.size < 2:
        yield f"{name}: no reference poses: encoders can only contradict each other, and scale is not observable"
        return
    between = np.diff(log.t[taken])
    usual = float(np.median(between))
    missing = np.flatnonzero(between > GAP * usual)
    if missing.size:
        places = [f"{between[k]:.3g} s after row {taken[k] + 1} (t {log.t[taken[k]]:.6g} s)" for k in missing]
        yield f"{name}: the reference drops out {_often(missing.size)}: {_places(places)}"
    late = log.t[taken[0]] - log.t[0], log.t[-1] - log.t[taken[-1]]
    for part, edge in (("first", late[0]), ("last", late[1])):
        if edge > max(GAP * usual, 1.0):
            yield f"{name}: no reference poses in the {part} {edge:.3g} s"


def _still(robot: RobotDescription, named_log: Named) -> Iterator[str]:
    counts = np.concatenate([named_log.log.wheel, named_log.log.pivot], axis=1)
    names = _names(robot)
    still = [column for column, values in zip(names, counts.T, strict=True) if np.ptp(values) == 0]
    if len(still) == len(names):
        yield f"{named_log.name}: nothing moves"
    elif still:
        yield f"{named_log.name}: {', '.join(still)} never change{'s' if len(still) == 1 else ''}"


def _fast(robot: RobotDescription, named_log: Named) -> Iterator[str]:
    for column, steps, limit in _wheels(robot, named_log.log):
        over = np.flatnonzero(np.abs(steps) > FAST * limit + 2)
        if over.size > OFTEN * len(steps):
            ratio = float(np.max(np.abs(steps) / limit))
            yield (
                f"{named_log.name}: {column} turns at up to {ratio:.3g} times max_wheel_speed: "
                "that, counts_per_rev or the unit is wrong"
            )
        elif over.size:
            places = [f"by {steps[k]:.0f} counts in row {k + 2} (t {named_log.log.t[k + 1]:.6g} s)" for k in over]
            yield f"{named_log.name}: {column} jumps {_often(over.size)}, faster than the robot can: {_places(places)}"


def _wheels(robot: RobotDescription, log: Log) -> Iterator[tuple[str, Array, Array]]:
    """Yield each wheel's column, its steps (N - 1,), and the steps that max_wheel_speed allows (N - 1,), counts."""
    for j, (column, k) in enumerate(zip(LogColumns.of(robot).wheel, robot.driven_wheels, strict=True)):
        speed = robot.max_wheel_speed * (robot.wheels[k].counts_per_rev or np.nan) / (2 * np.pi)
        yield column, np.diff(log.wheel[:, j]), speed * np.diff(log.t)


def _column(robot: RobotDescription, log: Log, name: str) -> Array:
    return log.wheel[:, LogColumns.of(robot).wheel.index(name)]


def _names(robot: RobotDescription) -> tuple[str, ...]:
    columns = LogColumns.of(robot)
    return (*columns.wheel, *columns.pivot)


def _places(places: list[str]) -> str:
    return "; ".join(places[:MOST_PLACES]) + ("; ..." if len(places) > MOST_PLACES else "")


def _times(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


def _often(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
