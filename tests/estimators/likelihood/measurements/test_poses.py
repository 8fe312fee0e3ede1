"""Reference poses in the likelihood: the tracked point's acceleration, in proportion to which they may be off, and
poses that are far apart, of a tracker whose errors last."""

# pyright: reportOptionalSubscript=false, reportOptionalOperand=false

import dataclasses

import numpy as np
import pytest

from castor_envs.logs.log import Log
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.trials.pymunk_generator import drive
from discrepancy.trials.reading import EXACT
from estimators.calibration.maximum_likelihood.calibrate import calibrate
from estimators.likelihood.measurements.poses import FAR_APART, SWINGING, ReferencePoses, far_apart

T = 0.05 * np.arange(400)
RADIUS, RATE, MOUNT, CLOCK = 1.5, 0.4, np.array([0.3, -0.1, 0.0]), np.array([0.02, 1e-3])
CIRCLE = np.array([RADIUS * np.sin(RATE * T), RADIUS * (1 - np.cos(RATE * T)), RATE * T]).T
"""A body that goes round in a circle, ahead."""


def reference(reference):
    """The reference of a log with these poses (K, 3)."""
    counts = np.zeros((len(T), 1))
    return ReferencePoses(Log(T, wheel=counts, pivot=counts, reference=reference), counts + T[:, None] * 100)


def test_on_a_circle_the_tracked_point_accelerates_toward_the_centre():
    poses = reference(CIRCLE)
    found = poses.accelerations(np.asarray(CIRCLE, dtype=np.float64), np.zeros(2), MOUNT)
    way = RATE * T[poses.used]
    turned = MOUNT[0] * np.array([np.cos(way), np.sin(way)]) + MOUNT[1] * np.array([-np.sin(way), np.cos(way)])
    from_centre = (CIRCLE[poses.used, :2] - [0.0, RADIUS]) + turned.T
    inside = slice(1, -1)  # at the ends of the log that of a moment later or earlier
    assert found[inside] == pytest.approx(-(RATE**2) * from_centre[inside], rel=(RATE * SWINGING) ** 2, abs=1e-4)


def test_acceleration_does_not_depend_on_the_samples_next_to_the_pose():
    """Where encoders are read early or late, the path is off there, and so would be the acceleration."""
    poses, moved = reference(CIRCLE), CIRCLE.astype(np.float64)
    before = poses.accelerations(moved, np.zeros(2), MOUNT)
    inside = slice(1, -1)
    for by in (-1, 0, 1):
        moved[poses.used[inside] + by, :2] += 0.02
    np.testing.assert_allclose(poses.accelerations(moved, np.zeros(2), MOUNT)[inside], before[inside], atol=1e-9)


def test_poses_that_sway_are_off_in_proportion():
    random = np.random.default_rng(4)
    state = np.column_stack([CIRCLE + 0.01 * random.normal(size=CIRCLE.shape), np.zeros(len(T))])
    poses, size = reference(CIRCLE), 3e-3
    swaying = CIRCLE.copy()
    swaying[poses.used, :2] -= size * poses.accelerations(state, CLOCK, MOUNT)
    weights = poses.weights(state, 1e-3, 1e-3, 0.0)
    still, changed = (poses_of.off(state, CLOCK, MOUNT) for poses_of in (poses, reference(swaying)))
    rows = poses.rows(state, CLOCK, MOUNT, weights, still, np.zeros(2), np.array([0.0, size]), 0)
    for kind, of_kind in rows.items():
        assert of_kind.numbers is not None
        by = of_kind.numbers(slice(None))
        assert not by[..., 0].any()
        assert by[..., 1] == pytest.approx(weights[kind] * (changed[kind] - still[kind]), abs=1e-9)


def with_poses(every):
    """A log in which the circle's poses were taken in some of the samples."""
    reference = np.full_like(CIRCLE, np.nan)
    reference[::every] = CIRCLE[::every]
    return Log(T, wheel=T[:, None] * 100, pivot=np.zeros((len(T), 0)), reference=reference)


def test_of_dense_poses_few_stay_and_they_are_as_they_were():
    dense = with_poses(2)
    fewer = far_apart(dense)
    (kept,) = np.nonzero(np.isfinite(fewer.reference[:, 0]))
    np.testing.assert_array_equal(T[kept], [0.0, FAR_APART, T[398]])
    np.testing.assert_array_equal(fewer.reference[kept], CIRCLE[kept])
    np.testing.assert_array_equal(fewer.wheel, dense.wheel)


@pytest.mark.parametrize("log", [with_poses(20), Log(T, wheel=T[:, None], pivot=np.zeros((len(T), 0)))])
def test_a_log_without_dense_poses_stays(log):
    assert far_apart(log) is log


def lasting(random, samples):
    """Errors (K, 3) of a tracker that last for 5 s: 3 mm and 6 mrad."""
    kept, errors = np.exp(-0.05 / 5.0), random.normal(size=(samples, 3))
    for k in range(1, samples):
        errors[k] = kept * errors[k - 1] + np.sqrt(1 - kept**2) * errors[k]
    return errors * [3e-3, 3e-3, 6e-3]


@pytest.mark.parametrize("seed", [0, 1])
def test_errors_that_last_for_seconds_are_slip_by_dense_poses_alone(seed):
    robot, logs = preset("differential"), []
    for k in range(2):
        way = wander(np.random.default_rng([seed, k]), duration=90.0, holonomic=False)
        log = drive(robot, way, 10 * seed + k, duration=90.0, noise=EXACT)
        errors = lasting(np.random.default_rng([seed, k]), len(log))
        logs.append(dataclasses.replace(log, reference=log.reference + errors))
    dense, fewer = (calibrate(robot, of).noise.along for of in (logs, [far_apart(log) for log in logs]))
    assert dense > 5 * fewer
