"""What a log shows at first sight: its sampling, its channels, and whether its encoders agree with each other."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from castor_envs.log_columns import LogColumns
from castor_envs.logs import Log
from castor_envs.robot import RobotDescription
from discrepancy.parity import parity_residual

FORMAT = "castor-inspect/1"
BLIND = "this robot's encoders cannot contradict each other: nothing can be seen without reference poses"


def inspect_logs(robot: RobotDescription, logs: dict[str, Log]) -> dict[str, Any]:
    """Return what logs of one robot show, by path, as plain data for JSON; ``format`` is `FORMAT`.

    Times in s, counts as in the log, lengths in mm a sample; every number is finite, or null where there is none.
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
        "duration": float(log.t[-1] - log.t[0]),
        "sample_period": {
            "median": float(np.median(steps)),
            "smallest": float(steps.min()),
            "largest": float(steps.max()),
            "declared": robot.sample_period,
        },
        "channels": channels,
        "constant": [channel["name"] for channel in channels if channel["smallest"] == channel["largest"]],
        "reference_rows": taken,
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


def _channel(
    name: str, unit: str, values: NDArray[np.float64], steps: NDArray[np.float64], at_most: float | None = None
) -> dict[str, Any]:
    return {
        "name": name,
        "unit": unit,
        "smallest": float(values.min()),
        "largest": float(values.max()),
        "largest_step": float(steps.max()),
        "at_most": at_most,
        "whole": bool(np.all(values == np.round(values))),
    }


def _parity(robot: RobotDescription, log: Log) -> dict[str, Any]:
    """Return the parity residual, rms in mm a sample, beside what rounded counts alone would leave."""
    parity = parity_residual(robot, log)

    def rows(names: list[str], rms: NDArray[np.float64], rounding: NDArray[np.float64]) -> list[dict[str, Any]]:
        return [
            {"name": name, "rms_mm": 1e3 * float(found), "rounding_mm": 1e3 * float(expected)}
            for name, found, expected in zip(names, rms, rounding, strict=True)
        ]

    seen = parity.redundancy > 0
    wheels = [f"wheel_{robot.wheel_names[k]}" for k in parity.wheels]
    castors = [f"castor_{i + 1}" for i in parity.castors]
    return {
        "redundancy": parity.redundancy,
        "moving_samples": int(parity.moving.sum()),
        "rolling": rows(wheels, parity.rolling_rms, parity.rolling_rounding) if seen else [],
        "side_slip": rows(castors, parity.side_slip_rms, parity.side_slip_rounding) if seen else [],
        "note": None if seen else BLIND,
    }
