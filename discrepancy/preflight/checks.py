"""Checks of single channels, times and reference poses, without any model of motion."""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.columns import LogColumns
from castor_envs.logs.log import Log, poses_taken, positions_taken
from castor_envs.logs.pace import wrong_times
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.validation.sufficient import SHORT
from estimators.likelihood.channels import Channels
from estimators.likelihood.rolling import GAP

PERIOD = 0.2
"""Largest relative difference of the sample period from the robot's without a remark."""

FAST, OFTEN = 3.0, 0.05
"""Multiple of max_wheel_speed that no wheel reaches; the part of steps above it from which on the fault is systematic,
not in single steps."""

SLOW = 0.05
"""Part of max_wheel_speed below which no drive stays throughout."""

REPEATED = 5
"""Poses that are the same as the one before, in succession, which no tracker measures of a robot that moves."""

STOPPED = 20
"""Rows that an encoder may stand still at a log's end without being asked why."""

MOST_PLACES = 3
"""Most places that are named of each kind."""


def dead_columns(logs: Sequence[Log]) -> frozenset[int]:
    """Return the encoders, pivots before wheels, that never change in any log though others do."""
    still = np.all([np.ptp(_counts(log), axis=0) == 0 for log in logs], axis=0)
    return frozenset(np.flatnonzero(still).tolist()) if not still.all() else frozenset()


def stops(log: Log) -> dict[int, int]:
    """Return the encoders, pivots before wheels, that stand still at the log's end longer than they ever do before,
    while others go on, each with the row from which on it does."""
    counts = _counts(log)
    moving = np.diff(counts, axis=0) != 0
    found = {}
    for column in np.flatnonzero(moving.any(axis=0)).tolist():
        rows = np.flatnonzero(moving[:, column])
        still = len(moving) - 1 - rows[-1]
        if still > max(np.diff(rows, prepend=-1).max(), STOPPED) and moving[-still:].any():
            found[column] = int(rows[-1]) + 1
    return found


def mistakes_in(robot: RobotDescription, log: Log) -> Iterator[str]:
    """Yield the first number of each column that is not finite; if all are, times that no drive can have, and wheels
    whose counter wraps at a power of two: that step by its range, less what they can turn."""
    columns = np.column_stack([log.t, _counts(log)])
    if not np.isfinite(columns).all():
        for name, values in zip(("t", *Channels(robot).names), columns.T, strict=True):
            for k in np.flatnonzero(~np.isfinite(values))[:1]:
                yield f"column {name!r}, row {k + 1}: {values[k]} is not finite; give a number"
        return
    yield from wrong_times(log.t, robot.sample_period)
    for name, counts, counted, limit in wheel_steps(robot, log):
        bits = int(np.ptp(counts)).bit_length()  # of the smallest counter that holds all counts
        off = np.flatnonzero((2**bits - np.abs(counted) <= limit) & (2 * limit < 2**bits))
        if off.size and bits >= np.iinfo(np.int8).bits:
            yield (
                f"{name} wraps at {2**bits} ({bits} bits), {off.size} times, first in row {off[0] + 2} "
                f"(t {log.t[off[0] + 1]:g} s), where it steps by {counted[off[0]]:.0f}: unwrap it, counts must go on"
            )


def remarks(robot: RobotDescription, log: Log) -> Iterator[str]:
    """Yield the remarks on one log."""
    names, counts, period = Channels(robot).names, _counts(log), float(np.median(np.diff(log.t)))
    if log.t[-1] - log.t[0] < SHORT:
        yield f"only {log.t[-1] - log.t[0]:.3g} s long ({len(log)} rows): little is observable"
    if abs(period / robot.sample_period - 1) > PERIOD:
        yield f"samples are {period:.4g} s apart, the robot file says {robot.sample_period:.4g} s"
    if gaps := _gaps(log.t, np.arange(len(log))):
        yield f"{len(gaps)} gap{'s' * (len(gaps) > 1)} between samples: {listed(gaps)}"
    still = [names[k] for k in np.flatnonzero(np.ptp(counts, axis=0) == 0)]
    if len(still) == len(names):
        yield "nothing moves"
    elif still:
        yield f"{', '.join(still)} never change{'s' * (len(still) == 1)}"
    yield from _fast(robot, log)
    if angles := _like_angles(robot, log):
        yield f"{', '.join(angles)}: not whole numbers, and as small as angles in rad; give counts"
    yield from _reference(log)


