"""Robots drawn within the tolerances that a file states."""

import dataclasses

import numpy as np
import pytest

from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.presets import preset, preset_names
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel
from castor_envs.vehicles.tolerances import Tolerances

STATED = Tolerances(radius=0.01, lateral=0.02, offset=0.03, pivot=1e-3, pivot_zero=2e-3)


def within(robot: RobotDescription, tolerances: Tolerances | None) -> RobotDescription:
    return dataclasses.replace(robot, tolerances=tolerances)


def test_a_robot_without_tolerances_is_drawn_as_described():
    robot = preset("asoc-prototype")
    assert robot.drawn(np.random.default_rng(0)) == robot


def test_stating_no_tolerances_leaves_files_and_hashes_as_they_were():
    robot = preset("swerve")
    assert "tolerances" not in robot.to_dict()
    assert within(robot, STATED).hash() != robot.hash()


def test_tolerances_survive_a_file(tmp_path):
    robot = within(preset("tricycle"), STATED)
    robot.save(tmp_path / "robot.json")
    assert RobotDescription.load(tmp_path / "robot.json") == robot


@pytest.mark.parametrize("name", preset_names())
def test_drawn_robots_scatter_as_stated(name):
    robot = within(preset(name), STATED)
    drawn = Geometry.of([robot.drawn(np.random.default_rng(k)) for k in range(600)])
    true = Geometry.of(robot)
    turned = np.where(true.fixed, drawn.angle - true.angle, drawn.pivot_zero - true.pivot_zero)
    relative = {
        STATED.radius: drawn.radius / true.radius - 1,
        STATED.pivot: drawn.pivot - true.pivot,
        STATED.pivot_zero: turned,
    }
    for expected, errors in relative.items():
        # Cut at three standard deviations, a normal number has 0.987 of its deviation; 600 draws show it to 3 %.
        np.testing.assert_allclose(np.std(errors, axis=0), 0.987 * expected, rtol=0.12)
        assert np.abs(np.mean(errors, axis=0)).max() < 0.2 * expected
        assert np.abs(errors).max() <= 3 * expected * (1 + 1e-9)


def test_lengths_that_are_nothing_stay_nothing():
    drawn = within(preset("swerve"), STATED).drawn(np.random.default_rng(1))
    assert all(castor.offset == 0.0 and castor.wheels[0].lateral == 0.0 for castor in drawn.castors)


def test_robots_of_different_tolerances_are_not_stacked():
    robot = preset("swerve")
    with pytest.raises(ValueError, match="must agree in tolerances"):
        Geometry.of([robot, within(robot, STATED)])


def test_wheels_that_stand_close_are_drawn_in_their_order():
    """Twin tyres 3 cm apart, whose places scatter by a centimetre: no draw exchanges them, and none is refused."""
    wheels = tuple(Wheel(radius=0.05, lateral=lateral) for lateral in (0.2, 0.17, -0.17, -0.2))
    castor = Castor(pivot=(0.0, 0.0), steering="fixed", wheels=wheels)
    robot = RobotDescription(name="twins", castors=(castor,), tolerances=Tolerances(lateral=0.05))
    for seed in range(400):
        lateral = [wheel.lateral for wheel in robot.drawn(np.random.default_rng(seed)).wheels]
        assert lateral == sorted(lateral, reverse=True)
