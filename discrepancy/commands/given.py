"""The logs and the vehicle that commands are given, and how they print what they found."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from castor_envs.errors import InputError
from castor_envs.logs.recordings import refuse_recording
from castor_envs.vehicles.load import Vehicle, load_vehicle

ROBOT_FILE, TRAIN_FILE = "robot.json", "train.json"
Logs = Annotated[
    list[Path], typer.Argument(help="Logs of the robot: CSV files, one for each run, or folders: all *.csv in them.")
]
Robot = Annotated[
    str | None, typer.Option(help=f"A preset's name, or a robot file (.json). Default: {ROBOT_FILE} beside the logs.")
]


def tell(data: dict[str, Any], told: Sequence[str | Table], as_json: bool) -> None:
    """Print data as JSON, or lines and tables."""
    if as_json:
        print(json.dumps(data, indent=2, allow_nan=False))
        return
    console = Console(highlight=False, markup=False, soft_wrap=True)
    for part in told:
        console.print(part)


def logs_of(given: list[Path]) -> list[Path]:
    """Return the logs given, those of a folder by name."""
    paths = []
    for path in given:
        if path.is_dir():
            found = sorted(path.glob("*.csv"))
            if not found:
                refuse_recording(path)
                raise InputError(f"{path}: is a folder without logs (*.csv)")
            paths += found
        elif path.is_file() and path.suffix.lower() == ".json":
            raise InputError(f"{path}: is a robot file, not a log; give it as --robot {path}, and logs as CSV files")
        else:
            paths.append(path)
    return paths


def vehicle_of(spec: str | None, logs: list[Path]) -> Vehicle:
    """Return the robot, or train, that a spec names; without one, that of the file beside the logs."""
    if spec is not None:
        return load_vehicle(spec)
    vehicles: dict[Path, Vehicle] = {}
    for log in logs:
        if not log.exists():
            raise InputError(f"{log}: cannot be read (No such file or directory)")
        file = next((candidate for name in (ROBOT_FILE, TRAIN_FILE) if (candidate := log.parent / name).exists()), None)
        if file is None:
            raise InputError(f"{log}: has no {ROBOT_FILE} beside it; name the robot with --robot")
        if file not in vehicles:
            vehicles[file] = load_vehicle(str(file))
    first, *rest = vehicles
    for path in rest:
        if vehicles[path].hash() != vehicles[first].hash():
            raise InputError(f"{first} and {path}: are different robots; inspect their logs one robot at a time")
    return vehicles[first]
