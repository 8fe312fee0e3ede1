"""The columns of a task's board in a terminal, and which of them a width holds."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from rich.cells import cell_len

from benchmarks.leaderboard.board import Entry, TaskBoard
from benchmarks.leaderboard.ranking import LEVEL
from benchmarks.scoring.registry import METRICS, Metric

_ORDER = (
    "nonsystematic_orientation_error",
    "mean_axle_position",
    "final_axle_position",
    "end_point_position",
    "end_point_heading",
    "share_within_5cm",
    "sound_axle_chosen",
    "contradiction",
    "offset_error",
    "radius_error",
    "half_track_error",
    "pivot_zero_error",
    "ate",
    "rpe_translation",
)
_GOES_FIRST = (
    "nonsystematic_orientation_error",
    "contradiction",
    "end_point_heading",
    "time",
    "rpe_translation",
    "end_point_position",
    "ate",
    "offset_error",
    "half_track_error",
    "radius_error",
    "pivot_zero_error",
    "final_axle_position",
    "mean_axle_position",
    "share_within_5cm",
    "sound_axle_chosen",
    "interval",
)
"""What is left out where a terminal is narrow, the least important first."""

_FRAME = 3  # a column's border and padding; one border more closes the table


@dataclass(frozen=True)
class Column:
    """A column of text."""

    name: str
    heading: str
    cells: tuple[str, ...]
    justify: Literal["left", "right"] = "right"

    @property
    def width(self) -> int:
        """What the widest of heading and cells takes in a terminal."""
        return max(map(cell_len, (self.heading, *self.cells)))


def board_columns(board: TaskBoard) -> list[Column]:
    """Return all columns that a terminal may be shown: the main metrics, an interval for the ranking one."""
    entries, primary = board.entries, board.metric
    columns = [
        Column("rank", "rank", tuple("–" if entry.rank is None else str(entry.rank) for entry in entries)),
        Column(
            "estimator",
            "estimator" if board.odometry is None else "method",
            tuple(entry.estimator for entry in entries),
            "left",
        ),
        _scores("primary", primary, entries),
    ]
    intervals = tuple(_interval(entry, primary) for entry in entries)
    if any(intervals):
        columns.append(Column("interval", f"{100 * LEVEL:.0f} %", tuple(text or "–" for text in intervals)))
    others = [name for name in _ORDER if name != primary.name and any(name in entry.scores for entry in entries)]
    columns += [_scores(name, METRICS[name], entries) for name in others]
    if board.odometry is None:
        times = (entry.time_per_update_us for entry in entries)
        columns.append(Column("time", "µs", tuple("–" if time is None else f"{time:.1f}" for time in times)))
    return columns


def fitting(columns: list[Column], width: int) -> tuple[list[Column], bool]:
    """Return the columns that a terminal of a width holds, and whether any had to be left out."""
    kept = list(columns)
    for name in _GOES_FIRST:
        if sum(column.width + _FRAME for column in kept) + 1 <= width:
            break
        kept = [column for column in kept if column.name != name]
    return kept, len(kept) < len(columns)


def _scores(name: str, metric: Metric, entries: Sequence[Entry]) -> Column:
    scores = [entry.scores.get(metric.name) for entry in entries]
    cells = tuple(metric.shown(None if score is None else score.mean) for score in scores)
    return Column(name, f"{metric.short}, {metric.shown_unit.replace('deg', '°')}", cells)


def _interval(entry: Entry, metric: Metric) -> str:
    score = entry.scores.get(metric.name)
    if score is None or score.low is None:
        return ""
    return f"{metric.shown(score.low)}–{metric.shown(score.high)}"
