"""A ceiling of what odometry of robots can reach: `filter`, told the true robot, on wheels that never slip.

Each wheel's encoder reads how far the floor passes beneath it along its rolling direction, as the equations of
`wheel-odometry` say; pivots' encoders read what they read. What is left are encoders' steps, and what happens between
samples.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from benchmarks.tasks.task import Run
from castor_envs.errors import Declined
from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.tolerances import Tolerances
from estimators.robots.calibrating_filter import CalibratingFilter
from estimators.steps.rolling_equations import EquationsOfSamples, Rows


def with_ceiling(robot: RobotDescription, runs: Sequence[Run], slips: bool = True) -> tuple[Run, ...]:
    """Return runs with the ceiling as their oracle; without one where the filter does not serve the robot.

    robot: the true one, as it is built. slips: False where wheels roll perfectly, so that they are taken as they read.
    """
    try:
        logs = [without_slip(robot, run.log) if slips else run.log for run in runs]
        poses = _followed(robot, logs, [run.start for run in runs])
    except Declined:
        return tuple(runs)
    return tuple(dataclasses.replace(run, oracle=pose[run.samples]) for run, pose in zip(runs, poses, strict=True))


def without_slip(robot: RobotDescription, log: Log) -> Log:
    """Return a log in which wheels with an encoder turn as if they rolled without slip on the log's reference poses.

    Raises Declined where castors' angles do not tell how wheels roll.
    """
    assert log.reference is not None
    rows = Rows.of(Geometry.of(robot))
    equations = EquationsOfSamples(rows)
    step = se2.relative_pose(log.reference[:-1], log.reference[1:])
    turn = step[:, 2]
    half = se2.rotate(step[:, :2], -turn / 2)
    motion = np.column_stack([half, 2 * np.sin(turn / 2)])
    rolled = np.zeros((len(log), len(rows.wheels)))
    for k, seen in enumerate(log.observations()):
        sample = equations.read(seen)
        if k > 0:
            swivelled = sample._replace(rolled=np.zeros_like(sample.rolled)).right(turn[k - 1])
            chord = np.sinc((turn[k - 1] + sample.swivel) / (2 * np.pi))
            rolled[k] = ((sample.matrix @ motion[k - 1] - swivelled) / chord)[: rolled.shape[1]]
    angle = np.cumsum(rolled, axis=0) / rows.geometry.radius[rows.wheels]
    counts = np.array(log.wheel, dtype=float)
    counts[:, rows.read] = np.round(angle / rows.angle_per_count)
    return dataclasses.replace(log, wheel=counts)


def _followed(robot: RobotDescription, logs: Sequence[Log], starts: Sequence[Array]) -> list[Array]:
    """Return the poses (K, 3) of the filter along each log; logs of one length side by side, which is faster."""
    exact, poses = dataclasses.replace(robot, tolerances=Tolerances()), [np.zeros(0)] * len(logs)
    by_length: dict[int, list[int]] = {}
    for k, log in enumerate(logs):
        by_length.setdefault(len(log), []).append(k)
    for alike in by_length.values():
        oracle = CalibratingFilter()
        oracle.reset(exact, np.array([starts[k] for k in alike]))
        samples = zip(*(logs[k].observations() for k in alike), strict=True)
        found = [oracle.update({name: np.stack([one[name] for one in of]) for name in of[0]}) for of in samples]
        for k, followed in zip(alike, np.array(found).swapaxes(0, 1), strict=True):
            poses[k] = followed
    return poses
