"""One log, and what estimators make of it, as poses in TUM or KITTI text."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from benchmarks.export.cases import Form, write_poses
from benchmarks.show.command import Following
from benchmarks.show.drives import drive_of
from benchmarks.show.follow import failures, follow, poses
from benchmarks.tasks.task import Episode, Run
from castor_envs.errors import InputError
from castor_envs.files import new_folder
from castor_envs.logs.csv import read_log
from castor_envs.vehicles.load import load_vehicle


def export_log(path: Path, robot: str, out: Path, form: Form, by: Following) -> Mapping[str, str]:
    """Write the reference of a log and estimated poses, at the rows that are scored; return who gave none, and why.

    Raises InputError for a log without reference poses, and where `out` exists already or cannot be written.
    """
    if form == "csv":
        raise InputError(f"{path}: is CSV already; choose --format tum or --format kitti for its poses")
    vehicle = load_vehicle(robot)
    drive = drive_of(path.name, vehicle, read_log(path, vehicle))
    if not drive.known.any():
        raise InputError(f"{path}: has no reference to compare poses with; castor-bench show draws them")
    if not drive.headed.any():
        raise InputError(f"{path}: its reference has no headings, and {form} is of poses; castor-bench show draws it")
    run = Run(drive.log)
    answers = follow(
        [replace(drive, samples=run.samples)], by.competitors(vehicle, of_methods=False), by.timeout, by.processes
    )
    with new_folder(out) as partial:
        estimates = {name: (estimate,) for name, estimate in poses(answers, 0).items()}
        write_poses(partial / path.stem, Episode(vehicle, (run,)), form, estimates)
    return failures(answers)
