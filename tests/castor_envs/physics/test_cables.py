"""Rolling over a cable takes a longer way, and its climb costs what it is high."""

import dataclasses
import functools
import math

import numpy as np
import pytest

from castor_envs.floor import Cable, Floor, cable_extra_roll
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.vehicles.presets import differential

G = 9.80665
RADIUS, TRACK, DIAMETER = 0.075, 0.34, 0.01  # LabMate and Borenstein's cables
WEIGHT = 46.0 * G


def center_heights(x, radius, diameter):
    """How high a disc's centre is at x when it rests on the floor or on a round cable at 0: the lowest it fits.

    No formula for the arc: the disc must clear every point of the cable's outline.
    """
    angle = np.linspace(0, math.pi, 1201)
    outline_x, outline_y = diameter / 2 * np.cos(angle), diameter / 2 * (1 + np.sin(angle))
    gap = radius**2 - (x[:, None] - outline_x) ** 2
    touching = np.where(gap > 0, outline_y + np.sqrt(np.maximum(gap, 0.0)), 0.0)
    return np.maximum(radius, touching.max(axis=1))


@functools.cache
def path_over(radius, diameter, crossing_angle=math.pi / 2):
    """The path of a disc's centre over a cable less its length in plan, as a sum of short chords, m."""
    reach = 1.2 * math.sqrt(2 * radius * diameter) / math.sin(crossing_angle)
    s = np.linspace(-reach, reach, 1201)
    heights = center_heights(s * math.sin(crossing_angle), radius, diameter)
    return float(np.sum(np.hypot(np.diff(s), np.diff(heights))) - 2 * reach)


def across(*, at=0.6, y=0.0, length=2.0, direction=math.pi / 2, diameter=DIAMETER):
    return Cable(center=(at, y), direction=direction, length=length, diameter=diameter)


@pytest.mark.parametrize("radius", [0.0381, 0.075, 0.114])
@pytest.mark.parametrize("diameter", [0.004, 0.01, 0.02])
def test_the_formula_is_the_geometry(radius, diameter):
    assert cable_extra_roll(radius, diameter) == pytest.approx(path_over(radius, diameter), rel=1e-3)


@pytest.mark.parametrize("speed", [0.1, 0.25, 0.55])
@pytest.mark.parametrize(("radius", "diameter"), [(0.075, 0.01), (0.0381, 0.01), (0.075, 0.02), (0.114, 0.005)])
def test_wheels_roll_the_longer_way_over_a_cable(radius, diameter, speed):
    floor = Floor(cables=(across(diameter=diameter),), climbing=False)
    world = RobotWorld(differential(radius=radius), floor)
    while world.pose[0] < 0.3:
        assert world.time < 30.0
        world.advance([speed / radius] * 2)
    angle, x = world.wheel_angles, world.pose[0]
    while world.pose[0] < 0.9 or not math.isclose(world.twist[0], speed, rel_tol=1e-4):
        assert world.time < 30.0
        world.advance([speed / radius] * 2)
    extra = radius * (world.wheel_angles - angle) - (world.pose[0] - x)
    np.testing.assert_allclose(extra, path_over(radius, diameter), rtol=0.01)
    assert world.pose[2] == pytest.approx(0.0, abs=1e-9)


def heading_after(cables, speed, climbing=False):
    """The final heading (degrees) of a LabMate-sized robot that drives over cables, its wheels turning alike."""
    robot = dataclasses.replace(differential(), max_wheel_torque=30.0)
    world = RobotWorld(robot, Floor(cables=cables, climbing=climbing))
    while abs(world.pose[0]) < max(abs(cable.center[0]) for cable in cables) + 0.4:
        assert world.time < 30.0
        world.advance([speed / RADIUS] * 2)
    for _ in range(20):
        world.advance([0.0, 0.0])
    np.testing.assert_allclose(*world.wheel_angles, atol=1e-3)
    return math.degrees(world.pose[2])


