"""Cells of a CSV file: what is a number, a date, a time of day or a blank, for whoever looks at them."""

import csv
import re
from collections import Counter
from collections.abc import Iterable
from datetime import UTC, datetime, timedelta
from pathlib import Path

from castor_envs.logs.table import complaint

_BLANK = {"", "na", "n/a", "null", "none", "-"}
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_HALF = r"(?: ?(?P<half>[AaPp])\.?[Mm]\.?)?"
_DATE = re.compile(
    r"(?:(?P<y>\d{4})(?P<by>[-/.])(?P<m>\d\d?)(?P=by)(?P<d>\d\d?)|"
    r"(?P<D>\d\d?)(?P<BY>[-/.])(?P<M>\d\d?)(?P=BY)(?P<Y>\d{4}))"
    rf"(?:[T ] *(?P<h>\d\d?)(?P<rest>:.*?){_HALF})?"
)
_TIME_OF_DAY = re.compile(rf"(\d{{1,3}}):([0-5]\d):([0-5]\d)(?:[.,](\d+))?{_HALF}")
_MINUTES = re.compile(r"(\d{1,3}):([0-5]\d)[.,](\d+)")
DAY, HOUR = 86_400 * 10**9, 3600 * 10**9
"""ns."""

_BY = {
    decimal: re.compile(
        rf"(?=.*\d)[+-]?(?:\d*(?:\{decimal}\d*)?(?:[eE][+-]?\d+)?|[1-9]\d{{0,2}}(?:\{between}\d{{3}})+(?:\{decimal}\d*)?)"
    )
    for decimal, between in (".,", ",.")
}
"""Numbers by the sign before their decimals, the other of which may stand between thousands."""

_GROUPS = re.compile(r"[+-]?\d{1,3}([.,])\d{3}(?:\1\d{3})+")
"""Thousands without decimals, or what is no number at all, as a version."""

UNCLEAR = "?"
"""What `with_points` adds to a number with a sign of which nothing says whether it is before decimals."""

MAY_BE_EITHER = (
    "may stand before decimals or between thousands, by the file's other numbers; write none between thousands, and "
    "the same before all decimals"
)
"""What is said of such numbers."""

SIGNS_AT_ONCE = 100
"""Rows of which the usual sign before decimals counts, if any of their numbers says one."""

MONTHS, HALF_DAY = 12, 12


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


def date(cell: str, month_first: bool = False) -> int | None:
    """Return a date as ns since 1970, to the microsecond, UTC where it names no zone; None of any other text.

    As ISO 8601 writes it, with slashes or dots for dashes, or with the year last: then the day is before the month, but
    with slashes and dashes behind it if `month_first`, or where only that makes a date. Without a time of day it is
    midnight.
    """
    found = _DATE.fullmatch(cell)
    if found is None:
        return None
    year, month, day = (found[part] or found[part.upper()] for part in "ymd")
    if found["BY"] in ("/", "-") and (int(month) > MONTHS or (month_first and int(day) <= MONTHS)):
        month, day = day, month
    hour = ""
    if found["h"]:
        if (of_day := _hour(found["h"], found["half"])) is None:
            return None
        hour = f"T{of_day:02}{found['rest'].replace('UTC', 'Z').replace(' ', '')}"
    try:
        read = datetime.fromisoformat(f"{year}-{month:0>2}-{day:0>2}{hour}")
    except ValueError:
        return None
    return (read.replace(tzinfo=read.tzinfo or UTC) - _EPOCH) // timedelta(microseconds=1) * 1000


def time_of_day(cell: str) -> int | None:
    """Return a time such as ``12:00:01.5`` or ``12:00:01 AM`` as ns since midnight, or ``30:01.5`` since the last hour;
    None of any other text."""
    if found := _MINUTES.fullmatch(cell):
        return (int(found[1]) * 60 + int(found[2])) * 10**9 + int(f"{found[3]:0<9.9}")
    found = _TIME_OF_DAY.fullmatch(cell)
    if found is None or (hours := _hour(found[1], found["half"])) is None:
        return None
    return ((hours * 60 + int(found[2])) * 60 + int(found[3])) * 10**9 + int(f"{found[4] or '0':0<9.9}")


def clock_turn(cell: str) -> int | None:
    """Return after how many ns the clock of a time of day is at 0 again; None of what is no time of day."""
    if ":" not in cell or time_of_day(cell) is None:  # most times are numbers
        return None
    return HOUR if _MINUTES.fullmatch(cell) else DAY


def _hour(number: str, half: str | None) -> int | None:
    """Return the hour from midnight of an hour's number, in a half of the day (a, p) or in none; None if there is no
    such hour."""
    hour = int(number)
    if half is None:
        return hour
    return hour % HALF_DAY + HALF_DAY * (half in "Pp") if 1 <= hour <= HALF_DAY else None


