"""Cells of a CSV file: what is a number, a date or a blank, for whoever looks at them."""

import csv
import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

from castor_envs.logs.table import complaint

_BLANK = {"", "na", "n/a", "null", "none", "-"}
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(,\d{3})+")
"""What may be a thousand, where a decimal comma needs quotes."""


def value_of(cell: str) -> float | None:
    """Return the number in a cell, None of any other text; NaN is a number."""
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


def is_number(cell: str) -> bool:
    """Return whether a cell's text is a number; NaN is one."""
    return value_of(cell) is not None


def is_blank(cell: str) -> bool:
    """Return whether a cell holds nothing, or a word for that: NA, N/A, NULL, None, -."""
    return cell.lower() in _BLANK


def date(cell: str) -> int | None:
    """Return a date as ISO 8601 writes it as ns since 1970, to the microsecond, UTC where it names no zone; or None."""
    if not (cell[:4].isdigit() and cell[4:5] == "-"):
        return None
    try:
        read = datetime.fromisoformat(cell)
    except ValueError:
        return None
    return (read.replace(tzinfo=read.tzinfo or UTC) - _EPOCH) // timedelta(microseconds=1) * 1000


def is_read(cell: str) -> bool:
    """Return whether a cell holds a number or a date."""
    return is_number(cell) or date(cell) is not None


def says_decimal_comma(cell: str) -> bool:
    """Return whether a cell is a number by a decimal comma, and by no comma between thousands."""
    return bool(_DECIMAL_COMMA.fullmatch(cell)) and not _THOUSANDS.fullmatch(cell)


def cells_of(path: Path, number: int, line: str, delimiter: str, decimal_comma: bool) -> list[str]:
    """Return the cells of a line, numbers with a decimal point; of a comment, those after its mark.

    decimal_comma: whether numbers may have one. Raises InputError for what is no CSV.
    """
    line = line.strip("\r\n")
    plain = '"' not in line and len(line) < csv.field_size_limit()  # which is split much faster
    try:
        if delimiter == " ":
            found = line.lstrip("# ").split()
        else:
            found = line.split(delimiter) if plain else next(csv.reader([line], delimiter=delimiter), [])
        cells = [cell.strip() for cell in found]
    except csv.Error as error:
        raise complaint(path, number, None, f"is not CSV ({error}); mend the line") from None
    if decimal_comma and "," in line:
        cells = [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]
    return [cells[0].lstrip("# "), *cells[1:]] if cells else cells
