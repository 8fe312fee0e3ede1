"""Times in a CSV file: which column holds them, in which unit, and when each row was taken.

Times are numbers; dates (`csv_cells.date`); times of day, which go on past midnight, or past the hour where they have
none; or the sum of two columns: of
whole seconds and of nanoseconds as of ROS, ``stamp.sec + stamp.nanosec``, or of a date and of a time of day,
``date + time``.
"""

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from castor_envs.errors import InputError, did_you_mean
from castor_envs.geometry.arrays import Array
from castor_envs.logs.recordings.csv_cells import (
    DAY,
    check_clear,
    clock_turn,
    is_day,
    is_number,
    moment,
    tells_month_first,
    value_of,
)
from castor_envs.logs.recordings.recording import UNITS, Clock, TimeUnit, nanoseconds
from castor_envs.logs.table import Line, number
from castor_envs.logs.unit_words import TIMES

PLUS = " + "
"""Between the names of two columns whose sum is the clock."""

SERIAL_DAYS, LONGEST_STEP = (32_874, 73_051), 1e-4
"""Days since 1899-12-30, as of spreadsheets, of 1990 and 2100; days between rows, 9 s: as seconds they were 10 kHz."""

IN_ORDER = 9
"""Steps ahead for each step back, from which a column called like a time may be the clock: not a time of a loop."""

_NAMED = re.compile(
    r"(?:(?:.*[\s_./%#-])?(?:t|ts|time|times|timestamps?|stamp|tstamp|secs?|seconds|millis|micros|nanos|epoch|elapsed|"
    r"uptime)(?:[\s_\[(/-].*)?|(?:[num]s(?:ecs?)?|(?:milli|micro|nano)se(?:c|cond)s))",
    re.IGNORECASE,
)
_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])")
"""Where a word begins in a name such as ``elapsedTime``."""

_OF_PAIRS = [re.compile(rf"(.*[\s_./])?{part}", re.IGNORECASE) for part in ("secs?", "n(?:ano)?secs?")]
"""Names of whole seconds, and of the nanoseconds beside them."""

_DIGIT = re.compile(r"\d")
_WITH_UNIT = re.compile(rf"[\[(]({'|'.join(sorted(set().union(*TIMES.values())))})[\])]", re.IGNORECASE)
_SEPARATOR = r"[\s_\[(/-]"
_UNIT_SAID: dict[TimeUnit, str] = {
    unit: rf"((^|{_SEPARATOR})({'|'.join(sorted(TIMES[unit] - {'s'}))})|{_SEPARATOR}{unit})\b"
    for unit in UNITS
    if unit in TIMES
}
"""What says a unit of time in a name; a lone ``s`` may be anything."""


def clock_of(names: Sequence[str], rows: Sequence[Sequence[str]]) -> Clock:
    """Return the clock of a table with columns of these names, whose first rows these are.

    It is the sum of whole seconds and of the nanoseconds beside them; or else the first column that is called like a
    time, or holds dates or times of day, and goes ahead; of none, the only one that always increases, or of several the
    only one with a unit of time in its name; then a column called like a time that does not go ahead; or else one row a
    second, and so it is where a column called like a time holds text such as ``12h00m01``. Of times of day beside
    dates it is both.
    """
    for sec, nanosec in _pairs(names):
        if (times := _sums(rows, sec, nanosec)) and _goes_ahead(times):
            return Clock(names[sec] + PLUS + names[nanosec])
    columns = [[cell for cell in cells if moment(cell) is not None] for cells in zip(*rows, strict=True)]
    known = [k for k, cells in enumerate(columns) if cells and not is_day(cells[0])]
    like = [k for k, name in enumerate(names) if _NAMED.fullmatch(_HUMP.sub("_", name))]
    called = [k for k in known if k in like]
    written = [k for k in known if not is_number(columns[k][0])]
    serial = [k for k in known if k not in written and _unit(names[k], _numbers(columns[k])) == "d"]
    at = next((k for k in (*called, *written, *serial) if _goes_ahead(_moments(columns[k]))), None)
    if at is None and any(not columns[k] and any(map(_DIGIT.search, (row[k] for row in rows))) for k in like):
        return Clock(period=1.0)  # the time is there, and what increases is something else
    if at is None:
        at = next(iter((*_rising(names, rows), *written, *called)), None)
    if at is None:
        return Clock(period=1.0)
    days = next((k for k, cells in enumerate(columns) if cells and is_day(cells[0])), None)
    if days is not None and clock_turn(columns[at][0]) == DAY:
        return Clock(names[days] + PLUS + names[at])
    return Clock(names[at], _unit(names[at], _numbers(columns[at])))


