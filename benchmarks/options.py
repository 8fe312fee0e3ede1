"""The options that several commands of ``castor-bench`` share, and checks of what they are given."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from castor_envs.errors import InputError

LOADING = 60.0
"""s: how long a task of a file may take to be loaded, where no option says."""
DEFAULT_RESULTS = Path("castor-results")
DETAILS = "details: castor-bench leaderboard TASK..., or --group NAME"
"""Said below an overview."""

TaskNames = Annotated[
    list[str] | None,
    typer.Option("--task", help="Only this task: a name, or file.py[:Class] (may be given several times)."),
]
GroupNames = Annotated[
    list[str] | None, typer.Option("--group", help="Only the tasks of this group (may be given several times).")
]
Results = Annotated[Path, typer.Option("--results", help="The folder that results are kept in.")]
MeasuredData = Annotated[
    Path | None,
    typer.Option("--measured", envvar="CASTOR_DATA", help="The folder with measured data."),
]
OtherRobotName = Annotated[
    str | None,
    typer.Option("--robot", help="Another robot for the tasks of squares: a preset's name or a robot file."),
]


def with_rows(results: Path) -> None:
    """Raise InputError for a results folder without rows."""
    if not (results / "rows").is_dir():
        raise InputError(f"no results in {results}; run castor-bench run first, or name the folder with --results")


def above_zero(option: str, value: float) -> None:
    """Raise InputError for a number that is not above 0."""
    if not 0 < value <= 1e6:
        raise InputError(f"{option} must be above 0 and at most 1e6, got {value:g}")


def at_least(option: str, value: int | None, least: int, limit: int = 100_000) -> None:
    """Raise InputError for a number out of range."""
    if value is not None and not least <= value <= limit:
        raise InputError(f"{option} must lie between {least} and {limit}, got {value}")


def end_for(failing: Sequence[str]) -> None:
    """End a command with exit code 1, its last line naming those who gave no poses; do nothing where all did."""
    if failing:
        print(f"not all succeeded: {', '.join(failing)} gave no poses; the reasons are above", file=sys.stderr)
        raise typer.Exit(1)


def console() -> Console:
    """Return a console; text that goes to a file or a pipe is not cut to 80 columns."""
    console = Console()
    return console if console.is_terminal else Console(width=160)
