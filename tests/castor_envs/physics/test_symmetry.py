"""Physics knows neither left from right, nor where N lies or which way it points."""

import dataclasses
import math

import numpy as np
import pytest

from castor_envs.floor import Cable, Floor, Patch
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel

FLOOR = Floor(
    patches=(Patch(center=(0.2, 0.15), size=(0.3, 0.4), friction=0.1, angle=0.4),),
    cables=(Cable(center=(0.1, 0.05), direction=1.3, length=0.6, diameter=0.006),),
    slope=(0.04, -0.02),
)


def mecanum() -> RobotDescription:
    castors = tuple(
        Castor(
            pivot=(x, y),
            steering="fixed",
            angle=0.1 * y,
            mass=1.0,
            inertia=0.002,
            wheels=(Wheel(radius=0.05, grip="omni", roller_angle=math.copysign(math.pi / 4, -x * y)),),
        )
        for x in (0.2, -0.25)
        for y in (0.15, -0.15)
    )
    return RobotDescription(name="mecanum", mass=12.0, inertia=0.4, center_of_mass=(-0.02, 0.0), castors=castors)


def robot_named(name: str) -> RobotDescription:
    """A preset, made lopsided where it can be, so that no symmetry of its own hides an error."""
    if name == "mecanum":
        return mecanum()
    robot = preset(name)
    if name in ("asoc-prototype", "powered-caster"):
        robot = dataclasses.replace(robot, center_of_mass=(0.02, 0.03))
    return robot


def mirrored(robot: RobotDescription) -> RobotDescription:
    """The robot in a mirror along its x axis: left wheels become right ones."""
    castors = tuple(
        dataclasses.replace(
            castor,
            pivot=(castor.pivot[0], -castor.pivot[1]),
            angle=-castor.angle,
            wheels=tuple(
                dataclasses.replace(wheel, lateral=-wheel.lateral, roller_angle=-wheel.roller_angle)
                for wheel in reversed(castor.wheels)
            ),
        )
        for castor in robot.castors
    )
    x, y = robot.center_of_mass
    return dataclasses.replace(robot, center_of_mass=(x, -y), castors=castors)


def mirrored_floor(floor: Floor) -> Floor:
    flip = np.array([1.0, -1.0])
    return dataclasses.replace(
        floor,
        patches=tuple(
            dataclasses.replace(patch, center=tuple(flip * patch.center), angle=-patch.angle) for patch in floor.patches
        ),
        cables=tuple(
            dataclasses.replace(cable, center=tuple(flip * cable.center), direction=-cable.direction)
            for cable in floor.cables
        ),
        slope=tuple(flip * floor.slope),
    )


def moved_floor(floor: Floor, shift: complex, turn: float) -> Floor:
    """The floor turned about the origin of N, then shifted."""

    def place(center):
        at = shift + complex(*center) * np.exp(1j * turn)
        return float(at.real), float(at.imag)

    slope = complex(*floor.slope) * np.exp(1j * turn)
    return dataclasses.replace(
        floor,
        patches=tuple(
            dataclasses.replace(patch, center=place(patch.center), angle=patch.angle + turn) for patch in floor.patches
        ),
        cables=tuple(
            dataclasses.replace(cable, center=place(cable.center), direction=cable.direction + turn)
            for cable in floor.cables
        ),
        slope=(float(slope.real), float(slope.imag)),
    )


def commands(robot: RobotDescription, k: int):
    """Smooth commands that differ from wheel to wheel, so that castors fight and slip."""
    wheel = 0.25 * robot.max_wheel_speed * np.sin(0.13 * k + 0.7 * np.arange(len(robot.driven_wheels)))
    return wheel, 2.0 * np.sin(0.11 * k + np.arange(len(robot.driven_castors)))


def run(robot, floor, pose, angles, twist, order, sign, samples=60):
    """Poses and castor angles of a drive; wheel commands in the given order, steering with the given sign."""
    world = RobotWorld(robot, floor, pose=pose, castor_angles=angles, twist=twist)
    rows = []
    for k in range(samples):
        wheel, steering = commands(robot, k)
        world.advance(wheel[order], sign * steering)
        rows.append([*world.pose, *world.castor_angles])
    return np.array(rows)


def swapped_wheels(robot: RobotDescription):
    """For each driven wheel, the driven wheel that its mirror image stands for: left and right of a castor change."""
    order, first = [], 0
    for castor in robot.castors:
        driven = sum(wheel.driven for wheel in castor.wheels)
        order += reversed(range(first, first + driven))
        first += driven
    return order


NAMES = ("asoc-prototype", "omnimate", "differential", "tricycle", "powered-caster", "swerve", "mecanum")


@pytest.mark.parametrize("floor", [Floor(), FLOOR], ids=["clean", "rough"])
@pytest.mark.parametrize("name", NAMES)
def test_a_mirrored_robot_on_a_mirrored_floor_drives_the_mirrored_path(name, floor):
    robot = robot_named(name)
    angles = np.linspace(-1.0, 2.0, len(robot.castors))
    pose, twist = np.array([0.0, 0.05, 0.3]), np.array([0.2, -0.1, 0.4])
    flip = np.array([1.0, -1.0, -1.0])
    straight = np.arange(len(robot.driven_wheels))
    plain = run(robot, floor, pose, angles, twist, straight, 1)
    mirror = run(mirrored(robot), mirrored_floor(floor), pose * flip, -angles, twist * flip, swapped_wheels(robot), -1)
    assert np.ptp(plain[:, :2]) > 0.1
    np.testing.assert_allclose(mirror, plain * [1.0, -1.0, -1.0, *-np.ones(len(robot.castors))], rtol=0, atol=1e-9)


@pytest.mark.parametrize(("shift", "turn"), [(3.0 - 2.0j, 0.0), (0.0j, 2.1), (-1.0 + 4.0j, -0.9)])
@pytest.mark.parametrize("name", NAMES)
def test_moving_robot_and_floor_moves_the_path_and_changes_nothing_else(name, shift, turn):
    robot = robot_named(name)
    angles = np.linspace(-1.0, 2.0, len(robot.castors))
    pose, twist = np.array([0.0, 0.05, 0.3]), np.array([0.2, -0.1, 0.4])
    order = np.arange(len(robot.driven_wheels))
    path_here = run(robot, FLOOR, pose, angles, twist, order, 1)
    at = shift + complex(*pose[:2]) * np.exp(1j * turn)
    there_pose = (at.real, at.imag, pose[2] + turn)
    path_there = run(robot, moved_floor(FLOOR, shift, turn), there_pose, angles, twist, order, 1)
    path = shift + (path_here[:, 0] + 1j * path_here[:, 1]) * np.exp(1j * turn)
    expected = np.column_stack([path.real, path.imag, path_here[:, 2] + turn, path_here[:, 3:]])
    np.testing.assert_allclose(path_there, expected, rtol=0, atol=1e-9)
