"""CSV files with any columns: a channel is a column, by the name in the header.

The header is the line before the first row of numbers, or the one before that where it holds units, which names then
end with: ``left [deg]``. Lines above it are left alone, and so is what begins with ``#``, unless it alone has the
names. A name that stands twice gets its place (``X``, ``X #2``), a column without a name too (``#3``). Cells are
separated by commas, semicolons, tabs, bars or blanks, whichever makes most of them numbers. Numbers may have a decimal
comma, between commas in quotes, and between thousands the sign that is not before decimals. A blank cell, or ``NA``,
``NULL`` or ``-``, is no reading, so one file may hold several rates. A file may also hold one reading a row, of the
signal that a column of text names (``t,signal,value``): then each name is a channel. What is the
time, and how it may be written: `csv_clock`.
"""

import itertools
import re
from collections import deque
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from castor_envs.logs.recordings.csv_cells import (
    MAY_BE_EITHER,
    UNCLEAR,
    cells_of,
    check_clear,
    decimal_sign_by_columns,
    is_blank,
    is_number,
    is_read,
    is_unclear,
    says_no_order,
    tells_month_first,
    usual_decimal_sign,
    value_of,
    with_points,
)
from castor_envs.logs.recordings.csv_clock import RowTimes, clock_of
from castor_envs.logs.recordings.csv_layout import head_of, layout_of
from castor_envs.logs.recordings.recording import Clock, Reading, RecordingFormat
from castor_envs.logs.recordings.text_lines import first_row, is_comment, numbered_lines
from castor_envs.logs.table import Line, complaint

BEFORE, BREAK = 10, 10.0
"""Rows before the last one, and their largest step in size, by which a last number without a line end is judged."""

FEWEST_READINGS, OFTEN = 3, 0.1
"""Of each signal of a file with a signal's reading a row, on average; and part of rows that name another one than the
row before: modes and states, which are text too, change less often."""

_SIGN, _POINT_OR_QUOTE, _ANY = re.compile("[.,]"), re.compile('[."]'), re.compile("")
"""What may be before decimals or between thousands; between cells with commas only a comma in quotes may. Any line."""


def _is_table(path: Path) -> bool:
    if not path.is_file() or path.suffix.lower() not in (".csv", ".tsv", ".txt", ".dat"):
        return False
    if path.suffix.lower() in (".csv", ".tsv"):
        return True
    cells = first_row(path)
    return cells is not None and not all(map(is_number, cells))


