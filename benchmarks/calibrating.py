"""``castor-bench calibrate``: a robot's own logs in, a calibrated robot file out, before beside after."""

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.umbmark_scatter import umbmark_scatter
from castor_envs.differential_axle import driven_axle
from castor_envs.errors import InputError, did_you_mean
from castor_envs.files import write_atomically
from castor_envs.logs import Log, read_log
from castor_envs.robot import RobotDescription
from castor_envs.train import TrainDescription
from castor_envs.trajectories import Direction
from castor_envs.vehicles import load_vehicle
from estimators.calibration import maximum_likelihood
from estimators.calibration.pivoting import Turn, calibrate, held_castor
from estimators.calibration.umbmark_correction import corrected, direction_of, from_errors, return_errors
from estimators.calibration.unseen import scale_rests_on_pivots, unseen_of

FORMAT = "castor-calibration/1"
Method = Literal["maximum-likelihood", "pivoting", "umbmark-correction"]
METHODS: dict[Method, str] = {
    "maximum-likelihood": "maximum likelihood of all counts and reference poses",
    "pivoting": "pivoting about held castors (Doebbler, eqs. 1-9)",
    "umbmark-correction": "correction from UMBmark squares (Borenstein and Feng)",
}
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


@dataclass(frozen=True)
class Found:
    """What a method found. remarks: for people. more: for programs, beside the parameters."""

    parameters: list[Parameter]
    calibrated: RobotDescription
    remarks: list[str] = field(default_factory=list)
    more: dict[str, Any] = field(default_factory=dict)


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

    method: one of `METHODS`; None: maximum likelihood, or the correction from squares where `side` is given. side: of
    the UMBmark squares that were driven, m. pivots: whether the places of free castors' pivots are found too. scatter:
    where a picture of the squares' end points goes. Raises InputError where logs, robot or options do not suit, or
    `out` is there already.
    """
    if out.exists():
        raise InputError(f"--out {out}: is there already; name a new file")
    described = load_vehicle(robot)
    if isinstance(described, TrainDescription):
        raise InputError(f"--robot {robot}: is a train; calibration serves single robots")
    chosen = _chosen(method, side, pivots, scatter)
    read = {path: read_log(path, described) for path in logs}
    match chosen:
        case "maximum-likelihood":
            found = likely(described, read, pivots)
        case "pivoting":
            found = Found(*pivoting(described, read))
        case "umbmark-correction":
            assert side is not None
            found = Found(*squares(described, read, side))
    if scatter is not None:
        assert side is not None
        _draw(scatter, described, found.calibrated, read, side)
    try:
        found.calibrated.save(out)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written to ({error.strerror or error})") from None
    if as_json:
        print(json.dumps(_as_json(chosen, described, found), indent=2, allow_nan=False))
        return
    _print(console, described, chosen, found)
    console.print(f"{out}: the calibrated robot", highlight=False, markup=False, soft_wrap=True)


def _chosen(method: str | None, side: float | None, pivots: bool, scatter: Path | None) -> Method:
    known = {name: name for name in get_args(Method)}
    if method is not None and method not in known:
        raise InputError(f"--method {method!r} is not known{did_you_mean(method, known)}")
    chosen = known[method] if method else "maximum-likelihood" if side is None else "umbmark-correction"
    if chosen == "umbmark-correction" and side is None:
        raise InputError("--method umbmark-correction needs the --side of the squares that were driven, m")
    if scatter is not None and side is None:
        raise InputError("--scatter shows the end points of UMBmark squares; give their --side")
    if pivots and chosen != "maximum-likelihood":
        raise InputError(f"--pivots is for maximum likelihood; {chosen} takes the pivots' places as known")
    return chosen


def likely(robot: RobotDescription, logs: Mapping[Path, Log], pivots: bool) -> Found:
    """Return what maximum likelihood finds, and what the logs do not show."""
    found = maximum_likelihood.calibrate(robot, list(logs.values()), pivots=pivots)
    rows = []
    for one, before, after, error in zip(
        found.parameters, found.before, found.after, found.standard_errors, strict=True
    ):
        numbers = map(float, (before, after, error))
        angle = one.unit == "rad"
        rows.append(Parameter(one.name, one.unit, "deg" if angle else "mm", 180 / np.pi if angle else 1e3, *numbers))
    unseen = unseen_of(found)
    remarks = [f"not seen: {one}" for one in unseen]
    if scale_rests_on_pivots(found):
        remarks.append("all lengths rest on the pivots' places in the robot file; reference poses would check them")
    noise, (x, y, yaw) = found.noise, found.mount
    remarks.append(f"slip {1e3 * noise.along:.2g} mm along and {1e3 * noise.across:.2g} mm across after 1 m")
    more: dict[str, Any] = {"unseen": [one._asdict() for one in unseen], "slip_m": [noise.along, noise.across]}
    if found.left is not None:
        before, after = found.left
        remarks += [
            f"reference: tracked point at x {1e3 * x:.1f}, y {1e3 * y:.1f} mm, turned by {np.degrees(yaw):.2f} deg; "
            f"noise {1e3 * noise.position:.2g} mm, {np.degrees(noise.heading):.2g} deg",
            *(
                f"{path}: the reference's clock is {1e3 * late:.0f} ms late at the start, {1e3 * rate:+.1f} ms/s"
                for path, (late, rate) in zip(logs, found.clocks, strict=True)
            ),
            f"odometry is {1e3 * before:.1f} mm (rms) off the reference before, {1e3 * after:.1f} mm after",
        ]
        more |= {
            "mount": {"x_m": x, "y_m": y, "psi_rad": yaw},
            "clocks": [{"offset_s": late, "rate": rate} for late, rate in found.clocks.tolist()],
            "reference_noise": {"position_m": noise.position, "heading_rad": noise.heading},
            "odometry_rms_m": {"before": before, "after": after},
        }
    return Found(rows, found.calibrated, remarks, more)


def squares(robot: RobotDescription, logs: Mapping[Path, Log], side: float) -> tuple[list[Parameter], RobotDescription]:
    """Return what UMBmark squares tell of a differential robot (Borenstein and Feng), and the corrected robot."""
    found = from_errors(robot, *return_errors(robot, list(logs.values()), _directions(logs), side), side)
    errors, calibrated = found.standard_errors, corrected(robot, found)
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


def _directions(logs: Mapping[Path, Log]) -> list[Direction]:
    ways = []
    for path, log in logs.items():
        try:
            ways.append(direction_of(log))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
    return ways


def _draw(
    scatter: Path, robot: RobotDescription, calibrated: RobotDescription, logs: Mapping[Path, Log], side: float
) -> None:
    """Draw where odometry says that squares end, before and after."""
    ways = _directions(logs)
    before, after = (return_errors(each, list(logs.values()), ways, side) for each in (robot, calibrated))
    picture = io.BytesIO()
    umbmark_scatter(before, after).savefig(picture, format="png", metadata={"Software": None})
    try:
        write_atomically(scatter, picture.getvalue())
    except OSError as error:
        raise InputError(f"--scatter {scatter}: cannot be written to ({error.strerror or error})") from None


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


def _print(console: Console, robot: RobotDescription, method: Method, found: Found) -> None:
    console.print(f"{robot.name}: {METHODS[method]}", highlight=False, markup=False, soft_wrap=True)
    table = Table()
    for heading in ("parameter", "unit", "before", "after", "± (95 %)"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    for one in found.parameters:
        shown = (one.before, one.after, COVERAGE * one.standard_error)
        table.add_row(one.name, one.shown_unit, *(f"{value * one.factor:.4f}" for value in shown))
    console.print(table, highlight=False, markup=False)
    for remark in found.remarks:
        console.print(remark, highlight=False, markup=False, soft_wrap=True)


def _as_json(method: Method, robot: RobotDescription, found: Found) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "method": METHODS[method],
        "robot_hash": robot.hash(),
        "calibrated_hash": found.calibrated.hash(),
        "parameters": [
            {
                "name": one.name,
                f"before_{one.unit}": one.before,
                f"after_{one.unit}": one.after,
                f"standard_error_{one.unit}": one.standard_error,
            }
            for one in found.parameters
        ],
        **found.more,
    }
