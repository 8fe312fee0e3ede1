"""Tables of papers beside ours, for people (rich) and for programs (JSON: units in the keys)."""

import json
from itertools import groupby
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.papers.comparison import Comparison, PaperTable, agreement
from benchmarks.papers.failure_modes import (
    METRICS,
    RATIOS,
    SWEEPS,
    Selection,
    Sweep,
    Tie,
    selections,
    ties,
    with_small_bends,
)
from castor_envs.vehicles.presets import FRAME_LENGTH

FORMAT = "castor-tables/1"
LEGEND = "printed | ours; = agrees to the printed rounding, != does not"
SIMULATED = "printed | ours +- its standard error (ours over printed)"


def draw(folder: Path) -> list[Path]:
    """Write pictures of Vogt's tests to a folder and return their paths."""
    # Matplotlib is slow to import, and only pictures need it.
    from benchmarks.papers.figures import write_figures

    return write_figures(folder)


def show_tables(tables: tuple[PaperTable, ...], pictures: list[Path], console: Console, json_text: bool) -> None:
    """Print tables, as JSON if so wished, else also which pictures were written."""
    if json_text:
        print(json.dumps(as_json(tables), indent=2, allow_nan=False))
        return
    print_tables(tables, console)
    if pictures:
        _say(console, f"\npictures: {', '.join(map(str, pictures))}")


def as_json(tables: tuple[PaperTable, ...]) -> dict[str, Any]:
    """Return tables and failure modes as plain data; table values are in the unit of print, which their keys name."""
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
                "values": [_value_json(one) for one in table.comparisons],
                **({"conditions": {one.key: one.value for one in table.conditions}} if table.conditions else {}),
                "notes": list(table.notes),
            }
            for table in tables
        ],
        **({"failure_modes": _failures_json()} if _of_metrics(tables) else {}),
    }


def _of_metrics(tables: tuple[PaperTable, ...]) -> bool:
    """Return whether a table is about the metrics of Vogt and Minor, whose failures are then shown too."""
    return any(dict(one.place).get("metric") in METRICS for table in tables for one in table.comparisons)


def _failures_json() -> dict[str, Any]:
    return {
        "frame_length_m": FRAME_LENGTH,
        "ratios": list(RATIOS),
        "sweeps": [_sweep_json(sweep) for sweep in SWEEPS],
    }


def _value_json(one: Comparison) -> dict[str, Any]:
    suffix = "" if one.unit is None else f"_{one.unit}"
    value = {
        **dict(one.place),
        "quantity": one.quantity,
        f"printed{suffix}": one.printed,
        f"ours{suffix}": one.ours,
        **dict(one.also),
    }
    if one.standard_error is None:
        return value | {"agrees": one.agrees}
    return value | {f"standard_error{suffix}": one.standard_error, "ratio": one.ratio}


def _sweep_json(sweep: Sweep) -> dict[str, Any]:
    small = with_small_bends(sweep)
    return {
        "name": sweep.name,
        "title": sweep.title,
        "test": sweep.test.number,
        "test_ratio": sweep.test_ratio,
        "claimed_ratio": sweep.claimed,
        "true_axle": sweep.test.true_axle,
        "bend_rad": sweep.bend,
        "metrics": [
            {
                "metric": metric,
                "selections": [_selection_json(one) for one in selections(sweep, metric)],
                "ties": [_tie_json(tie) for tie in ties(sweep, metric)],
                "ties_of_small_bends": [_tie_json(tie) for tie in ties(small, metric)],
            }
            for metric in METRICS
        ],
    }


def _selection_json(one: Selection) -> dict[str, Any]:
    return {"from_ratio": one.low, "to_ratio": one.high, "axle": one.axle}


def _tie_json(tie: Tie) -> dict[str, Any]:
    return {"ratio": tie.ratio, "axles": list(tie.axles), "lowest": tie.lowest}


def print_tables(tables: tuple[PaperTable, ...], console: Console) -> None:
    """Print every table as printed | ours, what agrees, and where the metrics fail if these are about them."""
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
    if not _of_metrics(tables):
        return
    console.print("\nWhere the metrics fail", style="bold", markup=False, highlight=False)
    for sweep in SWEEPS:
        for line in failure_lines(sweep):
            _say(console, line)


