"""Coulomb's law: no more than friction times load, no creep at rest, sliding beyond."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from castor_envs.floor import Floor, Patch
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Contact, RobotDescription, Wheel

G = 9.80665


def with_friction(name, friction, **changes):
    return dataclasses.replace(preset(name), contact=Contact(friction=friction), **changes)


def total_mass(robot):
    return robot.mass + sum(castor.mass for castor in robot.castors)


@pytest.mark.parametrize("friction", [0.05, 0.2])
@pytest.mark.parametrize(("drive", "command"), [("servo", 15.0), ("servo", -15.0), ("voltage", 1.0), ("voltage", -1.0)])
def test_asked_for_more_a_robot_accelerates_at_friction_times_g(friction, drive, command):
    world, gained = RobotWorld(with_friction("differential", friction)), [0.0]
    for _ in range(4):
        world.advance([command, command], drive=drive)
        gained.append(abs(world.twist[0]))
        assert np.all(np.abs(world.wheels["speed"]) * 0.075 > 1.2 * gained[-1])  # wheels spin
    expected = friction * G * world.robot.sample_period
    assert gained[1] == pytest.approx(expected, rel=0.02)  # the bristles first wind up
    np.testing.assert_allclose(np.diff(gained)[1:], expected, rtol=1e-9)


@pytest.mark.parametrize("acceleration", [0.4, -0.4])
def test_below_friction_times_g_nothing_slides(acceleration):
    friction = 0.05
    world = RobotWorld(with_friction("differential", friction), twist=(0.6, 0.0, 0.0))
    for k in range(20):
        world.advance([(0.6 + acceleration * (k + 1) * 0.05) / 0.075] * 2)
        assert np.all(np.hypot(world.wheels["force_long"], world.wheels["force_lat"]) < friction * 46 * G / 2)
        np.testing.assert_allclose(world.wheels["speed"] * 0.075, world.twist[0], rtol=2e-3)


@given(direction=st.floats(-math.pi, math.pi), speed=st.floats(0.3, 1.5), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_with_all_wheels_held_a_robot_slides_as_a_block_does(direction, speed, seed):
    """Straight on for v^2 / (2 mu g), whatever way its wheels stand."""
    friction = 0.3
    robot = with_friction("swerve", friction, max_steering_torque=1000.0)
    heavy = tuple(dataclasses.replace(wheel, inertia=1e5) for wheel in robot.castors[0].wheels)  # nothing turns them
    castors = tuple(dataclasses.replace(castor, wheels=heavy) for castor in robot.castors)
    robot = dataclasses.replace(robot, castors=castors)
    angles = np.random.default_rng(seed).uniform(-math.pi, math.pi, 4)
    way = np.array([math.cos(direction), math.sin(direction)])
    world = RobotWorld(robot, castor_angles=angles, twist=(*(speed * way), 0.0))
    world.wheels["speed"] = 0.0
    for _ in range(math.ceil(speed / (friction * G) / robot.sample_period) + 10):
        world.advance(np.zeros(4))
    # Bristles must stretch before they slide, and robot and bristles swing out afterwards.
    np.testing.assert_allclose(world.pose[:2], speed**2 / (2 * friction * G) * way, atol=5e-4)
    np.testing.assert_allclose(world.twist, 0.0, atol=1e-6)


@given(speed=st.floats(0.1, 1.0), sideways=st.floats(0.3, 1.0), friction=st.floats(0.1, 0.8))
@settings(max_examples=15, deadline=None)
def test_coasting_wheels_brake_sideways_only(speed, sideways, friction):
    world = RobotWorld(with_friction("differential", friction, sample_period=0.01), twist=(speed, sideways, 0.0))
    for k in range(1, 130):
        world.advance([0.0, 0.0], drive="off")
        sliding = sideways - friction * G * k * 0.01
        if sliding > 0.05:
            np.testing.assert_allclose(world.twist, [speed, sliding, 0.0], atol=0.02)
    np.testing.assert_allclose(world.twist, [speed, 0.0, 0.0], atol=0.01)


CIRCLE_ROBOTS = ("asoc-prototype", "omnimate", "differential", "tricycle", "powered-caster", "swerve", "mecanum")


def robot_for_circle(name):
    if name != "mecanum":
        return preset(name)
    base = preset("swerve")
    castors = tuple(
        dataclasses.replace(
            castor,
            steering="fixed",
            pivot_counts_per_rev=None,
            wheels=(Wheel(radius=0.05, grip="omni", roller_angle=math.copysign(math.pi / 4, i % 2 - 0.5)),),
        )
        for i, castor in enumerate(base.castors)
    )
    return dataclasses.replace(base, castors=castors)


def even_loads(robot: RobotDescription):
    """The static loads of the presets: all wheels alike, but for the tricycle's lever."""
    if robot.name == "tricycle":
        return G * np.array([12.0 + 3.0, 9.0 + 1.5, 9.0 + 1.5])
    return np.full(len(robot.wheels), total_mass(robot) * G / len(robot.wheels))


def contact_points(robot, world):
    """Where the wheels touch the floor, complex (w,)."""
    x, y, psi = world.pose
    points = []
    for i, wheel in zip(robot.wheel_castors, robot.wheels, strict=True):
        castor = robot.castors[i]
        arm = complex(-castor.offset, wheel.lateral) * np.exp(1j * world.castor_angles[i])
        points.append(complex(x, y) + np.exp(1j * psi) * (complex(*castor.pivot) + arm))
    return np.array(points)


def momentum(world):
    return np.sum([body.mass * np.array(body.velocity) for body in world.simulation.space.bodies], axis=0)


