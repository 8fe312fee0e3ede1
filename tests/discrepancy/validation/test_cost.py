"""What an effect costs in use, against what is known in closed form."""

# pyright: reportOperatorIssue=false

import numpy as np
import pytest

from castor_envs.effects.dimensions import AllWheelRadius, LoadRadius, WheelRadius
from castor_envs.floor import Floor
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.weight import swung_loads
from discrepancy.validation.cost import cost_of, odometry

ROBOT = preset("asoc-prototype")


def test_what_an_effect_costs_is_what_odometry_is_off():
    """A straight drive with all wheels 1 % too large: 10 cm in 10 m; nothing for a clean one."""
    t = np.linspace(0, 20, 401)
    counts = np.tile((t * 0.5 / ROBOT.wheels[0].radius * ROBOT.wheels[0].counts_per_rev / (2 * np.pi))[:, None], (1, 6))
    log = Log(t, counts, np.zeros((401, 3)))
    assert cost_of(ROBOT, AllWheelRadius(value=0.01), [log]) == pytest.approx(0.1, rel=1e-3)
    assert cost_of(ROBOT, AllWheelRadius(value=0.0), [log]) == 0.0
    assert cost_of(ROBOT, AllWheelRadius(value=0.01), [Log(t, counts * 0, np.zeros((401, 3)))]) is None


def off(robot, rolled, wheel_angle):
    """How far odometry is off the true path, m, of a log with these angles of wheels."""
    encoders = Encoders(Geometry.of(ROBOT), np.full(6, 0.5))
    log = Log(rolled.t, encoders.wheel(wheel_angle), encoders.pivot(rolled.castor_angle))
    path = odometry(robot, log)
    return np.abs(((path - path[0]) - (rolled.pose - rolled.pose[0]))[:, :2]).max()


def test_odometry_of_the_right_robot_follows_the_true_path():
    """Independent: the path was integrated from the motion, the counts from rolling on it; half a count is left."""
    real = ROBOT.with_effects(WheelRadius(castor=2, wheel=1, value=0.02))
    rolled = roll(real.as_built(), wander(np.random.default_rng(2), duration=12.0))
    assert off(real, rolled, rolled.wheel_angle) < 5e-3
    assert off(ROBOT, rolled, rolled.wheel_angle) > 10e-3


def test_odometry_knows_that_radii_change_as_loads_shift():
    soft, rolled = 4e-5, roll(ROBOT, wander(np.random.default_rng(2), duration=12.0))
    theta = (rolled.castor_angle[1:] + rolled.castor_angle[:-1]) / 2
    radius = 0.0381 - soft * (swung_loads(ROBOT, Floor().normal_gravity, theta) - 22.5 * Floor().normal_gravity / 6)
    turned = np.cumsum(np.diff(rolled.wheel_angle, axis=0) * 0.0381 / radius, axis=0)
    wheel_angle = np.vstack([np.zeros(6), turned])
    known = off(ROBOT.with_effects(LoadRadius(value=soft)), rolled, wheel_angle)
    assert known < 1e-3
    assert off(ROBOT, rolled, wheel_angle) > 3 * known
