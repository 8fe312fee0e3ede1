"""The columns of a task's board in a terminal, and which of them a width holds."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from rich.cells import cell_len

from benchmarks.leaderboard.board import Entry, TaskBoard
from benchmarks.leaderboard.ranking import LEVEL
from benchmarks.scoring.metric import INTERVAL_KEEP, TIME_KEEP, WORST_TIME_KEEP, Metric
from benchmarks.scoring.registry import BOARD_METRICS

FRAME = 3
"""Width of a column's border and padding; one border more closes the table."""


@dataclass(frozen=True)
class Column:
    """A column of text. keep: None: always shown; else, in a narrow terminal, columns of lowest `keep` go first."""

    name: str
    heading: str
    cells: tuple[str, ...]
    justify: Literal["left", "right"] = "right"
    keep: int | None = None

    @property
    def width(self) -> int:
        """Width of the heading or the widest cell in a terminal."""
        return max(map(cell_len, (self.heading, *self.cells)))


def board_columns(board: TaskBoard) -> list[Column]:
    """Return all columns that a terminal may be shown: the main metrics, an interval for the ranking one."""
    entries, primary = board.rows, board.metric
    columns = [
        Column("rank", "rank", tuple("–" if entry.rank is None else str(entry.rank) for entry in entries)),
        Column(
            "estimator",
            "estimator" if board.odometry is None else "method",
            tuple(entry.shown for entry in entries),
            "left",
        ),
        _scores("primary", primary, entries),
    ]
    intervals = tuple(_interval(entry, primary) for entry in entries)
    if any(intervals):
        cells = tuple(text or "–" for text in intervals)
        columns.append(Column("interval", f"{100 * LEVEL:.0f} %", cells, keep=INTERVAL_KEEP))
    further = [
        (metric.column, metric)
        for name, metric in BOARD_METRICS.items()
        if metric.column is not None and name != primary.name and any(name in entry.scores for entry in entries)
    ]
    for place, metric in sorted(further, key=lambda pair: pair[0].place):
        columns.append(_scores(metric.name, metric, entries, place.keep))
    if board.odometry is None:
        for name, heading, keep in (("mean", "update, µs", TIME_KEEP), ("worst", "worst, µs", WORST_TIME_KEEP)):
            costs = (None if entry.cost is None else getattr(entry.cost, name) for entry in entries)
            cells = tuple("–" if cost is None else f"{cost:.1f}" for cost in costs)
            columns.append(Column(f"{name} time", heading, cells, keep=keep))
    return columns


def fitting(columns: list[Column], width: int) -> tuple[list[Column], bool]:
    """Return the columns that a terminal of a width holds, and whether any had to be left out."""
    kept = list(columns)
    for keep in sorted(column.keep for column in columns if column.keep is not None):
        if sum(column.width + FRAME for column in kept) + 1 <= width:
            break
        kept = [column for column in kept if column.keep is None or column.keep > keep]
    return kept, len(kept) < len(columns)


def _scores(name: str, metric: Metric, entries: Sequence[Entry], keep: int | None = None) -> Column:
    scores = [entry.scores.get(metric.name) for entry in entries]
    cells = tuple(metric.shown(None if score is None else score.mean) for score in scores)
    return Column(name, f"{metric.short}, {metric.shown_unit.replace('deg', '°')}", cells, keep=keep)


def _interval(entry: Entry, metric: Metric) -> str:
    score = entry.scores.get(metric.name)
    if score is None or score.low is None:
        return ""
    return f"{metric.shown(score.low)}–{metric.shown(score.high)}"
