"""``castor-bench calibrate``: from logs of a robot to a calibrated robot file; prints each number before and after."""

import io
import json
import math
from collections.abc import Sequence
from pathlib import Path
from string import ascii_letters
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.options import LOADING
from castor_envs.errors import InputError
from castor_envs.files import check_writable, write_atomically, writing
from castor_envs.logs.csv import read_log
from castor_envs.logs.pace import wrong_times
from castor_envs.motion.kinematics import Geometry
from castor_envs.processes import Job, OneWorker
from castor_envs.vehicles.load import load_robot
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.identifiability import COVERAGE
from estimators.calibration.parameters import parameters_of, values_of
from estimators.calibration.protocol import Recording, Report, ReportingMethod, Result
from estimators.calibration.umbmark import directions_of, return_errors
from estimators.plugins.find import runs_others_code
from estimators.plugins.registry import CALIBRATION, CalibrationEntry, load_calibration

FORMAT = "castor-calibration/1"
SHOWN = {"m": ("mm", 1e3), "rad": ("deg", 180 / np.pi), "1": ("1", 1.0)}
"""Units for people, and the factor from SI."""


def calibrate_logs(
    logs: Sequence[Path],
    robot: str,
    out: Path,
    method: str | None,
    side: float | None,
    pivots: bool,
    scatter: Path | None,
    as_json: bool,
    console: Console,
) -> None:
    """Calibrate the robot that `robot` names from logs, write it to `out`, and print what changed.

    method: the spec of a calibration method; None: maximum likelihood, or the correction from squares where `side` is
    given. side: of the UMBmark squares that were driven, m. pivots: whether the places of free castors' pivots are
    found too. scatter: file for a picture of the squares' end points. Raises InputError where logs, robot or options do
    not suit, or `out` exists already.
    """
    _check_new("--out", out, ".json")
    if scatter is not None:
        _check_new("--scatter", scatter, ".png")
    described = load_robot(robot)
    spec = method or ("maximum-likelihood" if side is None else "umbmark-correction")
    entry = _entry(spec)
    _check_options(entry, side, pivots, scatter)
    recordings = _read(logs, described, side)
    report = (_of_built_in if entry.builtin else _of_plug_in)(entry, described, recordings, pivots)
    picture = None if scatter is None or side is None else _drawn(described, report.calibrated, recordings, side)
    with writing(f"--out {out}"):
        report.calibrated.save(out)
    if scatter is not None and picture is not None:
        try:
            write_atomically(scatter, picture)
        except OSError as error:
            out.unlink()
            raise InputError(f"--scatter {scatter}: cannot be written to ({error.strerror or error})") from None
    title = str(getattr(entry.kind, "title", entry.name))
    if as_json:
        print(json.dumps(_as_json(title, described, report), indent=2, allow_nan=False))
        return
    _print(console, described, title, report)
    if described.effects:
        names = ", ".join(effect.name for effect in described.effects)
        kept = f"the robot file's effects ({names}) are kept; leave out those that were calibrated"
        console.print(kept, highlight=False, markup=False, soft_wrap=True)
    console.print(f"{out}: the calibrated robot", highlight=False, markup=False, soft_wrap=True)


def _entry(spec: str) -> CalibrationEntry:
    if not runs_others_code(spec, CALIBRATION):
        return load_calibration(spec)
    from benchmarks.run.choose import entries_named  # half as long to import as all the rest

    (entry,) = entries_named((spec,), LOADING, load_calibration)
    return entry


def _of_built_in(
    entry: CalibrationEntry, robot: RobotDescription, recordings: Sequence[Recording], pivots: bool
) -> Report:
    made = entry.kind(pivots=True) if pivots else entry.factory()
    if isinstance(made, ReportingMethod):
        return made.report(robot, recordings)
    return difference(robot, made.calibrate(robot, recordings))


def _of_plug_in(
    entry: CalibrationEntry, robot: RobotDescription, recordings: Sequence[Recording], pivots: bool
) -> Report:
    """Return the report of a method of others, from a process of its own; raises InputError where it fails or declines.

    Without a time limit: Ctrl-C ends it.
    """
    from benchmarks.run.evaluate import answered
    from benchmarks.run.worker_calibrate import report_calibration
    from benchmarks.run.worker_estimate import Failure

    worker = OneWorker()
    try:
        outcome = worker.outcome(
            Job(report_calibration, (entry.spec, entry.source_hash, robot, tuple(recordings), pivots))
        )
    finally:
        worker.close()
    answer = answered(outcome, math.inf, f"calibration method {entry.name!r}")
    if isinstance(answer, Failure):
        raise InputError(f"calibration method {entry.name!r} {answer.reason}")
    return answer if isinstance(answer, Report) else difference(robot, answer)


