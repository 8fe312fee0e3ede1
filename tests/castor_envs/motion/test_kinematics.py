import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from castor_envs.motion.kinematics import Geometry, castor_rates, constraint_matrix, forward, inverse, pivot_velocity
from castor_envs.vehicles.presets import preset, preset_names
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel

TRAILING = [name for name in preset_names() if name not in ("differential", "tricycle", "swerve", "omni3")]
number = st.floats(-2, 2)
twists = st.tuples(number, number, number).map(np.array)
seeds = st.integers(0, 2**32 - 1)


def contact_velocity(robot, theta, rate, twist, wheel):
    """A contact point's velocity by finite differences of its position in N, seen in the castor's frame."""
    castor, w = robot.castors[robot.wheel_castors[wheel]], robot.wheels[wheel]
    i, step = robot.wheel_castors[wheel], 1e-6

    def position(t):
        psi, angle = twist[2] * t, theta[i] + rate[i] * t
        body = complex(castor.pivot[0], castor.pivot[1])
        arm = complex(-castor.offset, w.lateral) * np.exp(1j * angle)
        return complex(twist[0], twist[1]) * t + np.exp(1j * psi) * (body + arm)

    return (position(step) - position(-step)) / (2 * step) * np.exp(-1j * theta[i])


@pytest.mark.parametrize("name", preset_names())
@given(twist=twists, seed=seeds)
def test_inverse_is_the_velocity_of_the_contact_points(name, twist, seed):
    robot, random = preset(name), np.random.default_rng(seed)
    geometry = Geometry.of(robot)
    theta = np.where(geometry.fixed, geometry.angle, random.uniform(-4, 4, geometry.n_castors))
    rate = np.where(geometry.fixed, 0.0, random.uniform(-4, 4, geometry.n_castors))
    motion = inverse(geometry, theta, rate, twist)
    for k, wheel in enumerate(robot.wheels):
        velocity = contact_velocity(robot, theta, rate, twist, k)
        assert motion.rate[k] * wheel.radius == pytest.approx(velocity.real, abs=1e-7)
        assert motion.side_slip[k] == pytest.approx(velocity.imag, abs=1e-7)


@pytest.mark.parametrize("name", TRAILING)
@given(twist=twists, seed=seeds)
def test_trailing_castors_do_not_slip_and_forward_undoes_inverse(name, twist, seed):
    geometry = Geometry.of(preset(name))
    theta = np.random.default_rng(seed).uniform(-4, 4, geometry.n_castors)
    rate = castor_rates(geometry, theta, twist)
    motion = inverse(geometry, theta, rate, twist)
    np.testing.assert_allclose(motion.side_slip, 0.0, atol=1e-12)
    np.testing.assert_allclose(forward(geometry, theta, rate, motion.rate), twist, atol=1e-9)


@given(v=number, omega=number)
def test_a_differential_robot_is_the_textbook_one(v, omega):
    geometry = Geometry.of(preset("differential"))
    rates = inverse(geometry, [0.0], [0.0], [v, 0.0, omega]).rate
    np.testing.assert_allclose(rates, [(v - omega * 0.17) / 0.075, (v + omega * 0.17) / 0.075], atol=1e-12)
    np.testing.assert_allclose(forward(geometry, [0.0], [0.0], rates), [v, 0.0, omega], atol=1e-12)


@given(v=st.floats(0.1, 2), steer=st.floats(-1.2, 1.2))
def test_a_tricycle_turns_about_the_meeting_of_its_axles(v, steer):
    """Front wheel speed v at steering angle delta: v_x = v cos(delta), omega = v sin(delta) / wheelbase."""
    geometry = Geometry.of(preset("tricycle"))
    rates = np.array([v / 0.075, np.nan, np.nan])
    np.testing.assert_allclose(
        forward(geometry, [steer, 0.0], [0.0, 0.0], np.nan_to_num(rates)),
        [v * math.cos(steer), 0.0, v * math.sin(steer) / 0.5],
        atol=1e-12,
    )