@pytest.mark.parametrize("name", CIRCLE_ROBOTS)
@given(seed=st.integers(0, 2**32 - 1), slippery=st.floats(0.0, 0.4), drive=st.sampled_from(["servo", "voltage"]))
@example(seed=1, slippery=0.0, drive="servo")
@settings(max_examples=4, deadline=None)
def test_contact_forces_stay_in_the_friction_circle(name, seed, slippery, drive):
    """Looked at after every substep, in random driving with jumps, on a floor with a slippery patch, on a slope."""
    random = np.random.default_rng(seed)
    robot = dataclasses.replace(robot_for_circle(name), sample_period=5e-4)
    patch = Patch(center=(0.15, 0.0), size=(0.3, 3.0), friction=slippery, angle=0.2)
    floor = Floor(patches=(patch,), slope=(0.02, 0.01))
    loads = even_loads(robot) / math.sqrt(1 + 0.02**2 + 0.01**2)
    world = RobotWorld(
        robot,
        floor,
        castor_angles=random.uniform(-3, 3, len(robot.castors)),
        twist=random.uniform(-1, 1, 3),
        substeps=1,
    )
    limit = robot.max_wheel_speed if drive == "servo" else 1.0
    wheel_command, steering_command = np.zeros(len(robot.driven_wheels)), np.zeros(len(robot.driven_castors))
    for k in range(300):
        if k % 40 == 0:
            wheel_command = random.uniform(-limit, limit, len(wheel_command))
            steering_command = random.uniform(-5, 5, len(steering_command))
        before = momentum(world)
        points = contact_points(robot, world)
        world.advance(wheel_command, steering_command, drive)
        across = ((points - 0.15) * np.exp(-0.2j)).real
        friction = np.where(np.abs(across) < 0.15, slippery, 0.8)
        certain = np.abs(np.abs(across) - 0.15) > 0.005  # not so near the patch's edge that a substep may cross it
        friction = np.where(certain, friction, 0.8)

        wheels = world.wheels
        grip = np.array([wheel.grip == "standard" for wheel in robot.wheels])
        rollers = np.array([math.cos(wheel.roller_angle) for wheel in robot.wheels])
        long, lat = wheels["force_long"], wheels["force_lat"]
        size = np.where(grip, np.hypot(long, lat), np.abs(long) / rollers)
        assert np.all(size <= friction * loads * (1 + 1e-9) + 1e-12)
        # The same by Newton's second law, from the bodies alone.
        downhill = total_mass(robot) * np.array(floor.downhill_gravity)
        force = (momentum(world) - before) / robot.sample_period - downhill
        assert math.hypot(*force) <= np.sum(friction * loads) * (1 + 1e-6) + 1e-6


# Share of the friction limit on which a robot still stands. Side forces on the pivot of a free castor also twist its
# pair of wheels: (1/2, offset / track) of the force on each wheel, so a split castor stands 63 % of the limit from any
# side; only the front wheel of a tricycle brakes, under 15 / 36 of its weight.
STANDS = {"tricycle": 0.4, "asoc-prototype": 0.6, "asoc-full-scale": 0.6, "4-castor": 0.6}
STANDS |= {"omnimate": 0.95, "differential": 0.95, "powered-caster": 0.95, "swerve": 0.95}


@pytest.mark.parametrize("heading", [0.0, 0.7, 2.4, math.pi / 2])
@pytest.mark.parametrize("name", STANDS)
@pytest.mark.parametrize("part", [0.2, 1.0])
def test_parked_under_the_friction_limit_a_robot_does_not_creep(name, heading, part):
    friction = 0.5
    robot = with_friction(name, friction)
    robot = dataclasses.replace(robot, max_wheel_torque=10 * robot.max_wheel_torque)
    floor = Floor(slope=(part * STANDS[name] * friction, 0.0))
    angles = np.random.default_rng(3).uniform(-math.pi, math.pi, len(robot.castors))
    angles = np.zeros(2) if name == "tricycle" else angles
    world = RobotWorld(robot, floor, pose=(0.0, 0.0, heading), castor_angles=angles)
    held = np.zeros(len(robot.driven_wheels))
    for _ in range(40):
        world.advance(held)
    settled = world.pose
    assert 0 < math.hypot(*settled[:2]) < 0.05
    for _ in range(40):
        world.advance(held)
    assert math.hypot(*(world.pose - settled)[:2]) / 2.0 < 1e-6  # m/s, a hundredth of what is allowed
    assert abs(world.pose[2] - settled[2]) / 2.0 < 1e-6


@pytest.mark.parametrize(
    ("name", "heading"), [("differential", 0.4), ("differential", 2.0), ("swerve", 1.0), ("omnimate", 0.0)]
)
@pytest.mark.parametrize("friction", [0.1, 0.3])
def test_beyond_the_friction_limit_a_held_robot_slides_down(name, heading, friction):
    """With g (sin - mu cos), like a block. Castors that could swing stand so that they trail."""
    slope = 0.5
    robot = with_friction(name, friction, max_wheel_torque=100.0, max_steering_torque=1000.0)
    angles = [math.pi] * 2 if name == "omnimate" else [0.3, 1.2, -2.0, 0.9]
    world = RobotWorld(
        robot, Floor(slope=(slope, 0.0)), pose=(0.0, 0.0, heading), castor_angles=angles[: len(robot.castors)]
    )
    held, before = np.zeros(len(robot.driven_wheels)), 0.0
    for k in range(16):
        world.advance(held)
        speed = math.hypot(*world.twist[:2])
        if k >= 6:
            expected = G * (slope - friction) / math.sqrt(1 + slope**2)
            assert (speed - before) / robot.sample_period == pytest.approx(expected, rel=1e-3)
        before = speed
    turned = math.atan2(world.pose[1], world.pose[0])
    assert abs(turned) == pytest.approx(math.pi, abs=1e-2)
