"""How loads on castors shift, which physics leaves out: by trailing, against statics, and by accelerating, by hand."""

import dataclasses
import math

import numpy as np
import pytest

from castor_envs.geometry.se2 import rotate_single
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.vehicles.presets import n_castor, preset
from castor_envs.vehicles.weight import chassis, swung_loads, wheel_loads

G = 9.80665
PROTOTYPE = preset("asoc-prototype")
R, OFFSET, CHASSIS, ALL = 0.24, 0.072, 18.0, 22.5
HEIGHT = 3 * 0.0381  # of the centre of mass over the floor, m: assumed, as in the trials' foreign simulator


def on_castors(loads):
    """Loads on castors (..., n) from those on their two wheels each (..., 2 n)."""
    return loads[..., ::2] + loads[..., 1::2]


def shifts(robot, angles):
    """Change of the loads on castors (K, n), of their mean, where castors stand at angles (K, n)."""
    return on_castors(swung_loads(robot, G, angles)) / on_castors(wheel_loads(robot, G)) - 1


@pytest.mark.parametrize("n", [3, 4, 6])
def test_trailing_one_way_shifts_loads_by_twice_offset_over_radius_of_the_chassis_share(n):
    direction = np.linspace(0.0, 2 * math.pi, 25)
    bearing = 2 * math.pi * np.arange(n) / n
    expected = 2 * OFFSET / R * CHASSIS / ALL * np.cos(bearing - direction[:, None])
    np.testing.assert_allclose(shifts(n_castor(n), np.tile(direction[:, None], n)), expected, atol=1e-12)


def test_on_the_prototype_trailing_shifts_them_by_up_to_48_percent():
    """And no other angles by more."""
    straight = shifts(PROTOTYPE, np.zeros((1, 3)))
    np.testing.assert_allclose(straight, [[0.48, -0.24, -0.24]], atol=1e-12)
    any_angles = np.random.default_rng(0).uniform(-math.pi, math.pi, (5000, 3))
    assert 0.4 < np.max(np.abs(shifts(PROTOTYPE, any_angles))) <= 0.48 + 1e-12


def test_three_loads_are_those_of_a_plate_by_hand():
    """Moments about the line through two axles: the third carries the weight by the ratio of distances from it."""
    for angles in np.random.default_rng(1).uniform(-math.pi, math.pi, (20, 3)):
        axle = [complex(*c.pivot) - OFFSET * np.exp(1j * a) for c, a in zip(PROTOTYPE.castors, angles, strict=True)]
        for i in range(3):
            third, first, second = axle[i], axle[i - 1], axle[i - 2]
            normal = 1j * (second - first) / abs(second - first)
            weight, load = ((np.conj(normal) * (place - first)).real for place in (0.0, third))
            expected = CHASSIS * G * weight / load + 1.5 * G
            assert on_castors(swung_loads(PROTOTYPE, G, angles[None]))[0, i] == pytest.approx(expected)


def transfer(acceleration, height):
    """Change of the prototype's three loads (3,), of their mean, by accelerating along x: moments about the floor.

    The centre of mass stands at `height` over the middle, all axles under their pivots; at the floor wheels push with
    M a. Forces up and both moments of all forces and of -M a at the centre of mass balance.
    """
    feet = np.array([[*castor.pivot, 0.0] for castor in PROTOTYPE.castors])
    up = np.array([0.0, 0.0, 1.0])
    arms = np.cross(feet, up)
    rows = np.vstack([np.ones(3), arms[:, 0], arms[:, 1]])
    inertial = np.array([-ALL * acceleration, 0.0, -ALL * G])
    moment = np.cross(np.array([0.0, 0.0, height]), inertial)
    load = np.linalg.solve(rows, [ALL * G, -moment[0], -moment[1]])
    return load / (ALL * G / 3) - 1


@pytest.mark.parametrize(("acceleration", "share"), [(0.5, 0.049), (1.0, 0.097), (2.0, 0.194)])
def test_accelerating_shifts_them_by_less_than_trailing(acceleration, share):
    """2 a h / (g R) from front to rear, against 0.48."""
    found = transfer(acceleration, HEIGHT)
    np.testing.assert_allclose(found, share * np.array([-1.0, 0.5, 0.5]), rtol=0.01)
    np.testing.assert_allclose(found[0], -2 * acceleration * HEIGHT / (G * R), rtol=1e-9)


def test_they_are_equal_at_two_metres_a_second_squared_if_the_centre_of_mass_is_as_high_as_28_cm():
    assert transfer(2.0, 0.28)[0] == pytest.approx(-0.48, rel=0.01)
    assert transfer(4.94, HEIGHT)[0] == pytest.approx(-0.48, rel=0.01)


def offset_behind(robot, i, pivot_ahead):
    """The same robot, the pivot of its fixed castor i described ahead of where it was, with as much more offset."""
    castor = robot.castors[i]
    ahead = rotate_single(np.array([pivot_ahead, 0.0]), castor.angle)
    moved = dataclasses.replace(
        castor, pivot=tuple(castor.pivot + ahead), offset=castor.offset + pivot_ahead, pivot_counts_per_rev=None
    )
    return dataclasses.replace(robot, castors=(*robot.castors[:i], moved, *robot.castors[i + 1 :]))


def drive(robot, castors=None):
    world = RobotWorld(robot, castor_angles=castors)
    for _ in range(20):
        world.advance(np.full(len(robot.driven_wheels), 6.0), np.full(len(robot.driven_castors), 0.3))
    return world.pose


@pytest.mark.parametrize("angle", [0.0, 0.4])
@pytest.mark.parametrize("ahead", [0.05, 0.15, 0.3])
def test_where_the_pivot_of_a_castor_that_never_turns_is_said_to_be_changes_nothing(ahead, angle):
    robot = preset("tricycle")
    rear = dataclasses.replace(robot.castors[1], angle=angle)
    robot = dataclasses.replace(robot, castors=(robot.castors[0], rear))
    other = offset_behind(robot, 1, ahead)
    np.testing.assert_allclose(wheel_loads(other, G), wheel_loads(robot, G), rtol=1e-12)
    for one, two in zip(chassis(other), chassis(robot), strict=True):
        np.testing.assert_allclose(one, two, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(drive(other), drive(robot), atol=1e-9)


@pytest.mark.parametrize("off", [0.0, 0.02, -0.05])
def test_loads_sum_to_the_weight_where_the_wheels_alone_cannot_balance_it(off):
    """On one axle the moment of a centre of mass ahead of it is borne by castors that physics has no load for."""
    robot = preset("differential")
    castors = [dataclasses.replace(castor, pivot=(0.2, castor.pivot[1])) for castor in robot.castors]
    robot = dataclasses.replace(robot, castors=tuple(castors), center_of_mass=(0.2 + off, 0.0))
    weight = G * (robot.mass + sum(castor.mass for castor in robot.castors))
    at = np.array([[castor.angle for castor in robot.castors]])
    assert np.sum(wheel_loads(robot, G)) == pytest.approx(weight, rel=1e-12)
    assert np.sum(swung_loads(robot, G, at)) == pytest.approx(weight, rel=1e-12)
