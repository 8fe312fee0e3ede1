"""Filters of wheels and a gyro: exact where nothing is wrong, and what they learn where something is."""

import dataclasses

import numpy as np
import pytest

from castor_envs.errors import Declined
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.presets import differential, preset
from castor_envs.vehicles.robot import Gyro
from estimators import WheelOdometry, load_estimator
from estimators.peers import invariant_ekf
from estimators.peers.invariant_ekf import InvariantEKF
from estimators.peers.wheel_gyro import RADIUS, TRACK, WheelGyro
from estimators.plugins.conformance.check import check
from estimators.steps.gyro import BIAS, GyroTurns

NAMES = ("invariant-ekf", "wheel-gyro")


def with_gyro(robot, **gyro):
    return dataclasses.replace(robot, gyro=Gyro(**gyro))


def read_by_gyro(observations, rate, bias=0.0):
    """Return observations with a gyro that reads the yaw rate (K,), rad/s, and its bias."""
    return [{**seen, "gyro": np.array([w + bias])} for seen, w in zip(observations, rate, strict=True)]


def bends(t):
    """A twist of a differential robot: bends to both sides, at changing speed."""
    return 0.4 + 0.2 * np.sin(0.9 * t), 0.0, 0.8 * np.sin(0.7 * t)


def sampled(motion, steps, twist, bias=0.0, noise=0.0):
    """Return the true poses and the observations with a gyro at evenly spaced times."""
    true, observations = motion.sampled(steps)
    rate = np.array([twist(float(seen["time"][0]))[2] for seen in observations])
    rate = rate + noise * np.random.default_rng(5).standard_normal(len(rate))
    return true, read_by_gyro(observations, rate, bias)


@pytest.mark.parametrize("robot", ["swerve", "asoc-prototype", "differential", "tricycle"])
@pytest.mark.parametrize("name", NAMES)
def test_conforms(name, robot):
    findings = check(load_estimator(name), with_gyro(preset(robot), noise=1e-3))
    assert [finding for finding in findings if not finding.passed] == []


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("robot", [differential(), preset("swerve"), Geometry.of(differential())])
def test_robots_without_a_gyro_are_declined(name, robot):
    with pytest.raises(Declined, match="needs a gyro"):
        load_estimator(name).factory().reset(robot, np.zeros(3))


@pytest.mark.parametrize("name", NAMES)
def test_robots_whose_motion_is_undetermined_are_declined(name):
    robot = with_gyro(preset("tricycle"))
    robot = dataclasses.replace(robot, castors=robot.castors[:1])
    with pytest.raises(Declined, match="determine how the body moves"):
        load_estimator(name).factory().reset(robot, np.zeros(3))


def test_a_trapezoid_integrates_a_rate_that_changes_evenly():
    turns, total = GyroTurns(None, 0.1), 0.0
    for k in range(11):
        read = turns.read({"time": np.array([0.1 * k]), "gyro": np.array([0.3 * k])})
        assert read.known == (k > 0)
        total += float(read.turn)
    assert total == pytest.approx(0.5 * 3.0 * 1.0**2)
    assert not turns.read({"time": np.array([1.1])}).known


@pytest.mark.parametrize("name", ["differential", "swerve", "tricycle"])
def test_wheels_and_gyro_that_agree_are_followed_exactly(name, exact_motion, drive):
    """On circles at any period: nothing contradicts, so that nothing is learned."""
    robot, (v, omega) = with_gyro(preset(name), noise=1e-3), (0.4, 0.6)
    theta = [castor.angle or np.angle(v + 1j * omega * complex(*castor.pivot)) for castor in robot.castors]
    theta = [0.0 if c.steering == "fixed" else angle for c, angle in zip(robot.castors, theta, strict=True)]
    motion = exact_motion(robot, lambda t: (v, 0.0, omega), 6.0, theta=theta, pose=(1.0, 1.0, 1.0))
    true, observations = motion.sampled(20)
    seen = read_by_gyro(observations, np.full(21, omega))
    np.testing.assert_allclose(drive(WheelGyro(), robot, seen, true[0]), true, atol=1e-9)


def test_wrong_radii_and_a_bias_are_learned(exact_motion, drive):
    """A wheel 1 % too large, a track 1 % too wide and 0.01 rad/s of bias: the heading drifts a tenth as far as that of
    the wheels, and less than a tenth as far as that of the gyro."""
    robot = with_gyro(differential(), noise=1e-4)
    motion = exact_motion(robot, bends, 60.0)
    true, seen = sampled(motion, 1200, bends, bias=0.01)
    (left, right) = robot.castors[0].wheels
    wheels = (
        dataclasses.replace(left, radius=1.01 * left.radius, lateral=1.01 * left.lateral),
        dataclasses.replace(right, lateral=1.01 * right.lateral),
    )
    believed = dataclasses.replace(
        robot, castors=(dataclasses.replace(robot.castors[0], wheels=wheels), *robot.castors[1:])
    )
    estimator = WheelGyro()
    off = np.abs(drive(estimator, believed, seen) - true)[-1]
    by_wheels = np.abs(drive(WheelOdometry(), believed, seen) - true)[-1]
    assert estimator.gyro_bias == pytest.approx(0.01, abs=5e-4)
    assert off[2] < min(by_wheels[2], 0.01 * 60.0) / 10
    assert np.hypot(*off[:2]) < np.hypot(*by_wheels[:2]) / 3


