"""CSV files with any columns: a channel is a column, by the name in the header.

The header is the line before the first row of numbers; lines above it are left alone. A name that stands twice gets its
place (``X``, ``X #2``), a column without a name too (``#3``). Cells are separated by commas, semicolons or tabs,
whichever gives the most of them, or else by blanks. Between semicolons or tabs a number may have a decimal comma. A
blank cell is no reading, so one file may hold several rates. Times are numbers, dates as ISO 8601 writes them (UTC
where they name no zone), or whole seconds and nanoseconds in two columns, as of ROS: ``stamp.sec + stamp.nanosec``.
"""

import csv
import itertools
import math
import re
from collections.abc import Generator, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TextIO

import numpy as np

from castor_envs.errors import InputError, did_you_mean
from castor_envs.geometry.arrays import Array
from castor_envs.logs.recordings.recording import Clock, Reading, RecordingFormat, TimeUnit, nanoseconds
from castor_envs.logs.table import Line, complaint, number

HEAD = 100
"""Lines in which the first row of numbers must come."""

_TIME = re.compile(
    r"(?:.*[\s_./%])?(?:t|time|times|timestamp|stamp|secs?|seconds|millis|micros|nanos|epoch|elapsed|uptime)(?:[\s_\[(].*)?",
    re.IGNORECASE,
)
_SECONDS = re.compile(r"(.*[\s_./])?secs?", re.IGNORECASE)
_NANOSECONDS = re.compile(r"(.*[\s_./])?n(?:ano)?secs?", re.IGNORECASE)
PLUS = " + "
"""Between the names of the columns of seconds and of nanoseconds that are one clock."""

_NAMED_UNIT = re.compile(r"[\[(](s|secs?|ms|us|µs|ns)[\])]", re.IGNORECASE)

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_UNIT_IN_NAME: dict[TimeUnit, str] = {
    "ns": r"(^|[\s_\[(])(ns|nsecs?|nanos|nanosecs?|nanoseconds)\b",
    "us": r"(^|[\s_\[(])(us|µs|usecs?|micros|microseconds)\b",
    "ms": r"(^|[\s_\[(])(ms|msecs?|millis|milliseconds)\b",
}


def is_number(cell: str) -> bool:
    """Return whether a cell's text is a number; NaN is one."""
    return value_of(cell) is not None


def value_of(cell: str) -> float | None:
    """Return the number in a cell, None of any other text."""
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


def date(cell: str) -> int | None:
    """Return a date as ISO 8601 writes it as ns since 1970, to the microsecond, UTC where it names no zone; or None."""
    if not (cell[:4].isdigit() and cell[4:5] == "-"):
        return None
    try:
        read = datetime.fromisoformat(cell)
    except ValueError:
        return None
    return (read.replace(tzinfo=read.tzinfo or UTC) - _EPOCH) // timedelta(microseconds=1) * 1000


