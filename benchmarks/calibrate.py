"""``castor-bench calibrate``: a robot's own logs in, a calibrated robot file out, before beside after."""

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from string import ascii_letters
from typing import Any, Literal, get_args

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.scatter import umbmark_scatter
from castor_envs.errors import InputError, did_you_mean
from castor_envs.files import write_atomically
from castor_envs.logs.csv import read_log
from castor_envs.logs.log import Log
from castor_envs.motion.trajectories import Direction
from castor_envs.vehicles.axle import driven_axle
from castor_envs.vehicles.load import load_vehicle
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription
from estimators.calibration import maximum_likelihood
from estimators.calibration.identifiability import COVERAGE, WHOLLY, Unseen, rests_on, scale_rests_on_pivots, unseen_of
from estimators.calibration.pivoting import Turn, calibrate, held_castor
from estimators.calibration.umbmark import corrected, direction_of, from_errors, return_errors

FORMAT = "castor-calibration/1"
Method = Literal["maximum-likelihood", "pivoting", "umbmark-correction"]
Seen = Literal["yes", "partly", "no"]
METHODS: dict[Method, str] = {
    "maximum-likelihood": "maximum likelihood of all counts and reference poses",
    "pivoting": "pivoting about held castors (Doebbler, eqs. 1-9)",
    "umbmark-correction": "correction from UMBmark squares (Borenstein and Feng)",
}
FIRST_ORDER = "the method is of first order: of errors of per cents, calibrate again with the calibrated robot"


@dataclass(frozen=True)
class Parameter:
    """One number of the robot file: before, after with its standard error, SI; and how it is shown.

    seen: "no": it keeps the file's number; "partly": the error holds only if what is not seen, and moves this parameter
    by more, is right in the file. rests_on: what that is.
    """

    name: str
    unit: str
    shown_unit: str
    factor: float
    before: float
    after: float
    standard_error: float
    seen: Seen = "yes"
    rests_on: tuple[str, ...] = ()


@dataclass(frozen=True)
class Found:
    """What a method found. unseen: what the logs do not show. remarks: for people. more: for programs, beside the
    parameters."""

    parameters: list[Parameter]
    calibrated: RobotDescription
    unseen: tuple[Unseen, ...] = ()
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
    _check_new("--out", out, ".json")
    if scatter is not None:
        _check_new("--scatter", scatter, ".png")
    described = load_vehicle(robot)
    if isinstance(described, TrainDescription):
        raise InputError(f"--robot {robot}: is a train; calibration serves single robots")
    chosen = _chosen(method, side, pivots, scatter)
    read = _read(logs, described)
    match chosen:
        case "maximum-likelihood":
            found = likely(described, read, pivots)
        case "pivoting":
            found = Found(*pivoting(described, read))
        case "umbmark-correction":
            assert side is not None
            found = Found(*squares(described, read, side), remarks=[FIRST_ORDER])
    picture = b""
    if scatter is not None:
        assert side is not None
        picture = _drawn(described, found.calibrated, read, side)
    try:
        found.calibrated.save(out)
    except OSError as error:
        raise InputError(f"--out {out}: cannot be written to ({error.strerror or error})") from None
    if scatter is not None:
        try:
            write_atomically(scatter, picture)
        except OSError as error:
            out.unlink()
            raise InputError(f"--scatter {scatter}: cannot be written to ({error.strerror or error})") from None
    if described.effects:
        names = ", ".join(effect.name for effect in described.effects)
        found.remarks.append(f"the robot file's effects ({names}) are kept; leave out those that were calibrated")
    if as_json:
        print(json.dumps(_as_json(chosen, described, found), indent=2, allow_nan=False))
        return
    _print(console, described, chosen, found)
    console.print(f"{out}: the calibrated robot", highlight=False, markup=False, soft_wrap=True)


def _check_new(option: str, path: Path, suffix: str) -> None:
    try:
        there = path.exists()
    except OSError as error:
        raise InputError(f"{option}: cannot be written to ({error.strerror or error})") from None
    if there:
        raise InputError(f"{option} {path}: is there already; name a new file")
    if path.suffix != suffix:
        raise InputError(f"{option} {path}: its name must end in {suffix}")


def _read(paths: Sequence[Path], robot: RobotDescription) -> dict[Path, Log]:
    """Return the logs; raises InputError for one that is given twice, or repeats another."""
    read: dict[Path, Log] = {}
    for path in paths:
        log = read_log(path, robot)
        for other, known in read.items():
            if path == other or (np.array_equal(log.t, known.t) and np.array_equal(log.wheel, known.wheel)):
                raise InputError(f"{path}: repeats {other}; give every log once, or intervals come out too narrow")
        read[path] = log
    return read


def _chosen(method: str | None, side: float | None, pivots: bool, scatter: Path | None) -> Method:
    known = {name: name for name in get_args(Method)}
    if method is not None and method not in known:
        raise InputError(f"--method {method!r} is not known{did_you_mean(method, known)}")
    chosen = known[method] if method else "maximum-likelihood" if side is None else "umbmark-correction"
    if chosen == "umbmark-correction" and side is None:
        raise InputError("--method umbmark-correction needs the --side of the squares that were driven, m")
    if side is not None and not (np.isfinite(side) and side > 0):
        raise InputError(f"--side {side:g}: the side of a square is a length above 0, m")
    if side is not None and chosen == "pivoting":
        raise InputError("--side is for squares, and --method pivoting takes turns about held castors")
    if scatter is not None and side is None:
        raise InputError("--scatter shows the end points of UMBmark squares; give their --side")
    if pivots and chosen != "maximum-likelihood":
        raise InputError(f"--pivots is for maximum likelihood; {chosen} takes the pivots' places as known")
    return chosen


