"""From strain to posture: exact where the curvature is a polynomial, wrong by 1 to 3 cm at the defaults."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from castor_envs.effects.train import DeadGauge, GaugeDrift, GaugeGain, GaugeNoise, SensorStops
from castor_envs.physics.beam import chain_pose
from castor_envs.sensors.posture import PostureSensors, curvature_at_gauges, posture
from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.train import Frame

LENGTH = 0.35
FRAME = Frame(length=LENGTH)
NUMBER_OF_LINKS = FRAME.links
QUIET = {"gauge_noise": 0.0, "gauge_offset": 0.0}
angles = st.floats(-math.pi / 2, math.pi / 2)


def quiet_train(n=3, **changes):
    train = cfmmr(n)
    return dataclasses.replace(
        train, frames=tuple(dataclasses.replace(frame, **(QUIET | changes)) for frame in train.frames)
    )


def readings(train, joint_angles, times, seed=0):
    """Relative poses (times, F, 3) and ages (times, F) that sensors give for joint angles (links,) of each frame."""
    sensors = PostureSensors(train.as_built(), np.random.default_rng(seed))
    poses, ages = zip(*(sensors.read(joint_angles, time) for time in times), strict=True)
    return np.array(poses), np.array(ages)


def even(*bends):
    return [np.full(NUMBER_OF_LINKS, bend / NUMBER_OF_LINKS) for bend in bends]


def arc(bend, length=LENGTH):
    """Chord 2 R sin(L / 2 R), halfway turned."""
    chord = length * np.sinc(bend / (2 * math.pi))
    return np.array([chord * math.cos(bend / 2), chord * math.sin(bend / 2), bend])


GAUGES = [None, (0.02,), (0.1, 0.3), (0.0, 0.2, 0.35), (0.01, 0.05, 0.3, 0.31, 0.34)]


@pytest.mark.parametrize("gauges", GAUGES)
@given(bend=angles)
def test_an_arc_is_seen_as_it_is_by_any_gauges(gauges, bend):
    frame = dataclasses.replace(FRAME, gauges=gauges)
    curvature = np.full(len(frame.gauge_positions), bend / LENGTH)
    np.testing.assert_allclose(posture(frame, curvature), arc(bend), atol=1e-10)


def beam(curvature):
    """Pose of the front end for a curvature (1/m) along s, by scipy."""

    def along(s, u):
        return math.cos(u[2]), math.sin(u[2]), curvature(s)

    return solve_ivp(along, (0, LENGTH), np.zeros(3), rtol=1e-10, atol=1e-12).y[:, -1]


@pytest.mark.parametrize(("gauges", "degree"), [(None, 2), ((0.0, 0.2, 0.35), 2), ((0.1, 0.3), 1), ((0.02,), 0)])
@given(data=st.data())
def test_curvature_that_is_a_polynomial_is_integrated_exactly(gauges, degree, data):
    """Up to degree 2, or one less than there are gauges; turning by up to some 100 deg."""
    frame = dataclasses.replace(FRAME, gauges=gauges)
    coefficients = [data.draw(st.floats(-2, 2)) / LENGTH ** (k + 1) for k in range(degree + 1)]

    def curvature(s):
        return sum(c * s**k for k, c in enumerate(coefficients)) * 0.4

    seen = posture(frame, [curvature(s) for s in frame.gauge_positions])
    np.testing.assert_allclose(seen, beam(curvature), atol=1e-8)
    assert seen[2] == pytest.approx(quad(curvature, 0, LENGTH)[0], abs=1e-9)


def test_many_readings_at_once_are_those_of_each():
    random = np.random.default_rng(0)
    curvature = random.normal(size=(5, 2, 4))
    together = posture(FRAME, curvature)
    assert together.shape == (5, 2, 3)
    for i, j in np.ndindex(5, 2):
        np.testing.assert_allclose(together[i, j], posture(FRAME, curvature[i, j]), atol=1e-14)


@given(start=st.floats(-3, 3), end=st.floats(-3, 3), links=st.integers(3, 24))
def test_gauges_read_curvature_that_runs_linearly_along_the_frame(start, end, links):
    """As a beam's does under end loads; the joints stand for the middles of its pieces."""
    frame = Frame(length=LENGTH, links=links, gauges=(0.0, 0.01, 0.12, 0.2, 0.349, 0.35))
    middles = (np.arange(links) + 0.5) / links
    bent = (start + (end - start) * middles) * LENGTH / links
    expected = start + (end - start) * np.array(frame.gauges) / LENGTH
    np.testing.assert_allclose(curvature_at_gauges(frame, bent), expected, atol=1e-12)


@given(start=st.floats(-2.5, 2.5), end=st.floats(-2.5, 2.5))
def test_a_sound_sensor_sees_the_pose_of_the_chain_within_two_millimetres(start, end):
    """What links and polynomial add to the error, far below that of the gauges."""
    middles = (np.arange(NUMBER_OF_LINKS) + 0.5) / NUMBER_OF_LINKS
    bent = (start + (end - start) * middles) * LENGTH / NUMBER_OF_LINKS
    seen, true = posture(FRAME, curvature_at_gauges(FRAME, bent)), chain_pose(FRAME, bent)
    assert math.dist(seen[:2], true[:2]) < 2e-3
    assert seen[2] == pytest.approx(true[2], abs=1e-9)


