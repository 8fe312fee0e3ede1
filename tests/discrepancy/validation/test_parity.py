"""The parity residual vanishes for true rolling, is what rounding makes it, and points at the castor that is wrong."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from castor_envs.effects.dimensions import PivotBias, WheelRadius
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry, castor_rates, inverse, pivot_velocity
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel
from discrepancy.validation.parity import Parity


def twist(t):
    """A smooth motion that keeps moving and turns both ways: v_x, v_y, omega in B."""
    return np.stack([0.25 + 0.05 * np.sin(t), 0.1 * np.cos(0.7 * t), 0.3 * np.sin(1.3 * t + 0.4)], axis=-1)


def rolled_log(robot, period=0.05, duration=8.0, rounded=True, wrapped=False):
    """What a robot's encoders count on that motion, rolling perfectly."""
    geometry = Geometry.of(robot)
    n = geometry.n_castors

    def pointing(t):
        """Castors without offset stand along their pivot's velocity; theirs is no differential equation."""
        u = pivot_velocity(geometry, twist(t))
        return np.arctan2(u[..., 1], u[..., 0])

    def castors(t, state):
        return np.where(geometry.fixed | (geometry.offset > 0), state[:n], pointing(t))

    def rates(t, state):
        angle = castors(t, state)
        turning = np.nan_to_num(castor_rates(geometry, angle, twist(t)))
        return np.concatenate([turning, inverse(geometry, angle, turning, twist(t)).rate])

    t = period * np.arange(round(duration / period) + 1)
    start = np.concatenate([np.where(geometry.fixed, geometry.angle, pointing(0.0)), np.zeros(len(robot.wheels))])
    state = solve_ivp(rates, (0, t[-1]), start, method="DOP853", t_eval=t, rtol=1e-11, atol=1e-11).y.T
    angle = np.unwrap([castors(*sample) for sample in zip(t, state, strict=True)], axis=0)
    wheel = state[:, n:] * geometry.counts_per_rev / (2 * np.pi)
    pivot = (angle + geometry.pivot_zero) * geometry.pivot_counts_per_rev / (2 * np.pi)
    wheel, pivot = wheel[:, robot.driven_wheels], pivot[:, robot.pivot_encoders]
    if rounded:
        wheel, pivot = np.round(wheel), np.round(pivot)
    if wrapped:
        pivot = np.mod(pivot, geometry.pivot_counts_per_rev[list(robot.pivot_encoders)])
    return Log(t=t, wheel=wheel, pivot=pivot)


def rolling(parity, values):
    """The values of wheels' rolling alone."""
    return values[..., : len(parity.rows.wheels)]


def side_slip(parity, values):
    """The values of castors' side slip alone."""
    return values[..., len(parity.rows.wheels) :]


def mecanum():
    corners = [(0.2, 0.2, -1), (-0.2, 0.2, 1), (-0.2, -0.2, -1), (0.2, -0.2, 1)]
    castors = tuple(
        Castor(pivot=(x, y), steering="fixed", wheels=(Wheel(radius=0.05, grip="omni", roller_angle=s * np.pi / 4),))
        for x, y, s in corners
    )
    return RobotDescription(name="mecanum", castors=castors)


REDUNDANT = {"2-castor": 3, "asoc-prototype": 6, "6-castor": 15, "omnimate": 3, "powered-caster": 5, "swerve": 5}


@pytest.mark.parametrize("name", REDUNDANT)
def test_an_n_castor_base_has_as_many_contradictions_as_rows_beyond_three(name):
    robot = preset(name)
    assert Parity(robot, rolled_log(robot, duration=1.0)).redundancy == REDUNDANT[name]


def test_omni_wheels_give_no_side_slip_rows():
    parity = Parity(mecanum(), rolled_log(mecanum(), duration=1.0, rounded=False))
    assert parity.redundancy == 1
    assert parity.rows.castors.size == 0
    assert np.abs(rolling(parity, parity.residual)).max() < 1e-9


@pytest.mark.parametrize("name", ["differential", "tricycle", "1-castor"])
def test_robots_without_redundancy_leave_nothing_to_see(name):
    robot = preset(name)
    log = rolled_log(preset("1-castor")) if name == "1-castor" else crawling(robot)
    parity = Parity(robot, log)
    assert parity.redundancy == 0
    assert np.abs(parity.residual).max() < 1e-12


def crawling(robot, n=50):
    """Counts that no robot need have made: without redundancy any counts agree."""
    random = np.random.default_rng(5)
    wheel = random.integers(0, 90, size=(n, len(robot.driven_wheels))).cumsum(axis=0)
    pivot = random.integers(-20, 20, size=(n, len(robot.pivot_encoders))).cumsum(axis=0)
    return Log(t=np.arange(n) * 0.05, wheel=wheel, pivot=pivot)


