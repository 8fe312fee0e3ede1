"""Predicted creep of motions that no contact can hold: what a fitted state may be where readings jump."""

import numpy as np
import pytest

from castor_envs.floor import Floor
from castor_envs.geometry.steps import Motion
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import Leg, Run, Trajectory
from castor_envs.physics.contact_motion import ForceBalance
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.weight import wheel_loads


@pytest.mark.parametrize("name", ["omni3", "swerve", "asoc-prototype"])
def test_forces_beyond_friction_make_no_contact_slip_without_bound(name):
    """Without a bound, contacts would yield by over 1e11 m/s for each N, and slip by 1e13 m in a sample."""
    robot = preset(name)
    rolled = roll(robot, Trajectory("ahead", (Run((Leg((1.0, 0.0, 0.0), 2.0),), speed=0.4, acceleration=0.5),)))
    pose, thrown = rolled.pose.copy(), 0.5
    pose[40:, 1] += thrown  # m, sideways within a sample
    balance = ForceBalance(robot, Motion(rolled.t, pose, rolled.wheel_angle, rolled.castor_angle), Floor())
    slip, found = balance.creep(agree=True), balance.yields
    assert max(np.abs(slip.rolling).max(), np.abs(slip.side).max()) < 4 * thrown
    fastest, floor = thrown / robot.sample_period, Floor()
    least = robot.contact.friction * wheel_loads(robot, floor.normal_gravity).min()  # N, at which a wheel slides
    assert found.max() < fastest / least