def test_at_its_defaults_a_sensor_is_accurate_to_one_to_three_centimetres():
    """As Vogt and Minor say of theirs; over random bends of up to 60 deg, offsets drawn anew for each."""
    random, errors, headings = np.random.default_rng(3), [], []
    for _ in range(400):
        bend = math.radians(random.uniform(-60, 60))
        sensors = PostureSensors(cfmmr(2), random)
        seen, _ = sensors.read(even(bend), 0.0)
        errors.append(math.dist(seen[0, :2], arc(bend)[:2]))
        headings.append(abs(seen[0, 2] - bend))
    assert 0.01 < np.mean(errors) < 0.03
    assert 0.01 < np.sqrt(np.mean(np.square(errors))) < 0.03
    assert np.mean(np.array(errors) < 0.06) > 0.97
    assert np.degrees(np.mean(headings)) < 6.0


def test_without_noise_and_offset_the_sensor_tells_the_truth():
    poses, ages = readings(quiet_train(), even(0.7, -0.3), [0.0, 0.05, 10.0])
    np.testing.assert_allclose(poses, np.broadcast_to([arc(0.7), arc(-0.3)], (3, 2, 3)), atol=1e-10)
    np.testing.assert_array_equal(ages, 0.0)


def heading_spread(gauges=None):
    """How much a unit of noise on each gauge alone changes the heading, by fitting it with numpy's own polyfit."""
    places = np.array(FRAME.gauge_positions if gauges is None else gauges)
    turned = []
    for k in range(len(places)):
        fit = np.polyfit(places, np.eye(len(places))[k], 2)
        turned.append(np.polyval(np.polyint(fit), LENGTH))
    return float(np.linalg.norm(turned))


def test_noise_is_white_and_offsets_are_constant_of_the_size_described():
    noisy = readings(quiet_train(2, gauge_noise=0.1), even(0.3), np.arange(4000) * 0.05)[0][:, 0, 2]
    assert np.std(noisy) == pytest.approx(0.1 * heading_spread(), rel=0.06)
    assert np.mean(noisy) == pytest.approx(0.3, abs=4 * 0.1 * heading_spread() / math.sqrt(4000))
    assert abs(np.corrcoef(noisy[1:], noisy[:-1])[0, 1]) < 0.06
    train = quiet_train(2, gauge_offset=0.5)
    starts = [readings(train, even(0.3), [0.0, 5.0], seed)[0][:, 0, 2] for seed in range(1500)]
    assert np.ptp(starts, axis=1).max() == 0.0
    assert np.std(starts) == pytest.approx(0.5 * heading_spread(), rel=0.1)
    assert np.mean(starts) == pytest.approx(0.3, abs=4 * 0.5 * heading_spread() / math.sqrt(1500))


def test_sensors_of_a_train_err_independently():
    headings = readings(quiet_train(3, gauge_noise=0.2), even(0.0, 0.0), np.arange(3000) * 0.05)[0][..., 2]
    assert abs(np.corrcoef(headings.T)[0, 1]) < 0.08


def test_the_noise_effect_adds_in_the_sum_of_squares():
    train = quiet_train(3, gauge_noise=0.3).with_effects(GaugeNoise(frame=2, value=0.4))
    noisy = readings(train, even(0.1, 0.1), np.arange(4000) * 0.05)[0][..., 2]
    np.testing.assert_allclose(np.std(noisy, axis=0), np.array([0.3, 0.5]) * heading_spread(), rtol=0.06)


@given(bend=angles, gain=st.floats(-0.5, 0.5))
def test_a_gain_error_of_all_gauges_shows_an_arc_as_a_sharper_one(bend, gain):
    train = quiet_train(3).with_effects(GaugeGain(frame=2, value=gain))
    poses, _ = readings(train, even(bend, bend), [0.0])
    np.testing.assert_allclose(poses[0], [arc(bend), arc(bend * (1 + gain))], atol=1e-9)


def test_a_gain_error_of_one_gauge_is_its_alone_and_gains_multiply():
    effects = GaugeGain(frame=1, gauge=3, value=0.2), GaugeGain(frame=1, value=0.1)
    poses, _ = readings(quiet_train(2).with_effects(*effects), even(0.8), [0.0])
    curvature = 0.8 / LENGTH * np.array([1.1, 1.1, 1.32, 1.1])
    fit = np.polyfit(FRAME.gauge_positions, curvature, 2)
    np.testing.assert_allclose(poses[0, 0], beam(lambda s: np.polyval(fit, s)), atol=1e-8)


@given(drift=st.floats(-0.1, 0.1), time=st.floats(0, 10))
def test_drift_bends_the_picture_by_drift_times_time_times_length(drift, time):
    train = quiet_train(3).with_effects(GaugeDrift(frame=1, value=drift))
    poses, _ = readings(train, even(0.3, 0.3), [time])
    np.testing.assert_allclose(poses[0], [arc(0.3 + drift * time * LENGTH), arc(0.3)], atol=1e-7)


