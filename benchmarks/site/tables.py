"""Boards and overviews as tables of pages: what each cell says, and by what it sorts."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from benchmarks.leaderboard.board import Entry, TaskBoard
from benchmarks.leaderboard.overview import Overview
from benchmarks.leaderboard.overview_views import overview_columns
from benchmarks.leaderboard.ranking import LEVEL, Interval
from benchmarks.scoring.metric import Metric
from benchmarks.scoring.registry import BOARD_METRICS

LOGARITHMIC = 20.0
"""Ratio of the largest to the smallest score from which intervals are drawn on a logarithmic axis."""


WHOLE = 100.0
"""Width of a column in which intervals are drawn; what lies outside is not."""


class Heading(NamedTuple):
    """Of a column. title: in more words."""

    text: str
    number: bool = True
    title: str = ""


class Bar(NamedTuple):
    """An interval as drawn, of `WHOLE` the column's width; low and high None where there is none."""

    mean: float
    low: float | None
    high: float | None


class Cell(NamedTuple):
    """What a cell says; sort: by what, "" for nothing; note: smaller, behind; link: where it leads."""

    text: str
    sort: str | float = ""
    note: str = ""
    link: str | None = None
    bar: Bar | None = None


@dataclass(frozen=True)
class Table:
    """A table whose second cell of each row names the row, or the first where there is no rank."""

    headings: tuple[Heading, ...]
    rows: tuple[tuple[Cell, ...], ...]
    names: int
    """The column that names rows."""


def overview_table(overview: Overview) -> Table:
    """Return an overview; a group's column sorts by the mean rank in it."""
    columns = overview_columns(overview)
    rows = []
    for k, entry in enumerate(overview.entries):
        groups = (entry.groups.get(group) for group in overview.groups)
        sorts = (entry.estimator, entry.mean_rank, entry.ranked, *("" if g is None else g.mean_rank for g in groups))
        rows.append(tuple(Cell(column.cells[k], sort) for column, sort in zip(columns, sorts, strict=True)))
    return Table(tuple(Heading(c.heading, c.justify == "right") for c in columns), tuple(rows), names=0)


def board_table(board: TaskBoard, link: Callable[[Entry], str | None] = lambda entry: None) -> Table:
    """Return a board with all its metrics; the ranking metric's intervals are drawn. link: to the page of a row."""
    metrics = [m for name, m in BOARD_METRICS.items() if any(name in entry.scores for entry in board.entries)]
    metrics.sort(key=lambda metric: metric != board.metric)
    drawn = [*board.entries, *([] if board.ceiling is None else [board.ceiling])]  # not who stands still, far off
    place, scale = _axis([e.scores[board.metric.name] for e in drawn if board.metric.name in e.scores], board.metric)
    headings = [Heading("rank"), Heading("estimator" if board.odometry is None else "method", number=False)]
    for metric in metrics:
        headings.append(Heading(f"{metric.title}, {metric.shown_unit}", title=metric.description))
        if metric == board.metric:
            headings.append(Heading(f"{100 * LEVEL:.0f} % interval, {scale}", number=False))
    if board.odometry is None:
        headings += [Heading("update, µs", title="mean CPU time of an update"), Heading("worst, µs")]
    rows = []
    for entry in board.rows:
        cells = [
            Cell("–" if entry.rank is None else str(entry.rank), "" if entry.rank is None else entry.rank),
            Cell(entry.shown, entry.estimator, link=link(entry) if entry in board.entries else None),
        ]
        for metric in metrics:
            score = entry.scores.get(metric.name)
            cells.append(_score(metric, score, noted=metric != board.metric))
            if metric == board.metric:
                cells.append(Cell(_limits(metric, score), "" if score is None else score.mean, bar=_bar(score, place)))
        if board.odometry is None:
            cells += [Cell("–") if cost is None else Cell(f"{cost:.1f}", cost) for cost in entry.costs]
        rows.append(tuple(cells))
    return Table(tuple(headings), tuple(rows), names=1)


def _score(metric: Metric, score: Interval | None, noted: bool) -> Cell:
    if score is None:
        return Cell("–")
    limits = _limits(metric, score)
    return Cell(metric.shown(score.mean), score.mean, f"[{limits}]" if noted and limits else "")


def _limits(metric: Metric, score: Interval | None) -> str:
    if score is None or score.low is None:
        return ""
    return f"{metric.shown(score.low)} to {metric.shown(score.high)}"


def _bar(score: Interval | None, place: Callable[[float], float]) -> Bar | None:
    if score is None or not 0 <= place(score.mean) <= WHOLE:
        return None
    if score.low is None or score.high is None:
        return Bar(place(score.mean), None, None)
    low, high = (min(max(place(end), 0.0), WHOLE) for end in (score.low, score.high))
    return Bar(place(score.mean), low, high)


def _axis(scores: Sequence[Interval], metric: Metric) -> tuple[Callable[[float], float], str]:
    """Return where values lie in a column's width, in hundredths, and what the axis is, in words."""
    means = [score.mean for score in scores]
    ends = [end for score in scores for end in (score.mean, score.low, score.high) if end is not None]
    least, top = min(means, default=0.0), max(ends, default=1.0) or 1.0
    if least > metric.rounding and max(means) / least > LOGARITHMIC:
        bottom = min([end for end in ends if end > 0.3 * least])

        def logarithmic(value: float) -> float:
            return round(WHOLE * math.log(max(value, 1e-3 * bottom) / bottom) / math.log(top / bottom), 2)

        return logarithmic, f"logarithmic from {metric.shown(bottom)} to {metric.shown(top)}"
    return (lambda value: round(WHOLE * value / top, 2)), f"from 0 to {metric.shown(top)}"
