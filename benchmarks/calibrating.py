"""``castor-bench calibrate``: a robot's own logs in, a calibrated robot file out, before beside after."""

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.umbmark_scatter import umbmark_scatter
from castor_envs.differential_axle import driven_axle
from castor_envs.errors import InputError
from castor_envs.files import write_atomically
from castor_envs.logs import Log, read_log
from castor_envs.robot import RobotDescription
from castor_envs.train import TrainDescription
from castor_envs.vehicles import load_vehicle
from estimators.calibration.pivoting import Turn, calibrate, held_castor
from estimators.calibration.umbmark_correction import corrected, direction_of, from_errors, return_errors

FORMAT = "castor-calibration/1"
PIVOTING = "pivoting about held castors (Doebbler, eqs. 1-9)"
UMBMARK = "correction from UMBmark squares (Borenstein and Feng)"
COVERAGE = 1.96
"""Standard errors on either side of a 95 % interval."""


@dataclass(frozen=True)
class Parameter:
    """One number of the robot file: before, after with its standard error, SI; and how it is shown."""

    name: str
    unit: str
    shown_unit: str
    factor: float
    before: float
    after: float
    standard_error: float


def calibrate_logs(
    logs: Sequence[Path],
    robot: str,
    out: Path,
    side: float | None,
    scatter: Path | None,
    as_json: bool,
    console: Console,
) -> None:
    """Calibrate the robot that `robot` names from logs, write it to `out`, and print what changed.

    side: of the UMBmark square that a differential robot drove, m; None: the robot turned about held castors. scatter:
    where a picture of the square's end points goes. Raises InputError where logs or robot do not suit, or `out` is
    there already.
    """
    if out.exists():
        raise InputError(f"--out {out}: is there already; name a new file")
    described = load_vehicle(robot)
    if isinstance(described, TrainDescription):
        raise InputError(f"--robot {robot}: is a train; calibration serves single robots")
    if scatter is not None and side is None:
        raise InputError("--scatter shows the end points of UMBmark squares; give their --side")
    read = {path: read_log(path, described) for path in logs}
    if side is None:
        method, (parameters, calibrated) = PIVOTING, pivoting(described, read)
    else:
        method, (parameters, calibrated) = UMBMARK, squares(described, read, side, scatter)
    try:
        calibrated.save(out)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written to ({error.strerror or error})") from None
    if as_json:
        print(json.dumps(_as_json(method, described, calibrated, parameters), indent=2, allow_nan=False))
        return
    _print(console, described, method, parameters)
    console.print(f"{out}: the calibrated robot", highlight=False, markup=False, soft_wrap=True)


def squares(
    robot: RobotDescription, logs: Mapping[Path, Log], side: float, scatter: Path | None
) -> tuple[list[Parameter], RobotDescription]:
    """Return what UMBmark squares tell of a differential robot (Borenstein and Feng), and the corrected robot."""
    ways = []
    for path, log in logs.items():
        try:
            ways.append(direction_of(log))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    before = return_errors(robot, list(logs.values()), ways, side)
    found = from_errors(robot, *before, side)
    errors, calibrated = found.standard_errors, corrected(robot, found)
    if scatter is not None:
        after = return_errors(calibrated, list(logs.values()), ways, side)
        picture = io.BytesIO()
        umbmark_scatter(before, after).savefig(picture, format="png", metadata={"Software": None})
        try:
            write_atomically(scatter, picture.getvalue())
        except OSError as error:
            raise InputError(f"--scatter {scatter}: cannot be written to ({error.strerror or error})") from None
    axle = driven_axle(robot)
    (left, right), (new_left, new_right) = (
        [wheel for wheel in each.castors[axle].wheels if wheel.driven] for each in (robot, calibrated)
    )
    rows = [
        _length("wheel base", left.lateral - right.lateral, new_left.lateral - new_right.lateral, errors.wheel_base),
        _length("left diameter", 2 * left.radius, 2 * new_left.radius, errors.diameters[1]),
        _length("right diameter", 2 * right.radius, 2 * new_right.radius, errors.diameters[0]),
    ]
    return rows, calibrated


def pivoting(robot: RobotDescription, logs: Mapping[Path, Log]) -> tuple[list[Parameter], RobotDescription]:
    """Return what turning about held castors tells (Doebbler eqs. 1-9), and the calibrated robot."""
    turns = []
    for path, log in logs.items():
        try:
            turns.append(Turn(log, held_castor(robot, log)))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    found = calibrate(robot, turns)
    calibrated = found.applied()
    rows = []
    for i, (old, new) in enumerate(zip(robot.castors, calibrated.castors, strict=True)):
        if not np.isfinite(found.parameters.offset[i]):
            continue
        errors, name = found.errors, f"castor {i + 1}"
        rows.append(_length(f"{name} offset", old.offset, new.offset, errors.offset[i]))
        zero = (old.pivot_zero, new.pivot_zero, errors.pivot_zero[i])
        rows.append(Parameter(f"{name} pivot_zero", "rad", "deg", 180 / np.pi, *map(float, zero)))
        for k, side in enumerate(("left", "right")):
            before, after = old.wheels[k], new.wheels[k]
            rows.append(_length(f"{name} {side} radius", before.radius, after.radius, errors.radius[i, k]))
            rows.append(_length(f"{name} {side} lateral", before.lateral, after.lateral, errors.half_track[i, k]))
    return rows, calibrated


def _length(name: str, before: float, after: float, error: float) -> Parameter:
    return Parameter(name, "m", "mm", 1e3, before, after, float(error))


def _print(console: Console, robot: RobotDescription, method: str, parameters: list[Parameter]) -> None:
    console.print(f"{robot.name}: {method}", highlight=False, markup=False, soft_wrap=True)
    table = Table()
    for heading in ("parameter", "unit", "before", "after", "± (95 %)"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    for one in parameters:
        shown = (one.before, one.after, COVERAGE * one.standard_error)
        table.add_row(one.name, one.shown_unit, *(f"{value * one.factor:.4f}" for value in shown))
    console.print(table, highlight=False, markup=False)


def _as_json(
    method: str, robot: RobotDescription, calibrated: RobotDescription, parameters: list[Parameter]
) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "method": method,
        "robot_hash": robot.hash(),
        "calibrated_hash": calibrated.hash(),
        "parameters": [
            {
                "name": one.name,
                f"before_{one.unit}": one.before,
                f"after_{one.unit}": one.after,
                f"standard_error_{one.unit}": one.standard_error,
            }
            for one in parameters
        ],
    }
