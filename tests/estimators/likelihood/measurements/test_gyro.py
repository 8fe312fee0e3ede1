"""A gyro in the likelihood: what it tells of a robot whose encoders cannot contradict each other, without a reference.

A differential robot turns by (right - left roll) / track, so a gyro tells the ratio of radius and track.
"""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from castor_envs.errors import Declined, InputError
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import Leg, Run, Trajectory
from castor_envs.sensors.gyro import GyroSensor
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Gyro
from estimators.calibration.drives import Poses, logged
from estimators.calibration.maximum_likelihood.calibrate import calibrate
from estimators.likelihood.log_likelihood import Noise
from estimators.likelihood.measurements.gyro import GyroRates

SIGMA, WIDER = 2e-3, 0.02
KNOWN = Noise(along=1e-5, across=1e-5, gyro=SIGMA)


def differential(gyro=None, wider=0.0):
    """Return a robot with fine encoders, whose rounding hides nothing; `wider`: by which part its track is."""
    robot = preset("differential")
    first, *others = robot.castors
    wheels = tuple(
        dataclasses.replace(wheel, counts_per_rev=1e6, lateral=(1 + wider) * wheel.lateral) for wheel in first.wheels
    )
    return dataclasses.replace(robot, castors=(dataclasses.replace(first, wheels=wheels), *others), gyro=gyro)


TURNS = Trajectory("turns", tuple(Run((Leg((0.3, 0.0, way), 0.8),), 0.1, 0.4) for way in (1.0, -0.5, 0.0, 0.8, -1.0)))
"""Bends whose rates change slowly, so that a sample's mean rate is that of its ends."""

ROLLED = roll(differential(wider=WIDER), TURNS)
RATE = TURNS.at(ROLLED.t)[1][:, 2]


def log_of(seed=0, poses: Poses = "none", **gyro):
    """Return a log of the robot with the wider track, and a gyro of such bias and walk."""
    log = logged(differential(wider=WIDER), ROLLED, poses)
    sensor = GyroSensor(Gyro(noise=SIGMA, **gyro), 1.0, np.random.default_rng(seed))
    return dataclasses.replace(log, gyro=sensor.readings(log.t, RATE))


def track_over_radius(found):
    """Return the logarithm of the ratio of track to mean radius, over that in the robot file, and its standard
    error."""
    at = {(p.kind, p.wheel): k for k, p in enumerate(found.parameters)}
    signs = np.zeros((2, len(at)))
    for wheel, sign in ((0, 1.0), (1, -1.0)):
        signs[0, at["lateral", wheel]], signs[1, at["radius", wheel]] = sign, 1.0
    track, radius = signs @ found.after
    before = signs @ found.before
    slope = signs[0] / track - signs[1] / radius
    return np.log(track / radius * before[1] / before[0]), np.sqrt(slope @ found.covariance @ slope)


def test_the_track_is_as_certain_as_the_gyros_noise_and_the_turn_allow():
    """By least squares of the rate beside a bias and a latency; nothing of the code under test is used."""
    regressors = np.column_stack([RATE, np.ones(len(RATE)), np.gradient(RATE, ROLLED.t)])
    expected = SIGMA * np.sqrt(np.linalg.inv(regressors.T @ regressors)[0, 0])
    _, error = track_over_radius(calibrate(differential(Gyro(noise=SIGMA)), [log_of()], noise=KNOWN))
    assert error == pytest.approx(expected, rel=0.05)


def test_without_the_gyro_nothing_is_known():
    with pytest.raises(Declined, match="without reference poses"):
        calibrate(differential(), [log_of()])


def test_estimates_scatter_as_they_say():
    robot = differential(Gyro(noise=SIGMA))
    found = [track_over_radius(calibrate(robot, [log_of(seed)])) for seed in range(8)]
    pulls = [(value - np.log1p(WIDER)) / error for value, error in found]
    low, high = chi2.ppf([1e-3, 1 - 1e-3], len(pulls))
    assert low < np.sum(np.square(pulls)) < high


def test_a_bias_changes_nothing():
    robot = differential(Gyro(noise=SIGMA))
    plain, biased = (calibrate(robot, [log_of(bias=bias)], noise=KNOWN) for bias in (0.0, 0.05))
    (value, error), (of_biased, _) = track_over_radius(plain), track_over_radius(biased)
    assert of_biased == pytest.approx(value, abs=0.01 * error)
    assert biased.gyro[0, 0] - plain.gyro[0, 0] == pytest.approx(0.05, rel=0.01)
    told = track_over_radius(calibrate(differential(Gyro(noise=SIGMA, bias=0.05)), [log_of(bias=0.05)], noise=KNOWN))
    assert told[0] == pytest.approx(value, abs=0.01 * error)


