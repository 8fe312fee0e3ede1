"""Times in a CSV file: which column holds them, in which unit, and when each row was taken.

Times are numbers; dates (`csv_cells.date`); times of day, which go on past midnight; or the sum of two columns: of
whole seconds and of nanoseconds as of ROS, ``stamp.sec + stamp.nanosec``, or of a date and of a time of day,
``date + time``.
"""

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from castor_envs.errors import InputError, did_you_mean
from castor_envs.geometry.arrays import Array
from castor_envs.logs.recordings.csv_cells import is_day, is_number, moment, time_of_day, value_of
from castor_envs.logs.recordings.recording import Clock, TimeUnit, nanoseconds
from castor_envs.logs.table import Line, number

PLUS = " + "
"""Between the names of two columns whose sum is the clock."""

DAY = 86_400 * 10**9
"""ns."""

IN_ORDER = 9
"""Steps ahead for each step back, from which a column called like a time may be the clock: not a time of a loop."""

_NAMED = re.compile(
    r"(?:(?:.*[\s_./%#-])?(?:t|ts|time|times|timestamps?|stamp|tstamp|secs?|seconds|millis|micros|nanos|epoch|elapsed|"
    r"uptime)(?:[\s_\[(/-].*)?|(?:[num]s(?:ecs?)?|(?:milli|micro|nano)se(?:c|cond)s))",
    re.IGNORECASE,
)
_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])")
"""Where a word begins in a name such as ``elapsedTime``."""

_SECONDS = re.compile(r"(.*[\s_./])?secs?", re.IGNORECASE)
_NANOSECONDS = re.compile(r"(.*[\s_./])?n(?:ano)?secs?", re.IGNORECASE)
_WITH_UNIT = re.compile(r"[\[(](s|secs?|ms|us|µs|ns)[\])]", re.IGNORECASE)

_UNIT_SAID: dict[TimeUnit, str] = {
    "ns": r"(^|[\s_\[(/-])(ns|nsecs?|nanos|nanosecs?|nanoseconds)\b",
    "us": r"(^|[\s_\[(/-])(us|µs|usecs?|micros|microsecs?|microseconds)\b",
    "ms": r"(^|[\s_\[(/-])(ms|msecs?|millis|millisecs?|milliseconds)\b",
    "s": r"([\s_\[(/-]s|(^|[\s_\[(/-])(secs?|seconds))\b",
}


def clock_of(names: Sequence[str], rows: Sequence[Sequence[str]]) -> Clock:
    """Return the clock of a table with columns of these names, whose first rows these are.

    It is the first column that is called like a time and goes ahead, or holds dates or times of day; of none, the only
    one that always increases, or of several the only one with a unit of time in its name; or else one row a second. Of
    seconds beside nanoseconds it is both, and of times of day beside dates.
    """
    columns = [[cell for cell in cells if moment(cell) is not None] for cells in zip(*rows, strict=True)]
    known = [k for k, cells in enumerate(columns) if cells]
    called = [k for k in known if _NAMED.fullmatch(_HUMP.sub("_", names[k])) and not is_day(columns[k][0])]
    written = [k for k in known if not is_number(columns[k][0]) and not is_day(columns[k][0])]
    at = next((k for k in called if _goes_ahead(columns[k])), None)
    at = next(iter((*written, *called)), None) if at is None else at
    if at is None:
        rising = [k for k, cells in enumerate(zip(*rows, strict=True)) if _rises(cells)]
        if len(rising) > 1:
            rising = [k for k in rising if _WITH_UNIT.search(names[k])]
        if len(rising) != 1:
            return Clock(period=1.0)
        (at,) = rising
    days = next((k for k in known if is_day(columns[k][0])), None)
    if days is not None and time_of_day(columns[at][0]) is not None:
        return Clock(names[days] + PLUS + names[at])
    if seconds := _SECONDS.fullmatch(names[at]):
        for rest in filter(None, map(_NANOSECONDS.fullmatch, names)):
            if rest[1] == seconds[1]:
                return Clock(names[at] + PLUS + rest[0])
    return Clock(names[at], _unit(names[at], np.array([float(cell) for cell in columns[at] if is_number(cell)])))


class RowTimes:
    """When the rows of a table were taken by a clock, row after row; raises InputError for a clock it has not."""

    def __init__(self, path: Path, names: Sequence[str], clock: Clock) -> None:
        if clock.time is None and clock.period is None:
            raise InputError(f'{path}: no column is known to be the time; give it as "time", or a "period"')
        self.columns = [] if clock.time is None else [clock.time] if clock.time in names else clock.time.split(PLUS, 1)
        for name in self.columns:
            if name not in names:
                raise InputError(f"{path}: has no column {name!r}{did_you_mean(name, names)}")
        self._path, self._period = path, clock.period or 0.0
        self._parts: list[tuple[str, int, TimeUnit]] = [
            (name, names.index(name), "ns" if k else clock.unit) for k, name in enumerate(self.columns)
        ]
        self._last = 0

    def of(self, row: int, line: Line) -> int:
        """Return the time, ns, of the next line, the row's number from 0; raises InputError where it is none."""
        if not self._parts:
            return round(row * self._period * 1e9)
        time = sum(self._part(line, *part) for part in self._parts)
        if len(self._parts) == 1 and time_of_day(line.cells[self._parts[0][1]]) is not None:
            time += DAY * max(round((self._last - time) / DAY), 0)  # as many days as come nearest to the row before
        self._last = time
        return time

    def _part(self, line: Line, name: str, at: int, unit: TimeUnit) -> int:
        cell = line.cells[at]
        if not is_number(cell) and (read := moment(cell)) is not None:
            return round(read)
        return nanoseconds(number(self._path, line.number, name, cell), unit, f"{self._path}:{line.number}")


def _goes_ahead(cells: Sequence[str]) -> bool:
    """Return whether times go ahead nearly always; or there is one alone."""
    steps = np.diff([moment(cell) or 0.0 for cell in cells])
    return not len(steps) or bool(np.sum(steps > 0) > IN_ORDER * np.sum(steps < 0))


def _rises(cells: Sequence[str]) -> bool:
    """Return whether each of these cells is a number larger than the one before."""
    values = [value_of(cell) for cell in cells]
    known = np.array([math.nan if value is None else value for value in values])
    return len(known) > 2 and bool(np.all(np.diff(known) > 0))


def _unit(name: str, times: Array) -> TimeUnit:
    """Return the unit of time that a column's name says; of no word, that which makes 1 us to 10 s of its steps."""
    for unit, pattern in _UNIT_SAID.items():
        if re.search(pattern, _HUMP.sub("_", name), re.IGNORECASE):
            return unit
    steps = np.diff(times[np.isfinite(times)])
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else math.nan
    return "ns" if step >= 1e6 else "us" if step >= 1e3 else "ms" if step >= 2 else "s"
