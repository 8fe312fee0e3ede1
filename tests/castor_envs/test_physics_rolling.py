"""With no slip, physics follows the kinematics; with slip, it is in proportion to force."""

import dataclasses
import math

import numpy as np
import pytest

from castor_envs.controller import KinematicController
from castor_envs.floor import Floor
from castor_envs.kinematics import Geometry, forward
from castor_envs.physics import World
from castor_envs.presets import preset, preset_names
from castor_envs.robot import Castor, Contact, RobotDescription, Wheel


def omni_robot(angles_and_rollers, pivots):
    """A base on fixed castors, one omni wheel each."""
    castors = tuple(
        Castor(
            pivot=pivot,
            steering="fixed",
            angle=angle,
            mass=0.8,
            inertia=0.002,
            wheels=(Wheel(radius=0.05, inertia=4e-4, grip="omni", roller_angle=roller),),
        )
        for pivot, (angle, roller) in zip(pivots, angles_and_rollers, strict=True)
    )
    return RobotDescription(name="omni", mass=12.0, inertia=0.4, castors=castors)


def three_omni_wheels():
    thirds = [2 * math.pi * i / 3 for i in range(3)]
    return omni_robot(
        [(angle + math.pi / 2, 0.0) for angle in thirds],
        [(0.2 * math.cos(angle), 0.2 * math.sin(angle)) for angle in thirds],
    )


def mecanum():
    pivots = [(0.2, 0.15), (0.2, -0.15), (-0.2, 0.15), (-0.2, -0.15)]
    return omni_robot([(0.0, math.copysign(math.pi / 4, -x * y)) for x, y in pivots], pivots)


def on_a_trailing_wheel():
    """A differential robot with a free support castor behind, whose one wheel idles."""
    robot = preset("differential")
    idle = Wheel(radius=0.04, inertia=1e-4, counts_per_rev=None)
    support = Castor(pivot=(-0.25, 0.0), offset=0.03, mass=1.0, inertia=0.001, wheels=(idle,))
    return dataclasses.replace(robot, center_of_mass=(-0.06, 0.0), castors=(*robot.castors, support))


ROBOTS = {name: lambda name=name: preset(name) for name in preset_names()}
ROBOTS |= {"three-omni": three_omni_wheels, "mecanum": mecanum, "trailing-wheel": on_a_trailing_wheel}
NO_SIDEWAYS = ("differential", "tricycle", "trailing-wheel")


def stiff(robot, slip_stiffness):
    """The robot with generous friction; its bristles keep their damping coefficient a stiffness' root, as a spring's."""
    damping = 1e-3 * math.sqrt(80.0 / slip_stiffness)
    contact = Contact(
        friction=50.0, slip_stiffness_long=slip_stiffness, slip_stiffness_lat=slip_stiffness, damping=damping
    )
    return dataclasses.replace(robot, contact=contact, sample_period=0.01)


def wanted_twist(name, t):
    ramp = min(1.0, t / 0.3)
    sideways = 0.0 if name in NO_SIDEWAYS else 0.15 * math.cos(1.9 * t)
    return ramp * np.array([0.25 * math.cos(1.1 * t), sideways, 0.7 * math.sin(1.7 * t)])


def moved(pose, twist):
    """The pose after a motion of constant twist in B, a unit of time long (exponential of SE(2))."""
    vx, vy, turn = twist
    v = complex(vx, vy) * (1.0 if abs(turn) < 1e-12 else (np.exp(1j * turn) - 1) / (1j * turn))
    at = complex(pose[0], pose[1]) + np.exp(1j * pose[2]) * v
    return np.array([at.real, at.imag, pose[2] + turn])


def driven_and_rolled(name, slip_stiffness, duration=1.5):
    """The final pose of a drive, and that of rolling without slip by the wheel and castor angles of the same drive."""
    robot = stiff(ROBOTS[name](), slip_stiffness)
    geometry, controller, world = Geometry.of(robot), KinematicController(robot), World(robot)
    rolled = world.pose
    for k in range(round(duration / robot.sample_period)):
        wheels, castors = world.wheel_angles, world.castor_angles
        world.advance(*controller.commands(castors, wanted_twist(name, (k + 0.5) * robot.sample_period)))
        turned = world.castor_angles - castors
        rolled = moved(rolled, forward(geometry, castors + turned / 2, turned, world.wheel_angles - wheels))
    return world.pose, rolled