def test_a_gyro_that_tells_nothing_is_like_none():
    log = log_of(poses="all")
    without = dataclasses.replace(log, gyro=None)
    robot = differential(Gyro(noise=SIGMA))
    noisy = calibrate(robot, [log], noise=dataclasses.replace(KNOWN, gyro=1e9))
    plain = calibrate(differential(), [without], noise=KNOWN)
    assert noisy.after == pytest.approx(plain.after, rel=1e-9)
    assert noisy.covariance == pytest.approx(plain.covariance, rel=1e-6, abs=1e-14)
    for other in (
        calibrate(differential(), [log], noise=KNOWN),
        calibrate(robot, [without], noise=KNOWN),
        calibrate(robot, [dataclasses.replace(log, gyro=np.full(len(log), np.nan))], noise=KNOWN),
    ):
        assert np.array_equal(other.after, plain.after)
        assert np.array_equal(other.covariance, plain.covariance)


def test_readings_that_are_missing_tell_nothing():
    robot, log = differential(Gyro(noise=SIGMA)), log_of()
    assert log.gyro is not None
    half = np.arange(len(log)) < len(log) // 2
    cut = dataclasses.replace(log, gyro=np.where(half, log.gyro, np.nan))
    told, of_cut = (track_over_radius(calibrate(robot, [one], noise=KNOWN)) for one in (log, cut))
    turned = [np.sum(part**2) - np.sum(part) ** 2 / len(part) for part in (RATE, RATE[half])]
    assert of_cut[1] / told[1] == pytest.approx(np.sqrt(turned[0] / turned[1]), rel=0.05)


def test_logs_with_and_without_a_gyro_are_fitted_together():
    robot, log = differential(Gyro(noise=SIGMA)), log_of()
    alone = calibrate(robot, [log], noise=KNOWN)
    both = calibrate(robot, [log, dataclasses.replace(log, gyro=None)], noise=KNOWN)
    assert track_over_radius(both) == pytest.approx(track_over_radius(alone), rel=1e-3)
    assert np.isnan(both.gyro).tolist() == [[False, False], [True, True]]


def test_the_track_is_no_more_certain_than_the_scale_of_the_gyro():
    tolerance, logs = 5e-3, [log_of(seed) for seed in range(2)]
    exact, scaled = (
        track_over_radius(calibrate(differential(Gyro(noise=SIGMA, scale_tolerance=part)), logs, noise=KNOWN))
        for part in (0.0, tolerance)
    )
    assert scaled[1] == pytest.approx(np.hypot(exact[1], tolerance), rel=0.01)


def test_a_bias_that_walks_costs_certainty_and_the_intervals_say_so():
    walk = 1e-3
    robot, plain = differential(Gyro(noise=SIGMA, bias_walk=walk)), differential(Gyro(noise=SIGMA))
    still = differential(Gyro(noise=SIGMA, bias_walk=1e-9))
    logs = [log_of(seed, bias_walk=walk) for seed in range(5)]
    found = [track_over_radius(calibrate(robot, [log], noise=KNOWN)) for log in logs]
    assert np.sum([((value - np.log1p(WIDER)) / error) ** 2 for value, error in found]) < chi2.ppf(1 - 1e-3, len(logs))
    of_plain = track_over_radius(calibrate(plain, logs[:1], noise=KNOWN))
    assert found[0][1] > 1.2 * of_plain[1]
    assert track_over_radius(calibrate(still, logs[:1], noise=KNOWN)) == pytest.approx(of_plain, rel=1e-4)


@pytest.mark.parametrize("factor", [-1.0, np.degrees(1.0)])
def test_a_wrong_sign_or_unit_is_said(factor):
    log = log_of()
    with pytest.raises(InputError, match=r"gyro_z (turns against the wheels|is in deg/s)"):
        calibrate(differential(Gyro(noise=SIGMA)), [dataclasses.replace(log, gyro=factor * log.gyro)])


def test_derivatives_are_those_of_finite_differences():
    random = np.random.default_rng(1)
    log = log_of(bias_walk=1e-4)
    rates = GyroRates(Geometry.of(differential(Gyro(noise=SIGMA, bias_walk=1e-4))), log)
    rates.scale = 0.1
    state = np.column_stack([ROLLED.pose + 0.01 * random.normal(size=ROLLED.pose.shape), log.wheel])
    weights, own = rates.weights(SIGMA), 0.01 * random.normal(size=len(rates.prior.deviation))

    def values(state, own, scale=0.1):
        rates.scale = scale
        return weights * rates.off(state, own)

    rows = rates.rows(state, weights, values(state, own), np.array([0.5]), 3)
    every = slice(0, len(rates.steps))
    change = random.normal(size=state.shape)
    by_state = rows.by_state(every, change[..., None])[..., 0]
    assert by_state == pytest.approx(values(state + change, own) - values(state, own), abs=1e-6 * abs(by_state).max())
    assert rows.numbers is not None
    by_numbers = rows.numbers(every)
    assert not by_numbers[..., 1:4].any()
    by_scale = values(state, own, 0.1 + 0.5) - values(state, own)
    assert by_numbers[..., 0] == pytest.approx(by_scale, abs=1e-9 * abs(by_scale).max())
    for k in range(len(own)):
        by_own = values(state, own + np.eye(len(own))[k]) - values(state, own)
        assert by_numbers[..., 4 + k] == pytest.approx(by_own, abs=1e-9 * max(abs(by_own).max(), 1.0))
