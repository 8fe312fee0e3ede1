"""The boards of stored results, as commands show them."""

from collections.abc import Sequence
from pathlib import Path

from benchmarks.leaderboard.board import Leaderboard, build
from benchmarks.leaderboard.notes import general_notes
from benchmarks.tasks.task import Task
from castor_envs.errors import InputError, shortened

MOST_REASONS = 400
"""Characters of why tasks without results could not be run."""


def stored_boards(tasks: Sequence[Task], results: Path, cases: int | None) -> Leaderboard:
    """Return the leaderboard of some tasks; raises InputError where none has results and nothing else is to be said.

    cases: how many of each task, from the first; None: all.
    """
    board = build(tasks, results, cases)
    if not any(task.entries or task.declined for task in board.boards) and not general_notes(board):
        reasons = dict.fromkeys(f"; {task.missing}" for task in board.boards if task.missing is not None)
        why = shortened("".join(reasons), MOST_REASONS)
        names = shortened(", ".join(task.name for task in tasks))
        raise InputError(f"no results of {names} in {results}; castor-bench run --task NAME makes them{why}")
    return board
