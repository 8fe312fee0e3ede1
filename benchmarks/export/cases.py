"""Episodes as files for people and other programs: logs as CSV, poses as TUM or KITTI text."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal, get_args

from benchmarks.export.floor_map import write_floor_map
from benchmarks.results.episodes import run_name, write_episode, write_floor
from benchmarks.results.rows import ResultsStore
from benchmarks.tasks.task import Case, Episode, Task
from castor_envs.errors import InputError, did_you_mean
from castor_envs.files import new_folder
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.logs.trajectory_files import export_kitti, export_tum

Form = Literal["csv", "tum", "kitti"]


def export_form(name: str) -> Form:
    """Return the export form of a name; raises InputError for an unknown name."""
    forms: dict[str, Form] = {form: form for form in get_args(Form)}
    if name not in forms:
        raise InputError(f"--format {name!r} is not known{did_you_mean(name, forms)}; choose csv, tum or kitti")
    return forms[name]


def export_cases(task: Task, cases: Sequence[Case], out: Path, form: Form, results: Path | None = None) -> None:
    """Record cases and write each into a separate folder below `out`, which appears whole or not at all.

    results: a results folder; the estimates of its rows of these episodes are written too, as TUM or KITTI text. Raises
    InputError where `out` exists already or cannot be written, or for estimates as CSV.
    """
    if results is not None and form == "csv":
        raise InputError("--results adds estimated poses; choose --format tum or --format kitti for them")
    if task.missing is not None:
        raise InputError(f"task {task.name}: {task.missing}")
    with new_folder(out) as partial:
        for case in cases:
            episode = task.record(case)
            if form == "csv":
                write_episode(partial / f"case-{case}", episode)
            else:
                estimates = {} if results is None else stored_estimates(results, task, case, episode)
                write_poses(partial / f"case-{case}", episode, form, estimates)


def stored_estimates(results: Path, task: Task, case: Case, episode: Episode) -> dict[str, tuple[Array, ...]]:
    """Return the stored estimates of an episode's runs by the name and source hash of the estimator."""
    return {
        f"{row.estimator}-{row.source_hash}": row.estimates
        for row in ResultsStore(results).rows(task.name, task.version)
        if row.case == case and row.episode == episode.digest and row.failure is None
    }


def write_poses(folder: Path, episode: Episode, form: Form, estimates: Mapping[str, Sequence[Array]]) -> None:
    """Write the scored poses of every run, the true and the estimated ones: run-01-cw.tum, run-01-cw-cast-0-....tum.

    The floor, where it is known and not even, is beside them as a floor file and as a map that `evo_traj
    --ros_map_yaml` draws: run-01-cw-floor.json, .yaml and .png.

    A train has a file for each axle, such as run-01-axle-2.tum. These are the poses at `Run.samples`, so that `evo_ape`
    on TUM text, without alignment, finds the ATE of the board.
    """
    folder.mkdir(parents=True)
    for k, run in enumerate(episode.runs):
        name = run_name(k + 1, run)
        write_floor(folder, name, run)
        if run.floor is not None and run.floor != Floor():
            write_floor_map(folder / f"{name}-floor.yaml", run.floor, run.truth.reshape(-1, 3))
        made = {"": run.truth, **{f"-{_safe(author)}": poses[k] for author, poses in estimates.items()}}
        for author, poses in made.items():
            axles = {"": poses} if run.axles is None else {f"-axle-{i}": axle for i, axle in enumerate(poses, start=1)}
            for axle, path in axles.items():
                file = folder / f"{name}{axle}{author}.{form}"
                if form == "tum":
                    export_tum(file, run.log.t[run.samples], path)
                else:
                    export_kitti(file, path)


def _safe(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]", "_", name)