def tells_month_first(cells: Iterable[str]) -> bool | None:
    """Return whether in dates with the year last, and no dots, the month comes first: one of them says it by a number
    that is no month, or else they lie closer together so; None where nothing says it."""
    seen: set[tuple[int, int, int]] = set()
    for cell in cells:
        found = _DATE.fullmatch(cell)
        if found is None or found["BY"] not in ("/", "-"):
            continue
        first, second, year = int(found["D"]), int(found["M"]), int(found["Y"])
        if max(first, second) > MONTHS:
            return second > MONTHS
        if first and second and year:
            seen.add((year, first, second))
    by_month = [datetime(year, first, second).toordinal() for year, first, second in seen]
    by_day = [datetime(year, second, first).toordinal() for year, first, second in seen]
    spans = [max(days, default=0) - min(days, default=0) for days in (by_month, by_day)]
    return None if spans[0] == spans[1] else spans[0] < spans[1]


def says_no_order(cell: str) -> bool:
    """Return whether a cell is a date, with the year last and no dots, of which it needs others to say what is the
    month, see `tells_month_first`."""
    found = _DATE.fullmatch(cell)
    return found is not None and found["BY"] in ("/", "-")


def moment(cell: str, month_first: bool = False) -> float | None:
    """Return what a cell says of when something was: a number; a date or a time of day as ns; None of other text."""
    value = value_of(cell)
    value = date(cell, month_first) if value is None else value
    return time_of_day(cell) if value is None else value


def is_day(cell: str) -> bool:
    """Return whether a cell is a date without a time of day."""
    return ":" not in cell and date(cell) is not None


def is_read(cell: str) -> bool:
    """Return whether a cell holds a number, a date or a time of day."""
    return moment(cell) is not None


def decimal_sign(cell: str) -> str | None:
    """Return the sign before the decimals of a number, "." or ","; None of one that reads as a number by both signs, as
    ``1,234`` and ``7``, and of other text."""
    signs = [sign for sign, number in _BY.items() if number.fullmatch(cell)]
    return signs[0] if len(signs) == 1 else None


def usual_decimal_sign(rows: Iterable[list[str]]) -> str | None:
    """Return the sign before the decimals of most numbers in the first rows, as many as it takes until one says it; ""
    where none does, None where there is no row. Nothing but thousands says nothing: it may be a version."""
    signs, row = Counter[str](), 0
    for row, cells in enumerate(rows, start=1):
        marked = (cell for cell in cells if ("." in cell or "," in cell) and not _GROUPS.fullmatch(cell))
        signs.update(sign for cell in marked if (sign := decimal_sign(cell)) is not None)
        if signs and row >= SIGNS_AT_ONCE:
            break
    return signs.most_common(1)[0][0] if signs else "" if row else None


def decimal_sign_by_columns(rows: Iterable[list[str]]) -> str:
    """Return the sign before decimals where no number says it: of a column that also has whole numbers from 100 on the
    other sign is between thousands; else a point, where no number has a comma. "" where it may be either."""
    whole, signs = set[int](), dict[int, set[str]]()
    for cells in rows:
        for k, cell in enumerate(cells):
            if cell.isdigit():
                whole |= {k} if len(cell) >= len("100") else set()
            elif ("." in cell or "," in cell) and _is_numeral(cell):
                signs.setdefault(k, set()).add("." if "." in cell else ",")
    between = set[str]().union(*(signs[k] for k in whole & signs.keys()))
    if between:
        return "" if len(between) > 1 else "," if "." in between else "."
    return "" if any("," in of for of in signs.values()) else "."


def with_points(cells: list[str], decimal: str | None) -> list[str]:
    """Return cells with numbers as Python writes them, of such whose decimals are after this sign, None for whichever
    makes them numbers.

    What is a number by the other sign alone, or by either where `decimal` is "", ends with `UNCLEAR`.
    """
    marked = decimal != "."  # a point needs no look
    return [_with_point(cell, decimal) if "," in cell or (marked and "." in cell) else cell for cell in cells]


def _with_point(cell: str, decimal: str | None) -> str:
    if decimal is None:
        decimal = decimal_sign(cell) or "."
    if decimal and _BY[decimal].fullmatch(cell):
        return cell.replace("," if decimal == "." else ".", "").replace(decimal, ".")
    return cell + UNCLEAR if _is_numeral(cell) else cell


def _is_numeral(cell: str) -> bool:
    return any(number.fullmatch(cell) for number in _BY.values())


def _in_ascii(cell: str) -> str:
    """Return a number without a degree sign behind it, and with a hyphen for a sign of minus; other text as it is."""
    plain = cell.replace("−", "-").removesuffix("°").rstrip()
    return plain if _is_numeral(plain) else cell


def is_unclear(cell: str) -> bool:
    """Return whether a cell holds a number that `UNCLEAR` ends."""
    return cell.endswith(UNCLEAR) and _is_numeral(cell[:-1])


def check_clear(path: Path, line: int, column: str, cell: str) -> None:
    """Raise InputError for a number in a cell that `UNCLEAR` ends."""
    if is_unclear(cell):
        raise complaint(path, line, column, f"{cell[:-1]!r} has a sign that {MAY_BE_EITHER}")


def cells_of(path: Path, number: int, line: str, delimiter: str) -> list[str]:
    """Return the cells of a line; of a comment, those after its mark. Raises InputError for what is no CSV."""
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
    if not line.isascii():
        cells = [_in_ascii(cell) for cell in cells]
    return [cells[0].lstrip("# "), *cells[1:]] if cells else cells
