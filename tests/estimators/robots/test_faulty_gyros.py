"""What a gyro does to `filter` that fails, lies, or is not read: no more harm than none, where wheels tell as much."""

import dataclasses

import numpy as np
import pytest

from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Gyro
from estimators import CalibratingFilter
from estimators.plugins.drives import winding

REDUNDANT = ("asoc-prototype", "omnimate", "swerve")
NOISE = 1e-3
"""rad/s, of readings."""


def with_gyro(name, **gyro):
    return dataclasses.replace(preset(name), gyro=Gyro(**{"noise": NOISE} | gyro))


def followed(robot, observations):
    """The estimator after a drive, its poses (K, 3), and what it released in each sample (K, q)."""
    estimator, poses, released = CalibratingFilter(), [], []
    estimator.reset(robot, np.zeros(3))
    for seen in observations:
        poses.append(estimator.update(seen))
        released.append(np.any(estimator.released, axis=0))
    return estimator, np.array(poses), np.array(released)


def read(drive, change, seed=0):
    """A drive's observations with readings changed: from times and true rates (K,) to what the gyro says (K,)."""
    rate = np.array([seen["gyro"][0] for seen in drive.observations])
    t = np.array([seen["time"][0] for seen in drive.observations])
    noise = NOISE * np.random.default_rng(seed).standard_normal(len(t))
    return [
        {**seen, "gyro": np.array([w])} for seen, w in zip(drive.observations, change(t, rate) + noise, strict=True)
    ]


def farthest(poses, drive):
    """By how much poses are off at most: m, rad."""
    off = np.abs(poses - drive.pose)
    return np.hypot(off[:, 0], off[:, 1]).max(), off[:, 2].max()


def normalised(estimator, drive):
    """The squared error at the end over its covariance, of three degrees of freedom."""
    off = estimator.pose - drive.pose[-1]
    return off @ np.linalg.solve(estimator.covariance, off)


