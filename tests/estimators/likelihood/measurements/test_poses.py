"""Reference poses in the likelihood: the tracked point's acceleration, in proportion to which they may be off."""

import numpy as np
import pytest

from castor_envs.logs.log import Log
from estimators.likelihood.measurements.poses import SWINGING, ReferencePoses

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
