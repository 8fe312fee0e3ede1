"""CSV files with any columns: a channel is a column, by the name in the header.

The header is the line before the first row of numbers, or the one before that where it holds units, which names then
end with: ``left [deg]``. Lines above it are left alone, and so is what begins with ``#``. A name that stands twice gets
its place (``X``, ``X #2``), a column without a name too (``#3``). Cells are separated by commas, semicolons, tabs,
bars or blanks, whichever makes most of them numbers. Numbers may have a decimal comma, between commas in quotes. A
blank cell, or ``NA``, ``NULL`` or ``-``, is no reading, so one file may hold several rates. Times are numbers, dates
as ISO 8601 writes them (UTC where they name no zone), or whole seconds and nanoseconds in two columns, as of ROS:
``stamp.sec + stamp.nanosec``.
"""

import itertools
import math
import re
from collections.abc import Generator, Iterator, Mapping
from pathlib import Path

import numpy as np

from castor_envs.errors import InputError, did_you_mean
from castor_envs.geometry.arrays import Array
from castor_envs.logs.recordings.csv_cells import cells_of, date, is_blank, is_number, value_of
from castor_envs.logs.recordings.csv_layout import head_of, layout_of
from castor_envs.logs.recordings.recording import Clock, Reading, RecordingFormat, TimeUnit, nanoseconds
from castor_envs.logs.recordings.text_lines import first_row, is_comment, numbered_lines
from castor_envs.logs.table import Line, complaint, number

_TIME = re.compile(
    r"(?:.*[\s_./%])?(?:t|time|times|timestamp|stamp|secs?|seconds|millis|micros|nanos|epoch|elapsed|uptime)(?:[\s_\[(].*)?",
    re.IGNORECASE,
)
_SECONDS = re.compile(r"(.*[\s_./])?secs?", re.IGNORECASE)
_NANOSECONDS = re.compile(r"(.*[\s_./])?n(?:ano)?secs?", re.IGNORECASE)
PLUS = " + "
"""Between the names of the columns of seconds and of nanoseconds that are one clock."""

_NAMED_UNIT = re.compile(r"[\[(](s|secs?|ms|us|µs|ns)[\])]", re.IGNORECASE)

_UNIT_IN_NAME: dict[TimeUnit, str] = {
    "ns": r"(^|[\s_\[(])(ns|nsecs?|nanos|nanosecs?|nanoseconds)\b",
    "us": r"(^|[\s_\[(])(us|µs|usecs?|micros|microseconds)\b",
    "ms": r"(^|[\s_\[(])(ms|msecs?|millis|milliseconds)\b",
    "s": r"[\s_\[(](s|secs?|seconds)\b",
}


def _is_table(path: Path) -> bool:
    if not path.is_file() or path.suffix.lower() not in (".csv", ".tsv", ".txt", ".dat"):
        return False
    if path.suffix.lower() in (".csv", ".tsv"):
        return True
    cells = first_row(path)
    return cells is not None and not all(map(is_number, cells))


