"""The verdict on a log: silent over perfect rolling, whatever the seed, and naming the castor that is wrong."""

import dataclasses

import numpy as np
import pytest

from castor_envs.effects.dimensions import PivotBias, WheelRadius
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import figure_eight, pivoting, umbmark, wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from discrepancy.inspect import inspect_log

TRAJECTORIES = {
    "stops": umbmark(),
    "rounded": umbmark("cw", "rounded"),
    "sideways": umbmark(corners="fixed"),
    "eight": figure_eight(),
    "pivoting": pivoting((0.24, 0.0)),
    "wander": wander(np.random.default_rng(3), duration=15.0),
}
CONSISTENT = "consistent with rounding"


def logs(robot, trajectory, seeds):
    """What a robot that rolls perfectly counts; every seed is another phase of its encoders and another start."""
    geometry, rolled = Geometry.of(robot), roll(robot, trajectory)
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        encoders = Encoders(geometry, Encoders.random_phase(geometry, random))
        yield Log(rolled.t, encoders.wheel(rolled.wheel_angle), encoders.pivot(rolled.castor_angle))


def verdict(robot, log):
    return inspect_log(robot, log)["parity"]["verdict"]


@pytest.mark.parametrize("trajectory", TRAJECTORIES)
@pytest.mark.parametrize("name", ["asoc-prototype", "omnimate"])
def test_perfect_rolling_is_consistent(name, trajectory):
    robot = preset(name)
    for log in logs(robot, TRAJECTORIES[trajectory], seeds=10):
        assert verdict(robot, log) == CONSISTENT


def test_effects_of_the_robot_file_are_known():
    robot = preset("asoc-prototype").with_effects(WheelRadius(castor=1, wheel=1, value=0.02))
    (log,) = logs(robot.as_built(), TRAJECTORIES["wander"], seeds=1)
    assert verdict(robot, log) == CONSISTENT
    assert verdict(robot.as_described(), log) != CONSISTENT


@pytest.mark.parametrize("period", [0.01, 0.1])
@pytest.mark.parametrize("trajectory", ["stops", "rounded", "eight"])
def test_perfect_rolling_is_consistent_at_any_period(period, trajectory):
    robot = dataclasses.replace(preset("asoc-prototype"), sample_period=period)
    for log in logs(robot, TRAJECTORIES[trajectory], seeds=4):
        assert verdict(robot, log).startswith("consistent ")


@pytest.mark.parametrize("trajectory", TRAJECTORIES)
@pytest.mark.parametrize(("castor", "wheel", "value"), [(1, 2, 0.005), (2, 1, 0.005), (3, 1, -0.005)])
def test_half_a_percent_of_a_radius_is_named(trajectory, castor, wheel, value):
    """Not while pivoting about castor 1, for castor 1: its wheels hardly roll."""
    if trajectory == "pivoting" and castor == 1:
        return
    robot = preset("asoc-prototype")
    real = robot.with_effects(WheelRadius(castor=castor, wheel=wheel, value=value)).as_built()
    for log in logs(real, TRAJECTORIES[trajectory], seeds=4):
        assert verdict(robot, log).startswith(f"castor {castor} contradicts this robot file (up to ")


@pytest.mark.parametrize("castor", [1, 2, 3])
def test_a_biased_pivot_is_named(castor):
    robot = preset("asoc-prototype")
    real = robot.with_effects(PivotBias(castor=castor, value=0.05)).as_built()
    for log in logs(real, TRAJECTORIES["wander"], seeds=3):
        assert verdict(robot, log).startswith(f"castor {castor} contradicts this robot file (up to ")


def test_a_log_that_shows_too_little_is_not_judged():
    robot = preset("asoc-prototype")
    still = Log(np.arange(9) * 0.05, np.zeros((9, 6)), np.zeros((9, 3)))
    assert verdict(robot, still) == "nothing moved: nothing can be said"
    short = Log(np.arange(3) * 0.05, np.outer(np.arange(3) * 60.0, np.ones(6)), np.zeros((3, 3)))
    assert verdict(robot, short) == "too short: nothing can be said"
