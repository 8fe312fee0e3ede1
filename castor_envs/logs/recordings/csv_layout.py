"""How a CSV file is laid out: its delimiter, its columns' names, and where its rows begin, by its first lines."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from castor_envs.logs.recordings.csv_cells import cells_of, is_blank, is_read, with_points
from castor_envs.logs.recordings.text_lines import is_comment
from castor_envs.logs.table import Line, complaint
from castor_envs.logs.unit_words import TIMES, WORDS

HEAD = 100
"""Lines, comments apart, by which the layout is judged, and in which the first row must come."""

DELIMITERS = (",", ";", "\t", "|", " ")
NAMED = 0.25
"""What names that fit the rows speak for a delimiter, beside the part of cells that are numbers."""

_SAID = "|".join(sorted({word for said in (WORDS, TIMES) for words in said.values() for word in words}))
_ATOM = rf"(?:{_SAID}|min|h|km|°C?|[mk]rad|m?[VAW]|N|Nm|k?Hz|k?g|K|Pa|%|1|bool)"
_UNIT = re.compile(rf"{_ATOM}(?:\^?-?\d|²|³)?(?:[/*·. ]{_ATOM}(?:\^?-?\d|²|³)?)*")


class Layout(NamedTuple):
    """delimiter: between cells. names: of the columns, distinct. header: the number of the last line above the rows,
    from 1, 0 for none."""

    delimiter: str
    names: list[str]
    header: int


def head_of(lines: Iterable[tuple[int, str]]) -> list[tuple[int, str]]:
    """Return the first lines that are not blank; of comments that follow each other the last two, which may hold names
    and units."""
    head: list[tuple[int, str]] = []
    rows = 0
    for line in lines:
        if not line[1].strip():
            continue
        if is_comment(line[1]) and len(head) > 1 and all(is_comment(text) for _, text in head[-2:]):
            head.pop(-2)
        head.append(line)
        rows += not is_comment(line[1])
        if rows == HEAD:
            break
    return head


def layout_of(path: Path, head: Sequence[tuple[int, str]]) -> Layout:
    """Return the layout under which most cells of the first row are numbers; raises InputError where there are none."""
    judged = [found for delimiter in DELIMITERS if (found := _judged(path, head, delimiter)) is not None]
    if not judged:
        raise complaint(path, None, None, f"holds no row of numbers in its first {HEAD} lines")
    return max(judged, key=lambda found: found[0])[1]


def _judged(path: Path, head: Sequence[tuple[int, str]], delimiter: str) -> tuple[tuple[float, int], Layout] | None:
    """Return what speaks for a delimiter, and the layout by it; None where no row follows."""
    lines = [Line(k, with_points(cells_of(path, k, text, delimiter), None)) for k, text in head]
    rows = [line for line, (_, text) in zip(lines, head, strict=True) if not is_comment(text) and len(line.cells) > 1]
    widths = Counter(len(line.cells) for line in rows)
    if not widths:
        return None
    width = widths.most_common(1)[0][0]
    rows = [line for line in rows if len(line.cells) == width]
    counted = [k for k in range(width) if _counts([line.cells[k] for line in rows])]
    first = next((line for line in rows if _is_row([line.cells[k] for k in counted])), None)
    if first is None:
        return None
    # A delimiter may end the rows alone, or the header alone.
    ends = all(is_blank(line.cells[-1]) for line in rows if line.number >= first.number)
    above = [
        (line.cells, is_comment(text))
        for line, (_, text) in zip(lines, head, strict=True)
        if line.number < first.number and any(line.cells)
    ]
    names = _names(above, {width, width - 1 if ends else width})
    fits = sum(is_read(cell) or is_blank(cell) for cell in first.cells) / width + (NAMED if names else 0.0)
    header = max((line.number for line in lines if line.number < first.number), default=0)
    layout = Layout(delimiter, _distinct(names or [""] * width), header)
    return (fits, width if delimiter != " " else 0), layout


def _counts(cells: list[str]) -> bool:
    """Return whether a column holds numbers: at least half of its cells, the name may be one of them."""
    given = [cell for cell in cells if not is_blank(cell)]
    read = sum(map(is_read, given))
    return read > 0 and 2 * read >= len(given)


def _is_row(cells: list[str]) -> bool:
    """Return whether most cells of the columns of numbers are numbers or dates."""
    given = [cell for cell in cells if not is_blank(cell)]
    return 2 * sum(map(is_read, given)) > len(given)


def _names(above: list[tuple[list[str], bool]], widths: set[int]) -> list[str] | None:
    """Return the names in the lines above the rows, see `_named`; None if none fit.

    above: cells, and whether the line is a comment. Comments have the names only where no other line has; the units
    below names they may have.
    """
    all_lines, plain = [cells for cells, _ in above], [cells for cells, comment in above if not comment]
    with_units = [cells for cells, comment in above if not comment or _are_units(cells)] if plain else []
    return next((names for lines in (with_units, plain, all_lines) if (names := _named(lines, widths))), None)


def _named(above: list[list[str]], widths: set[int]) -> list[str] | None:
    """Return the names in the last of these lines, or in the one before where the last one holds units.

    widths: of the rows, with and without a blank cell at their end.
    """
    fitting = [cells[:-1] if not cells[-1] and len(cells) - 1 in widths else cells for cells in above[-2:]]
    if not fitting or len(fitting[-1]) not in widths:
        return None
    *before, last = fitting
    named = bool(before) and len(before[0]) == len(last) and all(before[0]) and not any(map(is_read, before[0]))
    if named and _are_units(last):
        return [
            f"{name} [{unit.strip('[]()')}]" if not is_blank(unit) else name
            for name, unit in zip(before[0], last, strict=True)
        ]
    return last


def _are_units(cells: list[str]) -> bool:
    given = [cell.strip("[]()") for cell in cells if not is_blank(cell)]
    return bool(given) and all(map(_UNIT.fullmatch, given))


def _distinct(names: list[str]) -> list[str]:
    found: list[str] = []
    for k, name in enumerate(names, start=1):
        found.append(f"{name} #{k}".strip() if not name or name in found else name)
    return found
