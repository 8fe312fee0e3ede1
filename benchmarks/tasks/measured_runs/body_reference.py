"""Where a robot's body truly was: a tracker's poses, less what is wrong with the tracker's clock and mount.

Offsets of the clock and of the tracked point belong to the measurement. Left in, they would be most of what is scored:
at 0.1 m/s a clock that is 0.2 s late is 20 mm, and axes that are turned by 1 degree are 17 mm after 1 m.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.tasks.measured_runs.splits import run_with_reference
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, inverse
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.maximum_likelihood.fit import fitted
from estimators.calibration.protocol import Recording, ReportingMethod
from estimators.likelihood.log_likelihood import LogLikelihood
from estimators.plugins.registry import load_calibration

METHOD = "maximum-likelihood"

HELD = np.full(3, 1e-6)
"""m, m and rad: standard deviations that hold the tracked point where calibration found it."""

FEW = 0.25
"""s: reference poses farther apart than this have a gap between them, in which no pose is interpolated."""


class Calibrated(NamedTuple):
    """What calibration finds: the robot, and the tracked point in its frame (3,), m, m, rad."""

    robot: RobotDescription
    mount: Array


def calibrated(robot: RobotDescription, recordings: Sequence[Log], one_clock: bool = False) -> Calibrated:
    """Return the robot and the mount as the method `METHOD` finds them in recordings; the robot as it is described, and
    the body as the tracked point, where the method does not find recordings to fit.

    one_clock: whether encoders and tracker were stamped by one clock. The method then gets four reference poses of each
    recording, too few for it to fit a clock: at a steady speed, a rate of the clock is a scale of the wheels.
    """
    method = load_calibration(METHOD).factory()
    assert isinstance(method, ReportingMethod)
    try:
        report = method.report(robot, [Recording(_with_four_poses(log) if one_clock else log) for log in recordings])
    except InputError:
        return Calibrated(robot, np.zeros(3))
    mount = report.more["mount"]
    return Calibrated(report.calibrated, np.array([mount["x_m"], mount["y_m"], mount["psi_rad"]]))


def of_body(found: Calibrated, logs: Sequence[Log], one_clock: bool = False) -> tuple[Log, ...]:
    """Return logs whose reference is the body's pose at the log's own times.

    one_clock: whether encoders and tracker were stamped by one clock, which is then left as it is.

    The mount is that of the calibration runs. The clock of each log, an offset and a rate, is what makes the log most
    likely with robot and mount held. Rows before and after the corrected reference are cut off; between poses it is
    interpolated linearly, which at v and omega misses omega v T^2 / 8 at most, 3 um at 0.1 m/s and 0.5 rad/s for poses
    every 20 ms. Raises InputError where a log keeps fewer than two poses.
    """
    poses = [_body(log, found.mount) for log in logs]
    if one_clock:
        return tuple(poses)
    geometry = Geometry.of(found.robot)
    models = [LogLikelihood(geometry, log, k) for k, log in enumerate(poses)]
    try:
        state, _, _ = fitted(models, geometry, (), np.zeros(0), None, placed=HELD)
    except (np.linalg.LinAlgError, ValueError):
        raise InputError("the reference and the counts are of different drives; give those of one run") from None
    kept = [on_own_clock(log, clock) for log, clock in zip(poses, state.clocks, strict=True)]
    if any(log is None for log in kept):
        raise InputError("a reference that covers none of its run; give poses at the run's own times")
    return tuple(log for log in kept if log is not None)


def _with_four_poses(log: Log) -> Log:
    assert log.reference is not None
    known = np.flatnonzero(np.isfinite(log.reference).all(axis=1))
    kept = known[np.round(np.linspace(0, len(known) - 1, 4)).astype(int)]
    reference = np.full_like(log.reference, np.nan)
    reference[kept] = log.reference[kept]
    return dataclasses.replace(log, reference=reference)


def _body(log: Log, mount: Array) -> Log:
    assert log.reference is not None
    return dataclasses.replace(log, reference=compose(log.reference, inverse(mount)))


def on_own_clock(log: Log, clock: Array) -> Log | None:
    """Return a log whose reference at t was the pose at t + clock[0] + clock[1] (t - t_0) with the poses at t instead;
    None where fewer than two rows have one."""
    assert log.reference is not None
    known = np.isfinite(log.reference).all(axis=1)
    taken = log.t[known] + clock[0] + clock[1] * (log.t[known] - log.t[0])
    after = np.clip(np.searchsorted(taken, log.t), 1, len(taken) - 1)
    close = (log.t >= taken[0]) & (log.t <= taken[-1]) & (taken[after] - taken[after - 1] <= FEW)
    poses = np.column_stack([np.interp(log.t, taken, column) for column in log.reference[known].T])
    return run_with_reference(dataclasses.replace(log, reference=np.where(close[:, None], poses, np.nan)))
