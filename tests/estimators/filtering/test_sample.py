"""What a sample of the filter does: the laws of its measurements, and of what it is told at the start."""

import dataclasses
import math

import numpy as np
import pytest

from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Gyro
from castor_envs.vehicles.tolerances import Tolerances
from estimators import CalibratingFilter
from estimators.filtering.creep import ROWS
from estimators.filtering.sample import linearised, turn_off_mean
from estimators.robots import calibrating_filter
from estimators.steps.rolling_equations import NUMBERS, swivelled

PERIOD = 0.05


def test_a_start_that_is_not_exact_stays_so(exact_motion, winding):
    """The covariance of the start, carried along the way, is all by which that of the pose differs."""
    robot, start = preset("asoc-prototype"), np.array([1.0, 2.0, 0.7])
    _, observations = exact_motion(robot, winding, 2.0).sampled(40)
    of_start = np.diag([1e-4, 4e-4, 9e-4]) + 1e-4
    exact, told = CalibratingFilter(), CalibratingFilter()
    exact.reset(robot, start)
    told.reset(robot, start, covariance=of_start)
    np.testing.assert_allclose(told.covariance, of_start, rtol=1e-12)
    for observation in observations:
        np.testing.assert_allclose(told.update(observation), exact.update(observation), atol=1e-12)
    x, y, _ = exact.pose - start
    carried = np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(told.covariance - exact.covariance, carried @ of_start @ carried.T, rtol=2e-3)


def test_a_heading_by_a_gyro_is_off_by_the_noise_of_all_readings():
    """The trapezoid rule takes both end readings by half and all others whole. Wheels of which nothing is known tell
    nothing of the turn."""
    noise, samples, standard = 0.02, 100, preset("differential")
    gyro = Gyro(noise=noise, bias_tolerance=0.0)
    told = dataclasses.replace(standard, gyro=gyro, tolerances=Tolerances(radius=0.3, lateral=0.3))
    estimator = CalibratingFilter()
    estimator.reset(told, np.zeros(3))
    for k in range(samples + 1):
        counts = np.full(2, 100.0 * (k > 0))
        estimator.update({"wheel": counts, "time": np.array([PERIOD * k]), "gyro": np.zeros(1)})
    expected = (PERIOD * noise) ** 2 * (samples - 0.5)
    assert estimator.covariance[2, 2] == pytest.approx(expected, rel=0.05)


def test_a_wheel_that_slips_stays_released_while_it_contradicts(exact_motion):
    """It begins to slip by a lot and goes on by little; by so little alone it would not be released. A count and a half
    is enough beside a castor whose reading stays: it does not swivel by that."""
    robot = preset("asoc-prototype")
    true, observations = exact_motion(robot, lambda t: (0.3, 0.0, 0.0), 5.0).sampled(100)

    def released(slips):
        estimator = CalibratingFilter()
        estimator.reset(robot, true[0])
        for k, observation in enumerate(observations):
            counts = slips.get(k, 0.0)
            estimator.update({**observation, "wheel": observation["wheel"] + counts * (np.arange(6) == 0)})
            if k == 61:
                return estimator.released[0, 0]
        raise AssertionError

    assert released({61: 1.5})
    assert not released({61: 1.0})
    assert released({60: 10.0, 61: 1.0})


def test_the_turning_rate_at_the_end_where_steering_turns():
    """Of a tricycle whose steering turns from delta - s to delta + s while its front wheel rolls evenly: the rate is v
    sin(steering) / base."""
    robot = preset("tricycle")
    delta, swivel, way, base = 0.5, 0.04, 0.02, 0.5
    estimator = CalibratingFilter()
    estimator.reset(robot, np.zeros(3))
    castors, carried, wheels, rows = (part.reshape(1, -1).view(np.recarray) for part in estimator._stack.parts[:4])
    size, at = estimator._stack.parts[calibrating_filter.STATE].shape[-1], estimator._at.radius.start
    m, turn = rows.shape[1], robot.castors[0].pivot_counts_per_rev or 0.0
    for angle in (delta - swivel / 2, delta + swivel / 2):
        swivelled(castors, 0, np.array([[angle / (2 * math.pi) * turn]]), 0.5)
    counts = np.array([[way / wheels["radius"][0, 0] / wheels["count"][0, 0]]])
    found, carry, moves = np.zeros((ROWS, m)), np.zeros((size, at)), np.zeros((3, size))
    equations = np.zeros((1, m, NUMBERS))
    linearised(castors, carried, wheels, rows, 0, counts, np.zeros(size), at, False, equations, found, carry, moves)
    off = turn_off_mean(castors, rows, 0, found, 3 + carried.shape[1], moves, np.zeros((4, 3)))
    expected = way / base * (math.sin(delta + swivel / 2) - math.sin(delta))
    assert off == pytest.approx(expected, rel=0.05)
