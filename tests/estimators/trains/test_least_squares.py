"""Method 2: against scipy, the derivatives by differences, the gauge freedom, and the errors on the static tests."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from benchmarks.tasks.static_tests import STATIC_TESTS
from castor_envs.vehicles.presets import cfmmr
from estimators.trains.least_squares import TrainLeastSquares, gauss_newton, jacobian, residuals
from estimators.trains.pose_noise import ODOMETRY_SIGMA, RELATIVE_SIGMA


def rows(poses, od, relative, priors=True):
    """All residuals in one row, written with complex numbers."""
    z = poses[:, 0] + 1j * poses[:, 1]
    seen = (z[:-1] - z[1:]) * np.exp(-1j * poses[1:, 2])
    turn = poses[:-1, 2] - poses[1:, 2]
    frames = np.stack([seen.real, seen.imag, turn], axis=-1) - relative
    frames[:, 2] = np.angle(np.exp(1j * frames[:, 2]))
    prior = poses - od
    parts = [(prior / ODOMETRY_SIGMA).ravel()] if priors else []
    return np.concatenate([*parts, (frames / RELATIVE_SIGMA).ravel()])


@pytest.mark.parametrize("n", [2, 3, 6, 10])
def test_same_minimum_as_scipy(n, snapshots):
    _, od, relative = snapshots(8, n, 1, seed=n)
    for k in range(8):
        found = gauss_newton(od[k], relative[k])
        by_scipy = least_squares(
            lambda x, k=k: rows(x.reshape(n, 3), od[k], relative[k]), od[k].ravel(), xtol=1e-14, ftol=1e-14, gtol=1e-14
        )
        assert found.converged
        assert found.rank == 3 * n
        np.testing.assert_allclose(found.poses.ravel(), by_scipy.x, rtol=0, atol=1e-6)
        np.testing.assert_allclose(found.cost, 2 * by_scipy.cost, rtol=1e-9)


@pytest.mark.parametrize("n", [2, 3, 10])
def test_jacobian_is_the_derivative(n):
    random = np.random.default_rng(n)
    poses, od = random.uniform(-1, 1, (2, n, 3))
    relative = random.uniform(-0.5, 0.5, (n - 1, 3))
    h = 1e-6
    by_differences = np.stack(
        [
            (rows(poses + step, od, relative) - rows(poses - step, od, relative)) / (2 * h)
            for step in h * np.eye(3 * n).reshape(3 * n, n, 3)
        ],
        axis=-1,
    )
    np.testing.assert_allclose(jacobian(poses, np.ones(n)), by_differences, rtol=1e-6, atol=1e-5)
    prior, frame = residuals(poses, od, relative)
    residual = np.concatenate([prior.ravel(), frame.ravel()])
    np.testing.assert_allclose(residual, rows(poses, od, relative), rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("n", [2, 3, 7])
def test_without_priors_the_whole_train_is_free_to_move(n, snapshots):
    _, (od,), (relative,) = snapshots(1, n, 1, seed=n)
    found = gauss_newton(od, relative, priors=False)
    assert not found.converged
    assert found.rank == 3 * n - 3
    # What is not determined: shifts along x and y, and a turn of all about the origin of N.
    free = np.zeros((3, n, 3))
    free[0, :, 0], free[1, :, 1] = 1.0, 1.0
    free[2] = np.stack([-od[:, 1], od[:, 0], np.ones(n)], axis=-1)
    h = jacobian(od, np.zeros(n))
    np.testing.assert_allclose(h @ free.reshape(3, -1).T, 0.0, atol=1e-9)
    place = (od[:, 0] + 1j * od[:, 1]) * np.exp(0.7j)
    elsewhere = np.stack([place.real + 3, place.imag - 1, od[:, 2] + 0.7], axis=-1)
    np.testing.assert_allclose(rows(elsewhere, od, relative, False), rows(od, od, relative, False), atol=1e-9)


def test_rank_is_6_of_9_on_the_papers_train():
    for test in STATIC_TESTS:
        assert gauss_newton(test.odometry, test.relative, priors=False).rank == 6


def test_errors_on_the_static_tests(standing):
    """Independent figures, to their rounding: mean position errors of least squares on the paper's tests."""
    found = []
    for test in STATIC_TESTS:
        estimator = TrainLeastSquares()
        estimator.reset(cfmmr(3), test.odometry)
        poses = [estimator.update(seen) for seen in standing(3, test.relative)][-1]
        found.append(np.hypot(*(poses - test.truth)[:, :2].T).mean())
        assert estimator.solution is not None
        assert estimator.solution.converged
        assert 7 <= estimator.solution.iterations <= 15
    np.testing.assert_allclose(found, (0.045, 0.092, 0.112, 0.075), rtol=0, atol=0.0005)


def test_a_prior_of_one_axle_attaches_the_train_to_it(snapshots):
    _, od, relative = snapshots(4, 5, 1)
    for axle in range(5):
        found = gauss_newton(od, relative, priors=np.arange(5) == axle)
        np.testing.assert_allclose(found.cost, 0.0, atol=1e-12)
        np.testing.assert_allclose(found.poses[:, axle], od[:, axle], atol=1e-9)


def test_leading_axes_are_problems(snapshots):
    _, od, relative = snapshots(6, 4, 1)
    together = gauss_newton(od.reshape(2, 3, 4, 3), relative.reshape(2, 3, 3, 3))
    for k in range(6):
        alone = gauss_newton(od[k], relative[k])
        np.testing.assert_allclose(together.poses.reshape(6, 4, 3)[k], alone.poses, atol=1e-9)
        np.testing.assert_allclose(together.cost.ravel()[k], alone.cost, rtol=1e-9)
