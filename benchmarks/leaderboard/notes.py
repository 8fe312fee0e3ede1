"""The notes below boards: shared ranks, failures, cases not done, files that cannot be used."""

from collections.abc import Sequence

from rich.console import Console

from benchmarks.leaderboard.board import Leaderboard, TaskBoard
from benchmarks.leaderboard.ranking import FEWEST_CASES, LEVEL
from benchmarks.results.archives import CorruptFileError
from benchmarks.results.references import CEILING, FLOOR
from benchmarks.results.rows import DECLINED, older_rows
from castor_envs.errors import shortened


def say(console: Console, text: str) -> None:
    """Print a line as it is: names of others' plug-ins are no markup."""
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def board_notes(board: TaskBoard, intervals: str | None) -> list[str]:
    """Return the notes below a table: shared ranks, failures, cases not done, older sources.

    intervals: where in the table the intervals stand, or None if the notes do not mention them.
    """
    served = "this robot" if board.odometry is None else "this task"
    refusals = [f"{declined.estimator} declines {served}: {declined.reason}" for declined in board.declined]
    if not board.entries:
        return refusals
    meaning = [f"mean over {len(board.cases)} case{'s' * (len(board.cases) != 1)}{_of_the_tasks_own(board)}"]
    too_few = len(board.cases) < FEWEST_CASES
    if intervals is not None and not too_few:
        meaning.append(f"{intervals} {100 * LEVEL:.0f} % intervals")
    if any(entry.rank is not None for entry in board.entries):
        shared = "who does not differ significantly (paired, 5 % family-wise) from the best of a rank shares it"
        meaning.append("too few to show a difference" if too_few else shared)
    if board.odometry is not None:
        meaning.append(f"odometry with the calibrated robot: {board.odometry}")
    notes = ["; ".join(meaning), *refusals]
    if board.ceiling is not None:
        notes.append(f"{CEILING} is told what nobody can know: a yardstick, no strict bound; it is no estimator")
    if board.floor is not None:
        notes.append(
            f"{FLOOR} never moves: where a drive ends near its start, its last position is nearly right, and its "
            "heading is off by the full turns driven"
        )
    for entry in board.entries:
        for failed in entry.failed:
            cases = ", ".join(map(str, failed.cases[:3])) + (", ..." if len(failed.cases) > 3 else "")
            did, reason = "declined" if failed.declined else "failed", failed.reason.removeprefix(DECLINED)
            notes.append(f"{entry.estimator} {did} {len(failed.cases)} of {len(board.cases)} cases ({cases}): {reason}")
        if entry.stands_still:
            notes.append(f"{entry.estimator} is not ranked: its ATE is no better than that of standing still")
        if entry.lacking:
            notes.append(f"{entry.estimator} has not run {len(entry.lacking)} of {len(board.cases)} cases; run again")
    timed = _timed_on(board)
    if len(timed) > 1:
        on = "; ".join(f"on {machine} {', '.join(names)}" for machine, names in timed.items())
        notes.append(f"updates were timed on several machines, and compare within one alone: {on}")
    if board.superseded:
        left_out = ", ".join(f"{name} at {source_hash} ({rows})" for name, source_hash, rows in board.superseded)
        notes.append(f"rows of other versions of an estimator's source are left out: {left_out}")
    return notes


def _timed_on(board: TaskBoard) -> dict[str, list[str]]:
    """Return the machines on which updates were timed, each with the estimators timed there."""
    machines: dict[str, list[str]] = {}
    for entry in board.entries:
        if entry.cost is not None and entry.cost.machine is not None:
            machines.setdefault(str(entry.cost.machine), []).append(entry.estimator)
    return machines


def _of_the_tasks_own(board: TaskBoard) -> str:
    """Return how a board's cases differ from those that its task has, nothing where they do not."""
    if board.official is None or set(board.cases) == set(board.official):
        return ""
    own, all_own = len(board.cases) - board.beyond, len(board.official)
    if not board.beyond:
        return f" (of the task's {all_own})"
    return (
        f" (the task's {all_own} and {board.beyond} more)"
        if own == all_own
        else (f" ({own} of the task's {all_own}, and {board.beyond} more)")
    )


def general_notes(leaderboard: Leaderboard) -> list[str]:
    """Return the notes on a whole folder of results: what is not shown, and why."""
    notes = [f"not shown: rows of {task} version {version}" for task, version in leaderboard.other_versions]
    notes += _unrepeated(leaderboard)
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


def _unrepeated(leaderboard: Leaderboard) -> list[str]:
    """Return which estimators gave other poses when they followed a log again, in which tasks."""
    tasks: dict[str, list[str]] = {}
    for board in leaderboard.boards:
        for entry in board.entries:
            if entry.cost is not None and not entry.cost.repeats:
                tasks.setdefault(entry.estimator, []).append(board.task)
    return [
        f"{estimator}: poses differ between two passes over the same log ({shortened(', '.join(names))}): it keeps "
        "state between episodes, or draws random numbers without a seed; castor-bench check says more"
        for estimator, names in tasks.items()
    ]


def _listed(refused: Sequence[CorruptFileError], shown: int = 3) -> str:
    """Return refused files with the reasons, in one line; of many the first `shown`."""
    unshown = f"; and {len(refused) - shown} more (--json lists all)" if len(refused) > shown else ""
    return "; ".join(map(str, refused[:shown])) + unshown
