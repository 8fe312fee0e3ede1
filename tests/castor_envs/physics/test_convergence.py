"""How errors fall with the substep: the scheme is of first order, in poses as in velocities, rolling or sliding."""

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import pytest

from castor_envs.floor import Floor
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.physics.stepper import Drive
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Castor, Contact, RobotDescription, Wheel

SECONDS = 2.0


@dataclass(frozen=True)
class Scene:
    """A drive of 2 s, and its errors at the default substep as docs/physics.md states them: µm, µm/s."""

    robot: str
    position: float
    velocity: float
    drive: Drive = "off"
    command: tuple[float, ...] = ()
    slope: tuple[float, float] = (0.0, 0.0)
    friction: float = 0.8
    start: dict = field(default_factory=dict)


SCENES = {
    "coasting on the flat": Scene("asoc-prototype", 2.2, 0.8, start={"twist": (0.5, 0.1, 0.3)}),
    "servos, flat": Scene("asoc-prototype", 0.1, 13, "servo", (4, 5, 4, 5, 4, 5)),
    "servos, 6 % slope": Scene("asoc-prototype", 0.2, 13, "servo", (4, 5, 4, 5, 4, 5), (0.06, 0.02)),
    "accelerating at constant voltage, flat": Scene("differential", 3.0, 9.0, "voltage", (0.2, 0.25)),
    "rolling down a 6 % slope": Scene(
        "asoc-prototype", 205, 8.5, slope=(0.06, 0.0), start={"castor_angles": [math.pi] * 3}
    ),
    "sliding, friction 0.03": Scene(
        "asoc-prototype", 153, 113, "servo", (4, 5, 4, 5, 4, 5), (0.06, 0.02), friction=0.03
    ),
}


def state(scene, finer):
    """Position and velocity of the robot (2, 2) after a drive with `finer` times the default substeps; the world."""
    robot = preset(scene.robot)
    robot = dataclasses.replace(robot, contact=dataclasses.replace(robot.contact, friction=scene.friction))
    floor = Floor(slope=scene.slope)
    substeps = finer * RobotWorld(robot, floor).substeps
    world = RobotWorld(robot, floor, substeps=substeps, **scene.start)
    for k in range(round(SECONDS / robot.sample_period)):
        size = math.sin((k + 0.5) * robot.sample_period) if scene.drive == "servo" else 1.0
        command = size * np.array(scene.command) if scene.command else np.zeros(len(robot.driven_wheels))
        world.advance(command, 0.0, scene.drive)
    x, y, psi = world.pose
    velocity = complex(*world.twist[:2]) * np.exp(1j * psi)
    return np.array([[x, y], [velocity.real, velocity.imag]]), world


@pytest.mark.parametrize("scene", SCENES.values(), ids=SCENES)
def test_halving_the_substep_halves_the_error_of_position_and_velocity(scene):
    """Differences of successive halvings fall by 2 for an error in proportion to the substep, by 4 for its square."""
    coarse, middle, fine = (state(scene, finer)[0] for finer in (1, 2, 4))
    before, after = np.linalg.norm(coarse - middle, axis=1), np.linalg.norm(middle - fine, axis=1)
    assert before / after == pytest.approx([2.0, 2.0], abs=0.1)
    error = 2e6 * before  # what is first order and halved by halving is twice what halving changes
    assert error == pytest.approx([scene.position, scene.velocity], rel=0.1, abs=0.06)


def test_speeding_up_from_rest_lags_behind_by_half_a_substep():
    """Positions move with the velocity before its change: the robot is where it was half a substep earlier."""
    scene = SCENES["rolling down a 6 % slope"]
    coarse, world = state(scene, 1)
    exact = 2 * state(scene, 2)[0] - coarse
    assert exact[0, 0] - coarse[0, 0] == pytest.approx(coarse[1, 0] * world.dt / 2, rel=0.1)
    assert coarse[1, 0] == pytest.approx(exact[1, 0], rel=2e-5)


def on_fixed_castors(places, roller_angle=0.0, grip: Literal["standard", "omni"] = "standard", inertia=1.0, **contact):
    """A robot on fixed castors at places (x, wheels' y)."""
    castors = [
        Castor(
            pivot=(x, 0.0),
            steering="fixed",
            mass=2.0 / len(places),
            inertia=0.001,
            wheels=tuple(
                Wheel(
                    radius=0.05, lateral=y, grip=grip, counts_per_rev=1000, roller_angle=-roller_angle * np.sign(x * y)
                )
                for y in lateral
            ),
        )
        for x, lateral in places
    ]
    return RobotDescription(
        name="fixed", castors=tuple(castors), mass=20.0, inertia=inertia, contact=Contact(**contact)
    )


@pytest.mark.parametrize("roller_angle", [0.8, 1.3, 1.4])
@pytest.mark.parametrize("inertia", [1.0, 0.3])
def test_stiff_rollers_take_as_many_substeps_as_they_need(roller_angle, inertia):
    robot = on_fixed_castors([(0.3, (0.2, -0.2)), (-0.3, (0.2, -0.2))], roller_angle, "omni", inertia)
    poses = []
    for finer in (1, 16):
        world = RobotWorld(robot, substeps=finer * RobotWorld(robot).substeps)
        for k in range(20):
            world.advance(np.array([0.8, 1.0, 0.8, 1.0]) * (6.0 if k < 12 else -6.0))
        poses.append(world.pose)
    assert math.dist(poses[0][:2], poses[1][:2]) < 1e-4  # m; without rollers as much
    assert poses[0][2] == pytest.approx(poses[1][2], abs=1e-3)


@pytest.mark.parametrize("stiffness", [80.0, 1000.0])
def test_substeps_do_not_depend_on_how_wheels_stand_on_castors_that_never_turn(stiffness):
    """Two wheels on one axle are one castor with two wheels, or two castors with pivots of their own."""
    one = on_fixed_castors([(0.0, (0.3, -0.3))], relaxation_length=1e-3, slip_stiffness_long=stiffness)
    castor = one.castors[0]
    apart = tuple(
        dataclasses.replace(
            castor,
            pivot=(0.4, wheel.lateral),
            offset=0.4,
            mass=castor.mass / 2,
            wheels=(dataclasses.replace(wheel, lateral=0.0),),
        )
        for wheel in castor.wheels
    )
    # The castors' masses stand farther out, which the chassis makes up for.
    inertia = one.inertia - castor.mass * 0.3**2 - castor.inertia
    other = RobotWorld(dataclasses.replace(one, castors=apart, inertia=inertia))
    assert other.substeps == pytest.approx(RobotWorld(one).substeps, abs=1)
