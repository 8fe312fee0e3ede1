"""Overviews for people (terminal, Markdown) and for programs (JSON)."""

from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.leaderboard.board import Leaderboard
from benchmarks.leaderboard.columns import FRAME, Column
from benchmarks.leaderboard.markdown import escaped, table_of
from benchmarks.leaderboard.notes import general_notes, say
from benchmarks.leaderboard.overview import GroupScore, Kind, Overview, OverviewEntry, overviews

TITLES = {
    Kind.ROBOTS: "Estimators of robots",
    Kind.TRAINS: "Estimators of trains",
    Kind.CALIBRATION: "Calibration methods",
}
MEANING = (
    "a group's cell: mean rank over its tasks · score as a multiple of the best one (geometric mean over the tasks)",
    "estimators that share a rank have the mean of its places; n/m: ranked in n of m tasks; a task served without a "
    "rank counts as the last place, and there is no multiple then",
)
MOST_NAMED = 3
"""Most tasks that a note names."""


def overviews_json(tables: Sequence[Overview]) -> list[dict[str, Any]]:
    """Return overviews as plain data."""
    return [
        {
            "of": table.kind.value,
            "robot": table.robot,
            "groups": [{"group": group, "tasks": list(tasks)} for group, tasks in table.groups.items()],
            "entries": [
                {
                    "estimator": entry.estimator,
                    "mean_rank": entry.mean_rank,
                    "tasks_ranked": entry.ranked,
                    "groups": {group: _score_json(score) for group, score in entry.groups.items()},
                }
                for entry in table.entries
            ],
        }
        for table in tables
    ]


def _score_json(score: GroupScore) -> dict[str, Any]:
    return {
        "mean_rank": score.mean_rank,
        "ratio_to_best": score.ratio,
        "tasks_ranked": score.ranked,
        "unranked": [{"task": one.task, "reason": one.reason} for one in score.unranked],
    }


def overviews_markdown(tables: Sequence[Overview]) -> str:
    """Return overviews as Markdown."""
    parts = []
    for overview in tables:
        columns = overview_columns(overview)
        rows = [[column.heading for column in columns], *zip(*(column.cells for column in columns), strict=True)]
        parts.append(f"## {escaped(overview_title(overview))}\n")
        numbers = [column.justify == "right" for column in columns]
        parts.append(table_of([list(map(escaped, row)) for row in rows], numbers))
        parts += [f"- {escaped(note)}\n" for note in (*MEANING, *overview_notes(overview))]
    return "\n".join(parts)


def print_overviews(leaderboard: Leaderboard, console: Console) -> None:
    """Print the overviews of a leaderboard in a terminal; a table too wide for it goes on below itself."""
    tables = overviews(leaderboard.boards)
    for table in tables:
        console.print(f"\n{overview_title(table)}", style="bold", markup=False, highlight=False)
        for columns in _parts(overview_columns(table), console.width):
            grid = Table()
            for column in columns:
                numbers = column.name != "estimator"
                grid.add_column(column.heading, justify=column.justify, no_wrap=numbers, overflow="fold")
            for k, entry in enumerate(table.entries):
                last = k + 1 < len(table.entries) and table.entries[k + 1].ranked < entry.ranked
                grid.add_row(*(column.cells[k] for column in columns), end_section=last)
            console.print(grid, highlight=False, markup=False)
        for note in overview_notes(table):
            say(console, note)
    if tables:
        say(console, "")
    for note in (*(MEANING if tables else ("no results",)), *not_run(leaderboard), *general_notes(leaderboard)):
        say(console, note)


def overview_title(table: Overview) -> str:
    """Return the heading of an overview."""
    on = "tasks of others" if table.of_others else table.robot
    return TITLES[table.kind] + ("" if on is None else f" on {on} (not official)")


def overview_columns(table: Overview) -> list[Column]:
    """Return the columns of an overview: estimator, mean rank, in how many tasks it is ranked, and the groups."""
    name = "method" if table.kind is Kind.CALIBRATION else "estimator"
    entries = table.entries
    return [
        Column("estimator", name, tuple(entry.estimator for entry in entries), "left"),
        Column("mean rank", "mean rank", tuple(f"{entry.mean_rank:.2f}" for entry in entries)),
        Column("ranked", "ranked in", tuple(f"{entry.ranked}/{table.tasks}" for entry in entries)),
        *(
            Column(group, group, tuple(_cell(entry.groups.get(group), len(tasks)) for entry in entries))
            for group, tasks in table.groups.items()
        ),
    ]


def overview_notes(table: Overview) -> list[str]:
    """Return who is not ranked in which tasks, and why."""
    return [_unranked_note(entry) for entry in table.entries if entry.unranked]


def _unranked_note(entry: OverviewEntry) -> str:
    named = [f"{one.task} ({one.reason})" for one in entry.unranked[:MOST_NAMED]]
    more = f" and {len(entry.unranked) - MOST_NAMED} more" if len(entry.unranked) > MOST_NAMED else ""
    return f"{entry.estimator} is not ranked in {', '.join(named)}{more}"


def _cell(score: GroupScore | None, tasks: int) -> str:
    if score is None:
        return "–"
    ratio = "–" if score.ratio is None else f"{score.ratio:#.3g}".rstrip(".") + "×"
    part = "" if score.ranked == tasks else f" {score.ranked}/{tasks}"
    return f"{score.mean_rank:.1f} · {ratio}{part}"


def _parts(columns: list[Column], width: int) -> Iterator[list[Column]]:
    """Yield the columns in parts that fit a width; each begins with the first column."""
    first, *rest = columns
    part = [first]
    for column in rest:
        if len(part) > 1 and sum(one.width + FRAME for one in (*part, column)) + 1 > width:
            yield part
            part = [first]
        part.append(column)
    yield part


def not_run(leaderboard: Leaderboard) -> list[str]:
    """Return which tasks could not be run, by the reason."""
    reasons: dict[str, list[str]] = {}
    for board in leaderboard.boards:
        if board.missing is not None:
            reasons.setdefault(board.missing, []).append(board.task)
    return [f"not run: {', '.join(tasks)}: {reason}" for reason, tasks in reasons.items()]
