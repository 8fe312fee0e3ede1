"""What a log shows at first sight: its sampling, its channels, and whether its encoders agree with each other."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.columns import LogColumns
from castor_envs.logs.log import Log, positions_taken
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight.checks import wheel_steps
from discrepancy.validation.parity import BLIND, Parity
from estimators.likelihood.measurements.gyro_check import gyro_against_wheels

POSE = (("ref_x", "m"), ("ref_y", "m"), ("ref_psi", "rad"))
"""Columns of a reference pose, and their units."""

FORMAT, DIGITS = "castor-inspect/1", 9
"""Name of the format, and decimals of its numbers."""

#: The drift (`Parity.drift`) from which on a log contradicts its robot file. Simulated perfect rolling stayed
#: below 1.5 at 10 to 100 samples a second (at 5, castors that swing round reach 2); half a percent of one wheel's
#: radius reached 3 and more at 20, on small and large robots. The rms of single samples cannot show as much: the
#: prediction for it holds within about 20 % for rolling and reads up to 35 % high for side slip, where castors hardly
#: turn even more, and half a percent of a radius moves it by a fifth. From this much on it is mentioned, but what
#: curved motion leaves between coarse samples has the same look.
CONTRADICTION = 2.0
#: One wrong castor shows on others too. Named is, of the castors that explain the drift as well as the best one does,
#: within this part, the one that drifts most; several, where they drift alike within this part.
ALIKE = 0.9


def inspect_logs(robot: RobotDescription, logs: dict[str, Log]) -> dict[str, Any]:
    """Return what logs of one robot show, by path, as plain data for JSON; ``format`` is `FORMAT`.

    Times in s, counts as in the log, lengths in mm a sample; every number is finite, or null where there is none.
    Floats are rounded far below what they can mean.
    """
    return _rounded(
        {
            "format": FORMAT,
            "robot": {"name": robot.name, "hash": robot.hash(), "sample_period": robot.sample_period},
            "logs": [{"path": path, **inspect_log(robot, log)} for path, log in logs.items()],
        }
    )


def inspect_log(robot: RobotDescription, log: Log) -> dict[str, Any]:
    """Return one entry of the ``logs`` of `inspect_logs`, without its path."""
    channels, steps, reference = _channels(robot, log), np.diff(log.t), _reference(log)
    return {
        "rows": len(log),
        "duration": log.t[-1] - log.t[0],
        "sample_period": {
            "median": np.median(steps),
            "smallest": steps.min(),
            "largest": steps.max(),
            "declared": robot.sample_period,
        },
        "channels": channels,
        "constant": [channel["name"] for channel in channels if channel["smallest"] == channel["largest"]],
        "reference_rows": len(reference),
        "reference": _pose_channels(reference) if len(reference) else None,
        "commands": log.command is not None,
        "unknown_columns": list(log.extra),
        "parity": _parity(robot, log),
        "gyro": _gyro(robot, log),
    }


def _channels(robot: RobotDescription, log: Log) -> list[dict[str, Any]]:
    """Return range and largest step of every encoder and gyro channel; a pivot's step is taken the shorter way round.

    `at_most` is the largest step, in counts, that the robot's speed limit allows in the time that step took; `still`
    the longest time, s, in which counts stay as they are while those of another encoder change.
    """
    columns, channels = LogColumns.of(robot), []
    moves = np.diff(np.column_stack([log.wheel, log.pivot]), axis=0) != 0
    still = [_still(log.t, ~changes, moves.any(axis=1)) for changes in moves.T]
    wheels = log.wheel.shape[1]
    for (name, counts, steps, limit), stands in zip(wheel_steps(robot, log), still[:wheels], strict=True):
        at_most = float(limit[np.argmax(np.abs(steps))])
        channels.append(_channel(name, "counts", counts, np.abs(steps), at_most, stands))
    pivots = zip(columns.pivot, robot.pivot_encoders, log.pivot.T, still[wheels:], strict=True)
    for name, i, counts, stands in pivots:
        turn, steps = robot.castors[i].pivot_counts_per_rev or np.nan, np.diff(counts)
        shorter = np.abs(steps - turn * np.round(steps / turn))
        channels.append(_channel(name, "counts", counts, shorter, still=stands))
    if log.gyro is not None:
        channels.append(_channel(columns.gyro[0], "rad/s", log.gyro, np.abs(np.diff(log.gyro))))
    return channels


def _reference(log: Log) -> Array:
    """Return the reference poses (k, 3) that were taken, NaN where one has no heading."""
    return np.zeros((0, 3)) if log.reference is None else log.reference[positions_taken(log)]


def _pose_channels(poses: Array) -> list[dict[str, Any]]:
    """Return range and largest step, from one pose to the next, of ref_x, ref_y and, if there is one, ref_psi."""
    columns = ((values[np.isfinite(values)], part) for values, part in zip(poses.T, POSE, strict=True))
    return [
        _channel(*part, values, np.abs(np.diff(values, prepend=values[:1]))) for values, part in columns if len(values)
    ]


def _still(t: Array, same: NDArray[np.bool_], moving: NDArray[np.bool_]) -> float:
    """Return the longest time, s, in which a channel stays the `same` (N - 1,), of the steps in which the robot is
    `moving` (N - 1,)."""
    lasted = np.concatenate([[0.0], np.cumsum(np.where(moving, np.diff(t), 0.0))])
    changes = np.flatnonzero(~same)
    first, last = np.append(0, changes + 1), np.append(changes, len(same))
    return float(np.max(lasted[last] - lasted[first]))


def _channel(
    name: str, unit: str, values: Array, steps: Array, at_most: float | None = None, still: float | None = None
) -> dict[str, Any]:
    return {
        "name": name,
        "unit": unit,
        "smallest": values.min(),
        "largest": values.max(),
        "largest_step": steps.max(),
        "at_most": at_most,
        "still": still,
        "whole": bool(np.all(values == np.round(values))),
    }


def _parity(robot: RobotDescription, log: Log) -> dict[str, Any]:
    """Return the parity residual, rms in mm a sample, beside what rounded counts alone would leave, and a verdict.

    `ratio` is the one over the other, `drift` that of sums over `window` s; null where nothing moved.
    """
    parity = Parity(robot, log)
    names = [f"wheel_{robot.wheel_names[k]}" for k in parity.rows.wheels]
    names += [f"castor_{i + 1}" for i in parity.rows.castors]
    rows = [
        {
            "name": name,
            "rms_mm": 1e3 * rms,
            "rounding_mm": 1e3 * rounding,
            "ratio": rms / rounding if rounding > 0 else None,
            "drift": drift if rounding > 0 and parity.window else None,
        }
        for name, rms, rounding, drift in zip(names, parity.rms, parity.rounding, parity.drift, strict=True)
    ]
    seen, w = parity.redundancy > 0, len(parity.rows.wheels)
    return {
        "redundancy": parity.redundancy,
        "moving_samples": int(parity.moving.sum()),
        "window": parity.window * np.median(np.diff(log.t)),
        "rolling": rows[:w] if seen else [],
        "side_slip": rows[w:] if seen else [],
        "verdict": _verdict(robot, parity, max(row["ratio"] or 0.0 for row in rows)) if seen else None,
        "note": None if seen else BLIND,
    }


def _gyro(robot: RobotDescription, log: Log) -> dict[str, Any] | None:
    """Return the gyro against the wheels; null where nothing can be said (`gyro_against_wheels`)."""
    check = gyro_against_wheels(robot, log)
    keys = "scale", "bias", "follows", "verdict"
    return None if check is None else {key: getattr(check, key) for key in keys}


def _verdict(robot: RobotDescription, parity: Parity, ratio: float) -> str:
    """Return one line that says whether the encoders agree and, if not, whose rows stand out most (`CONTRADICTION`).

    ratio: the largest of a row's rms over that of rounding.
    """
    if not parity.moving.any():
        return "nothing moved: nothing can be said"
    if not parity.window:
        return "too short: nothing can be said"
    drift = np.zeros(len(robot.castors))
    np.maximum.at(drift, parity.rows.castor, parity.drift)
    if drift.max() >= CONTRADICTION:
        suspect = np.where(parity.explained >= ALIKE * parity.explained.max(), drift, 0.0)
        named = [str(i + 1) for i in np.flatnonzero(suspect >= ALIKE * suspect.max())]
        subject = f"castor {named[0]} contradicts" if len(named) == 1 else f"castors {' and '.join(named)} contradict"
        their, slip = ("its", "it slips") if len(named) == 1 else ("their", "they slip")
        return (
            f"{subject} this robot file (up to {drift.max():.2g} times rounding): "
            f"{their} radii, track, offset or pivot zero are off, or {slip}"
        )
    if ratio >= CONTRADICTION:
        return (
            f"consistent over {parity.window} samples, but single ones are up to {ratio:.2g} times rounding: "
            "counts jump, or the samples are too far apart for the motion"
        )
    return "consistent with rounding"


def _rounded(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: _rounded(value) for key, value in data.items()}
    if isinstance(data, list):
        return [_rounded(value) for value in data]
    return round(float(data), DIGITS) if isinstance(data, float | np.floating) else data