class Table:
    """A CSV file; each pass over it opens it anew and reads line by line."""

    kind, held = "CSV file", False

    def __init__(self, path: Path) -> None:
        self._path = path
        self.notes: list[str] = []
        self.left_out: dict[str, str] = {}
        head = head_of(numbered_lines(path, self.notes))
        if not head:
            raise complaint(path, None, None, "is empty; a CSV file was expected")
        self._delimiter, self._decimal_comma, self._names, self._header = layout_of(path, head)

    def clock(self) -> Clock:
        """Return the first column that is called like a time, or holds dates, and its unit; of none, the only one that
        always increases, or of several the only one with a unit of time in its name; or else one row a second.

        Of seconds beside nanoseconds, both.
        """
        rows = [line.cells for line in itertools.islice(self._lines(), 1000)]
        named = next((k for k, name in enumerate(self._names) if _TIME.fullmatch(name)), None)
        dated = (k for k in range(len(self._names)) if any(date(cells[k]) is not None for cells in rows))
        at = next(dated, None) if named is None else named
        if at is None:
            rising = [k for k in range(len(self._names)) if _rises([cells[k] for cells in rows])]
            if len(rising) > 1:
                rising = [k for k in rising if _NAMED_UNIT.search(self._names[k])]
            if len(rising) != 1:
                return Clock(period=1.0)
            (at,) = rising
        column = self._names[at]
        if seconds := _SECONDS.fullmatch(column):
            for rest in filter(None, map(_NANOSECONDS.fullmatch, self._names)):
                if rest[1] == seconds[1]:
                    return Clock(column + PLUS + rest[0])
        return Clock(column, _unit(column, np.array([float(cells[at]) for cells in rows if is_number(cells[at])])))

    def readings(self, channels: frozenset[str] | None, clock: Clock) -> Generator[Reading]:
        """Yield readings, see `Recording`."""
        if clock.time is None and clock.period is None:
            raise InputError(f'{self._path}: no column is known to be the time; give it as "time", or a "period"')
        by = [] if clock.time is None else [clock.time] if clock.time in self._names else clock.time.split(PLUS, 1)
        for name in by:
            if name not in self._names:
                raise InputError(f"{self._path}: has no column {name!r}{did_you_mean(name, self._names)}")
        parts: list[tuple[int, TimeUnit]] = [
            (self._names.index(n), "ns" if k else clock.unit) for k, n in enumerate(by)
        ]
        taken = [(k, n) for k, n in enumerate(self._names) if n not in by and (channels is None or n in channels)]
        seen: set[str] = set()
        odd: dict[str, str] = {}
        for row, line in enumerate(self._lines()):
            time = sum(self._time(line, k, unit) for k, unit in parts)
            if not parts:
                time = round(row * (clock.period or 0.0) * 1e9)
            for k, name in taken:
                cell = line.cells[k]
                if not cell:
                    continue
                if (value := value_of(cell)) is not None:
                    seen.add(name)
                    yield Reading(name, time, value)
                elif is_blank(cell):
                    continue
                elif channels is not None:
                    raise complaint(self._path, line.number, name, f"{cell!r} is not a number; mend or blank it")
                elif name not in odd:
                    odd[name] = f"{cell!r} in line {line.number}"
        if channels is None:
            self.left_out = dict(self._left_out({*seen, *by}, odd))

    def _left_out(self, seen: set[str], odd: Mapping[str, str]) -> Iterator[tuple[str, str]]:
        """Yield which columns are left out, and why.

        seen: those with numbers, and the clock. odd: of those with other text its first cell and line.
        """
        for k, name in enumerate(self._names, start=1):
            if name in odd and name in seen:
                yield name, f"in part, from {odd[name]} on: an import refuses what is no number; mend or blank it"
            elif name in odd:
                yield name, "text"
            elif name not in seen and name != f"#{k}":
                yield name, "blank in all rows"

    def _time(self, line: Line, at: int, unit: TimeUnit) -> int:
        """Return the time, ns, in a cell of a line."""
        cell = line.cells[at]
        if not is_number(cell) and (read := date(cell)) is not None:
            return read
        return nanoseconds(number(self._path, line.number, self._names[at], cell), unit, f"{self._path}:{line.number}")

    def _lines(self) -> Iterator[Line]:
        for k, text in numbered_lines(self._path, self.notes):
            if k <= self._header or not text.strip() or is_comment(text):
                continue
            cells = cells_of(self._path, k, text, self._delimiter, self._decimal_comma)
            if len(cells) == len(self._names) + 1 and not cells[-1]:  # a delimiter at the end
                cells.pop()
            if len(cells) != len(self._names):
                problem = f"has {len(cells)} cells, the header {len(self._names)}; mend or remove the line"
                raise complaint(self._path, k, None, problem)
            yield Line(k, cells)


def _rises(cells: list[str]) -> bool:
    """Return whether each of these cells is a number larger than the one before."""
    values = [value_of(cell) for cell in cells]
    known = np.array([math.nan if value is None else value for value in values])
    return len(known) > 2 and bool(np.all(np.diff(known) > 0))


def _unit(name: str, times: Array) -> TimeUnit:
    """Return the unit of time that a column's name says; of no word, that which makes 1 us to 10 s of its steps."""
    for unit, pattern in _UNIT_IN_NAME.items():
        if re.search(pattern, name, re.IGNORECASE):
            return unit
    steps = np.diff(times[np.isfinite(times)])
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else math.nan
    return "ns" if step >= 1e6 else "us" if step >= 1e3 else "ms" if step >= 2 else "s"


FORMAT = RecordingFormat("CSV file (.csv, .tsv, .txt)", _is_table, Table)
