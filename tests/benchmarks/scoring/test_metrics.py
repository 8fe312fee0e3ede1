"""Metrics against hand-computed and published numbers, an implementation with matrices, and symmetries."""

import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.scoring import path_metrics, square_metrics
from castor_envs.geometry.se2 import relative_pose
from castor_envs.logs.importers.optiodom import find_sessions, published_correction, read_session
from castor_envs.motion.kinematics import Geometry

OF_PATHS = (path_metrics.absolute_trajectory_error, path_metrics.relative_pose_error, path_metrics.end_point_error)

numbers = st.floats(-3, 3)
poses = st.tuples(numbers, numbers, numbers)


def path(seed, samples=40, step=0.2):
    """Return a random smooth path (samples, 3) from the origin."""
    random = np.random.default_rng(seed)
    psi = np.cumsum(random.normal(0, 0.2, samples))
    xy = np.cumsum(
        step * random.uniform(0.2, 1, samples)[:, None] * np.column_stack([np.cos(psi), np.sin(psi)]), axis=0
    )
    return np.column_stack([xy - xy[0], psi - psi[0]])


def matrix(pose):
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array([[c, -s, pose[0]], [s, c, pose[1]], [0, 0, 1]])


def moved(motion, poses):
    c, s = np.cos(motion[2]), np.sin(motion[2])
    x, y, psi = np.moveaxis(poses, -1, 0)
    return np.stack([motion[0] + c * x - s * y, motion[1] + s * x + c * y, motion[2] + psi], axis=-1)


MIRROR = np.array([1.0, -1.0, -1.0])


def test_umbmark_by_hand():
    cw = [(0.10, 0.20), (0.12, 0.16), (0.14, 0.18)]  # centroid (.12, .18)
    ccw = [(-0.3, 0.4), (-0.3, 0.4)]  # centroid (-.3, .4): a 3-4-5 triangle
    result = square_metrics.umbmark(cw, ccw)
    np.testing.assert_allclose(result.centroid_cw, [0.12, 0.18])
    np.testing.assert_allclose(result.centroid_ccw, [-0.3, 0.4])
    assert result.r_ccw == pytest.approx(0.5)
    assert result.r_cw == pytest.approx(np.hypot(0.12, 0.18))
    assert result.e_max_syst == pytest.approx(0.5)


def test_umbmark_is_batched():
    cw, ccw = np.random.default_rng(0).normal(size=(2, 7, 5, 3))
    together = square_metrics.umbmark(cw, ccw)
    for k in range(7):
        alone = square_metrics.umbmark(cw[k], ccw[k])
        for batch, single in zip(together, alone, strict=True):
            np.testing.assert_allclose(batch[k], single)


def test_return_errors_are_true_minus_odometry():
    """Borenstein and Feng 1994: eps = absolute - calculated; right of where the odometry thinks is eps_y < 0."""
    errors = square_metrics.return_errors((0, 0, 0), (0.01, -0.05, 0.1), (0.03, 0.0, -0.1))
    np.testing.assert_allclose(errors, [-0.02, -0.05, 0.2])


@given(poses, poses, poses, poses)
def test_return_errors_do_not_depend_on_where_the_square_lies(start, end, estimate, motion):
    start, end, estimate = (np.array(pose) for pose in (start, end, estimate))
    moved_errors = square_metrics.return_errors(*(moved(motion, pose) for pose in (start, end, estimate)))
    np.testing.assert_allclose(moved_errors, square_metrics.return_errors(start, end, estimate), atol=1e-12)


def test_orientation_error_by_hand():
    """One degree to each side is one degree, not none: absolute values are averaged, in each direction."""
    assert square_metrics.orientation_error([1.0, -1.0], [3.0, -3.0]) == pytest.approx(2.0)


def test_orientation_error_takes_off_the_systematic_part():
    cw, ccw = np.array([0.5, 0.9]), np.array([-0.2, -0.6])
    clean_cw, clean_ccw = np.array([0.2, 0.4]), np.array([-0.1, -0.3])  # means .3 and -.2
    expected = ((0.2 + 0.6) / 2 + (0.0 + 0.4) / 2) / 2
    assert square_metrics.orientation_error(cw, ccw, clean_cw, clean_ccw) == pytest.approx(expected)


@given(st.floats(-1, 1), st.floats(-1, 1), st.integers(0, 99))
def test_orientation_error_is_free_of_any_systematic_error(bias_cw, bias_ccw, seed):
    bumps, clean = np.random.default_rng(seed).normal(size=(2, 2, 5))
    bias = np.array([[bias_cw], [bias_ccw]])
    with_bias = square_metrics.orientation_error(*(bumps + bias), *(clean + bias))
    assert with_bias == pytest.approx(square_metrics.orientation_error(*bumps, *clean))


