"""``castor-diagnose find``."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from castor_envs.errors import InputError
from castor_envs.files import new_folder, write_atomically, write_json
from castor_envs.logs.csv import read_log
from castor_envs.logs.trajectory_files import write_drive
from castor_envs.vehicles.load import file_name
from castor_envs.vehicles.train import TrainDescription
from discrepancy.commands.given import Logs, Robot, logs_of, tell, vehicle_of
from discrepancy.diagnose import examine
from discrepancy.posterior.verdicts import Material
from discrepancy.report import sentences
from discrepancy.trains.examine import examine_train


def find(
    logs: Logs,
    robot: Robot = None,
    holdout: Annotated[
        list[Path] | None, typer.Option(help="Logs, or folders of logs, that must confirm each effect.")
    ] = None,
    clean: Annotated[
        list[Path] | None,
        typer.Option(help="Logs, or folders, of the robot without the fault: only what goes beyond them is named."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            help="Write report.html, diagnosis.json and robot.json, or train.json, with the effects named to this new "
            "folder."
        ),
    ] = None,
    separate: Annotated[
        Path | None,
        typer.Option(help="Write the drive that would distinguish the names of an ambiguous answer to this CSV file."),
    ] = None,
    material: Annotated[float, typer.Option(help="mm after 10 m, and mrad after a turn, that matter.", min=0)] = 1.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON (castor-diagnosis/2).")] = False,
) -> None:
    """Name the effects that the robot file lacks; the word `find` may be left out.

    Verdicts: named; ambiguous (these motions cannot distinguish several effects); unconfirmed (the held-out logs do not
    confirm it); unexplained (no effect of the catalogue explains the logs); negligible (it costs less than --material,
    or clean logs show it as large); no discrepancy.
    """
    for option, path, what in (("--out", out, "folder"), ("--separate", separate, "file")):
        if path is not None and path.exists():
            raise InputError(f"{option} {path}: is there already; name a new {what}")
    paths = [logs_of(given or []) for given in (logs, holdout, clean)]
    _check_apart(*paths)
    description = vehicle_of(robot, paths[0])
    if separate is not None and isinstance(description, TrainDescription):
        raise InputError(f"--separate {separate}: {description.name} is a train; drives are for single robots")
    named, held_out, before = ({str(path): read_log(path, description) for path in kind} for kind in paths)
    matters = Material(1e-3 * material, 1e-3 * material)
    if isinstance(description, TrainDescription):
        examined = examine_train(description, named, held_out, before, matters)
    else:
        examined = examine(description, named, held_out, before, matters)
    best = max(examined.drives, key=lambda drive: drive.expected, default=None)
    data = examined.data | {
        "robot_file": str(out / file_name(description)) if out and examined.found else None,
        "separating_drive_file": str(separate) if separate is not None and best is not None else None,
    }
    if out is not None:
        with new_folder(out) as partial:
            write_json(partial / "diagnosis.json", data)
            write_atomically(partial / "report.html", dataclasses.replace(examined, data=data).page())
            if examined.found is not None:
                examined.found.save(partial / file_name(examined.found))
    lines = sentences.as_lines(data)
    if separate is not None and best is None:
        lines.append(f"not written: {separate}: {sentences.why_no_drive(data)}")
    elif separate is not None and best is not None:
        write_drive(separate, best.trajectory, description.sample_period)
        lines.append(f"written: {separate}: {best.what}")
    tell(data, [*lines, *([] if out is None else [f"written: {out}"])], as_json)


def _check_apart(logs: Sequence[Path], held_out: Sequence[Path], clean: Sequence[Path]) -> None:
    """Raise InputError for a log that is given twice: it would confirm itself, or count as two."""
    given: dict[Path, str] = {}
    for what, paths in (("a log", logs), ("--holdout", held_out), ("--clean", clean)):
        for path in paths:
            if (before := given.get(path.resolve())) is not None:
                raise InputError(f"{path}: is given twice, as {before} and as {what}; give it once")
            given[path.resolve()] = what
