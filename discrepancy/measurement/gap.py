"""The gap between odometry and reference, given the most likely states of logs."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.measurement.fit_states import fit_states
from estimators.calibration.maximum_likelihood.fit import State
from estimators.likelihood.creep_prediction import LEAST_NOISE
from estimators.likelihood.log_likelihood import LogLikelihood


def errors_of(
    models: Sequence[LogLikelihood], geometry: Geometry, at: State, slips: Sequence[Array]
) -> tuple[Array, ...]:
    """Return for each log the difference between odometry, with the slips (K - 1, rows) that are predicted, and
    reference at every reference pose (poses, 3), m and rad, once it is aligned with these."""
    return tuple(
        model.errors(geometry, clock, at.mount, predicted) if model.poses else np.zeros((0, 3))
        for model, clock, predicted in zip(models, at.clocks, slips, strict=True)
    )


def gap_of(errors: Sequence[Array]) -> tuple[float, float] | None:
    """Return the rms of the differences that `errors_of` returns, m and rad; None without a reference."""
    off = np.concatenate(errors)
    if not len(off):
        return None
    return float(np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1)))), float(np.sqrt(np.mean(off[:, 2] ** 2)))


def path_without_reference(robot: RobotDescription, log: Log) -> Array:
    """Return the most likely path (K, 3) of a robot with its effects by a log's encoders and gyro, from 0."""
    alone = dataclasses.replace(log, reference=None)
    model = LogLikelihood(Geometry.of(robot.as_built()), alone)
    at, *_ = fit_states(robot, [model], [alone], None, None, LEAST_NOISE)
    return at.states[0][:, :3]
