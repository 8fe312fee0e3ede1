"""What a log shows at first sight: its sampling, its channels, and whether its encoders agree with each other."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.columns import LogColumns
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.validation.parity import BLIND, Parity, parity_residual

FORMAT = "castor-inspect/1"

#: The drift (`Parity.rolling_drift`) from which on a log contradicts its robot file. Simulated perfect rolling stayed
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
    Floats are rounded far below what they can mean: times to 1e-9 s, lengths to 1e-6 mm, ratios to 1e-3.
    """
    return {
        "format": FORMAT,
        "robot": {"name": robot.name, "hash": robot.hash(), "sample_period": robot.sample_period},
        "logs": [{"path": path, **inspect_log(robot, log)} for path, log in logs.items()],
    }


def inspect_log(robot: RobotDescription, log: Log) -> dict[str, Any]:
    """Return one entry of the ``logs`` of `inspect_logs`, without its path."""
    channels = _channels(robot, log)
    steps = np.diff(log.t)
    taken = 0 if log.reference is None else int(np.isfinite(log.reference).all(axis=1).sum())
    return {
        "rows": len(log),
        "duration": _rounded(log.t[-1] - log.t[0], 9),
        "sample_period": {
            "median": _rounded(np.median(steps), 9),
            "smallest": _rounded(steps.min(), 9),
            "largest": _rounded(steps.max(), 9),
            "declared": robot.sample_period,
        },
        "channels": channels,
        "constant": [channel["name"] for channel in channels if channel["smallest"] == channel["largest"]],
        "reference_rows": taken,
        "reference": _reference(log) if taken else None,
        "commands": log.command is not None,
        "unknown_columns": list(log.extra),
        "parity": _parity(robot, log),
    }


def _channels(robot: RobotDescription, log: Log) -> list[dict[str, Any]]:
    """Return range and largest step of every encoder and gyro channel; a pivot's step is taken the shorter way round.

    `at_most` is the largest step, in counts, that the robot's speed limit allows in the time that step took.
    """
    columns, period = LogColumns.of(robot), np.diff(log.t)
    channels = []
    for j, (name, k) in enumerate(zip(columns.wheel, robot.driven_wheels, strict=True)):
        limit = robot.max_wheel_speed * (robot.wheels[k].counts_per_rev or np.nan) / (2 * np.pi)
        steps = np.abs(np.diff(log.wheel[:, j]))
        channels.append(_channel(name, "counts", log.wheel[:, j], steps, float(limit * period[np.argmax(steps)])))
    for j, (name, i) in enumerate(zip(columns.pivot, robot.pivot_encoders, strict=True)):
        turn = robot.castors[i].pivot_counts_per_rev or np.nan
        steps = np.diff(log.pivot[:, j])
        channels.append(_channel(name, "counts", log.pivot[:, j], np.abs(steps - turn * np.round(steps / turn))))
    if log.gyro is not None:
        channels.append(_channel(columns.gyro[0], "rad/s", log.gyro, np.abs(np.diff(log.gyro))))
    return channels


def _reference(log: Log) -> list[dict[str, Any]]:
    """Return range and largest step, from one pose that was taken to the next, of ref_x, ref_y and ref_psi."""
    assert log.reference is not None
    taken = log.reference[np.isfinite(log.reference).all(axis=1)]
    steps = np.abs(np.diff(taken, axis=0, prepend=taken[:1]))
    parts = zip(("ref_x", "ref_y", "ref_psi"), ("m", "m", "rad"), taken.T, steps.T, strict=True)
    return [_channel(name, unit, values, step) for name, unit, values, step in parts]


def _channel(
    name: str, unit: str, values: NDArray[np.float64], steps: NDArray[np.float64], at_most: float | None = None
) -> dict[str, Any]:
    return {
        "name": name,
        "unit": unit,
        "smallest": _rounded(values.min(), 9),
        "largest": _rounded(values.max(), 9),
        "largest_step": _rounded(steps.max(), 9),
        "at_most": None if at_most is None else _rounded(at_most, 6),
        "whole": bool(np.all(values == np.round(values))),
    }


def _parity(robot: RobotDescription, log: Log) -> dict[str, Any]:
    """Return the parity residual, rms in mm a sample, beside what rounded counts alone would leave, and a verdict.

    `ratio` is the one over the other, `drift` that of sums over `window` s; null where nothing moved.
    """
    parity = parity_residual(robot, log)

    def rows(names: list[str], rms: Array, rounding: Array, drift: Array) -> list[dict[str, Any]]:
        return [
            {
                "name": name,
                "rms_mm": _rounded(1e3 * found, 6),
                "rounding_mm": _rounded(1e3 * expected, 6),
                "ratio": _rounded(found / expected, 3) if expected > 0 else None,
                "drift": _rounded(summed, 3) if expected > 0 and parity.window else None,
            }
            for name, found, expected, summed in zip(names, rms, rounding, drift, strict=True)
        ]

    seen = parity.redundancy > 0
    wheels = [f"wheel_{robot.wheel_names[k]}" for k in parity.wheels]
    castors = [f"castor_{i + 1}" for i in parity.castors]
    rolling = rows(wheels, parity.rolling_rms, parity.rolling_rounding, parity.rolling_drift)
    side_slip = rows(castors, parity.side_slip_rms, parity.side_slip_rounding, parity.side_slip_drift)
    return {
        "redundancy": parity.redundancy,
        "moving_samples": int(parity.moving.sum()),
        "window": _rounded(parity.window * np.median(np.diff(log.t)), 9),
        "rolling": rolling if seen else [],
        "side_slip": side_slip if seen else [],
        "verdict": _verdict(robot, parity, rolling + side_slip) if seen else None,
        "note": None if seen else BLIND,
    }


def _verdict(robot: RobotDescription, parity: Parity, rows: list[dict[str, Any]]) -> str:
    """Return one line that says whether the encoders agree and, if not, whose rows stand out most (`CONTRADICTION`)."""
    if not parity.moving.any():
        return "nothing moved: nothing can be said"
    if not parity.window:
        return "too short: nothing can be said"
    drift = np.zeros(len(robot.castors))
    np.maximum.at(drift, np.array(robot.wheel_castors)[parity.wheels], parity.rolling_drift)
    np.maximum.at(drift, parity.castors, parity.side_slip_drift)
    if drift.max() >= CONTRADICTION:
        suspect = np.where(parity.explained >= ALIKE * parity.explained.max(), drift, 0.0)
        named = [str(i + 1) for i in np.flatnonzero(suspect >= ALIKE * suspect.max())]
        subject = f"castor {named[0]} contradicts" if len(named) == 1 else f"castors {' and '.join(named)} contradict"
        their, slip = ("its", "it slips") if len(named) == 1 else ("their", "they slip")
        return (
            f"{subject} this robot file (up to {drift.max():.2g} times rounding): "
            f"{their} radii, track, offset or pivot zero are off, or {slip}"
        )
    ratio = max(row["ratio"] or 0.0 for row in rows)
    if ratio >= CONTRADICTION:
        return (
            f"consistent over {parity.window} samples, but single ones are up to {ratio:.2g} times rounding: "
            "counts jump, or the samples are too far apart for the motion"
        )
    return "consistent with rounding"


def _rounded(value: float | np.floating[Any], digits: int) -> float:
    return round(float(value), digits)