def summary(table: PaperTable) -> str:
    """Return how many of a table's values agree, in a line."""
    counts = [
        f"{agreeing} of {values} {quantity}s" for quantity, (agreeing, values) in agreement(table.comparisons).items()
    ]
    return f"{', '.join(counts[:-1])} and {counts[-1]} agree to the printed rounding"


def conditions_line(table: PaperTable) -> str:
    """Return which of a table's conditions are not the default ones, and where all of them stand, in a line."""
    changed = [str(one) for one in table.conditions if one.value != one.default]
    text = f"Changed conditions: {', '.join(changed)}" if changed else "All conditions are the default ones"
    return f"{text}. --json shows all of them, castor-bench tables --help their reasons."


def failure_lines(sweep: Sweep) -> list[str]:
    """Return what a sweep shows, line by line: where each metric's selection changes, and what the paper claims."""
    kept, other = ("A", "B") if sweep.keeps == 0 else ("B", "A")
    true, small = sweep.test.true_axle, with_small_bends(sweep)
    lines = [
        f"{sweep.title}: {kept} by {abs(sweep.bend):.4f} rad, {other} by {RATIOS[0]:g} to {RATIOS[1]:g} times "
        f"that; test {sweep.test.number} sits at {sweep.test_ratio:.3f}, where axle {true} is true. The paper: it "
        f"fails at {_claim(sweep)}."
    ]
    for metric in METRICS:
        ranges = [_range(one, true) for one in selections(sweep, metric)]
        if len(ranges) == 1:
            ranges = [f"selects axle {selections(sweep, metric)[0].axle} throughout"]
        of_small = [tie.ratio for tie in ties(small, metric)]
        for k, tie in enumerate(ties(sweep, metric)):
            axles = f"{', '.join(map(str, tie.axles[:-1]))} and {tie.axles[-1]}"
            moved = f" (for small bends {of_small[k]:.3f})" if abs(of_small[k] - tie.ratio) > 5e-4 else ""
            ranges.append(f"axles {axles} tie at {tie.ratio:.3f}{moved}{'' if tie.lowest else ', above it'}")
        lines.append(f"  {metric}: {'; '.join(ranges)}")
    return lines


def _claim(sweep: Sweep) -> str:
    return "equal curvature" if sweep.claimed == 1 else f"a ratio of about {sweep.claimed:g}"


def _range(one: Selection, true: int) -> str:
    place = f"from {one.low:.3f} to {one.high:.3f}"
    return f"selects axle {one.axle}{'' if one.axle == true else ' (wrong)'} {place}"


def _grid(table: PaperTable) -> Table:
    """Return a table of values by their rows and columns; what a row says before a colon groups it."""
    columns = list(dict.fromkeys(one.column for one in table.comparisons))
    grid = Table(table.rows)
    for column in columns:
        grid.add_column(column, justify="right", no_wrap=True)
    rows = dict.fromkeys(one.row for one in table.comparisons)
    for _, together in groupby(rows, key=lambda row: row.partition(":")[0]):
        for row in together:
            cells = {one.column: one for one in table.comparisons if one.row == row}
            grid.add_row(row, *(_cell(cells.get(column)) for column in columns))
        grid.add_section()
    return grid


def _cell(one: Comparison | None) -> str:
    if one is None:
        return ""
    if not isinstance(one.printed, float) or not isinstance(one.ours, float):
        text = f"{one.printed} | {one.ours}"
    elif one.standard_error is not None:
        spread = f"{one.ours:.{one.digits}f} +- {one.standard_error:.{one.digits}f}"
        return f"{one.printed:.{one.digits}f} | {spread} ({one.ratio:.2f})"
    else:
        text = f"{one.printed:.{one.digits}f} | {one.ours:.{one.digits + 1}f}"
    return f"{text} {'= ' if one.agrees else '[bold]!=[/bold]'}"


def _say(console: Console, text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)