def test_the_common_scale_of_lengths_stays_as_described(exact_motion, drive):
    """Twice the robot turns as far by the same counts: a gyro cannot know."""
    robot = with_gyro(differential())
    true, seen = sampled(exact_motion(robot, bends, 20.0), 400, bends)
    wheels = [dataclasses.replace(w, radius=2 * w.radius, lateral=2 * w.lateral) for w in robot.castors[0].wheels]
    believed = dataclasses.replace(robot, castors=(dataclasses.replace(robot.castors[0], wheels=tuple(wheels)),))
    path = drive(WheelGyro(), believed, seen)
    np.testing.assert_allclose(path[:, 2], true[:, 2], atol=2e-3)
    np.testing.assert_allclose(path[:, :2], 2 * true[:, :2], atol=0.02)


def test_the_covariance_is_that_of_the_errors(exact_motion, drive):
    """Of robots drawn from the prior the squared errors over the covariance are those of a chi-square or smaller:
    slip is allowed for, and there is none here."""
    robot, random, squares = with_gyro(differential(), noise=1e-3), np.random.default_rng(2), []
    motion = exact_motion(robot, bends, 30.0)
    for _ in range(30):
        bias = float(BIAS * random.standard_normal())
        true, observations = motion.sampled(300)
        rate = [bends(float(seen["time"][0]))[2] + 1e-3 * random.standard_normal() for seen in observations]
        scale = 1.0 + TRACK * random.standard_normal()
        wheels = [
            dataclasses.replace(w, radius=w.radius * (1 + RADIUS * random.standard_normal()), lateral=scale * w.lateral)
            for w in robot.castors[0].wheels
        ]
        castors = (dataclasses.replace(robot.castors[0], wheels=tuple(wheels)), *robot.castors[1:])
        estimator = WheelGyro()
        path = drive(estimator, dataclasses.replace(robot, castors=castors), read_by_gyro(observations, rate, bias))
        off = path[-1] - true[-1]
        squares.append(off @ np.linalg.solve(estimator.covariance, off))
    assert np.mean(squares) < 3 * 1.4
    assert np.mean(squares) > 0.3


@pytest.mark.parametrize("name", ["differential", "swerve"])
def test_without_slip_the_invariant_filter_steps_by_wheels_along_the_gyro(name, monkeypatch, exact_motion, drive):
    """Exact on circles at any period then, though its velocity is taken to be constant."""
    monkeypatch.setattr(invariant_ekf, "SLIP", 0.0)
    monkeypatch.setattr(invariant_ekf, "WHEELS", 1e-8)
    robot, (v, omega) = dataclasses.replace(with_gyro(preset(name)), sample_period=0.3), (0.4, 0.6)
    theta = [0.0 if c.steering == "fixed" else np.angle(v + 1j * omega * complex(*c.pivot)) for c in robot.castors]
    motion = exact_motion(robot, lambda t: (v, 0.0, omega), 6.0, theta=theta, pose=(1.0, 1.0, 1.0))
    true, observations = motion.sampled(20)
    seen = read_by_gyro(observations, np.full(21, omega))
    np.testing.assert_allclose(drive(InvariantEKF(), robot, seen, true[0]), true, atol=1e-6)


def test_slip_is_seen_in_the_way_of_a_burst_and_dies_away(exact_motion, drive):
    robot = with_gyro(differential())
    true, observations = exact_motion(robot, lambda t: (0.3, 0.0, 0.0), 6.0, pose=(0.0, 0.0, 0.7)).sampled(120)
    spun = read_by_gyro(observations, np.zeros(121))
    for seen in spun[60:64]:
        seen["wheel"] = 3 * seen["wheel"]
    estimator, ahead = InvariantEKF(), np.array([np.cos(0.7), np.sin(0.7)])
    drive(estimator, robot, spun[:60], true[0])
    before = estimator.slip_velocity @ ahead
    estimator.update(spun[60])
    first = estimator.slip_velocity
    assert first @ ahead > before + 0.002
    assert abs(first[0] * ahead[1] - first[1] * ahead[0]) < 1e-9
    way = [drive(e, robot, spun[:64], true[0])[-1, :2] @ ahead for e in (InvariantEKF(), WheelOdometry())]
    assert way[0] < way[1]
    drive(estimator, robot, [*spun[:60], *read_by_gyro(observations[60:], np.zeros(61))], true[0])
    assert np.hypot(*estimator.slip_velocity) < 1e-3


