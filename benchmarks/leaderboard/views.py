"""Boards for people (terminal, Markdown: mm and degrees) and for programs (JSON: SI, units in the keys; CSV: SI)."""

import csv
import io
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.leaderboard.board import Entry, Leaderboard, TaskBoard
from benchmarks.leaderboard.columns import board_columns, fitting
from benchmarks.leaderboard.markdown import escaped, table_of
from benchmarks.leaderboard.notes import board_notes, general_notes, say
from benchmarks.leaderboard.overview import overviews
from benchmarks.leaderboard.overview_views import overviews_json
from benchmarks.leaderboard.ranking import LEVEL
from benchmarks.scoring.metric import Metric
from benchmarks.scoring.registry import BOARD_METRICS

FORMAT = "castor-leaderboard/2"
CSV_COLUMNS = (
    *("group", "task", "version", "estimator", "source_hash", "rank", "metric", "unit", "mean", "low", "high"),
    *("cases", "cases_done", "cases_failed", "cases_declined", "cases_lacking"),
    *("mean_update_us", "worst_update_us"),
)


def as_json(leaderboard: Leaderboard) -> dict[str, Any]:
    """Return the leaderboard as plain data; scores in SI, with their units in their keys."""
    return {
        "format": FORMAT,
        "interval_level": LEVEL,
        "overview": overviews_json(overviews(leaderboard.boards)),
        "tasks": [_board_json(board) for board in leaderboard.boards],
        "not_shown": [{"task": task, "version": version} for task, version in leaderboard.other_versions],
        "older_formats": list(leaderboard.older_formats),
        "refused": [
            {"path": str(error.path), "reason": error.reason}
            for error in (*leaderboard.refused, *leaderboard.refused_episodes)
        ],
    }


def _board_json(board: TaskBoard) -> dict[str, Any]:
    return {
        "task": board.task,
        "group": board.group,
        "version": board.version,
        "title": board.title,
        "description": board.description,
        "primary_metric": board.metric.key,
        "unit": board.metric.unit,
        "cases": len(board.cases),
        "cases_of_task": None if board.official is None else len(board.official),
        "cases_beyond": board.beyond,
        "odometry": board.odometry,
        "entries": [_entry_json(entry) for entry in board.entries],
        "ceiling": None if board.ceiling is None else _entry_json(board.ceiling),
        "floor": None if board.floor is None else _entry_json(board.floor),
        "declined": [{"estimator": declined.estimator, "reason": declined.reason} for declined in board.declined],
        "missing": board.missing,
        "superseded": [
            {"estimator": name, "source_hash": source_hash, "rows": rows}
            for name, source_hash, rows in board.superseded
        ],
    }


def _entry_json(entry: Entry) -> dict[str, Any]:
    return {
        "rank": entry.rank,
        "estimator": entry.estimator,
        "source_hash": entry.source_hash,
        "scores": {
            BOARD_METRICS[name].key: {"mean": score.mean, "low": score.low, "high": score.high}
            for name, score in entry.scores.items()
        },
        "mean_update_us": entry.costs[0],
        "worst_update_us": entry.costs[1],
        "updates_timed_on": None if entry.cost is None or entry.cost.machine is None else str(entry.cost.machine),
        "poses_repeat": None if entry.cost is None else entry.cost.repeats,
        "cases_done": entry.done,
        "failed": [{"reason": failed.reason, "cases": list(failed.cases)} for failed in entry.failed],
        "lacking": list(entry.lacking),
        "stands_still": entry.stands_still,
    }