def likely(robot: RobotDescription, logs: Mapping[Path, Log], pivots: bool) -> Found:
    """Return what maximum likelihood finds, and what the logs do not show."""
    with np.errstate(over="ignore", invalid="ignore"):  # what overflows has no fit, which is an InputError
        found = maximum_likelihood.calibrate(robot, list(logs.values()), pivots=pivots)
    rows, unseen = [], unseen_of(found)
    hidden = np.linalg.norm(found.unseen, axis=0)
    columns = (found.parameters, found.before, found.after, found.standard_errors, hidden, rests_on(found, unseen))
    for parameter, before, after, error, part, rests in zip(*columns, strict=True):
        unit, factor = ("deg", 180 / np.pi) if parameter.unit == "rad" else ("mm", 1e3)
        seen: Seen = "no" if part > WHOLLY else "partly" if rests else "yes"
        what = tuple(each.what for each in rests)
        numbers = (float(before), float(after), float(error))
        rows.append(Parameter(parameter.name, parameter.unit, unit, factor, *numbers, seen, what))
    remarks = []
    if scale_rests_on_pivots(found):
        remarks.append("all lengths rest on the pivots' places in the robot file; reference poses would check them")
    noise, (x, y, yaw) = found.noise, found.mount
    remarks.append(f"slip {1e3 * noise.along:.2g} mm along and {1e3 * noise.across:.2g} mm across after 1 m")
    names = [row.name for row in rows]
    more: dict[str, Any] = {
        "unseen": [
            {"what": each.what, "shown_by": each.shown_by, "moves": dict(zip(names, each.moves.tolist(), strict=True))}
            for each in unseen
        ],
        "slip_m": [noise.along, noise.across],
    }
    if found.left is not None:
        before, after = found.left
        remarks += [
            _tracked_point(found),
            f"reference: noise {1e3 * noise.position:.2g} mm, {np.degrees(noise.heading):.2g} deg",
            *(
                f"{path}: the reference is {1e3 * abs(ahead):.0f} ms {'ahead of' if ahead > 0 else 'behind'} the "
                f"counts at the start, and gains {1e3 * rate:.1f} ms/s"
                for path, (ahead, rate) in zip(logs, found.clocks, strict=True)
            ),
            f"odometry is {1e3 * before:.1f} mm (rms) off the reference before, {1e3 * after:.1f} mm after",
        ]
        more |= {
            "mount": {"x_m": x, "y_m": y, "psi_rad": yaw}
            | {"standard_errors": found.mount_errors.tolist(), "seen": found.mount_seen.tolist()},
            "clocks": [{"ahead_s": ahead, "rate": rate} for ahead, rate in found.clocks.tolist()],
            "reference_noise": {"position_m": noise.position, "heading_rad": noise.heading},
            "odometry_rms_m": {"before": before, "after": after},
        }
    return Found(rows, found.calibrated, unseen, remarks, more)


def _tracked_point(found: maximum_likelihood.Calibration) -> str:
    """Return where the tracked point is; of what the logs do not show, how far it may be off where it is believed."""
    factors, units = (1e3, 1e3, 180 / np.pi), ("mm", "mm", "deg")
    columns = zip(
        ("x", "y", "turned by"), found.mount, found.mount_errors, found.mount_seen, factors, units, strict=True
    )
    parts = [
        f"{name} {value * factor:.{1 if unit == 'mm' else 2}f} ± {COVERAGE * error * factor:.2g} {unit}"
        + ("" if seen else " (not seen)")
        for name, value, error, seen, factor, unit in columns
    ]
    return f"reference: tracked point at {', '.join(parts)}"


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


def _drawn(robot: RobotDescription, calibrated: RobotDescription, logs: Mapping[Path, Log], side: float) -> bytes:
    """Return a picture (PNG) of where odometry says that squares end, before and after."""
    ways = _directions(logs)
    before, after = (return_errors(each, list(logs.values()), ways, side) for each in (robot, calibrated))
    picture = io.BytesIO()
    umbmark_scatter(before, after).savefig(picture, format="png", metadata={"Software": None})
    return picture.getvalue()


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
        zero, error = new.pivot_zero, float(errors.pivot_zero[i])
        rows.append(Parameter(f"{name} pivot_zero", "rad", "deg", 180 / np.pi, old.pivot_zero, zero, error))
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
    letters = {each.what: letter for each, letter in zip(found.unseen, ascii_letters, strict=False)}
    for heading in ("parameter", "unit", "before", "after", "± (95 %)"):
        table.add_column(heading, justify="left" if heading in ("parameter", "unit") else "right")
    for one in found.parameters:
        before, after, error = (
            f"{value * one.factor:.4f}" for value in (one.before, one.after, COVERAGE * one.standard_error)
        )
        marks = f" ({', '.join(letters[what] for what in one.rests_on)})" if one.rests_on else ""
        interval = ("kept" if one.seen == "no" else error) + marks
        table.add_row(one.name, one.shown_unit, before, after, interval)
    console.print(table, highlight=False, markup=False)
    if found.unseen:
        console.print(
            "± with a letter: if what it stands for is right in the robot file", highlight=False, markup=False
        )
    for remark in [*(f"({letters[each.what]}) not seen: {each}" for each in found.unseen), *found.remarks]:
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
                f"standard_error_{one.unit}": None if one.seen == "no" else one.standard_error,
                "seen": one.seen,
                "rests_on": list(one.rests_on),
            }
            for one in found.parameters
        ],
        **found.more,
    }
