"""Predicted creep of motions that no contact can hold: what a fitted state may be where readings jump."""

import dataclasses
import math

import numpy as np
import pytest

from castor_envs.envs.sensed import SensedRobot
from castor_envs.floor import Floor
from castor_envs.geometry.steps import Motion
from castor_envs.motion.controllers import Commands
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import Leg, Run, Trajectory
from castor_envs.physics.contact_motion import ForceBalance
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Castor, Contact, RobotDescription, Wheel
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


def four_mecanum_wheels(roller_angle, friction=0.1):
    wheel = {"radius": 0.05, "inertia": 5e-4, "grip": "omni", "counts_per_rev": 1000.0}
    castors = [
        Castor(
            pivot=(x, y),
            steering="fixed",
            inertia=0.001,
            wheels=(Wheel(**wheel, roller_angle=roller_angle if x * y > 0 else -roller_angle),),
        )
        for x in (0.2, -0.2)
        for y in (0.15, -0.15)
    ]
    return RobotDescription(
        name="mecanum", castors=tuple(castors), mass=10.0, max_wheel_torque=10.0, contact=Contact(friction=friction)
    )


@pytest.mark.parametrize("roller_angle", [math.pi / 6, math.pi / 4, 1.0])
@pytest.mark.parametrize(("share", "slides"), [(0.9, False), (1.1, True)])
def test_rollers_at_an_angle_hold_less_along(roller_angle, share, slides):
    """A roller pushes across itself alone, at its angle to the wheel: of mu N the cosine is along. Physics says it of
    wheels that spin, the prediction of a motion that needs as much."""
    robot = four_mecanum_wheels(roller_angle)
    acceleration = share * math.cos(roller_angle) * robot.contact.friction * Floor().normal_gravity
    t = np.linspace(0.0, 1.95, 40)
    way = 0.5 * acceleration * t**2
    motion = Motion(
        t, way[:, None] * [1.0, 0.0, 0.0], np.tile(way[:, None] / 0.05, 4), np.zeros((len(t), len(robot.castors)))
    )
    balance = ForceBalance(robot, motion, Floor())
    rolling = ForceBalance(dataclasses.replace(robot, contact=Contact(friction=100.0)), motion, Floor())
    assert np.all((balance.yields[20, :4] > 1.001 * rolling.yields[20, :4]) == slides)

    sensed = SensedRobot(robot, Floor())
    sensed.reset(np.random.default_rng(0), np.zeros(4))
    for _ in range(3):
        sensed.advance(Commands(np.full(4, 20.0 if slides else 0.01), np.zeros(0)))
    assert np.all(sensed.sliding() == slides)
    if slides:
        reached = sensed.world.twist[0]
        sensed.advance(Commands(np.full(4, 20.0), np.zeros(0)))
        most = math.cos(roller_angle) * robot.contact.friction * Floor().normal_gravity
        assert (sensed.world.twist[0] - reached) / 0.05 == pytest.approx(most, rel=0.02)


def test_a_wheel_that_stands_creeps_as_if_it_rolled_a_little():
    """Turning about its left wheel a robot rolls on the right one alone; the left contact yields a fiftieth as much,
    as its bristles are let go by the way before and after, and not a millionth."""
    robot = preset("differential")
    left = robot.wheels[0].lateral
    turn = Trajectory("about a wheel", (Run((Leg((-left, 0.0, -1.0), 2.0),), speed=0.5, acceleration=1.0),))
    rolled = roll(robot, turn)
    motion = Motion(rolled.t, rolled.pose, rolled.wheel_angle, rolled.castor_angle)
    assert abs(rolled.wheel_angle[-1, 0]) < 1e-9 < 1.0 < abs(rolled.wheel_angle[-1, 1])
    yields = ForceBalance(robot, motion, Floor()).yields[20]
    assert yields[0] == pytest.approx(yields[1] / 50, rel=1e-3)