def test_end_point_error_by_hand():
    true = [(0, 0, 0), (1, 1, 6.0)]
    error = path_metrics.end_point_error(true, [(0, 0, 0), (1.3, 0.6, 6.5)])
    assert error.position == pytest.approx(0.5)
    assert error.heading == pytest.approx(0.5)


def test_a_missed_turn_counts():
    assert path_metrics.end_point_error([(0, 0, 2 * np.pi)], [(0, 0, 0)]).heading == pytest.approx(2 * np.pi)


def test_trajectory_error_by_hand():
    true = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
    estimate = [(0, 0, 0), (1, 3, 9), (2, 4, 9)]
    assert path_metrics.absolute_trajectory_error(true, estimate) == pytest.approx(np.sqrt(25 / 3))


def test_trajectory_error_sees_a_mirrored_path():
    """Aligning a straight path would hide this; the official error has no alignment."""
    true = np.column_stack([np.zeros(5), np.arange(5.0), np.full(5, np.pi / 2)])
    assert path_metrics.absolute_trajectory_error(true, true * MIRROR) == pytest.approx(2 * np.sqrt(30 / 5))


def test_relative_error_of_a_scale_error_is_that_fraction():
    true = np.column_stack([np.arange(0, 4.01, 0.25), np.zeros((17, 2))])
    error = path_metrics.relative_pose_error(true, true * [1.1, 1, 1])
    assert error.translation == pytest.approx(0.1)
    assert error.rotation == pytest.approx(0.0)


def test_a_segment_of_a_metre_is_ten_steps_of_a_tenth_whatever_their_sum_is_rounded_to():
    """The position is off by k^2 / 1000 m after k steps, so a segment's error tells where it starts and ends."""
    k = np.arange(60)
    true = np.column_stack([np.cumsum(np.full(60, 0.1)), np.zeros((60, 2))])
    assert (np.diff(true[::10, 0]) < 1.0).any()
    error = path_metrics.relative_pose_error(true, true + np.column_stack([0 * k, k**2 / 1000, 0 * k]))
    assert error.translation == pytest.approx(np.mean((k[10:] ** 2 - k[:-10] ** 2) / 1000), rel=1e-9)


def test_relative_error_of_a_drifting_heading_is_its_rate():
    """An estimate that bends by .1 rad/m beside a straight path: chord of a unit arc against a unit of straight."""
    s = np.arange(0, 4.01, 0.25)
    true = np.column_stack([s, 0 * s, 0 * s])
    bent = np.column_stack([np.sin(0.1 * s) / 0.1, (1 - np.cos(0.1 * s)) / 0.1, 0.1 * s])
    error = path_metrics.relative_pose_error(true, bent)
    assert error.rotation == pytest.approx(0.1)
    assert error.translation == pytest.approx(np.hypot(np.sin(0.1) / 0.1 - 1, (1 - np.cos(0.1)) / 0.1))


def test_relative_error_forgets_where_a_fault_happened():
    """A jump of the heading at the start costs the segments over it, not all that come after."""
    s = np.arange(0, 9.01, 0.25)
    true = np.column_stack([s, 0 * s, 0 * s])
    faulty = np.array([moved((0, 0, 0.3), pose) if k else pose for k, pose in enumerate(true)])
    error = path_metrics.relative_pose_error(true, faulty)
    segments = len(s) - 4
    assert error.rotation == pytest.approx(0.3 / segments)


@given(st.integers(0, 999))
def test_relative_error_agrees_with_matrices(seed):
    """inv(inv(Q_i) Q_j) inv(P_i) P_j, segment by segment, as KITTI defines it."""
    true, estimate = path(seed), path(seed + 1)
    travelled = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(true[:, :2], axis=0).T))])
    translation, rotation = [], []
    for i in range(len(true)):
        ends = [j for j in range(len(true)) if travelled[j] >= travelled[i] + 1.0]
        if ends:
            j = ends[0]
            wanted = np.linalg.inv(matrix(true[i])) @ matrix(true[j])
            got = np.linalg.inv(matrix(estimate[i])) @ matrix(estimate[j])
            off = np.linalg.inv(got) @ wanted
            length = travelled[j] - travelled[i]
            translation.append(np.hypot(off[0, 2], off[1, 2]) / length)
            turned = (true[j, 2] - true[i, 2]) - (estimate[j, 2] - estimate[i, 2])
            rotation.append(abs(turned) / length)
    error = path_metrics.relative_pose_error(true, estimate)
    assert error.translation == pytest.approx(np.mean(translation))
    assert error.rotation == pytest.approx(np.mean(rotation))


