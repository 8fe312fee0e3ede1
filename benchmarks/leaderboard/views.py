"""A leaderboard for people (terminal, Markdown: mm and degrees) and for programs (JSON: SI, units in the keys)."""

from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.leaderboard.board import Entry, Leaderboard, TaskBoard
from benchmarks.leaderboard.columns import board_columns, fitting
from benchmarks.leaderboard.ranking import FEWEST_CASES, LEVEL
from benchmarks.results.archives import CorruptFileError
from benchmarks.results.rows import DECLINED, older_rows
from benchmarks.scoring.metric import Metric
from benchmarks.scoring.registry import BOARD_METRICS

FORMAT = "castor-leaderboard/1"


def as_json(leaderboard: Leaderboard) -> dict[str, Any]:
    """Return the leaderboard as plain data; scores in SI, with their units in their keys."""
    return {
        "format": FORMAT,
        "interval_level": LEVEL,
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
        "version": board.version,
        "title": board.title,
        "description": board.description,
        "primary_metric": board.metric.key,
        "unit": board.metric.unit,
        "cases": len(board.cases),
        "odometry": board.odometry,
        "entries": [
            {
                "rank": entry.rank,
                "estimator": entry.estimator,
                "source_hash": entry.source_hash,
                "scores": {
                    BOARD_METRICS[name].key: {"mean": score.mean, "low": score.low, "high": score.high}
                    for name, score in entry.scores.items()
                },
                "time_per_update_us": entry.time_per_update_us,
                "cases_done": entry.done,
                "failed": [{"reason": failed.reason, "cases": list(failed.cases)} for failed in entry.failed],
                "lacking": list(entry.lacking),
                "stands_still": entry.stands_still,
            }
            for entry in board.entries
        ],
        "declined": [{"estimator": declined.estimator, "reason": declined.reason} for declined in board.declined],
        "missing": board.missing,
        "superseded": [
            {"estimator": name, "source_hash": source_hash, "rows": rows}
            for name, source_hash, rows in board.superseded
        ],
    }


def as_markdown(leaderboard: Leaderboard) -> str:
    """Return the leaderboard as Markdown, a table for each task with all its metrics."""
    parts = []
    for board in leaderboard.boards:
        parts.append(f"## {board.title}\n\n`{board.task}`, version {board.version}. {board.description}\n")
        if board.missing is not None:
            parts.append(f"Not run: {board.missing}\n")
        if board.entries:
            metrics = [board.metric, *(metric for metric in _present(board) if metric != board.metric)]
            header = _header(board, metrics)
            lines = [header, ["--:", "---", *["--:"] * (len(header) - 2)]]
            lines += [_cells(entry, metrics, board.odometry is None) for entry in board.entries]
            parts.append("".join(f"| {' | '.join(line)} |\n" for line in lines))
        parts += [f"- {note}\n" for note in _notes(board, intervals="in brackets")]
    parts += [f"{note}\n" for note in _general_notes(leaderboard)]
    return "\n".join(parts)


def print_leaderboard(leaderboard: Leaderboard, console: Console) -> None:
    """Print the leaderboard in a terminal, a table for each task with its main metrics, as many as the width holds."""
    narrow = False
    for board in leaderboard.boards:
        if not (board.entries or board.declined or board.missing):
            continue
        console.print(f"\n{board.title}", style="bold", markup=False, highlight=False)
        if board.missing is not None:
            _say(console, f"not run: {board.missing}")
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
        for note in _notes(board, intervals=None):
            _say(console, note)
    for note in _general_notes(leaderboard):
        _say(console, note)
    if narrow:
        _say(console, "narrow terminal: castor-bench leaderboard --markdown shows every score")