@given(twist=twists)
def test_three_omni_wheels_are_the_textbook_ones(twist):
    """Wheel i at distance L and bearing a rolls at -sin(a) v_x + cos(a) v_y + L omega, and never minds side slip."""
    bearings = [0.0, 2 * math.pi / 3, 4 * math.pi / 3]
    castors = tuple(
        Castor(
            pivot=(0.2 * math.cos(a), 0.2 * math.sin(a)),
            steering="fixed",
            angle=a + math.pi / 2,
            wheels=(Wheel(radius=0.05, grip="omni"),),
        )
        for a in bearings
    )
    geometry = Geometry.of(RobotDescription(name="omni", castors=castors))
    rates = inverse(geometry, geometry.angle, np.zeros(3), twist).rate
    expected = [(-math.sin(a) * twist[0] + math.cos(a) * twist[1] + 0.2 * twist[2]) / 0.05 for a in bearings]
    np.testing.assert_allclose(rates, expected, atol=1e-12)
    np.testing.assert_allclose(forward(geometry, geometry.angle, np.zeros(3), rates), twist, atol=1e-12)


@given(twist=twists)
def test_four_mecanum_wheels_are_the_textbook_ones(twist):
    """Rollers at +-45 deg: r phi_dot = v_x -+ v_y -+ (a + b) omega."""
    places = [(0.3, 0.2, -1), (0.3, -0.2, 1), (-0.3, 0.2, 1), (-0.3, -0.2, -1)]
    castors = tuple(
        Castor(
            pivot=(x, y),
            steering="fixed",
            wheels=(Wheel(radius=0.05, grip="omni", roller_angle=sign * math.pi / 4),),
        )
        for x, y, sign in places
    )
    geometry = Geometry.of(RobotDescription(name="mecanum", castors=castors))
    rates = inverse(geometry, geometry.angle, np.zeros(4), twist).rate
    expected = [(twist[0] + sign * twist[1] - math.copysign(0.5, y) * twist[2]) / 0.05 for (x, y, sign) in places]
    np.testing.assert_allclose(rates, expected, atol=1e-12)


@given(seed=seeds)
def test_a_batch_of_robots_is_its_members(seed):
    random, robot = np.random.default_rng(seed), preset("asoc-prototype")
    robots = [
        dataclasses.replace(
            robot, castors=tuple(dataclasses.replace(c, offset=random.uniform(0.05, 0.1)) for c in robot.castors)
        )
        for _ in range(4)
    ]
    batch = Geometry.of(robots)
    theta, twist = random.uniform(-3, 3, (4, 3)), random.uniform(-1, 1, (4, 3))
    rate = castor_rates(batch, theta, twist)
    motion = inverse(batch, theta, rate, twist)
    twists = forward(batch, theta, rate, motion.rate)
    runs = inverse(batch.expand(1), theta[:, None], rate[:, None], twist[:, None])
    for k, member in enumerate(robots):
        geometry = Geometry.of(member)
        np.testing.assert_array_equal(rate[k], castor_rates(geometry, theta[k], twist[k]))
        np.testing.assert_array_equal(motion.rate[k], inverse(geometry, theta[k], rate[k], twist[k]).rate)
        np.testing.assert_allclose(twists[k], twist[k], atol=1e-10)
        np.testing.assert_array_equal(runs.rate[k, 0], motion.rate[k])


@given(name=st.sampled_from(preset_names()), twist=twists, seed=seeds)
def test_the_constraint_matrix_says_the_same_as_inverse(name, twist, seed):
    geometry, random = Geometry.of(preset(name)), np.random.default_rng(seed)
    theta, rate = random.uniform(-3, 3, (2, geometry.n_castors))
    a, b = constraint_matrix(geometry, theta)
    motion = inverse(geometry, theta, rate, twist)
    of_wheel = np.tile(geometry.wheel_castor, 2)
    rows = np.concatenate([motion.rate * geometry.radius, motion.side_slip])
    np.testing.assert_allclose(a @ twist + b * rate[of_wheel], rows, atol=1e-12)
    opposite, _ = constraint_matrix(geometry, theta + np.pi)  # half a turn on, what turns with castors is reversed
    np.testing.assert_allclose(a + opposite, 2 * np.multiply.outer(b, [0, 0, 1]), atol=1e-12)


@given(twist=twists)
def test_pivots_move_as_points_of_a_rigid_body(twist):
    geometry = Geometry.of(preset("6-castor"))
    u = pivot_velocity(geometry, twist)
    for i in range(6):
        for j in range(i):
            baseline = geometry.pivot[i] - geometry.pivot[j]
            assert np.dot(u[i] - u[j], baseline) == pytest.approx(0.0, abs=1e-12)


def test_robots_of_another_layout_do_not_make_a_batch():
    with pytest.raises(ValueError, match="agree"):
        Geometry.of([preset("asoc-prototype"), preset("differential")])