def test_relative_error_of_a_path_that_is_too_short():
    assert np.isnan(path_metrics.relative_pose_error(path(0, 5), path(1, 5), distance=100.0)).all()


@given(st.integers(0, 999), poses)
def test_moving_the_world_changes_nothing(seed, motion):
    true, estimate = path(seed), path(seed + 1)
    for metric in (
        path_metrics.absolute_trajectory_error,
        path_metrics.relative_pose_error,
        path_metrics.end_point_error,
    ):
        moved_score = metric(moved(motion, true), moved(motion, estimate))
        np.testing.assert_allclose(moved_score, metric(true, estimate), rtol=1e-9, atol=1e-12)


@given(st.integers(0, 999), poses)
def test_relative_error_is_the_same_from_a_wrong_start(seed, motion):
    """Moving the estimate alone changes no relative motion."""
    true, estimate = path(seed), path(seed + 1)
    moved_error = path_metrics.relative_pose_error(true, moved(motion, estimate))
    np.testing.assert_allclose(moved_error, path_metrics.relative_pose_error(true, estimate), rtol=1e-9)


@given(st.integers(0, 999))
def test_mirroring_both_changes_nothing(seed):
    true, estimate = path(seed), path(seed + 1)
    for metric in (
        path_metrics.absolute_trajectory_error,
        path_metrics.relative_pose_error,
        path_metrics.end_point_error,
    ):
        np.testing.assert_allclose(metric(true * MIRROR, estimate * MIRROR), metric(true, estimate), rtol=1e-12)


def test_path_metrics_are_batched():
    true = path(0)
    estimates = np.stack([path(k) for k in range(1, 7)]).reshape(2, 3, 40, 3)
    truths = np.broadcast_to(true, estimates.shape)
    for metric, together in (
        (path_metrics.absolute_trajectory_error, path_metrics.absolute_trajectory_error(truths, estimates)),
        (path_metrics.end_point_error, path_metrics.end_point_error(truths, estimates)),
        (path_metrics.relative_pose_error, path_metrics.relative_pose_error(true, estimates)),
    ):
        for i, j in np.ndindex(2, 3):
            np.testing.assert_allclose(np.array(together)[..., i, j], metric(true, estimates[i, j]))


# The worked example published with the OptiOdom data: centroids in mm, and the largest end errors before and after.
PUBLISHED = {
    "230620202042": ((-10.9, -6.2), (-23.2, 19.7), 33.3, 7.2),
    "230620202144": (None, None, 66.8, 4.6),
}


@pytest.mark.parametrize("session", PUBLISHED)
def test_published_umbmark_of_a_measured_session(session):
    data = os.environ.get("CASTOR_DATA")
    folders = find_sessions(Path(data)) if data else {}
    if session not in folders:
        pytest.skip("the OptiOdom data are not there: set CASTOR_DATA")
    measured = read_session(folders[session])
    cw, ccw, before, after = PUBLISHED[session]
    for robot, largest in (
        (measured.robot, before),
        (published_correction(session).apply(measured.robot), after),
    ):
        geometry = Geometry.of(robot)
        errors = {"cw": [], "ccw": []}
        for log, direction in zip(measured.runs, measured.directions, strict=True):
            rolled = np.diff(log.wheel, axis=0) * 2 * np.pi * geometry.radius / geometry.counts_per_rev
            turn = (rolled[:, 1] - rolled[:, 0]) / (geometry.lateral[0] - geometry.lateral[1])
            psi = np.cumsum(turn) - turn / 2
            along = rolled.mean(axis=1)
            end = (np.sum(along * np.cos(psi)), np.sum(along * np.sin(psi)), np.sum(turn))
            truth = np.asarray(log.reference)
            errors[direction].append(relative_pose(truth[0], truth[-1]) - end)
        result = square_metrics.umbmark(errors["cw"], errors["ccw"])
        if cw is not None and robot is measured.robot:
            np.testing.assert_allclose(1e3 * result.centroid_cw, cw, atol=0.1)
            np.testing.assert_allclose(1e3 * result.centroid_ccw, ccw, atol=0.1)
        ends = np.concatenate([errors["cw"], errors["ccw"]])[:, :2]
        assert 1e3 * np.linalg.norm(ends, axis=1).max() == pytest.approx(largest, abs=0.1)