def first_row(path: Path) -> list[str] | None:
    """Return the cells of the first line that is no comment, split at blanks; None for what is no text."""
    try:
        with path.open(encoding="utf-8-sig") as file:
            return next((line.split() for line in file if line.strip() and not line.startswith("#")), None)
    except (OSError, UnicodeDecodeError):
        return None


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
        head = [line for _, line in itertools.islice(self._numbered(), HEAD)]
        if not any(map(str.strip, head)):
            raise complaint(path, None, None, "is empty; a CSV file was expected")
        self._delimiter, self._names, self._header = self._layout(head)

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
        for row, line in enumerate(self._lines()):
            time = sum(self._time(line, k, unit) for k, unit in parts)
            if not parts:
                time = round(row * (clock.period or 0.0) * 1e9)
            for k, name in taken:
                cell = line.cells[k]
                if not cell:
                    continue
                if (value := value_of(cell)) is not None:
                    yield Reading(name, time, value)
                elif channels is not None:
                    raise complaint(self._path, line.number, name, f"{cell!r} is not a number; mend or blank it")

    def _time(self, line: Line, at: int, unit: TimeUnit) -> int:
        """Return the time, ns, in a cell of a line."""
        cell = line.cells[at]
        if not is_number(cell) and (read := date(cell)) is not None:
            return read
        return nanoseconds(number(self._path, line.number, self._names[at], cell), unit, f"{self._path}:{line.number}")

    def _text(self) -> TextIO:
        try:
            return self._path.open(encoding="utf-8-sig", newline="")
        except OSError as error:
            raise complaint(self._path, None, None, f"cannot be read ({error.strerror or error})") from None

    def _layout(self, head: list[str]) -> tuple[str, list[str], int]:
        """Return the delimiter, the columns' names, and after how many lines the rows begin."""
        best: tuple[tuple[float, int], str, list[str], int] | None = None
        for delimiter in (",", ";", "\t", " "):
            rows = [self._cells(k, line, delimiter) for k, line in enumerate(head, start=1)]
            first = next((k for k, cells in enumerate(rows) if _is_row(cells)), None)
            if first is None:
                continue
            fits = sum(_is_read(cell) or not cell for cell in rows[first]) / len(rows[first]), len(rows[first])
            if best is None or (delimiter != " " and fits > best[0]):
                above = [cells for cells in rows[:first] if any(cells)]
                names = above[-1] if above and len(above[-1]) == len(rows[first]) else [""] * len(rows[first])
                best = fits, delimiter, names, first
        if best is None:
            raise complaint(self._path, None, None, f"holds no row of numbers in its first {HEAD} lines")
        _, delimiter, names, first = best
        return delimiter, _distinct(names), first

    def _lines(self) -> Iterator[Line]:
        for k, text in self._numbered():
            if k <= self._header or not text.strip() or text.startswith("#"):
                continue
            cells = self._cells(k, text, self._delimiter)
            if len(cells) != len(self._names):
                problem = f"has {len(cells)} cells, the header {len(self._names)}; mend or remove the line"
                raise complaint(self._path, k, None, problem)
            yield Line(k, cells)

    def _numbered(self) -> Iterator[tuple[int, str]]:
        """Yield the lines of the file and their numbers, from 1."""
        with self._text() as file:
            try:
                yield from enumerate(file, start=1)
            except UnicodeDecodeError:
                raise complaint(self._path, None, None, "is not text in UTF-8; save it as UTF-8") from None

    def _cells(self, number: int, line: str, delimiter: str) -> list[str]:
        line = line.strip("\r\n")
        if delimiter == " ":
            return line.lstrip("#").split()
        plain = '"' not in line and len(line) < csv.field_size_limit()  # which is split much faster
        try:
            found = line.split(delimiter) if plain else next(csv.reader([line], delimiter=delimiter), [])
            cells = [cell.strip() for cell in found]
        except csv.Error as error:
            raise complaint(self._path, number, None, f"is not CSV ({error}); mend the line") from None
        if delimiter != ",":
            cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
        return [cells[0].lstrip("# "), *cells[1:]] if cells else cells


def _is_row(cells: list[str]) -> bool:
    """Return whether most cells are numbers or dates."""
    given = [cell for cell in cells if cell]
    return len(given) > 1 and sum(map(_is_read, given)) > len(given) / 2


def _is_read(cell: str) -> bool:
    return is_number(cell) or date(cell) is not None


def _rises(cells: list[str]) -> bool:
    """Return whether each of these cells is a number larger than the one before."""
    values = [value_of(cell) for cell in cells]
    known = np.array([math.nan if value is None else value for value in values])
    return len(known) > 2 and bool(np.all(np.diff(known) > 0))


def _distinct(names: list[str]) -> list[str]:
    found: list[str] = []
    for k, name in enumerate(names, start=1):
        found.append(f"{name} #{k}".strip() if not name or name in found else name)
    return found


def _unit(name: str, times: Array) -> TimeUnit:
    """Return the unit of time that a column's name says; of no word, that which makes 1 us to 10 s of its steps."""
    for unit, pattern in _UNIT_IN_NAME.items():
        if re.search(pattern, name, re.IGNORECASE):
            return unit
    steps = np.diff(times[np.isfinite(times)])
    step = float(np.median(steps[steps > 0])) if (steps > 0).any() else math.nan
    return "ns" if step >= 1e6 else "us" if step >= 1e3 else "ms" if step >= 2 else "s"


FORMAT = RecordingFormat("CSV file (.csv, .tsv, .txt)", _is_table, Table)
