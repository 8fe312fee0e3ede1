"""With no slip, physics follows the kinematics; with slip, it is in proportion to force."""

import dataclasses
import math

import numpy as np
import pytest

from castor_envs.floor import Floor
from castor_envs.geometry.se2 import rotate_single
from castor_envs.motion.controllers import KinematicController, trailing_angles
from castor_envs.motion.kinematics import Geometry, forward
from castor_envs.motion.trajectories import pivoting
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.vehicles.presets import preset, preset_names
from castor_envs.vehicles.robot import Castor, Contact, RobotDescription, Wheel


@pytest.mark.parametrize("drive", ["servo", "voltage"])
@pytest.mark.parametrize("held", [1, 2, 3])
def test_wheels_that_are_held_stand_whatever_they_are_commanded(held, drive):
    """The prototype turns about the held castor: its pivot stays where it is, and all others go round it."""
    robot = preset("asoc-prototype")
    pivot = np.array(robot.castors[held - 1].pivot)
    first = pivoting(robot.castors[held - 1].pivot).runs[0].legs[0].motion
    world = RobotWorld(robot, held=held, castor_angles=trailing_angles(Geometry.of(robot), first))
    for _ in range(40):
        world.advance(np.full(6, 2.0 if drive == "servo" else 0.1), drive=drive)
    turned = np.abs(world.wheel_angles).reshape(3, 2)
    assert 10 * turned[held - 1].max() < np.delete(turned, held - 1, axis=0).min()
    assert world.pose[2] > 0.3
    assert math.dist(world.pose[:2] + rotate_single(pivot, world.pose[2]), pivot) < 0.012


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
    """The robot with generous friction and stiffer bristles, their damping ratio kept."""
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
    geometry, controller, world = Geometry.of(robot), KinematicController(robot), RobotWorld(robot)
    rolled = world.pose
    for k in range(round(duration / robot.sample_period)):
        wheels, castors = world.wheel_angles, world.castor_angles
        world.advance(*controller.commands(castors, wanted_twist(name, (k + 0.5) * robot.sample_period)))
        turned = world.castor_angles - castors
        rolled = moved(rolled, forward(geometry, castors + turned / 2, turned, world.wheel_angles - wheels))
    return world.pose, rolled


@pytest.mark.parametrize("name", ROBOTS)
def test_without_slip_physics_follows_the_kinematics(name):
    errors = []
    for slip_stiffness in (80.0, 800.0, 8000.0):
        driven, rolled = driven_and_rolled(name, slip_stiffness)
        errors.append(np.abs(driven - rolled).max())
    assert np.hypot(*driven[:2]) > 0.15
    assert errors[1] < errors[0] / 5
    assert errors[2] < 1e-5


@pytest.mark.parametrize("name", ["three-omni", "mecanum", "differential", "powered-caster", "asoc-prototype"])
def test_a_world_starts_in_rolling_motion_and_coasts_on(name):
    robot = ROBOTS[name]()
    twist = np.array([0.3, 0.0 if name in NO_SIDEWAYS else -0.2, 0.0])
    ahead = math.atan2(twist[1], twist[0])
    world = RobotWorld(robot, twist=twist, castor_angles=[ahead] * len(robot.castors))
    for wheel, castor, speed in zip(robot.wheels, robot.wheel_castors, world.wheels["speed"], strict=True):
        pivots = robot.castors[castor].steering != "fixed"
        v = complex(*twist[:2]) * np.exp(-1j * (ahead if pivots else robot.castors[castor].angle))
        assert wheel.radius * speed == pytest.approx(v.real + math.tan(wheel.roller_angle) * v.imag)
    for _ in range(20):
        world.advance(np.zeros(len(robot.driven_wheels)), drive="off")
    np.testing.assert_allclose(world.twist, twist, atol=1e-9)
    np.testing.assert_allclose(world.pose, twist, atol=1e-9)


def steady(floor, command, contact):
    """How far a differential robot's wheels roll, and how far it gets (along, across), in a second of driving."""
    world = RobotWorld(dataclasses.replace(preset("differential"), contact=contact), floor)
    for _ in range(60):
        world.advance([command, command])
    angle, pose = world.wheel_angles, world.pose
    for _ in range(20):
        world.advance([command, command])
    (x, y, turned), rolled = world.pose - pose, 0.075 * (world.wheel_angles - angle)
    assert rolled[0] == pytest.approx(rolled[1])
    assert turned == pytest.approx(0.0, abs=1e-9)
    return rolled[0], x, y


@pytest.mark.parametrize("command", [2.0, 9.0, -6.0])
@pytest.mark.parametrize("slope", [0.02, -0.05, 0.1])
@pytest.mark.parametrize("slip_stiffness", [40.0, 80.0, 300.0])
def test_slip_uphill_is_the_weights_part_along_the_slope_over_the_slip_stiffness(command, slope, slip_stiffness):
    contact = Contact(slip_stiffness_long=slip_stiffness, slip_stiffness_lat=70.0)
    rolled, gone, aside = steady(Floor(slope=(slope, 0.0)), command, contact)
    # Force over load is m g sin / (m g cos) = the slope, so the slip is slope / slip stiffness, whatever the speed.
    assert (rolled - gone) / abs(rolled) == pytest.approx(slope / slip_stiffness, rel=0.002)
    assert aside == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("command", [2.0, 9.0, -6.0])
@pytest.mark.parametrize("slope", [0.02, -0.05, 0.1])
@pytest.mark.parametrize("slip_stiffness", [40.0, 80.0, 300.0])
def test_along_a_contour_the_robot_drifts_downhill_by_the_side_slip_angle(command, slope, slip_stiffness):
    contact = Contact(slip_stiffness_long=70.0, slip_stiffness_lat=slip_stiffness)
    rolled, gone, aside = steady(Floor(slope=(0.0, slope)), command, contact)
    assert aside / abs(gone) == pytest.approx(-slope / slip_stiffness, rel=0.002)
    assert rolled == pytest.approx(gone, rel=1e-6)


@pytest.mark.parametrize("relaxation_length", [0.01, 0.03])
def test_the_side_force_builds_up_over_the_relaxation_length(relaxation_length):
    """A rolling wheel that is suddenly pushed aside: its side force follows the slip angle over that distance.

    Robot on a cross slope, rolling from the start without any bristle deflection. Newton: m y'' = -m g s - F, and
    F = k z + c z' with z' = y' - V z / sigma; integrated here by itself.
    """
    slope, speed, slip_stiffness, damping = 0.05, 0.5, 80.0, 1e-3
    contact = Contact(relaxation_length=relaxation_length, damping=damping)
    robot = dataclasses.replace(preset("differential"), contact=contact, sample_period=0.005)
    world = RobotWorld(robot, Floor(slope=(0.0, slope)), twist=(speed, 0.0, 0.0), substeps=20)
    g = 9.80665 / math.sqrt(1 + slope**2)
    y, v, z, dt = 0.0, 0.0, 0.0, 1e-6
    for _ in range(40):
        world.advance([speed / 0.075] * 2)
        for _ in range(round(robot.sample_period / dt)):
            rate = v - speed / relaxation_length * z
            v -= dt * g * (slope + slip_stiffness / relaxation_length * (z + damping * rate))
            z += dt * rate
            y += dt * v
        assert world.pose[1] == pytest.approx(y, rel=0.02, abs=1e-6)