FAULTS = {
    "dead": lambda t, rate: np.where(t < 5.0, rate, 0.0),
    "frozen": lambda t, rate: np.where(t < 5.0, rate, rate[np.searchsorted(t, 5.0)]),
    "at the end of its range": lambda t, rate: np.clip(rate, -0.4, 0.4),
    "of the wrong sign": lambda t, rate: -rate,
    "jumping": lambda t, rate: rate + 0.3 * ((t > 5.0) & (t < 5.5)),
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("name", REDUNDANT)
def test_a_gyro_that_contradicts_all_wheels_is_released(name, fault):
    drive = winding(preset(name))
    _, without, _ = followed(preset(name), drive.observations)
    robot = with_gyro(name)
    estimator, poses, released = followed(robot, read(winding(robot), FAULTS[fault]))
    way, turn = farthest(without, drive)
    off = farthest(poses, drive)
    assert off[0] < way + 1e-3
    assert off[1] < turn + 2e-3
    assert normalised(estimator, drive) < 12.8  # 1 in 200
    assert released[:, -1].mean() > 0.03
    assert released[:, :-1].mean() < 0.01  # where the gyro contradicts by little, a wheel may be taken for it


@pytest.mark.parametrize("too_far", [-0.02, 0.01, 0.02])
@pytest.mark.parametrize("name", REDUNDANT)
def test_a_scale_within_its_tolerance_is_learned(name, too_far):
    robot = with_gyro(name, scale_tolerance=0.02)
    drive = winding(robot)
    estimator, poses, released = followed(robot, read(drive, lambda t, rate: (1.0 + too_far) * rate))
    assert estimator.gyro_scale == pytest.approx(too_far, abs=5e-3)
    assert farthest(poses, drive)[1] < 2e-3
    assert normalised(estimator, drive) < 12.8
    assert not released.any()


def test_where_wheels_tell_the_turn_but_once_the_gyro_stays():
    """Two wheels and a gyro: any of them may be wrong, and wheels slip oftener than gyros fail."""
    robot = with_gyro("differential")
    drive = winding(robot)
    for k in range(100, 120):
        drive.observations[k]["wheel"] = drive.observations[k]["wheel"] + [30.0, 0.0]
    _, poses, released = followed(robot, drive.observations)
    assert released[100:120, :2].all()
    assert not released[:, -1].any()
    assert farthest(poses, drive)[1] < 0.02  # 600 counts make 0.4 rad


@pytest.mark.parametrize(("name", "most"), [("asoc-prototype", 1.5e-3), ("differential", 0.02)])
def test_stamps_that_jitter_are_believed_no_more_than_that(name, most):
    """By 5 ms of 50, which odometry does not see; errors then fit the covariance."""
    robot = with_gyro(name)
    drive = winding(robot)
    late = 0.005 * np.random.default_rng(3).standard_normal(len(drive.pose))
    seen = read(drive, lambda t, rate: rate)
    estimator, poses, _ = followed(
        robot, [{**one, "time": one["time"] + by} for one, by in zip(seen, late, strict=True)]
    )
    assert farthest(poses, drive)[0] < most
    assert normalised(estimator, drive) < 12.8


@pytest.mark.parametrize("bias", [0.08, -0.15])
def test_the_bias_that_the_file_states_is_none(bias):
    robot, told = with_gyro("differential"), with_gyro("differential", bias=bias, bias_tolerance=0.005)
    drive = winding(robot)
    estimator, poses, _ = followed(told, read(drive, lambda t, rate: rate + bias))
    assert estimator.gyro_bias == pytest.approx(bias, abs=5e-4)
    assert farthest(poses, drive)[0] < 2e-3


def test_a_bias_shows_while_the_robot_stands():
    """Wheels that count nothing are not released for a gyro that says that the body turns."""
    robot, bias = with_gyro("differential", bias_tolerance=0.02), 0.08
    drive = winding(robot)
    stands = {**drive.observations[0], "gyro": np.array([bias])}
    seen = [{**stands, "time": np.array([0.05 * k])} for k in range(60)]
    _, poses, released = followed(robot, seen)
    assert not released[:, :-1].any()
    np.testing.assert_allclose(poses[:, :2], 0.0, atol=1e-9)
    free = dataclasses.replace(robot, gyro=Gyro(noise=NOISE))
    seen += [{**one, "time": one["time"] + 3.0, "gyro": one["gyro"] + bias} for one in drive.observations]
    estimator, poses, released = followed(free, seen)
    assert not released.any()
    assert estimator.gyro_bias == pytest.approx(bias, abs=2e-3)
    assert farthest(poses[60:], drive)[0] < 5e-3


@pytest.mark.parametrize("name", ["asoc-prototype", "differential"])
def test_readings_that_are_missing_leave_what_is_read(name):
    """Whether they are not finite or not there, and whatever is missing after the gyro is read again."""
    robot = with_gyro(name)
    drive = winding(robot)
    seen = read(drive, lambda t, rate: rate)
    blank = [{**one, "gyro": np.full(1, np.nan)} if 30 <= k < 60 else one for k, one in enumerate(seen)]
    gone = [{of: part for of, part in one.items() if of != "gyro" or not 30 <= k < 60} for k, one in enumerate(seen)]
    estimator, poses, released = followed(robot, blank)
    np.testing.assert_array_equal(followed(robot, gone)[1], poses)
    way, turn = farthest(poses, drive)
    assert way < 3e-3
    assert turn < 3e-3
    assert normalised(estimator, drive) < 12.8
    assert not released.any()


def test_robots_of_a_stack_miss_their_own_readings():
    robot = with_gyro("asoc-prototype")
    seen = read(winding(robot), lambda t, rate: rate)
    blank = [{**one, "gyro": np.full(1, np.nan)} if k % 7 == 0 else one for k, one in enumerate(seen)]
    single = np.stack([followed(robot, of)[1] for of in (seen, blank)], axis=1)
    estimator = CalibratingFilter()
    estimator.reset(Geometry.of([robot, robot]), np.zeros((2, 3)))
    for k, both in enumerate(zip(seen, blank, strict=True)):
        pose = estimator.update({part: np.stack([one[part] for one in both]) for part in both[0]})
        np.testing.assert_allclose(pose, single[k], atol=1e-9)


def test_a_batch_may_follow_a_reset_for_one_robot():
    """Bit for bit as a stack that is reset as such, time stamps of the first sample too."""
    robot = with_gyro("asoc-prototype")
    seen = [
        {part: np.tile(of, (7, 1)) for part, of in one.items()} | {"time": np.tile(one["time"] + 5.0, (7, 1))}
        for one in read(winding(robot), lambda t, rate: rate)
    ]
    grown, stack = CalibratingFilter(), CalibratingFilter()
    grown.reset(robot, np.zeros(3))
    stack.reset(robot, np.zeros((7, 3)))
    for one in seen:
        np.testing.assert_array_equal(grown.update(one), stack.update(one))
    np.testing.assert_array_equal(grown.covariance, stack.covariance)
