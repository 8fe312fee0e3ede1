"""The oracle of robots, a yardstick and no strict bound: `filter`, told the true robot, on wheels that never slip.

Castors that the floor turns stand as it turns them where they roll along the true way without slip to their side; each
wheel's encoder reads how far the floor passes beneath it along its rolling direction, as the equations of
`wheel-odometry` say. What is left are encoders' steps, and what happens between samples.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.tasks.task import Run
from castor_envs.errors import Declined
from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry, castor_rates
from castor_envs.sensors.encoders import castor_angles
from castor_envs.vehicles.robot import Contact, RobotDescription
from castor_envs.vehicles.tolerances import Tolerances
from estimators.robots.calibrating_filter import CalibratingFilter
from estimators.steps.rolling_equations import EquationsOfSamples, Rows

STIFF = Contact(slip_stiffness_long=1e6, slip_stiffness_lat=1e6)
"""Contacts of wheels that never slip: the filter is to expect no creep under forces."""

SUBSTEPS = 4
"""In which trailing castors' angles are integrated, a sample, by the midpoint rule: where one swings by 0.3 rad in
a sample, it is off by 5e-5 rad, a twentieth of its encoder's step."""


def with_ceiling(robot: RobotDescription, runs: Sequence[Run], slips: bool = True) -> tuple[Run, ...]:
    """Return runs with the ceiling as their oracle; without one where the filter does not serve the robot.

    robot: the true one, as it is built. slips: False where wheels roll perfectly, so that they are taken as they read.
    """
    try:
        logs = [without_slip(robot, run.log) if slips else run.log for run in runs]
        poses = _followed(robot, logs, [run.start for run in runs])
    except Declined:
        return tuple(runs)
    return tuple(replace(run, oracle=pose[run.samples]) for run, pose in zip(runs, poses, strict=True))


def without_slip(robot: RobotDescription, log: Log) -> Log:
    """Return a log in which wheels with an encoder turn as if they rolled without slip on the log's reference poses,
    and castors that the floor turns as if they did not slip to their side either.

    Raises Declined where castors' angles do not tell how wheels roll.
    """
    assert log.reference is not None
    geometry = Geometry.of(robot)
    rows = Rows.of(geometry)
    equations = EquationsOfSamples(rows)
    trailing = replace(log, pivot=_trailing(geometry, log))
    step = se2.relative_pose(log.reference[:-1], log.reference[1:])
    turn = step[:, 2]
    half = se2.rotate(step[:, :2], -turn / 2)
    motion = np.column_stack([half, 2 * np.sin(turn / 2)])
    rolled = np.zeros((len(log), len(rows.wheels)))
    for k, seen in enumerate(trailing.observations()):
        sample = equations.read(seen)
        if k > 0:
            swivelled = sample._replace(rolled=np.zeros_like(sample.rolled)).right(turn[k - 1])
            chord = np.sinc((turn[k - 1] + sample.swivel) / (2 * np.pi))
            rolled[k] = ((sample.matrix @ motion[k - 1] - swivelled) / chord)[: rolled.shape[1]]
    angle = np.cumsum(rolled, axis=0) / rows.geometry.radius[rows.wheels]
    counts = np.array(log.wheel, dtype=float)
    counts[:, rows.read] = np.round(angle / rows.angle_per_count)
    return replace(log, wheel=counts, pivot=np.round(trailing.pivot) % geometry.pivot_counts_per_rev[geometry.sensed])


def _trailing(geometry: Geometry, log: Log) -> Array:
    """Return the pivots' counts (K, p), not rounded, of castors that trail along a log's reference without side slip,
    from where they stand at first, as integrated; of others as they read."""
    assert log.reference is not None
    turned = geometry.trailing & ~geometry.driven & ~geometry.fixed
    step = se2.relative_pose(log.reference[:-1], log.reference[1:])
    angles = [castor_angles(geometry, log.pivot[0])]
    for displacement in step:
        part = np.append(se2.rotate(displacement[:2], -displacement[2] / 2), displacement[2]) / SUBSTEPS
        angle = angles[-1]
        for _ in range(SUBSTEPS):
            angle = angle + castor_rates(geometry, angle + castor_rates(geometry, angle, part) / 2, part)
        angles.append(angle)
    pivot = np.array(log.pivot, dtype=float)
    sensed = geometry.sensed
    counts = (np.array(angles) + geometry.pivot_zero)[:, sensed] * geometry.pivot_counts_per_rev[sensed] / (2 * np.pi)
    return np.where(turned[sensed], counts, pivot)


def _followed(robot: RobotDescription, logs: Sequence[Log], starts: Sequence[Array]) -> list[Array]:
    """Return the poses (K, 3) of the filter along each log; logs of one length side by side, which is faster."""
    poses = [np.zeros(0)] * len(logs)
    exact = replace(robot, tolerances=Tolerances(), contact=STIFF)
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
