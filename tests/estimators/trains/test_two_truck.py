"""IPEC of two trucks: a bump that turns one of them stays in odometry, and not in the corrected heading."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from castor_envs.errors import InputError
from castor_envs.vehicles.presets import cfmmr
from estimators.trains.odometry import TrainOdometry
from estimators.trains.two_truck import TwoTruckIPEC, corrected


def run(estimator, train, start, observations):
    estimator.reset(train, start)
    return np.array([estimator.update(seen) for seen in observations])


@pytest.mark.parametrize("curvature", [0.0, 0.8])
@pytest.mark.parametrize("bumped", [[0], [2], [1, 3], [0, 3]])
def test_removes_what_a_bump_turned(curvature, bumped, circling):
    train, truth, observations = circling(2, curvature=curvature, seconds=4.0)
    observations[20]["wheel"] = observations[20]["wheel"].copy()
    observations[20]["wheel"][bumped] += 10.0
    left, right = train.modules[0].castors[0].wheels
    turned = 10.0 * 2 * np.pi * left.radius / left.counts_per_rev / (left.lateral - right.lateral)
    alone = run(TrainOdometry(), train, truth[0], observations)[-1] - truth[-1]
    ipec = run(TwoTruckIPEC(), train, truth[0], observations)[-1] - truth[-1]
    hit = sorted({wheel // 2 for wheel in bumped})
    np.testing.assert_allclose(np.abs(alone[hit, 2]), turned, rtol=1e-9)
    # What is left is the line: in a bend the bumped truck also rolls 5 counts sideways to it.
    assert np.abs(ipec[:, 2]).max() < 0.15 * turned
    assert np.abs(ipec[:, :2]).max() < 0.2 * np.abs(alone[:, :2]).max()


@given(st.integers(0, 10**6), st.floats(-3, 3), st.floats(-1.2, 1.2))
def test_headings_follow_the_line_and_the_rear_truck_keeps_its_distance(seed, line, bend):
    random = np.random.default_rng(seed)
    x, y = random.uniform(0.1, 0.4), random.uniform(-0.3, 0.3)
    front = random.uniform(-5, 5, 2)
    rear = front - random.uniform(0.05, 0.6) * np.array([np.cos(line), np.sin(line)])
    od = np.array([[*front, random.uniform(-9, 9)], [*rear, random.uniform(-9, 9)]])
    poses = corrected(od, np.array([[x, y, bend]]))
    np.testing.assert_array_equal(poses[0, :2], front)
    # The belief is now the relative pose, and its line that of odometry.
    seen = complex(*(poses[0] - poses[1])[:2])
    assert abs(seen - np.hypot(x, y) * np.exp(1j * line)) < 1e-9
    assert abs(seen * np.exp(-1j * poses[1, 2]) - complex(x, y)) < 1e-9
    assert abs(np.exp(1j * (poses[0, 2] - poses[1, 2] - bend)) - 1) < 1e-9
    assert np.abs(poses[:, 2] - od[:, 2]).max() <= np.pi + 1e-9


@pytest.mark.parametrize("n", [3, 10])
def test_trains_of_more_axles_are_refused(n):
    with pytest.raises(InputError, match=f"joins two axles, and .* has {n}; grpec-xy"):
        TwoTruckIPEC().reset(cfmmr(n), np.zeros((n, 3)))
