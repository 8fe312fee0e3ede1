"""The boards of many tasks in one table: estimators against groups of tasks, a mean rank and a ratio for each."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from statistics import fmean, geometric_mean
from typing import NamedTuple

from benchmarks.leaderboard.board import Entry, TaskBoard
from benchmarks.leaderboard.ranking import places
from benchmarks.tasks.other_robots import TaskName

LEAST = 0.1
"""In ratios, scores below this count as this, in the unit for people (mm, degrees, mm/m): a good tracker's own error.
An estimator whose equations made a task's truth has an error of 0, and a ratio to 0 would mean nothing."""


class Kind(StrEnum):
    """What is compared: estimators of robots, of trains, or calibration methods."""

    ROBOTS = "robots"
    TRAINS = "trains"
    CALIBRATION = "calibration"


@dataclass(frozen=True)
class Unranked:
    """A task in which an estimator has no rank though it serves it, and why, such as "failed 2 of 20 cases"."""

    task: str
    reason: str


@dataclass(frozen=True)
class GroupScore:
    """What an estimator reached in the tasks of a group that it serves.

    mean_rank: mean of its places (see `ranking.places`) in all of these tasks. ratio: geometric mean, over the tasks,
    of its score divided by the best ranked one; None if it is unranked in any: leaving out hard tasks would flatter it.
    (Of normalised numbers only the geometric mean orders estimators in a way that does not depend on what they are
    divided by: P. J. Fleming and J. J. Wallace, "How not to lie with statistics", Comm. ACM 29, 1986.) ranked: in how
    many tasks it has a rank.
    """

    mean_rank: float
    ratio: float | None
    ranked: int
    unranked: tuple[Unranked, ...]


@dataclass(frozen=True)
class OverviewEntry:
    """A row of an overview. mean_rank: mean over the groups that it serves. ranked: in how many tasks it has a rank."""

    estimator: str
    mean_rank: float
    ranked: int
    groups: dict[str, GroupScore]

    @property
    def ratio(self) -> float:
        """The geometric mean of its groups' ratios; infinite where it has none in one of them."""
        return geometric_mean([math.inf if score.ratio is None else score.ratio for score in self.groups.values()])

    @property
    def unranked(self) -> tuple[Unranked, ...]:
        """The tasks of all groups in which it has no rank though it serves them."""
        return tuple(one for score in self.groups.values() for one in score.unranked)


@dataclass(frozen=True)
class Overview:
    """One table. groups: the names of their tasks that have results. robot: label and hash of a user's robot, or None.

    of_others: whether the tasks are those of users' files.
    entries: those that are ranked in the most tasks first, among them by mean rank, and of these by ratio.
    """

    kind: Kind
    robot: str | None
    of_others: bool
    groups: dict[str, tuple[str, ...]]
    entries: tuple[OverviewEntry, ...]

    @property
    def tasks(self) -> int:
        """How many tasks have results."""
        return sum(map(len, self.groups.values()))


def overviews(boards: Sequence[TaskBoard]) -> tuple[Overview, ...]:
    """Return the overviews of the boards that have entries.

    Official ones stand first, those of users' tasks and of users' robots apart.
    """
    tables: dict[tuple[bool, str, Kind], list[TaskBoard]] = {}
    for board in boards:
        if board.entries:
            _, robot, source = TaskName.of(board.task)
            tables.setdefault((source is not None, robot or "", _kind(board)), []).append(board)
    order = sorted(tables, key=lambda key: (*key[:2], list(Kind).index(key[2])))
    return tuple(_overview(kind, robot or None, others, tables[others, robot, kind]) for others, robot, kind in order)


def _kind(board: TaskBoard) -> Kind:
    if board.odometry is not None:
        return Kind.CALIBRATION
    return Kind.TRAINS if board.of_train else Kind.ROBOTS


def _overview(kind: Kind, robot: str | None, of_others: bool, boards: list[TaskBoard]) -> Overview:
    grouped: dict[str, list[TaskBoard]] = {}
    for board in boards:
        grouped.setdefault(board.group, []).append(board)
    scores: dict[str, dict[str, GroupScore]] = {}
    for group, members in grouped.items():
        standings = [_standings(board) for board in members]
        for name in {name: None for board in standings for name in board}:
            scores.setdefault(name, {})[group] = _group_score([board[name] for board in standings if name in board])
    entries = [
        OverviewEntry(
            name,
            mean_rank=fmean(score.mean_rank for score in groups.values()),
            ranked=sum(score.ranked for score in groups.values()),
            groups=groups,
        )
        for name, groups in scores.items()
    ]
    entries.sort(key=lambda entry: (-entry.ranked, entry.mean_rank, entry.ratio, entry.estimator))
    groups = {group: tuple(board.task for board in members) for group, members in grouped.items()}
    return Overview(kind, robot, of_others, groups, tuple(entries))


class _Standing(NamedTuple):
    """One estimator on one board: its place, and its score divided by the best or why it has no rank."""

    place: float
    ratio: float
    unranked: Unranked | None


def _standings(board: TaskBoard) -> dict[str, _Standing]:
    """Return how each estimator of a board stands."""
    place = places({entry.estimator: entry.rank for entry in board.entries})
    means = {
        entry.estimator: max(entry.scores[board.metric.name].mean, LEAST / board.metric.factor)
        for entry in board.entries
        if entry.rank is not None
    }
    best = min(means.values(), default=math.nan)
    return {
        entry.estimator: _Standing(
            place[entry.estimator],
            means.get(entry.estimator, math.nan) / best,
            None if entry.rank is not None else Unranked(board.task, _why_unranked(entry, len(board.cases))),
        )
        for entry in board.entries
    }


def _group_score(standings: list[_Standing]) -> GroupScore:
    unranked = tuple(standing.unranked for standing in standings if standing.unranked is not None)
    return GroupScore(
        mean_rank=fmean(standing.place for standing in standings),
        ratio=None if unranked else geometric_mean(standing.ratio for standing in standings),
        ranked=len(standings) - len(unranked),
        unranked=unranked,
    )


def _why_unranked(entry: Entry, cases: int) -> str:
    """Return why an entry has no rank."""
    if entry.failed:
        did = "declined" if all(failure.declined for failure in entry.failed) else "failed"
        return f"{did} {sum(len(failure.cases) for failure in entry.failed)} of {cases} cases"
    if entry.lacking:
        return f"has not run {len(entry.lacking)} of {cases} cases"
    return "is no better than standing still"