def _like_angles(robot: RobotDescription, log: Log) -> list[str]:
    """Return the encoders that seem to give rad.

    That counts are not whole says nothing: imported angles and lengths are not, nor are pivots that wrap at such a
    number of counts a turn.
    """
    pivots = zip(LogColumns.of(robot).pivot, robot.pivot_encoders, log.pivot.T, strict=True)
    turns = ((name, counts, robot.castors[castor].pivot_counts_per_rev or np.nan) for name, castor, counts in pivots)
    found = [
        name
        for name, counts, turn in turns
        if not _whole(counts) and np.ptp(counts) > 0 and np.max(np.abs(counts)) <= 2 * np.pi < SLOW * turn
    ]
    for name, counts, steps, limit in wheel_steps(robot, log):
        in_rad = float(np.median(robot.max_wheel_speed * np.diff(log.t) / limit))  # as a part of the same in counts
        if not _whole(counts) and 0 < np.max(np.abs(steps) / limit) <= min(in_rad, SLOW):
            found.append(name)
    return found


def _whole(counts: Array) -> bool:
    return bool(np.all(counts == np.round(counts)))


def _fast(robot: RobotDescription, log: Log) -> Iterator[str]:
    for column, _, steps, limit in wheel_steps(robot, log):
        over = np.flatnonzero(np.abs(steps) > FAST * limit + 2)
        if over.size > OFTEN * len(steps):
            fast = f"{column} turns at up to {np.max(np.abs(steps) / limit):.3g} times max_wheel_speed"
            yield f"{fast}: that, counts_per_rev or the unit is wrong"
        elif over.size:
            places = [f"by {steps[k]:.0f} counts in row {k + 2} (t {log.t[k + 1]:.6g} s)" for k in over]
            yield f"{column} jumps {_often(over.size)}, faster than the robot can: {listed(places)}"


def _reference(log: Log) -> Iterator[str]:
    taken = positions_taken(log)
    if blank := taken.size - poses_taken(log).size:
        of = "has no headings" if blank == taken.size else f"has no heading in {blank} of {taken.size} rows"
        yield f"the reference {of}: odometry is turned as its positions show, and compared with these alone"
    if taken.size < 2:
        yield "no reference poses: encoders can only contradict each other, and scale is not observable"
        return
    if gaps := _gaps(log.t, taken):
        yield f"the reference drops out {_often(len(gaps))}: {listed(gaps)}"
    longest = GAP * float(np.median(np.diff(log.t[taken])))
    for part, edge in (("first", log.t[taken[0]] - log.t[0]), ("last", log.t[-1] - log.t[taken[-1]])):
        if edge > max(longest, 1.0):
            yield f"no reference poses in the {part} {edge:.3g} s"
    yield from _repeated(log, taken)


def _repeated(log: Log, taken: NDArray[np.intp]) -> Iterator[str]:
    """Yield where the reference repeats a pose while wheels turn; taken: the rows with a pose."""
    assert log.reference is not None
    poses = np.nan_to_num(log.reference[taken])
    moved, turning = ((np.diff(of, axis=0) != 0).any(axis=1) for of in (poses, _counts(log)[taken]))
    again = ~moved & turning
    repeated = np.count_nonzero(again)
    if repeated < REPEATED:  # a robot may be back where it was
        return
    if 2 * repeated >= len(again):
        each = len(again) / max(len(again) - repeated, 1)
        yield f"the reference stands in {each:.2g} rows or so with each pose while wheels turn: give it once"
        return
    edges = np.flatnonzero(np.diff(again, prepend=False, append=False))
    held = [(first, last) for first, last in edges.reshape(-1, 2).tolist() if last - first >= REPEATED]
    if held:
        places = [
            f"for {log.t[taken[last]] - log.t[taken[first]]:.3g} s after row {taken[first] + 1} "
            f"(t {log.t[taken[first]]:.6g} s)"
            for first, last in held
        ]
        yield f"the reference repeats a pose while wheels turn {_often(len(held))}: {listed(places)}; leave these out"


def _gaps(t: Array, rows: NDArray[np.intp]) -> list[str]:
    """Return where the times between these rows are unusually long."""
    between = np.diff(t[rows])
    far = np.flatnonzero(between > GAP * np.median(between))
    return [f"{between[k]:.3g} s after row {rows[k] + 1} (t {t[rows[k]]:.6g} s)" for k in far]


def wheel_steps(robot: RobotDescription, log: Log) -> Iterator[tuple[str, Array, Array, Array]]:
    """Yield each wheel's column, its counts (N,), their steps (N - 1,), and those that max_wheel_speed allows."""
    for name, k, counts in zip(LogColumns.of(robot).wheel, robot.driven_wheels, log.wheel.T, strict=True):
        speed = robot.max_wheel_speed * (robot.wheels[k].counts_per_rev or np.nan) / (2 * np.pi)
        yield name, counts, np.diff(counts), speed * np.diff(log.t)


def _counts(log: Log) -> Array:
    return np.column_stack([log.pivot, log.wheel])


def listed(found: Sequence[str]) -> str:
    """Return the first places of all found as text."""
    remainder = f"; and {len(found) - MOST_PLACES} more" if len(found) > MOST_PLACES else ""
    return "; ".join(found[:MOST_PLACES]) + remainder


def _often(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
