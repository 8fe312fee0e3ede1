"""Odometry of a train: exact arcs, axle by axle, whatever its neighbours do."""

import dataclasses

import numpy as np
import pytest

from castor_envs.vehicles.presets import axle_module, cfmmr
from castor_envs.vehicles.train import TrainDescription
from estimators.trains.odometry import TrainOdometry


@pytest.mark.parametrize("n", [2, 3, 10])
@pytest.mark.parametrize("curvature", [0.0, 0.8, -1.7])
def test_exact_on_circles_and_lines(n, curvature, circling):
    train, truth, observations = circling(n, curvature=curvature, seconds=3.0)
    estimator = TrainOdometry()
    estimator.reset(train, truth[0])
    poses = np.array([estimator.update(seen) for seen in observations])
    np.testing.assert_allclose(poses, truth, atol=1e-11)
    assert poses.dtype == np.float64


def odd_train():
    """Axles whose wheels all differ."""
    modules = []
    for i in range(3):
        module = axle_module()
        wheels = tuple(
            dataclasses.replace(wheel, radius=0.05 + 0.004 * i + 0.001 * k, counts_per_rev=900 + 100 * i + 50 * k)
            for k, wheel in enumerate(module.castors[0].wheels)
        )
        wheels = (dataclasses.replace(wheels[0], lateral=0.1 + 0.02 * i), wheels[1])
        modules.append(dataclasses.replace(module, castors=(dataclasses.replace(module.castors[0], wheels=wheels),)))
    return TrainDescription(name="odd", modules=tuple(modules), frames=cfmmr(3).frames)


def test_every_step_is_an_arc_of_its_own_axle():
    train = odd_train()
    random = np.random.default_rng(5)
    start = random.uniform(-1, 1, (3, 3))
    counts = random.integers(-200, 200, (40, 6)).astype(float)
    counts[0] = 0.0
    estimator = TrainOdometry()
    estimator.reset(train, start)
    place, psi = start[:, 0] + 1j * start[:, 1], start[:, 2].copy()
    for k, count in enumerate(counts):
        for i, module in enumerate(train.modules):
            left, right = module.castors[0].wheels
            rolled = [
                2 * np.pi * wheel.radius / (wheel.counts_per_rev or np.nan) * c
                for wheel, c in zip((left, right), count[2 * i :], strict=False)
            ]
            turn = (rolled[1] - rolled[0]) / (left.lateral - right.lateral)
            ahead = rolled[0] + turn * left.lateral
            # Along the heading, integrated over an even turn.
            factor = ahead if turn == 0 else ahead * (np.exp(1j * turn) - 1) / (1j * turn)
            place[i] += factor * np.exp(1j * psi[i])
            psi[i] += turn
        poses = estimator.update({"wheel": count, "time": np.array([0.05 * k])})
        np.testing.assert_allclose(poses, np.stack([place.real, place.imag, psi], axis=-1), atol=1e-12)


def test_relative_poses_are_not_read():
    estimator = TrainOdometry()
    estimator.reset(cfmmr(3), np.ones((3, 3)))
    np.testing.assert_array_equal(estimator.update({"wheel": np.zeros(6)}), np.ones((3, 3)))
    assert estimator.status is None
