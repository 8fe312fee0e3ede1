"""The ceiling of trains: exact but for encoders' steps where axles roll without slip, blind to slip to the side."""

import numpy as np
import pytest

from benchmarks.tasks.ceilings.trains import counts_per_radian, followed_ideally, rolled_angles
from castor_envs.geometry import se2
from castor_envs.vehicles.presets import cfmmr

TRAIN = cfmmr(3)
LATERAL = TRAIN.modules[0].wheels[0].lateral
RADIUS = TRAIN.modules[0].wheels[0].radius


def circling(curvature: float, way: float, across: float = 0.0):
    """Poses (K, 9) of three axles on circles, from three places, that drift by `across` m to the left in all."""
    samples = 200
    steps = np.array([np.sinc(curvature * way / samples / (2 * np.pi)), 0.0, curvature * way / samples])
    steps[0] *= way / samples
    poses = [np.array([[0.0, 0.0, 0.3], [-0.4, 0.1, 0.2], [-0.8, 0.3, -0.1]])]
    half = np.array([0.0, 0.0, steps[2] / 2])
    for _ in range(samples):
        chord = se2.compose(poses[-1], half)
        poses.append(se2.compose(se2.compose(chord, [steps[0], across / samples, 0.0]), half))
    return np.array(poses).reshape(len(poses), -1)


@pytest.mark.parametrize("curvature", [0.0, 0.7, -2.0])
def test_wheels_on_a_circle_roll_the_arcs_of_their_radii(curvature):
    """The closed form: each wheel rolls 1 - curvature times its lateral distance as far as its axle."""
    angles = rolled_angles(TRAIN, circling(curvature, way=3.0))
    expected = np.tile([3.0 * (1 - curvature * LATERAL), 3.0 * (1 + curvature * LATERAL)], 3) / RADIUS
    np.testing.assert_allclose(angles[-1], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("curvature", [0.0, 0.7, -2.0])
def test_only_steps_of_encoders_are_left_where_nothing_slips(curvature):
    pose = circling(curvature, way=3.0)
    samples = np.arange(0, len(pose), 10)
    found = followed_ideally(TRAIN, pose, samples)
    count = RADIUS / counts_per_radian(TRAIN)[0]
    turned = count / (2 * LATERAL)
    assert np.abs(found - pose[samples].reshape(len(samples), 3, 3).swapaxes(0, 1)).max() < count + 3.0 * turned


def test_slip_to_the_side_is_not_seen():
    pose = circling(0.0, way=1.0, across=0.05)
    found = followed_ideally(TRAIN, pose, np.array([len(pose) - 1]))
    off = se2.relative_pose(found[:, 0], pose[-1].reshape(3, 3))
    np.testing.assert_allclose(off[:, 1], 0.05, rtol=0, atol=2e-3)
