"""A leaderboard for people (terminal, Markdown: mm and degrees) and for programs (JSON: SI, units in the keys)."""

from typing import Any

from rich.console import Console
from rich.table import Table

from benchmarks.evaluation import METRICS, Metric
from benchmarks.leaderboard import Entry, Leaderboard, TaskBoard
from benchmarks.ranking import FEWEST_CASES, LEVEL

FORMAT = "castor-leaderboard/1"
_SHORT = ("nonsystematic_orientation_error", "end_point_position", "end_point_heading", "ate", "rpe_translation")


def as_json(leaderboard: Leaderboard) -> dict[str, Any]:
    """Return the leaderboard as plain data; scores in SI, with their units in their keys."""
    return {
        "format": FORMAT,
        "interval_level": LEVEL,
        "tasks": [_board_json(board) for board in leaderboard.boards],
        "not_shown": [{"task": task, "version": version} for task, version in leaderboard.other_versions],
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
        "entries": [
            {
                "rank": entry.rank,
                "estimator": entry.estimator,
                "source_hash": entry.source_hash,
                "scores": {
                    METRICS[name].key: {"mean": score.mean, "low": score.low, "high": score.high}
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
            lines = [_header(metrics), ["--:", "---", *["--:"] * (len(metrics) + 1)]]
            lines += [_cells(entry, metrics, everywhere=True) for entry in board.entries]
            parts.append("".join(f"| {' | '.join(line)} |\n" for line in lines))
        parts += [f"- {note}\n" for note in _notes(board)]
    parts += [f"{note}\n" for note in _general_notes(leaderboard)]
    return "\n".join(parts)


def print_leaderboard(leaderboard: Leaderboard, console: Console) -> None:
    """Print the leaderboard in a terminal, a table for each task with its main metrics."""
    for board in leaderboard.boards:
        console.print(f"\n{board.title}", style="bold", markup=False, highlight=False)
        if board.missing is not None:
            _say(console, f"not run: {board.missing}")
        if board.entries:
            present = _present(board)
            main = [board.metric, *(METRICS[name] for name in _SHORT if METRICS[name] in present)]
            metrics = list(dict.fromkeys(main))
            table = Table()
            for number, column in enumerate(_header(metrics)):
                table.add_column(column, justify="left" if number == 1 else "right", no_wrap=number == 1)
            for entry in board.entries:
                table.add_row(*_cells(entry, metrics, everywhere=False))
            console.print(table, highlight=False, markup=False)
        for note in _notes(board):
            _say(console, note)
    for note in _general_notes(leaderboard):
        _say(console, note)


def _say(console: Console, text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def _present(board: TaskBoard) -> list[Metric]:
    return [metric for name, metric in METRICS.items() if any(name in entry.scores for entry in board.entries)]


def _header(metrics: list[Metric]) -> list[str]:
    return ["rank", "estimator", *(f"{metric.title}, {metric.shown_unit}" for metric in metrics), "update, µs"]


def _cells(entry: Entry, metrics: list[Metric], everywhere: bool) -> list[str]:
    """Return a row of text; intervals for the first metric, or everywhere."""
    cells = ["–" if entry.rank is None else str(entry.rank), entry.estimator]
    for number, metric in enumerate(metrics):
        score = entry.scores.get(metric.name)
        text = metric.shown(None if score is None else score.mean)
        if score is not None and score.low is not None and (everywhere or number == 0):
            text += f" [{metric.shown(score.low)}, {metric.shown(score.high)}]"
        cells.append(text)
    return [*cells, "–" if entry.time_per_update_us is None else f"{entry.time_per_update_us:.1f}"]


def _notes(board: TaskBoard) -> list[str]:
    """Return what is said below a table: failures, cases not done, older sources."""
    few = len(board.cases) < FEWEST_CASES
    shared = f"in brackets {100 * LEVEL:.0f} % intervals; who shares a rank does not differ significantly"
    meaning = "too few to show a difference" if few else shared
    notes = [f"mean over {len(board.cases)} case{'s' * (len(board.cases) != 1)}; {meaning}"]
    for entry in board.entries:
        for failed in entry.failed:
            cases = ", ".join(map(str, failed.cases[:3])) + (", ..." if len(failed.cases) > 3 else "")
            notes.append(
                f"{entry.estimator} failed {len(failed.cases)} of {len(board.cases)} cases ({cases}): {failed.reason}"
            )
        if entry.stands_still:
            notes.append(f"{entry.estimator} is not ranked: its ATE is no better than that of standing still")
        if entry.lacking:
            notes.append(f"{entry.estimator} has not run {len(entry.lacking)} of {len(board.cases)} cases; run again")
    if board.superseded:
        others = ", ".join(f"{name} at {source_hash} ({rows})" for name, source_hash, rows in board.superseded)
        notes.append(f"rows of other versions of an estimator's source are left out: {others}")
    return notes if board.entries else []


def _general_notes(leaderboard: Leaderboard) -> list[str]:
    return [f"not shown: rows of {task} version {version}" for task, version in leaderboard.other_versions]
