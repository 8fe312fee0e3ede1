"""Method 1: covariance intersection, its pairwise updates, and that they contradict the relative poses."""

import numpy as np
import pytest

from benchmarks.tasks.static_tests import STATIC_TESTS
from castor_envs.vehicles.presets import cfmmr
from estimators.trains.grpec import errors
from estimators.trains.pose_noise import ODOMETRY_SIGMA, RELATIVE_SIGMA
from estimators.trains.rmspec import (
    RMSPEC,
    ROLLING_SIGMA,
    TURNING_SIGMA,
    Belief,
    deviations,
    grown,
    intersection,
    updated,
)


def seen_from(rear, front):
    """The front axle's place in the rear axle's frame, as a complex number."""
    return ((front[0] - rear[0]) + 1j * (front[1] - rear[1])) * np.exp(-1j * rear[2])


@pytest.mark.parametrize(
    ("test", "contradiction"), list(zip(STATIC_TESTS, (0.077, 0.169, 0.115, 0.127), strict=True)), ids=range(1, 5)
)
def test_belief_contradicts_the_relative_poses(test, contradiction, standing):
    estimator = RMSPEC()
    estimator.reset(cfmmr(3), test.odometry)
    poses = [estimator.update(seen) for seen in standing(3, test.relative)][-1]
    gaps = [abs(seen_from(poses[f + 1], poses[f]) - complex(*test.relative[f, :2])) for f in range(2)]
    # The paper's Fig. 2: one frame is put right, by its own lights, and the other no longer fits.
    assert min(gaps) < 0.002
    assert abs(max(gaps) - contradiction) < 0.002
    assert np.hypot(*(poses - test.truth)[:, :2].T).mean() > 0.05


def covariance(random):
    root = random.normal(size=(3, 3))
    return root @ root.T + 0.1 * np.eye(3)


@pytest.mark.parametrize("seed", range(20))
def test_covariance_intersection_finds_the_smallest_determinant(seed):
    random = np.random.default_rng(seed)
    a, b = covariance(random), covariance(random)
    gain, fused = intersection(a, b)
    grid = [np.linalg.inv(w * np.linalg.inv(a) + (1 - w) * np.linalg.inv(b)) for w in np.linspace(0, 1, 2001)]
    assert np.linalg.det(fused) <= min(np.linalg.det(p) for p in grid) * (1 + 1e-9)
    # x = P (w A^-1 x_a + (1 - w) B^-1 x_b): the weights of both estimates add up to the identity.
    kept = (np.eye(3) - gain) @ a
    np.testing.assert_allclose(kept, kept.T, atol=1e-10)
    np.testing.assert_allclose(gain @ b, (gain @ b).T, atol=1e-10)
    # Consistent whatever the correlation: here fully correlated errors, the worst case of both.
    cross = np.linalg.cholesky(a) @ np.linalg.cholesky(b).T
    keep = np.eye(3) - gain
    actual = keep @ a @ keep.T + gain @ b @ gain.T + keep @ cross @ gain.T + gain @ cross.T @ keep.T
    assert np.linalg.eigvalsh(fused - actual).min() > -1e-9


def test_covariance_intersection_keeps_what_is_better_in_all_directions():
    random = np.random.default_rng(1)
    good = covariance(random)
    bad = good + covariance(random)
    for first, second, weight in ((good, bad, 0.0), (bad, good, 1.0)):
        gain, fused = intersection(first, second)
        np.testing.assert_allclose(fused, good, rtol=1e-12)
        np.testing.assert_allclose(gain, weight * np.eye(3), atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_covariances_grow_as_those_of_many_noisy_axles(seed):
    random = np.random.default_rng(seed)
    begin = np.diag(ODOMETRY_SIGMA**2)
    before = random.uniform(-1, 1, 3)
    roll, turn = 0.2, random.uniform(-0.3, 0.3)
    after = before + np.array([roll * np.cos(before[2] + turn / 2), roll * np.sin(before[2] + turn / 2), turn])
    start = before + random.multivariate_normal(np.zeros(3), begin, 40000)
    sigma = np.sqrt([0.2, 0.2, 0.2] * ROLLING_SIGMA**2 + [0, 0, abs(turn) * TURNING_SIGMA**2])
    along, across, extra = (random.normal(size=(40000, 3)) * sigma).T
    place = (start[:, 0] + 1j * start[:, 1]) + (roll + along + 1j * across) * np.exp(1j * (start[:, 2] + turn / 2))
    drawn = np.cov(np.stack([place.real, place.imag, start[:, 2] + turn + extra]))
    predicted = grown(begin, before, after)
    scale = np.sqrt(np.outer(np.diag(predicted), np.diag(predicted)))
    np.testing.assert_allclose(drawn / scale, predicted / scale, atol=0.03)


def test_prediction_through_a_frame_either_way_is_as_uncertain_as_many_draws():
    random = np.random.default_rng(3)
    relative = np.array([0.32, 0.11, 0.6])
    for trusted in (0, 1):
        # One axle known exactly but for its covariance, the other not at all: CI then takes the prediction whole.
        poses = np.array([[0.3, 0.1, 0.4], [0.0, 0.0, 0.0]])
        covariances = np.array([np.diag([1e6, 1e6, 1e6])] * 2)
        covariances[trusted] = np.diag(ODOMETRY_SIGMA**2)
        # Trust is by deviation: turn the other axle's heading away.
        poses[1 - trusted, 2] += 1.2
        vector = seen_from(poses[trusted], poses[1 - trusted])
        true = complex(*relative[:2]) if trusted == 1 else -complex(*relative[:2]) * np.exp(-1j * relative[2])
        poses[trusted, 2] += np.angle(vector) - np.angle(true)
        assert deviations(poses, relative[None])[0].argmin() == trusted
        belief = updated(Belief(poses, covariances), relative[None])
        start = poses[trusted] + random.normal(size=(60000, 3)) * ODOMETRY_SIGMA
        drawn = relative + random.normal(size=(60000, 3)) * RELATIVE_SIGMA
        seen = drawn[:, 0] + 1j * drawn[:, 1]
        if trusted == 1:
            place, psi = start[:, 0] + 1j * start[:, 1] + seen * np.exp(1j * start[:, 2]), start[:, 2] + drawn[:, 2]
        else:
            psi = start[:, 2] - drawn[:, 2]
            place = start[:, 0] + 1j * start[:, 1] - seen * np.exp(1j * psi)
        sample = np.stack([place.real, place.imag, psi])
        np.testing.assert_allclose(belief.poses[1 - trusted], sample.mean(axis=1), atol=2e-3)
        scale = np.sqrt(np.diag(np.cov(sample)))
        np.testing.assert_allclose(
            belief.covariances[1 - trusted] / np.outer(scale, scale), np.corrcoef(sample), atol=0.03
        )
        np.testing.assert_array_equal(belief.poses[trusted], poses[trusted])


def test_frames_are_judged_as_trains_of_two():
    for test in STATIC_TESTS:
        for f, pair in enumerate(deviations(test.odometry, test.relative)):
            alone = errors(test.odometry[f : f + 2], test.relative[f : f + 1])
            np.testing.assert_array_equal(pair, alone.theta_dev)