class Table:
    """A CSV file; each pass over it opens it anew and reads line by line."""

    kind, held, inside = "CSV file", False, ""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.notes: list[str] = []
        self.left_out: dict[str, str] = {}
        head = head_of(numbered_lines(path, self.notes))
        if not head:
            raise complaint(path, None, None, "is empty; a CSV file was expected")
        self._delimiter, self._names, self._header = layout_of(path, head)
        self._decimal = self._usual_decimal_sign()

    def clock(self) -> Clock:
        """Return the clock, see `clock_of`."""
        clock = clock_of(self._names, self._first_rows())
        self._row_times(clock)  # which may have something to say
        return clock

    def _row_times(self, clock: Clock) -> RowTimes:
        times = RowTimes(self._path, self._names, clock)
        first = next(self._lines(), None)
        for k, cell in enumerate([] if first is None else first.cells):
            if self._names[k] in times.columns and says_no_order(cell):
                told = tells_month_first(line.cells[k] for line in self._lines())
                times.month_first = bool(told)
                if told is None:
                    self._say(f"dates such as {cell!r} are read with the day before the month, as nothing says which")
        return times

    def readings(self, channels: frozenset[str] | None, clock: Clock) -> Generator[Reading]:
        """Yield readings, see `Recording`."""
        times = self._row_times(clock)
        named = [(k, name) for k, name in enumerate(self._names) if name not in times.columns]
        taken = [(k, name) for k, name in named if channels is None or name in channels]
        signals = self._signals([k for k, _ in named]) if channels is None or not taken else None
        seen: set[str] = set()
        odd: dict[str, tuple[int, str]] = {}
        for row, line in enumerate(self._lines()):
            time = times.of(row, line)
            if signals is not None:
                name = line.cells[signals[0]]
                taken = [(signals[1], name)] if channels is None or name in channels else []
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
                    check_clear(self._path, line.number, name, cell)
                    raise complaint(self._path, line.number, name, f"{cell!r} is not a number; mend or blank it")
                elif name not in odd:
                    odd[name] = line.number, cell
        if channels is None:
            names = self._names if signals is None else list(odd)
            self.left_out = dict(_left_out(names, {*seen, *times.columns}, odd))

    def _signals(self, columns: list[int]) -> tuple[int, int] | None:
        """Return which of the columns beside the clock has the names of signals, and which their values, where rows
        hold a reading of one signal each: it has text alone, few words that follow each other often; None elsewhere."""
        rows = self._first_rows()
        texts = [k for k in columns if rows and not any(is_read(row[k]) or is_blank(row[k]) for row in rows)]
        if len(columns) != 2 or len(texts) != 1:
            return None
        (names,), (values,) = texts, set(columns) - set(texts)
        words = [row[names] for row in rows]
        changes = sum(word != other for word, other in itertools.pairwise(words))
        if FEWEST_READINGS * len(set(words)) > len(words) or changes < OFTEN * len(words):
            return None
        self._say(f"rows are readings of what {self._names[names]!r} names: each of these is a channel")
        return names, values

    def _first_rows(self) -> list[list[str]]:
        return [line.cells for line in itertools.islice(self._lines(), 1000)]

    def _say(self, what: str) -> None:
        """Add a note about the file, once."""
        if (said := f"{self._path.name}: {what}") not in self.notes:
            self.notes.append(said)

    def _usual_decimal_sign(self) -> str:
        """Return the sign before decimals, "" where numbers have signs and none says it."""
        lines = self._lines_with(_POINT_OR_QUOTE if self._delimiter == "," else _SIGN)
        usual = usual_decimal_sign(cells_of(self._path, *line, self._delimiter) for line in lines)
        if usual == "":
            every = self._lines_with(_ANY)
            usual = decimal_sign_by_columns(cells_of(self._path, *line, self._delimiter) for line in every)
        return "." if usual is None else usual

    def _lines_with(self, mark: re.Pattern[str]) -> Iterator[tuple[int, str]]:
        lines = numbered_lines(self._path, [])
        return ((k, text) for k, text in lines if k > self._header and mark.search(text) and not is_comment(text))

    def _lines(self) -> Iterator[Line]:
        before: deque[str] = deque(maxlen=BEFORE)  # the last cells of rows
        for k, text in numbered_lines(self._path, self.notes):
            if k <= self._header or not text.strip() or is_comment(text):
                continue
            cells = with_points(cells_of(self._path, k, text, self._delimiter), self._decimal)
            if len(cells) == len(self._names) + 1 and not cells[-1]:  # a delimiter at the end
                cells.pop()
            unended, missing = not text.endswith(("\n", "\r")), len(cells) < len(self._names)
            if unended and (missing or _lacks_its_end(cells[-1], before)):
                self._say(f"line {k}, the last, is cut off, and left out")
                break
            if len(cells) != len(self._names):
                problem = f"has {len(cells)} cells, the header {len(self._names)}; mend or remove the line"
                raise complaint(self._path, k, None, problem)
            before.append(cells[-1])
            yield Line(k, cells)


def _left_out(names: Sequence[str], seen: set[str], odd: Mapping[str, tuple[int, str]]) -> Iterator[tuple[str, str]]:
    """Yield which of these columns are left out, and why.

    seen: those with numbers, and the clock. odd: of those with other text the line of its first cell, and the cell.
    """
    for k, name in enumerate(names, start=1):
        if name in odd and name in seen:
            line, cell = odd[name]
            where = f"{cell.removesuffix(UNCLEAR)!r} in line {line}"
            yield name, f"in part, from {where} on: an import refuses what is no number; mend or blank it"
        elif name in odd:
            yield name, f"numbers with a sign that {MAY_BE_EITHER}" if is_unclear(odd[name][1]) else "text"
        elif name not in seen and name != f"#{k}":
            yield name, "blank in all rows"


def _lacks_its_end(cell: str, before: Iterable[str]) -> bool:
    """Return whether a number, where a file ends, is cut off: it is shorter than the last one of the rows before, and
    further from that than `BREAK` of their steps, but not once it goes on with as many digits."""
    numbers = [(other, value) for other in before if (value := value_of(other)) is not None]
    value = value_of(cell)
    if value is None or len(numbers) < 2 or len(cell) >= len(numbers[-1][0]):
        return False
    reach = BREAK * max(abs(number - last) for (_, last), (_, number) in itertools.pairwise(numbers))
    text, last = numbers[-1]
    scale = 10.0 ** max(len(text.partition(".")[0]) - len(cell), 0)
    least, most = scale * abs(value), scale * (abs(value) + 1)
    return abs(value - last) > reach and least - reach <= abs(last) <= most + reach


FORMAT = RecordingFormat("CSV file (.csv, .tsv, .txt)", _is_table, Table)
