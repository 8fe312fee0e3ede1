"""``castor-bench robot``."""

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.robots.command import check_robot, new_robot
from castor_envs.errors import InputError


def robot_file(
    file: Annotated[str, typer.Argument(help="A robot's or train's file (.json), or a preset's name.")],
    new: Annotated[bool, typer.Option("--new", help="Ask for a robot and write it to the file.")] = False,
    force: Annotated[bool, typer.Option("--force", help="With --new: replace a file that is there.")] = False,
    png: Annotated[Path | None, typer.Option(help="Draw the layout to this file (PNG).")] = None,
    as_json_text: Annotated[bool, typer.Option("--json", help="Print JSON (castor-robot-check/1).")] = False,
) -> None:
    """Check a robot's file: layout, what it can do, what is odd; or ask for a new one. Exit code 1 if it is invalid.

    Lines that begin with CHECK name what is allowed and hardly meant, such as millimetres given as metres.
    """
    if force and not new:
        raise InputError("--force is for --new")
    if new and as_json_text:
        raise InputError("--new asks questions; check the file with --json afterwards")
    if new:
        new_robot(file, png, force)
    elif not check_robot(file, png, as_json_text):
        raise typer.Exit(1)