def difference(robot: RobotDescription, calibrated: RobotDescription) -> Report:
    """Return the report of a method that returns only a robot: its numbers before and after, without errors."""
    parameters = parameters_of(robot, pivots=True)
    before, after = (values_of(Geometry.of(described), parameters) for described in (robot, calibrated))
    rows = zip(parameters, before.tolist(), after.tolist(), strict=True)
    return Report(tuple(Result(p.name, p.unit, old, new, None) for p, old, new in rows), calibrated)


def _check_new(option: str, path: Path, suffix: str) -> None:
    with writing(option):
        exists = path.exists()
    if exists:
        raise InputError(f"{option} {path}: is there already; name a new file")
    if path.suffix != suffix:
        raise InputError(f"{option} {path}: its name must end in {suffix}")
    with writing(f"{option} {path}"):
        check_writable(path)


def _check_options(entry: CalibrationEntry, side: float | None, pivots: bool, scatter: Path | None) -> None:
    """Raise InputError for options that contradict each other or the method."""
    takes_squares = getattr(entry.kind, "takes_squares", None)
    if takes_squares and side is None:
        raise InputError(f"--method {entry.name} needs the --side of the squares that were driven, m")
    if side is not None and not (np.isfinite(side) and side > 0):
        raise InputError(f"--side {side:g}: the side of a square is a length above 0, m")
    if side is not None and takes_squares is False and scatter is None:
        raise InputError(f"--side is for squares, and --method {entry.name} does not ask for them")
    if scatter is not None and side is None:
        raise InputError("--scatter shows the end points of UMBmark squares; give their --side")
    if pivots and not getattr(entry.kind, "finds_pivots", False):
        raise InputError(f"--pivots is for maximum likelihood; {entry.name} takes the pivots' places as known")


def _read(paths: Sequence[Path], robot: RobotDescription, side: float | None) -> list[Recording]:
    """Return the logs; raises InputError for a log that is given twice or repeats an earlier log, and for times that no
    drive has."""
    read: list[Recording] = []
    for path in paths:
        log = read_log(path, robot)
        for wrong in wrong_times(log.t, robot.sample_period):
            raise InputError(f"{path}: {wrong}")
        for earlier in read:
            repeated = np.array_equal(log.t, earlier.log.t) and np.array_equal(log.wheel, earlier.log.wheel)
            if str(path) == earlier.name or repeated:
                raise InputError(
                    f"{path}: repeats {earlier.name}; give every log once, or intervals come out too narrow"
                )
        read.append(Recording(log, side=side, name=str(path)))
    return read


def _drawn(
    robot: RobotDescription, calibrated: RobotDescription, recordings: Sequence[Recording], side: float
) -> bytes:
    """Return a picture (PNG) of where odometry says that squares end, before and after."""
    from benchmarks.scatter import umbmark_scatter  # Matplotlib is slow to import, and only the picture needs it

    logs, ways = [recording.log for recording in recordings], directions_of(recordings)
    before, after = (return_errors(described, logs, ways, side) for described in (robot, calibrated))
    picture = io.BytesIO()
    umbmark_scatter(before, after).savefig(picture, format="png", metadata={"Software": None})
    return picture.getvalue()


def _print(console: Console, robot: RobotDescription, title: str, report: Report) -> None:
    console.print(f"{robot.name}: {title}", highlight=False, markup=False, soft_wrap=True)
    table = Table()
    letters = dict(zip(report.unseen, ascii_letters, strict=False))
    for heading in ("parameter", "unit", "before", "after", "± (95 %)"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    for result in report.results:
        unit, factor = SHOWN[result.unit]
        error = result.standard_error
        interval = "–" if error is None else "kept" if result.seen == "no" else f"{COVERAGE * error * factor:.4f}"
        marks = f" ({', '.join(letters[unseen_part] for unseen_part in result.rests_on)})" if result.rests_on else ""
        before, after = (f"{value * factor:z.4f}" for value in (result.before, result.after))
        table.add_row(result.name, unit, before, after, interval + marks)
    console.print(table, highlight=False, markup=False)
    if report.unseen:
        console.print(
            "± with a letter: if what it stands for is right in the robot file", highlight=False, markup=False
        )
    unseen = (f"({letters[unseen_part]}) not seen: {sentence}" for unseen_part, sentence in report.unseen.items())
    for remark in [*unseen, *report.remarks]:
        console.print(remark, highlight=False, markup=False, soft_wrap=True)


def _as_json(title: str, robot: RobotDescription, report: Report) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "method": title,
        "robot_hash": robot.hash(),
        "calibrated_hash": report.calibrated.hash(),
        "parameters": [
            {
                "name": result.name,
                f"before_{result.unit}": result.before,
                f"after_{result.unit}": result.after,
                f"standard_error_{result.unit}": None if result.seen == "no" else result.standard_error,
                "seen": result.seen,
                "rests_on": list(result.rests_on),
            }
            for result in report.results
        ],
        **report.more,
    }
