"""Drives in physics: they are what a robot does, they join without a gap, and sensors report them."""

import dataclasses

import numpy as np
import pytest

from benchmarks.tasks.driving.drive import drive, joined, recorded
from benchmarks.tasks.driving.manoeuvres import laps, manoeuvres
from castor_envs.geometry import se2
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import Leg, Run, Trajectory
from castor_envs.vehicles.presets import preset, preset_names
from castor_envs.vehicles.robot import Gyro

ARC = Trajectory("arc", (Run((Leg((1.0, 0.0, 0.8), 2.0),), 0.3, 0.3),))


@pytest.mark.parametrize("name", ["asoc-prototype", "differential", "omni3"])
def test_a_gentle_drive_is_perfect_rolling_but_for_creep(name):
    robot = preset(name)
    rolled = roll(robot, ARC)
    true = drive(robot, robot, ARC, float(rolled.t[-1]), np.random.default_rng(0), castor_angle=rolled.castor_angle[0])
    assert np.abs(true.pose - rolled.pose)[:, :2].max() < 0.003
    np.testing.assert_allclose(true.wheel, rolled.wheel_angle, atol=0.05)


def test_drives_join_where_the_last_one_ended():
    robot, random = preset("asoc-prototype"), np.random.default_rng(1)
    first = drive(robot, robot, ARC, 9.0, random)
    second = drive(robot, robot, ARC, 9.0, random, castor_angle=first.castor[-1])
    whole = joined([first, second])
    assert len(whole.t) == len(first.t) + len(second.t) - 1
    np.testing.assert_allclose(np.diff(whole.t), 0.05, atol=1e-12)
    np.testing.assert_allclose(se2.relative_pose(first.pose[-1], whole.pose[-1]), second.pose[-1], atol=1e-12)
    for name in ("pose", "wheel", "castor"):
        jumps = np.abs(np.diff(getattr(whole, name), axis=0))
        assert jumps[len(first.t) - 1].max() < 0.02  # from rest: 0.01 m and rad


def test_a_drive_at_its_own_times_is_itself():
    robot = preset("swerve")
    true = drive(robot, robot, ARC, 5.0, np.random.default_rng(2))
    again = true.at(true.t)
    for field in dataclasses.fields(true):
        np.testing.assert_array_equal(getattr(again, field.name), getattr(true, field.name))


def test_encoders_round_and_the_gyro_is_off_by_bias_and_noise():
    robot = dataclasses.replace(preset("asoc-prototype"), gyro=Gyro(noise=0.01, bias=0.2))
    true = drive(robot, robot, ARC, 9.0, np.random.default_rng(3))
    log = recorded(robot, true, np.random.default_rng(4))
    counts = true.wheel * 1200 / (2 * np.pi)
    assert np.abs(log.wheel - log.wheel[0] - (counts - counts[0])).max() <= 1.0
    assert log.gyro is not None
    off = log.gyro - true.yaw_rate
    assert np.mean(off) == pytest.approx(0.2, abs=4 * 0.01 / np.sqrt(len(off)))
    assert np.std(off) == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize("name", preset_names())
def test_manoeuvres_are_long_enough_and_end_elsewhere(name):
    robot = preset(name)
    trajectory = manoeuvres(robot, np.random.default_rng(5), 60.0)
    assert trajectory.duration >= 60.0
    assert np.hypot(*trajectory.at(60.0)[0][:2]) > 0.1
    for run in trajectory.runs:
        for leg in run.legs:
            assert np.abs(Geometry.of(robot).side_slip_of_fixed(np.array(leg.motion))).max(initial=0.0) < 1e-9


def test_laps_are_as_long_as_asked_for():
    trajectory = laps(np.random.default_rng(6), 137.0)
    assert trajectory.path_length == pytest.approx(137.0)
    assert np.hypot(*trajectory.at(trajectory.duration)[0][:2]) > 0.1