def as_markdown(leaderboard: Leaderboard) -> str:
    """Return the leaderboard as Markdown, a table for each task with all its metrics."""
    parts = []
    for board in leaderboard.boards:
        title, description = escaped(board.title), escaped(board.description)
        parts.append(f"## {title}\n\n`{board.task}`, version {board.version}. {description}\n")
        if board.missing is not None:
            parts.append(f"Not run: {escaped(board.missing)}\n")
        if board.entries:
            rows = [[rank, escaped(name), *scores] for rank, name, *scores in whole_table(board)]
            parts.append(table_of(rows, [column != 1 for column in range(len(rows[0]))]))
        parts += [f"- {escaped(note)}\n" for note in board_notes(board, intervals="in brackets")]
    parts += [f"{escaped(note)}\n" for note in general_notes(leaderboard)]
    return "\n".join(parts)


def whole_table(board: TaskBoard) -> list[list[str]]:
    """Return a board with all its metrics as text, the header first; its second column is text, the others numbers."""
    metrics = [board.metric, *(metric for metric in _present(board) if metric != board.metric)]
    return [_header(board, metrics), *(_cells(entry, metrics, board.odometry is None) for entry in board.rows)]


def as_csv(leaderboard: Leaderboard) -> str:
    """Return a row for each estimator of each task: its score by the metric that ranks, in SI, and cases by outcome."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(CSV_COLUMNS)
    for board in leaderboard.boards:
        for entry in board.entries:
            score = entry.scores.get(board.metric.name)
            numbers = (None, None, None) if score is None else (score.mean, score.low, score.high)
            declined = sum(len(failure.cases) for failure in entry.failed if failure.declined)
            failed = sum(len(failure.cases) for failure in entry.failed) - declined
            outcomes = (len(board.cases), entry.done, failed, declined, len(entry.lacking))
            row = (board.group, board.task, board.version, entry.estimator, entry.source_hash, entry.rank)
            writer.writerow((*row, board.metric.key, board.metric.unit, *numbers, *outcomes, *entry.costs))
    return text.getvalue()


def print_leaderboard(leaderboard: Leaderboard, console: Console) -> None:
    """Print the leaderboard in a terminal, a table for each task with its main metrics, as many as the width holds."""
    narrow = False
    for board in leaderboard.boards:
        if not (board.entries or board.declined or board.missing):
            continue
        console.print(f"\n{board.title}", style="bold", markup=False, highlight=False)
        if board.missing is not None:
            say(console, f"not run: {board.missing}")
        if board.entries:
            columns, left_out = fitting(board_columns(board), console.width)
            narrow = narrow or left_out
            table = Table()
            for column in columns:
                # Numbers are never cut or wrapped; a name too long for any terminal is.
                numbers = column.name != "estimator"
                table.add_column(column.heading, justify=column.justify, no_wrap=numbers, overflow="fold")
            for cells in zip(*(column.cells for column in columns), strict=True):
                table.add_row(*cells)
            console.print(table, highlight=False, markup=False)
        for note in board_notes(board, intervals=None):
            say(console, note)
    for note in general_notes(leaderboard):
        say(console, note)
    if narrow:
        say(console, "narrow terminal: castor-bench leaderboard --markdown shows every score")


def _present(board: TaskBoard) -> list[Metric]:
    return [metric for name, metric in BOARD_METRICS.items() if any(name in entry.scores for entry in board.entries)]


def _header(board: TaskBoard, metrics: list[Metric]) -> list[str]:
    titles = [f"{metric.title}, {metric.shown_unit}" for metric in metrics]
    if board.odometry is not None:
        return ["rank", "method", *titles]
    return ["rank", "estimator", *titles, "update, µs", "worst, µs"]


def _cells(entry: Entry, metrics: list[Metric], timed: bool) -> list[str]:
    """Return a row of text, each score with its interval. timed: with the time of an update."""
    cells = ["–" if entry.rank is None else str(entry.rank), entry.shown]
    for metric in metrics:
        score = entry.scores.get(metric.name)
        text = metric.shown(None if score is None else score.mean)
        if score is not None and score.low is not None:
            text += f" [{metric.shown(score.low)}, {metric.shown(score.high)}]"
        cells.append(text)
    if not timed:
        return cells
    return [*cells, *("–" if cost is None else f"{cost:.1f}" for cost in entry.costs)]