@pytest.mark.parametrize("gauge", [1, 2, 3, 4])
def test_a_dead_gauge_reads_zero_whatever_the_others_disturb(gauge):
    train = quiet_train(2, gauge_gains=(1.0, 1.2, 1.0, 0.9), gauge_drift=0.05)
    train = train.with_effects(DeadGauge(frame=1, gauge=gauge))
    poses, _ = readings(train, even(0.9), [4.0])
    curvature = 0.9 / LENGTH * np.array([1.0, 1.2, 1.0, 0.9]) + 0.2
    curvature[gauge - 1] = 0.0
    fit = np.polyfit(FRAME.gauge_positions, curvature, 2)
    np.testing.assert_allclose(poses[0, 0], beam(lambda s: np.polyval(fit, s)), atol=1e-8)


def test_with_all_gauges_dead_a_frame_looks_straight():
    effects = [DeadGauge(frame=1, gauge=k) for k in (1, 2, 3, 4)]
    poses, ages = readings(cfmmr(2).with_effects(*effects), even(0.9), [0.0, 1.0])
    np.testing.assert_allclose(poses[:, 0], np.broadcast_to([LENGTH, 0, 0], (2, 3)), atol=1e-12)
    np.testing.assert_array_equal(ages, 0.0)


def test_a_sensor_that_stops_repeats_its_last_reading_and_its_age_grows():
    sensors = PostureSensors(
        cfmmr(3).with_effects(SensorStops(frame=2, value=0.12)).as_built(), np.random.default_rng(0)
    )
    seen = [sensors.read(even(0.1 * k, 0.1 * k), 0.05 * k) for k in range(8)]
    poses, ages = np.array([pose for pose, _ in seen]), np.array([age for _, age in seen])
    np.testing.assert_allclose(ages[:, 0], 0.0)
    np.testing.assert_allclose(ages[:, 1], [0, 0, 0, 0.05, 0.10, 0.15, 0.20, 0.25], atol=1e-12)
    np.testing.assert_array_equal(poses[3:, 1], np.broadcast_to(poses[2, 1], (5, 3)))
    assert np.all(np.diff(poses[:, 0], axis=0).any(axis=1))
    assert np.all(np.diff(poses[:3, 1], axis=0).any(axis=1))


def test_a_sensor_that_stops_at_once_has_one_reading():
    poses, ages = readings(quiet_train(2, rps_stops=0.0), even(0.4), [0.0, 0.05, 3.0])
    np.testing.assert_allclose(poses[:, 0], np.broadcast_to(arc(0.4), (3, 3)), atol=1e-10)
    np.testing.assert_allclose(ages[:, 0], [0.0, 0.05, 3.0])


def test_what_is_read_is_not_changed_by_later_readings():
    sensors = PostureSensors(cfmmr(2), np.random.default_rng(0))
    first, _ = sensors.read(even(0.4), 0.0)
    kept = first.copy()
    sensors.read(even(-0.4), 0.05)
    np.testing.assert_array_equal(first, kept)


NOTHING = [
    GaugeNoise(frame=1, value=0.0),
    GaugeGain(frame=1, value=0.0),
    GaugeGain(frame=2, gauge=2, value=0.0),
    GaugeDrift(frame=2, value=0.0),
    SensorStops(frame=1, value=100.0),
]


@pytest.mark.parametrize("effect", NOTHING, ids=lambda effect: effect.name)
def test_an_effect_of_no_size_changes_no_reading(effect):
    times = np.arange(20) * 0.05
    plain, effected = (
        readings(train, even(0.4, -0.2), times)[0] for train in (cfmmr(3), cfmmr(3).with_effects(effect))
    )
    np.testing.assert_array_equal(effected, plain)


@pytest.mark.parametrize(
    "effect",
    [
        GaugeNoise(frame=1, value=0.2),
        GaugeGain(frame=1, value=0.1),
        GaugeGain(frame=1, gauge=2, value=-0.1),
        GaugeDrift(frame=1, value=0.02),
        DeadGauge(frame=1, gauge=3),
        SensorStops(frame=1, value=0.3),
    ],
    ids=lambda effect: effect.name,
)
def test_an_effect_changes_its_own_frame_s_readings_alone(effect):
    times = np.arange(20) * 0.05
    plain, effected = (
        readings(train, even(0.4, -0.2), times)[0] for train in (cfmmr(3), cfmmr(3).with_effects(effect))
    )
    assert np.abs(effected[:, 0] - plain[:, 0]).max() > 1e-3
    np.testing.assert_array_equal(effected[:, 1], plain[:, 1])


def test_the_same_seed_gives_the_same_readings_and_another_one_others():
    times = np.arange(20) * 0.05
    first, again, other_seed = (readings(cfmmr(3), even(0.4, -0.2), times, seed)[0] for seed in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other_seed).min(axis=(0, 1)).min() > 0.0
