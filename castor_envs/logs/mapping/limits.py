"""Where a log contradicts the robot file or the map: encoders that stand, turn too fast or jump, rows at another rate,
speeds in a unit that is none of a speed."""

import math
from collections.abc import Iterator

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.columns import LogColumns
from castor_envs.logs.log import Log
from castor_envs.logs.mapping.channel_map import ChannelMap, Column
from castor_envs.logs.mapping.guess import is_estimate
from castor_envs.logs.mapping.places import words_of
from castor_envs.logs.mapping.said_units import says_speed
from castor_envs.logs.mapping.units import TURN, counts_in, kind_of
from castor_envs.logs.pace import unit_meant
from castor_envs.logs.recordings.csv_clock import unit_said
from castor_envs.logs.recordings.ros import CLOCKS
from castor_envs.vehicles.robot import Castor, RobotDescription

TOO_FAST = 3.0
"""How much faster than by the robot file's limit a wheel or a castor may be before it is in doubt: limits are rough."""

USUAL = 95
"""Percentile of the sizes of steps: few of them are a counter's faults."""

FEW = 3.0
"""Counts that are no jump, however short the time between rows."""

LEAST_BITS = 8
"""Of a counter: those of drives and of microcontrollers have 8, 12, 16, 32 bits."""


def limit_notes(robot: RobotDescription, by: ChannelMap, log: Log) -> Iterator[str]:
    """Yield where log and robot file differ: wheels beyond its limit, rows at another rate, a gyro or fixes that it
    lacks, encoders that stand, speeds that the map takes for angles, the robot's own pose that it takes for a
    reference, and jumps that no wheel and no castor makes."""
    if log.fix is not None and robot.fixes is None:
        yield 'fix_x: the robot file has no "fixes", so that estimators do not use them; add them, with their noise'
    if log.gyro is not None and robot.gyro is None:
        yield 'gyro_z: the robot file has no "gyro", so that estimators do not use it; add one, with its "noise"'
    columns = LogColumns.of(robot)
    yield from _still_notes(columns, by, log)
    yield from _speed_notes(columns, by)
    yield from _estimate_notes(columns, by)
    steps = np.diff(log.t)
    period = float(np.median(steps))
    paces = np.maximum(steps, period)  # messages that were held up come all at once
    for key, k, counts in zip(columns.wheel, robot.driven_wheels, log.wheel.T, strict=True):
        wheel = robot.wheels[k]
        turn = wheel.counts_per_rev or 1.0
        fast = _usual(counts, paces) * 2 * np.pi / turn
        if fast > TOO_FAST * robot.max_wheel_speed:
            yield (
                f"{key}: turns at {fast:.3g} rad/s, the robot's limit is {robot.max_wheel_speed:g}: is its unit right, "
                "and its counts_per_rev?"
            )
        most = robot.max_wheel_speed * turn / (2 * np.pi)
        unit = counts_in(by.columns[key].unit, turn, wheel.radius)
        yield from _jump_notes(key, by.columns[key], log.t, counts, paces, most, unit)
    for key, i, counts in zip(columns.pivot, robot.pivot_encoders, log.pivot.T, strict=True):
        turn = robot.castors[i].pivot_counts_per_rev or 1.0
        most = _fastest_turn(robot, robot.castors[i]) * turn / (2 * np.pi)
        unit = counts_in(by.columns[key].unit, turn)
        yield from _jump_notes(key, by.columns[key], log.t, counts, paces, most, unit)
    if abs(period / robot.sample_period - 1) > 0.1:
        apart = f"rows come every {period:.4g} s, the robot file's sample_period is {robot.sample_period:g} s"
        yield f"{apart}: {next(_other_units(robot, by, period), 'mend that')}"


def _other_units(robot: RobotDescription, by: ChannelMap, period: float) -> Iterator[str]:
    """Yield in which other unit a column of times makes the rows' period, s, that of the robot file; by message or
    record, times have no unit to be mistaken."""
    columns = LogColumns.of(robot)
    for key in dict.fromkeys(by.columns[name].source for name in (*columns.wheel, *columns.pivot)):
        time, taken = by.places[key].time, by.places[key].clock.unit
        meant = unit_meant(period, robot.sample_period, taken)
        if meant is not None and time not in (None, *CLOCKS):
            said = ", as its name says" if unit_said(time) == meant else ""
            yield f'is the time {time!r} in {meant}{said}, not in {taken}? mend "unit" of the source {key!r}'


