"""Tables of papers beside ours, for people (rich) and for programs (JSON: units in the keys)."""

import json
from itertools import groupby
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.papers.comparison import Appendix, Comparison, PaperTable, agreement

FORMAT = "castor-tables/1"
LEGEND = "printed | ours; = agrees to the printed rounding, != does not"
SIMULATED = "printed | ours +- its standard error (ours over printed)"


def draw(folder: Path) -> list[Path]:
    """Write pictures of Vogt's tests to a folder and return their paths."""
    # Matplotlib is slow to import, and only pictures need it.
    from benchmarks.papers.figures import write_figures

    return write_figures(folder)


def show_tables(tables: tuple[PaperTable, ...], pictures: list[Path], console: Console, json_text: bool) -> None:
    """Print tables as JSON, or else as text with the names of the pictures that were written."""
    if json_text:
        print(json.dumps(as_json(tables), indent=2, allow_nan=False))
        return
    print_tables(tables, console)
    if pictures:
        _say(console, f"\npictures: {', '.join(map(str, pictures))}")


def as_json(tables: tuple[PaperTable, ...]) -> dict[str, Any]:
    """Return tables and their appendices as plain data; values are in the unit of print, which their keys name."""
    return {
        "format": FORMAT,
        "tables": [
            {
                "name": table.name,
                "title": table.title,
                "agreement": {
                    quantity: {"agree": agreeing, "of": values}
                    for quantity, (agreeing, values) in agreement(table.comparisons).items()
                },
                "values": [_value_json(value) for value in table.comparisons],
                **(
                    {"conditions": {condition.key: condition.value for condition in table.conditions}}
                    if table.conditions
                    else {}
                ),
                "notes": list(table.notes),
            }
            for table in tables
        ],
        **{appendix.key: dict(appendix.data) for appendix in _appendices(tables)},
    }


def _conditions_json(table: PaperTable) -> dict[str, Any]:
    conditions = {condition.key: condition.value for condition in table.conditions}
    return {"conditions": conditions} if conditions else {}


def _appendices(tables: tuple[PaperTable, ...]) -> list[Appendix]:
    """Return the tables' appendices, each once."""
    return list({table.appendix.key: table.appendix for table in tables if table.appendix is not None}.values())


def _value_json(comparison: Comparison) -> dict[str, Any]:
    suffix = "" if comparison.unit is None else f"_{comparison.unit}"
    value = {
        **dict(comparison.place),
        "quantity": comparison.quantity,
        f"printed{suffix}": comparison.printed,
        f"ours{suffix}": comparison.ours,
        **dict(comparison.also),
    }
    if comparison.standard_error is None:
        return value | {"agrees": comparison.agrees}
    return value | {f"standard_error{suffix}": comparison.standard_error, "ratio": comparison.ratio}


def print_tables(tables: tuple[PaperTable, ...], console: Console) -> None:
    """Print every table as printed | ours, what agrees, and what belongs to several of them."""
    for table in tables:
        console.print(f"\n{table.title}", style="bold", markup=False, highlight=False)
        console.print(_grid(table), highlight=False)
        judged = bool(agreement(table.comparisons))
        _say(console, LEGEND if judged else SIMULATED)
        for note in table.notes:
            _say(console, note)
        if table.conditions:
            _say(console, conditions_line(table))
        if judged:
            _say(console, summary(table))
    for appendix in _appendices(tables):
        console.print(f"\n{appendix.title}", style="bold", markup=False, highlight=False)
        for line in appendix.lines:
            _say(console, line)


def summary(table: PaperTable) -> str:
    """Return how many of a table's values agree, in a line."""
    counts = [
        f"{agreeing} of {values} {quantity}s" for quantity, (agreeing, values) in agreement(table.comparisons).items()
    ]
    return f"{', '.join(counts[:-1])} and {counts[-1]} agree to the printed rounding"


def conditions_line(table: PaperTable) -> str:
    """Return which of a table's conditions are not the default ones, and where all of them stand, in a line."""
    changed = [str(condition) for condition in table.conditions if condition.value != condition.default]
    text = f"Changed conditions: {', '.join(changed)}" if changed else "All conditions are the default ones"
    return f"{text}. --json shows all of them, castor-bench tables --help their reasons."


def _grid(table: PaperTable) -> Table:
    """Return a table of values by their rows and columns; what a row says before a colon groups it."""
    columns = list(dict.fromkeys(value.column for value in table.comparisons))
    grid = Table(table.rows)
    for column in columns:
        grid.add_column(column, justify="right", no_wrap=True)
    rows = dict.fromkeys(value.row for value in table.comparisons)
    for _, together in groupby(rows, key=lambda row: row.partition(":")[0]):
        for row in together:
            cells = {value.column: value for value in table.comparisons if value.row == row}
            grid.add_row(row, *(_cell(cells.get(column)) for column in columns))
        grid.add_section()
    return grid


def _cell(value: Comparison | None) -> str:
    if value is None:
        return ""
    if not isinstance(value.printed, float) or not isinstance(value.ours, float):
        text = f"{value.printed} | {value.ours}"
    elif value.standard_error is not None:
        spread = f"{value.ours:.{value.digits}f} +- {value.standard_error:.{value.digits}f}"
        return f"{value.printed:.{value.digits}f} | {spread} ({value.ratio:.2f})"
    else:
        text = f"{value.printed:.{value.digits}f} | {value.ours:.{value.digits + 1}f}"
    return f"{text} {'= ' if value.agrees else '[bold]!=[/bold]'}"


def _say(console: Console, text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)