def test_the_bias_is_learned_while_the_robot_stands(drive):
    robot = with_gyro(differential(), noise=1e-3, bias=0.01)
    still = [{"wheel": np.zeros(2), "time": np.array([0.05 * k]), "gyro": np.array([0.01])} for k in range(400)]
    heading = drive(InvariantEKF(), robot, still)[:, 2]
    assert heading[-1] - heading[200] < 0.1 * 0.01 * 0.05 * 199


def test_without_readings_of_the_gyro_the_wheels_tell_the_turn(exact_motion, drive):
    robot = with_gyro(preset("swerve"))
    motion = exact_motion(robot, lambda t: (0.5, 0.2 * np.cos(0.9 * t), 0.3 * np.sin(1.1 * t)), 4.0)
    _, observations = motion.sampled(80)
    by_wheels = drive(WheelOdometry(), robot, observations)[:, 2]
    np.testing.assert_allclose(drive(WheelGyro(), robot, observations)[:, 2], by_wheels, atol=1e-9)
    np.testing.assert_allclose(drive(InvariantEKF(), robot, observations)[:, 2], by_wheels, atol=1e-3)


USERS = ("filter", "skid-ratio", "wpilib-swerve", *NAMES)
"""All that read a gyro."""


def made(name):
    if name.startswith("wpilib"):
        pytest.importorskip("wpimath")
    return load_estimator(name).factory()


def winding_swerve(exact_motion, **gyro):
    """A swerve with a gyro, its true poses and observations, in which the gyro reads what it should."""
    robot = with_gyro(preset("swerve"), **gyro)
    motion = exact_motion(robot, lambda t: (0.5, 0.2 * np.cos(0.9 * t), 0.3 * np.sin(1.1 * t)), 4.0)
    true, observations = motion.sampled(80)
    rate = np.array([0.3 * np.sin(1.1 * seen["time"][0]) for seen in observations])
    return robot, true, observations, rate


@pytest.mark.parametrize("name", USERS)
def test_a_bias_that_the_file_states_changes_nothing(name, exact_motion, drive):
    robot, _, observations, rate = winding_swerve(exact_motion, noise=1e-3)
    told = with_gyro(robot, noise=1e-3, bias=0.4)
    plain = drive(made(name), robot, read_by_gyro(observations, rate))
    biased = drive(made(name), told, read_by_gyro(observations, rate, bias=0.4))
    np.testing.assert_allclose(biased, plain, atol=1e-9)


@pytest.mark.parametrize("name", USERS)
def test_where_the_gyro_is_not_read_no_turn_is_lost_or_counted_twice(name, exact_motion, drive):
    """Wheels roll without slip, so that either tells the turn; 20 samples are missing, and one. Readings that are not
    finite are none."""
    robot, true, observations, rate = winding_swerve(exact_motion, noise=1e-3)
    seen = read_by_gyro(observations, rate)
    missing = [20 <= k < 40 or k == 60 for k in range(len(seen))]
    blank = [{**one, "gyro": np.full(1, np.nan)} if no else one for one, no in zip(seen, missing, strict=True)]
    gone = [observations[k] if no else seen[k] for k, no in enumerate(missing)]
    path = drive(made(name), robot, blank)
    np.testing.assert_array_equal(drive(made(name), robot, gone), path)
    whole = np.abs(drive(made(name), robot, seen) - true).max(axis=0)
    assert (np.abs(path - true).max(axis=0) < whole + np.array([2e-3, 2e-3, 1e-3])).all()


def test_a_missing_reading_ends_a_window_of_the_filter(exact_motion, drive):
    """Every 0.5 s: what is read between is used all the same, and teaches the bias."""
    robot = with_gyro(differential(), noise=1e-4)
    _, seen = sampled(exact_motion(robot, bends, 60.0), 1200, bends, bias=0.01)
    blank = [{**one, "gyro": np.full(1, np.nan)} if k % 10 == 0 else one for k, one in enumerate(seen)]
    estimator = WheelGyro()
    drive(estimator, robot, blank)
    assert estimator.gyro_bias == pytest.approx(0.01, abs=2e-3)


@pytest.mark.parametrize("name", NAMES)
def test_a_mirrored_robot_goes_the_mirrored_path(name, noise, drive):
    robot = with_gyro(differential(), noise=1e-3)
    rate = np.random.default_rng(1).normal(size=30)
    seen = read_by_gyro(noise(robot, counts=100), rate)
    swapped = [{**s, "wheel": s["wheel"][::-1], "gyro": -s["gyro"]} for s in seen]
    path = drive(load_estimator(name).factory(), robot, seen, (1.0, 2.0, 0.3))
    mirror = drive(load_estimator(name).factory(), robot, swapped, (1.0, -2.0, -0.3))
    np.testing.assert_allclose(mirror, path * [1.0, -1.0, -1.0], atol=1e-9)
