"""``castor-bench drive``."""

from pathlib import Path
from typing import Annotated

import typer

from benchmarks.drive.command import drive
from benchmarks.options import above_zero


def drive_by_hand(
    robot: Annotated[str, typer.Option(help="The robot or train: a preset's name or a file.")] = "asoc-prototype",
    floor: Annotated[
        str | None, typer.Option(help="A floor file or the name slippery; default: an even floor.")
    ] = None,
    estimator: Annotated[
        list[str] | None,
        typer.Option(
            "--estimator",
            help="A name, module:Class or file.py[:Class] (several times); default: wheel-odometry, of trains "
            "train-odometry.",
        ),
    ] = None,
    record: Annotated[
        Path | None, typer.Option(help="Write the drive to this new log (.csv), with the vehicle's file beside it.")
    ] = None,
    seed: Annotated[int | None, typer.Option(help="Seed of everything random.", min=0)] = None,
    duration: Annotated[float, typer.Option(help="End by itself after so many seconds.")] = 3600.0,
) -> None:
    """Drive a robot or a train by keyboard in a window, and watch where it is and where estimators believe it is."""
    above_zero("--duration", duration)
    drive(robot, floor, estimator or [], record, seed, duration)