def _say(console: Console, text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def _present(board: TaskBoard) -> list[Metric]:
    return [metric for name, metric in BOARD_METRICS.items() if any(name in entry.scores for entry in board.entries)]


def _header(board: TaskBoard, metrics: list[Metric]) -> list[str]:
    titles = [f"{metric.title}, {metric.shown_unit}" for metric in metrics]
    if board.odometry is not None:
        return ["rank", "method", *titles]
    return ["rank", "estimator", *titles, "update, µs"]


def _cells(entry: Entry, metrics: list[Metric], timed: bool) -> list[str]:
    """Return a row of text, each score with its interval. timed: with the time of an update."""
    cells = ["–" if entry.rank is None else str(entry.rank), entry.estimator]
    for metric in metrics:
        score = entry.scores.get(metric.name)
        text = metric.shown(None if score is None else score.mean)
        if score is not None and score.low is not None:
            text += f" [{metric.shown(score.low)}, {metric.shown(score.high)}]"
        cells.append(text)
    if not timed:
        return cells
    return [*cells, "–" if entry.time_per_update_us is None else f"{entry.time_per_update_us:.1f}"]


def _notes(board: TaskBoard, intervals: str | None) -> list[str]:
    """Return the notes below a table: shared ranks, failures, cases not done, older sources.

    intervals: where in the table the intervals stand, or None if the notes do not mention them.
    """
    served = "this robot" if board.odometry is None else "this task"
    refusals = [f"{declined.estimator} declines {served}: {declined.reason}" for declined in board.declined]
    if not board.entries:
        return refusals
    meaning = [f"mean over {len(board.cases)} case{'s' * (len(board.cases) != 1)}"]
    too_few = len(board.cases) < FEWEST_CASES
    if intervals is not None and not too_few:
        meaning.append(f"{intervals} {100 * LEVEL:.0f} % intervals")
    if any(entry.rank is not None for entry in board.entries):
        shared = "who does not differ significantly (paired, 5 % family-wise) from the best of a rank shares it"
        meaning.append("too few to show a difference" if too_few else shared)
    if board.odometry is not None:
        meaning.append(f"odometry with the calibrated robot: {board.odometry}")
    notes = ["; ".join(meaning), *refusals]
    for entry in board.entries:
        for failed in entry.failed:
            cases = ", ".join(map(str, failed.cases[:3])) + (", ..." if len(failed.cases) > 3 else "")
            did, reason = "declined" if failed.declined else "failed", failed.reason.removeprefix(DECLINED)
            notes.append(f"{entry.estimator} {did} {len(failed.cases)} of {len(board.cases)} cases ({cases}): {reason}")
        if entry.stands_still:
            notes.append(f"{entry.estimator} is not ranked: its ATE is no better than that of standing still")
        if entry.lacking:
            notes.append(f"{entry.estimator} has not run {len(entry.lacking)} of {len(board.cases)} cases; run again")
    if board.superseded:
        left_out = ", ".join(f"{name} at {source_hash} ({rows})" for name, source_hash, rows in board.superseded)
        notes.append(f"rows of other versions of an estimator's source are left out: {left_out}")
    return notes


def _general_notes(leaderboard: Leaderboard) -> list[str]:
    notes = [f"not shown: rows of {task} version {version}" for task, version in leaderboard.other_versions]
    if leaderboard.older_formats:
        remedy = "are not shown; run the tasks again, or remove the folder"
        notes.append(older_rows(leaderboard.older_formats, leaderboard.folder, remedy))
    if leaderboard.refused:
        notes.append(
            f"rows refused: {_listed(leaderboard.refused)}; castor-bench run computes them again, or delete them"
        )
    if leaderboard.refused_episodes:
        listed = _listed(leaderboard.refused_episodes)
        notes.append(f"episodes refused: {listed}; castor-bench run records them again")
    return notes


def _listed(refused: Sequence[CorruptFileError], shown: int = 3) -> str:
    """Return refused files with the reasons, in one line; of many the first `shown`."""
    unshown = f"; and {len(refused) - shown} more (--json lists all)" if len(refused) > shown else ""
    return "; ".join(map(str, refused[:shown])) + unshown