@pytest.mark.parametrize("name", ["asoc-prototype", "omnimate", "powered-caster", "swerve"])
def test_the_residual_of_perfect_rolling_shrinks_with_the_cube_of_the_period(name):
    robot = preset(name)
    largest = []
    for period in (0.025, 0.0125, 0.00625):
        parity = Parity(robot, rolled_log(robot, period, duration=3.0, rounded=False))
        largest.append(np.abs(parity.residual).max())
    assert largest[0] < 5e-5
    assert largest[0] / largest[1] > 6.5
    assert largest[1] / largest[2] > 6.5


@pytest.mark.parametrize("name", ["asoc-prototype", "2-castor", "powered-caster"])
def test_rounded_counts_leave_the_predicted_variance(name):
    robot = preset(name)
    parity = Parity(robot, rolled_log(robot, duration=30.0))
    assert parity.moving.mean() > 0.99
    np.testing.assert_allclose(rolling(parity, parity.rms), rolling(parity, parity.rounding), rtol=0.2)
    np.testing.assert_allclose(side_slip(parity, parity.rms), side_slip(parity, parity.rounding), rtol=0.35)


def test_coarser_encoders_leave_more_in_proportion():
    fine = preset("asoc-prototype")
    wheels = [tuple(dataclasses.replace(w, counts_per_rev=300.0) for w in castor.wheels) for castor in fine.castors]
    coarse = dataclasses.replace(
        fine,
        castors=tuple(
            dataclasses.replace(castor, wheels=w, pivot_counts_per_rev=1286)
            for castor, w in zip(fine.castors, wheels, strict=True)
        ),
    )
    a, b = (Parity(robot, rolled_log(robot)) for robot in (fine, coarse))
    np.testing.assert_allclose(rolling(b, b.rounding), 4 * rolling(a, a.rounding), rtol=1e-3)


@pytest.mark.parametrize("castor", [1, 2, 3])
@pytest.mark.parametrize("wheel", [1, 2])
def test_a_wrong_wheel_radius_shows_on_that_wheel(castor, wheel):
    described = preset("asoc-prototype")
    real = described.with_effects(WheelRadius(castor=castor, wheel=wheel, value=0.02)).as_built()
    parity = Parity(described, rolled_log(real))
    ratio = rolling(parity, parity.rms) / rolling(parity, parity.rounding)
    assert np.argmax(ratio) == 2 * (castor - 1) + wheel - 1
    assert ratio.max() > 2


@pytest.mark.parametrize("castor", [1, 2, 3])
def test_a_biased_pivot_shows_on_that_castor(castor):
    described = preset("asoc-prototype")
    real = described.with_effects(PivotBias(castor=castor, value=0.05)).as_built()
    parity = Parity(described, rolled_log(real))
    ratio = side_slip(parity, parity.rms) / side_slip(parity, parity.rounding)
    assert np.argmax(ratio) == castor - 1
    assert ratio.max() > 3


def test_wrapping_of_pivot_counts_changes_nothing():
    robot = preset("asoc-prototype")
    a, b = (Parity(robot, rolled_log(robot, duration=3.0, wrapped=wrapped)) for wrapped in (False, True))
    np.testing.assert_allclose(a.residual, b.residual, atol=1e-14)


def test_a_robot_at_rest_has_no_residual():
    robot = preset("asoc-prototype")
    log = Log(t=np.arange(5) * 0.05, wheel=np.full((5, 6), 7.0), pivot=np.full((5, 3), 100.0))
    parity = Parity(robot, log)
    assert not parity.moving.any()
    assert not parity.rms.any()
    assert not parity.rounding.any()


def test_a_castor_whose_angle_is_unknown_is_left_out():
    robot = preset("asoc-prototype")
    blind = dataclasses.replace(robot.castors[1], pivot_counts_per_rev=None)
    blinded = dataclasses.replace(robot, castors=(robot.castors[0], blind, robot.castors[2]))
    log = rolled_log(robot, duration=2.0, rounded=False)
    parity = Parity(blinded, dataclasses.replace(log, pivot=log.pivot[:, [0, 2]]))
    assert parity.redundancy == 3
    np.testing.assert_array_equal(parity.rows.wheels, [0, 1, 4, 5])
    np.testing.assert_array_equal(parity.rows.castors, [0, 2])
    assert np.abs(rolling(parity, parity.residual)).max() < 5e-5
