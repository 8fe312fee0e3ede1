"""Where a log and the robot file contradict each other: encoders that stand, turn too fast or jump, rows at another
rate."""

import math
from collections.abc import Iterator

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.columns import LogColumns
from castor_envs.logs.log import Log
from castor_envs.logs.mapping.channel_map import ChannelMap, Column
from castor_envs.logs.mapping.units import counts_in, kind_of
from castor_envs.vehicles.robot import RobotDescription

TOO_FAST = 3.0
"""How much faster than the robot file's limit a wheel may be before its unit is in doubt: limits are rough."""

USUAL = 95
"""Percentile of the sizes of steps: few of them are a counter's faults."""

FEW = 3.0
"""Counts that are no jump, however short the time between rows."""

TURN = {"rev": 1.0, "deg": 360.0, "rad": 2 * math.pi}
LEAST_BITS = 8
"""Of a counter: those of drives and of microcontrollers have 8, 12, 16, 32 bits."""


def limit_notes(robot: RobotDescription, by: ChannelMap, log: Log) -> Iterator[str]:
    """Yield where log and robot file differ: wheels beyond its limit, rows at another rate, a gyro that it lacks."""
    if log.fix is not None and robot.fixes is None:
        yield 'fix_x: the robot file has no "fixes", so that estimators do not use them; add them, with their noise'
    if log.gyro is not None and robot.gyro is None:
        yield 'gyro_z: the robot file has no "gyro", so that estimators do not use it; add one, with its "noise"'
    yield from _still_notes(LogColumns.of(robot), by, log)
    steps = np.diff(log.t)
    period = float(np.median(steps))
    paces = np.maximum(steps, period)  # messages that were held up come all at once
    for key, k, counts in zip(LogColumns.of(robot).wheel, robot.driven_wheels, log.wheel.T, strict=True):
        wheel = robot.wheels[k]
        turn = wheel.counts_per_rev or 1.0
        usual = float(np.percentile(np.abs(np.diff(counts)) / paces, USUAL))
        fast = usual * 2 * np.pi / turn
        if fast > TOO_FAST * robot.max_wheel_speed:
            yield (
                f"{key}: turns at {fast:.3g} rad/s, the robot's limit is {robot.max_wheel_speed:g}: is its unit right, "
                "and its counts_per_rev?"
            )
        most = TOO_FAST * max(usual, robot.max_wheel_speed * turn / (2 * np.pi))
        column = by.columns[key]
        unit = counts_in(column.unit, turn, wheel.radius) * column.scale
        yield from _jump_notes(key, column, log.t, counts / unit, np.maximum(most * paces, FEW) / unit)
    if abs(period / robot.sample_period - 1) > 0.1:
        yield f"rows come every {period:.4g} s, the robot file's sample_period is {robot.sample_period:g} s: mend that"


def _still_notes(columns: LogColumns, by: ChannelMap, log: Log) -> Iterator[str]:
    """Yield which encoders never moved, and a gyro that shows 0 alone."""
    still = [*zip(columns.wheel, log.wheel.T, strict=True), *zip(columns.pivot, log.pivot.T, strict=True)]
    if log.gyro is not None and not np.any(log.gyro):
        still.append((columns.gyro[0], log.gyro))
    for key, values in still:
        if np.ptp(values) == 0:
            yield f"{key}: {by.columns[key].channel!r} never changes: is it the right channel?"


def _jump_notes(key: str, column: Column, t: Array, value: Array, most: Array) -> Iterator[str]:
    """Yield one note on steps of an encoder (K,) at times t (K,), s, that no wheel makes.

    most (K - 1,): the largest step that is none, as `value` in the channel's unit.
    """
    steps = np.diff(value)
    jumps = np.flatnonzero(np.abs(steps) > most)
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
        yield f'{said}: does it wrap at {period:.6g}? add "wraps_at": {period:.6g} to the map'


def _period(jump: float, around: float, column: Column) -> float | None:
    """Return where a counter wraps that jumps so far: at a power of two, an angle at a whole turn; None if neither.

    around: by how much the wheel's own motion may make the jump smaller.
    """
    if kind_of(column.unit) != "position" or jump <= 0:
        return None
    bits = max(LEAST_BITS, round(math.log2(jump)))
    period = TURN.get(column.unit, 2.0**bits)
    return period if abs(jump - period) <= min(around, period / 4) else None
