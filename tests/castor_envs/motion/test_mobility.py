"""Which motions wheels allow: against the velocities of their contacts, worked out by hand."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from castor_envs.errors import InputError
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.mobility import Mobility, check_drivable, turned_by_motors
from castor_envs.motion.trajectories import umbmark
from castor_envs.vehicles.presets import preset, preset_names, split_castor
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel

PAIR = (Wheel(radius=0.05, lateral=0.1), Wheel(radius=0.05, lateral=-0.1))
IDLE = Wheel(radius=0.05, counts_per_rev=None)


def on_axles(*axles):
    """Return a robot with a fixed pair of wheels at each (x, y, angle)."""
    castors = [Castor(pivot=(x, y), steering="fixed", angle=angle, wheels=PAIR) for x, y, angle in axles]
    return RobotDescription(name="fixed", castors=tuple(castors))


@pytest.mark.parametrize(
    ("name", "freedom", "steered", "redundancy"),
    [
        ("asoc-prototype", 3, (), 6),
        ("1-castor", 3, (), 0),
        ("differential", 2, (), 0),
        ("tricycle", 2, (0,), 0),
        ("powered-caster", 3, (), 5),
        ("swerve", 3, (0, 1, 2, 3), 5),
        ("omni3", 3, (), 0),
    ],
)
def test_presets_move_as_their_names_say(name, freedom, steered, redundancy):
    """Each driven wheel of known direction gives an equation, each axle with a standard wheel another; 3 are needed."""
    mobility = Mobility.of(preset(name))
    assert (mobility.freedom, mobility.steered, mobility.redundancy) == (freedom, steered, redundancy)
    assert mobility.omnidirectional == (freedom == 3)


@given(x=st.floats(-1, 1), y=st.floats(-1, 1), angle=st.floats(-3, 3))
def test_no_motion_of_one_axle_slips_and_all_turn_about_its_line(x, y, angle):
    mobility = Mobility.of(on_axles((x, y, angle)))
    left = np.array([-np.sin(angle), np.cos(angle)])
    for v_x, v_y, omega in mobility.motions:
        assert np.array([v_x - omega * y, v_y + omega * x]) @ left == pytest.approx(0, abs=1e-9)
    assert mobility.center is not None
    point, along = mobility.center
    assert abs(along @ left) == pytest.approx(1, abs=1e-6)  # the line of the axle
    away = point - (x, y)
    assert away[0] * left[1] - away[1] * left[0] == pytest.approx(0, abs=1e-6)  # through its middle


def test_two_axles_that_cross_turn_about_one_point_only():
    mobility = Mobility.of(on_axles((0.5, 0.0, 0.0), (0.0, 0.2, np.pi / 2)))
    assert mobility.center is not None
    point, along = mobility.center
    assert mobility.freedom == 1
    np.testing.assert_allclose(point, (0.5, 0.2), atol=1e-9)
    assert along is None


def test_parallel_axles_drive_straight_and_three_that_do_not_meet_hold_the_robot():
    straight = Mobility.of(on_axles((0.3, 0.0, 0.0), (-0.3, 0.0, 0.0)))
    assert (straight.freedom, straight.center) == (1, None)
    np.testing.assert_allclose(np.abs(straight.motions[0]), (1, 0, 0), atol=1e-9)
    held = Mobility.of(on_axles((0.3, 0.0, 0.0), (-0.3, 0.0, 0.0), (0.0, 0.0, 1.0)))
    assert (held.freedom, held.center) == (0, None)


@given(v_x=st.floats(-1, 1), v_y=st.floats(-1, 1), omega=st.floats(-1, 1))
def test_the_nearest_motion_keeps_speed_and_turning(v_x, v_y, omega):
    """An axle 0.2 m behind the origin: turning moves the origin sideways by 0.2 m times the rate."""
    nearest = Mobility.of(on_axles((-0.2, 0.0, 0.0))).nearest((v_x, v_y, omega))
    np.testing.assert_allclose(nearest, (v_x, 0.2 * omega, omega), atol=1e-5)
    np.testing.assert_allclose(Mobility.of(preset("omni3")).nearest((v_x, v_y, omega)), (v_x, v_y, omega), atol=1e-9)


@pytest.mark.parametrize("name", preset_names())
def test_motors_turn_every_preset_but_the_base_on_one_castor(name):
    assert turned_by_motors(preset(name)) == (name != "1-castor")


@pytest.mark.parametrize(
    ("others", "turned"),
    [
        ((Castor(pivot=(-0.5, 0.0), steering="fixed", wheels=(IDLE,)),), True),
        ((Castor(pivot=(-0.5, 0.0), offset=0.05, wheels=(IDLE,)),), False),
        ((Castor(pivot=(-0.5, 0.0), steering="fixed", wheels=(dataclasses.replace(IDLE, grip="omni"),)),), False),
        ((split_castor((-0.5, 0.0)),), True),
    ],
)
def test_what_a_split_castor_needs_to_turn_a_body(others, turned):
    """An idle fixed wheel, which does not slip sideways, or a second split castor; no idle castor or omni wheel."""
    robot = RobotDescription(name="two", castors=(split_castor((0.5, 0.0)), *others))
    assert turned_by_motors(robot) == turned


@pytest.mark.parametrize("grips", [("standard", "omni"), ("omni", "standard"), ("standard", "standard")])
def test_one_wheel_without_rollers_keeps_its_castor_from_slipping_sideways(grips):
    """Whichever wheel of the castor it is."""
    wheels = [Wheel(radius=0.05, lateral=side, grip=grip) for side, grip in zip((0.15, -0.15), grips, strict=True)]
    behind = Castor(pivot=(0.3, 0.0), offset=0.05, pivot_counts_per_rev=4096, wheels=(Wheel(radius=0.05),))
    fixed = Castor(pivot=(0.0, 0.0), steering="fixed", wheels=tuple(wheels))
    robot = RobotDescription(name="mixed", castors=(fixed, behind))
    with pytest.raises(InputError, match="slip sideways"):
        check_drivable(robot, umbmark(corners="fixed"))
    rollers = dataclasses.replace(fixed, wheels=tuple(dataclasses.replace(wheel, grip="omni") for wheel in wheels))
    slip = Geometry.of(dataclasses.replace(robot, castors=(rollers, behind))).side_slip_of_fixed([0.0, 1.0, 0.0])
    np.testing.assert_array_equal(slip, 0.0)
    assert abs(Geometry.of(robot).side_slip_of_fixed([0.0, 1.0, 0.0])[0]) == pytest.approx(1.0)