def _still_notes(columns: LogColumns, by: ChannelMap, log: Log) -> Iterator[str]:
    """Yield which encoders never moved, and a gyro that shows 0 alone."""
    still = [*zip(columns.wheel, log.wheel.T, strict=True), *zip(columns.pivot, log.pivot.T, strict=True)]
    if log.gyro is not None and not np.any(log.gyro):
        still.append((columns.gyro[0], log.gyro))
    for key, values in still:
        if np.ptp(values) == 0:
            yield f"{key}: {by.columns[key].channel!r} never changes: is it the right channel?"


def _speed_notes(columns: LogColumns, by: ChannelMap) -> Iterator[str]:
    """Yield which channels are speeds by their names, and none by the units that the map gives them."""
    for key in (*columns.wheel, *columns.pivot, *columns.gyro):
        column = by.columns.get(key)
        if column is not None and kind_of(column.unit) == "position" and any(map(says_speed, column.channels)):
            said = f"{key}: {column.channel!r} is a speed by its name, {column.unit!r} is none"
            yield f"{said}: are channel and unit right?"


def _estimate_notes(columns: LogColumns, by: ChannelMap) -> Iterator[str]:
    """Yield that a map takes a pose for the reference that the robot computed itself, by its name."""
    mapped = {key: by.columns[key] for key in columns.reference if key in by.columns}
    found = [key for key, column in mapped.items() if any(is_estimate(words_of(name)) for name in column.channels)]
    if found:
        said = f"{mapped[found[0]].channel!r} is the robot's own pose by its name, which is no reference"
        yield f"{', '.join(found)}: {said}: estimators are compared with it; is there a pose from outside?"


def _usual(counts: Array, paces: Array) -> float:
    """Return how many counts a second an encoder (K,) makes when it is fast; paces (K - 1,): s, between its rows."""
    return float(np.percentile(np.abs(np.diff(counts)) / paces, USUAL))


def _fastest_turn(robot: RobotDescription, castor: Castor) -> float:
    """Return how fast a castor turns at most about its pivot, rad/s: by its motor, or as the robot and its own wheels
    move its axle."""
    if castor.steering == "driven":
        return robot.max_steering_speed
    speed = robot.max_wheel_speed * max(wheel.radius for wheel in robot.wheels)
    return speed / min(arm for arm in (castor.offset, *(abs(wheel.lateral) for wheel in castor.wheels)) if arm)


def _jump_notes(
    key: str, column: Column, t: Array, counts: Array, paces: Array, most: float, per_unit: float
) -> Iterator[str]:
    """Yield one note on steps of an encoder (K,) at times t (K,), s, that no wheel or castor makes.

    paces (K - 1,): s, between rows. most: counts a second at the robot's limit. per_unit: counts in the channel's unit.
    """
    steps = np.diff(counts)
    jumps = np.flatnonzero(np.abs(steps) > np.maximum(TOO_FAST * max(_usual(counts, paces), most) * paces, FEW))
    steps /= per_unit * column.scale
    if not len(jumps):
        return
    first = jumps[0]
    others = f", and {len(jumps) - 1} more" if len(jumps) > 1 else ""
    unit = column.unit.removesuffix("/row") if kind_of(column.unit) != "speed" else f"{column.unit} s"
    said = f"{key}: jumps by {column.sign * steps[first]:.6g} {unit} after {t[first]:.3f} s of the log{others}"
    period = _period(abs(float(steps[first])), 2 * float(np.percentile(np.abs(steps), USUAL)), column)
    if period is None:
        yield f"{said}: was it reset, or a reading wrong? cut the recording there, or blank the reading"
    else:
        wrap = f"{period:.12g}" if column.unit in TURN else f"{period:.0f}"
        yield f'{said}: does it wrap at {wrap}? add "wraps_at": {wrap} to the map'


def _period(jump: float, around: float, column: Column) -> float | None:
    """Return where a counter wraps that jumps so far: at a power of two, an angle at a whole turn; None if neither.

    around: by how much the wheel's own motion may make the jump smaller.
    """
    if kind_of(column.unit) != "position" or jump <= 0:
        return None
    bits = max(LEAST_BITS, round(math.log2(jump)))
    period = TURN.get(column.unit, 2.0**bits)
    return period if abs(jump - period) <= min(around, period / 4) else None
