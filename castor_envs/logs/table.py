"""CSV files, read so that every error names its place: ``file:line: column 'x': what is wrong; what to do``."""

import csv
import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array


class Line(NamedTuple):
    """One line of a file: its number, counted from 1, and its cells as text."""

    number: int
    cells: list[str]


def complaint(path: Path, line: int | None, column: str | None, message: str) -> InputError:
    """Return the error for a place in a file; `line` and `column` are left out where they are None."""
    place = f"{path}:{line}" if line is not None else f"{path}"
    return InputError(f"{place}: column {column!r}: {message}" if column is not None else f"{place}: {message}")


def read_lines(path: Path, delimiter: str = ",") -> list[Line]:
    """Return the lines of a CSV file that are not blank.

    Raises InputError if there are none, or the file cannot be read.
    """
    return list(each_line(path, delimiter))


def each_line(path: Path, delimiter: str = ",") -> Iterator[Line]:
    """Yield the lines of a CSV file that are not blank, one in memory at a time; raises InputError as `read_lines`."""
    if path.is_dir():
        raise complaint(
            path, None, None, "is a folder; name a CSV file in it (of a ROS bag, castor-bench import makes one)"
        )
    empty = True
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            for line in _lines(path, file, delimiter):
                empty = False
                yield line
    except OSError as error:
        raise complaint(path, None, None, f"cannot be read ({error.strerror or error})") from None
    except UnicodeDecodeError:
        raise complaint(path, None, None, "is not text in UTF-8; save it as UTF-8") from None
    if empty:
        raise complaint(path, None, None, "is empty; a CSV file was expected")


def _lines(path: Path, file: Iterator[str], delimiter: str) -> Iterator[Line]:
    reader = csv.reader(file, strict=True, delimiter=delimiter)
    last = 0
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                yield Line(last + 1, cells)
            last = reader.line_num
    except csv.Error as error:
        raise complaint(path, last + 1, None, f"is not CSV ({error}); mend the line") from None


def check_width(path: Path, line: Line, expected: int, kind: str = "columns of the header") -> None:
    """Raise InputError unless the line has `expected` cells; `kind` says what they are."""
    if len(line.cells) != expected:
        message = f"{len(line.cells)} cells where the {kind} are {expected}; mend or remove the line"
        raise complaint(path, line.number, None, message)


def number(path: Path, line: int, column: str, cell: str) -> float:
    """Return a cell as a finite float; raises InputError for blanks, text, NaN and infinities."""
    text = cell.strip()
    try:
        value = float(text)
    except ValueError:
        value = None
    if value is None or "_" in text:
        problem = f"{text!r} is not a number" if text else "is blank"
        raise complaint(path, line, column, f"{problem}; give a number here")
    if not math.isfinite(value):
        raise complaint(path, line, column, f"{text!r} is not finite; give a finite number or remove the line")
    return value


def numbers(path: Path, lines: Sequence[Line], places: Mapping[str, int]) -> Array:
    """Return the cells of columns, (lines, columns), as finite floats; raises InputError as `number`.

    places: where a column's cell stands in a line, by the column's name.
    """
    cells = [[line.cells[k] for k in places.values()] for line in lines]
    try:
        values = np.array(cells, dtype=float).reshape(len(lines), len(places))  # faster than one by one
        if np.isfinite(values).all() and not any("_" in "".join(row) for row in cells):
            return values
    except ValueError:
        pass
    named = ((line.number, zip(places, row, strict=True)) for line, row in zip(lines, cells, strict=True))
    return np.array([[number(path, line, *cell) for cell in row] for line, row in named])