def unit_said(name: str) -> TimeUnit | None:
    """Return the unit of time that a column's name says, None where it says none."""
    named = _HUMP.sub("_", name)
    return next((unit for unit, pattern in _UNIT_SAID.items() if re.search(pattern, named, re.IGNORECASE)), None)


class RowTimes:
    """When the rows of a table were taken by a clock, row after row; raises InputError for a clock it has not.

    month_first: of dates with the year last.
    """

    month_first = False

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
        if len(self._parts) == 1 and (turn := clock_turn(line.cells[self._parts[0][1]])) is not None:
            time += turn * max(round((self._last - time) / turn), 0)  # as many as come nearest to the row before
        self._last = time
        return time

    def _part(self, line: Line, name: str, at: int, unit: TimeUnit) -> int:
        cell = line.cells[at]
        if not is_number(cell) and (read := moment(cell, self.month_first)) is not None:
            return round(read)
        check_clear(self._path, line.number, name, cell)
        return nanoseconds(number(self._path, line.number, name, cell), unit, f"{self._path}:{line.number}")


def _pairs(names: Sequence[str]) -> Iterator[tuple[int, int]]:
    """Yield the places of columns of seconds and of nanoseconds whose names begin alike, in whatever order."""
    seconds, nanoseconds = ([(k, pattern.fullmatch(name)) for k, name in enumerate(names)] for pattern in _OF_PAIRS)
    yield from ((k, other) for k, sec in seconds for other, rest in nanoseconds if sec and rest and sec[1] == rest[1])


def _sums(rows: Sequence[Sequence[str]], sec: int, nanosec: int) -> list[float]:
    """Return seconds and nanoseconds together, s, of the rows that have both."""
    parts = ((value_of(row[sec]), value_of(row[nanosec])) for row in rows)
    return [s + ns / 1e9 for s, ns in parts if s is not None and ns is not None]


def _numbers(cells: Sequence[str]) -> Array:
    return np.array([value for cell in cells if (value := value_of(cell)) is not None])


def _moments(cells: Sequence[str]) -> list[float]:
    """Return times as numbers, of dates and of times of day in ns; times of day go on past midnight."""
    month_first = bool(tells_month_first(cells))
    times = np.array([moment(cell, month_first) or 0.0 for cell in cells])
    turns = {clock_turn(cell) for cell in cells}
    if len(turns) == 1 and (turn := turns.pop()) is not None:
        times = np.unwrap(times, period=turn)
    return times.tolist()


def _goes_ahead(times: Sequence[float]) -> bool:
    """Return whether times go ahead nearly always; or there is one alone."""
    steps = np.diff(times)
    return not len(steps) or bool(np.sum(steps > 0) > IN_ORDER * np.sum(steps < 0))


def _rising(names: Sequence[str], rows: Sequence[Sequence[str]]) -> list[int]:
    """Return the only column that always increases, or of several the only one with a unit of time; none elsewhere."""
    rising = [k for k, cells in enumerate(zip(*rows, strict=True)) if _rises(cells)]
    if len(rising) > 1:
        rising = [k for k in rising if _WITH_UNIT.search(names[k])]
    return rising if len(rising) == 1 else []


def _rises(cells: Sequence[str]) -> bool:
    """Return whether each of these cells is a number larger than the one before."""
    values = [value_of(cell) for cell in cells]
    known = np.array([math.nan if value is None else value for value in values])
    return len(known) > 2 and bool(np.all(np.diff(known) > 0))


def _unit(name: str, times: Array) -> TimeUnit:
    """Return the unit of time that a column's name says; of no word, that which makes 1 us to 10 s of its steps, or
    days as spreadsheets count them."""
    if (said := unit_said(name)) is not None:
        return said
    steps = np.diff(times[np.isfinite(times)])
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else math.nan
    if step < LONGEST_STEP and SERIAL_DAYS[0] < times[0] < SERIAL_DAYS[1]:
        return "d"
    return "ns" if step >= 1e6 else "us" if step >= 1e3 else "ms" if step >= 2 else "s"