@pytest.mark.parametrize("speed", [0.15, 0.3, -0.3])
@pytest.mark.parametrize("side", [1, -1])
def test_a_cable_turns_a_labmate_sized_robot_towards_the_wheel_that_crosses_it(side, speed):
    way = math.copysign(1, speed)
    cable = across(at=0.6 * way, y=side * TRACK / 2, length=0.1)
    assert heading_after((cable,), speed) * side * way == pytest.approx(0.57, abs=0.02)
    assert heading_after((cable,), speed) * side * way == pytest.approx(
        math.degrees(path_over(RADIUS, DIAMETER) / TRACK), rel=0.01
    )


def test_ten_cables_turn_it_ten_times_as_far():
    cables = tuple(across(at=0.5 + 0.25 * i, y=TRACK / 2 + 0.2, length=0.5) for i in range(10))
    assert heading_after(cables, 0.25) / 10 == pytest.approx(0.57, abs=0.02)


@pytest.mark.parametrize("angle", [0.6, 1.0, 2.2])
def test_a_slanting_crossing_follows_the_profile_of_its_cut(angle):
    cable = across(y=TRACK / 2, length=0.2, direction=angle)
    expected = math.degrees(path_over(RADIUS, DIAMETER, angle) / TRACK)
    assert heading_after((cable,), 0.25) == pytest.approx(expected, rel=0.01)


def test_a_wheel_that_passes_beside_a_cable_does_not_feel_it():
    assert heading_after((across(y=TRACK / 2 + 0.06, length=0.1),), 0.25, climbing=True) == pytest.approx(0.0, abs=1e-9)


def kinetic_energy(world):
    vx, _, turning = world.twist
    return (
        0.5 * 46.0 * vx**2 + 0.5 * 2.6 * turning**2 + 0.5 * np.sum(world.wheels["inertia"] * world.wheels["speed"] ** 2)
    )


@pytest.mark.parametrize("speed", [0.6, 0.8, 1.2])
def test_coasting_over_a_cable_pays_the_climb_and_gets_it_back(speed):
    robot = dataclasses.replace(differential(), sample_period=0.001)
    world = RobotWorld(robot, Floor(cables=(across(at=0.2),)), twist=(speed, 0.0, 0.0), substeps=8)
    start, way = kinetic_energy(world), []
    while world.pose[0] < 0.35:
        assert world.time < 30.0
        world.advance([0.0, 0.0], drive="off")
        way.append((world.pose[0], kinetic_energy(world)))
    x, energy = np.transpose(way)
    climb = WEIGHT * DIAMETER
    on_top = np.interp(0.2, x, energy)
    assert start - on_top == pytest.approx(climb, rel=0.02)
    assert energy[-1] - on_top == pytest.approx(climb, rel=0.03)
    # On the way, too, the energy follows the height of the wheels' centres.
    heights = center_heights(x - 0.2, RADIUS, DIAMETER) - RADIUS
    np.testing.assert_allclose(start - energy, WEIGHT * heights, atol=0.03 * climb)


def test_motors_that_lift_a_robot_onto_a_cable_do_the_work_of_the_climb():
    robot = dataclasses.replace(differential(), sample_period=0.001, max_wheel_torque=40.0)
    world, work = RobotWorld(robot, Floor(cables=(across(at=0.2),)), substeps=4), 0.0
    while world.pose[0] < 0.1999:
        assert world.time < 30.0
        speed = min(0.05, 0.2 * world.time, 2 * (0.2 - world.pose[0]) + 0.002)
        world.advance([speed / RADIUS] * 2)
        work += robot.sample_period * float(np.sum(world.wheels["torque"] * world.wheels["speed"]))
    assert kinetic_energy(world) < 0.01
    assert work == pytest.approx(WEIGHT * DIAMETER, rel=0.02)


def test_without_the_climbing_force_a_robot_coasts_on_at_its_speed():
    world = RobotWorld(differential(), Floor(cables=(across(at=0.2),), climbing=False), twist=(0.5, 0.0, 0.0))
    for _ in range(40):
        world.advance([0.0, 0.0], drive="off")
    assert world.twist[0] == pytest.approx(0.5, rel=2e-3)  # but for the spin that the wheels borrow on the way
