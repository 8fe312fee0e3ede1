"""z: closed forms, invariances, and that whitening makes declared noise white."""

import dataclasses
import math

import numpy as np
import pytest

from castor_envs.effects.catalogue import catalogue
from castor_envs.effects.clocks import ClockOffset, SampleJitter
from castor_envs.effects.dimensions import LoadRadius, PivotBias
from castor_envs.effects.encoders import WheelEccentricity
from castor_envs.effects.reference import ReferenceLeverX, ReferenceYaw
from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry, constraint_matrix
from castor_envs.motion.mobility import moves_sideways
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset, preset_names
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.trials.generators import generator
from discrepancy.trials.pymunk_generator import drive
from discrepancy.trials.reading import EXACT
from discrepancy.trials.strength.separation import (
    StrengthMetric,
    apart,
    class_of,
    gaussian_strength,
    is_physical,
    without,
)
from discrepancy.trials.strength.whitening import NoiseModel
from discrepancy.validation.parity import Parity
from discrepancy.validation.sufficient import redundancy

ASOC = preset("asoc-prototype")
SPEED = 0.2
ECCENTRIC = WheelEccentricity(castor=1, wheel=2, value=0.002)


def straight(robot, seconds, radii):
    """The exact log of a robot whose wheels of radii (w,) roll straight along x at SPEED, castors at 0."""
    t = robot.sample_period * np.arange(round(seconds / robot.sample_period) + 1)
    per_rev = np.array([wheel.counts_per_rev for wheel in robot.wheels])
    wheel = SPEED * t[:, None] / np.asarray(radii) * per_rev / (2 * math.pi)
    pose = np.column_stack([SPEED * t, 0 * t, 0 * t])
    return Log(t, wheel, np.zeros((len(t), len(robot.pivot_encoders))), reference=pose)


@pytest.fixture(scope="module")
def run():
    return drive(ASOC, wander(np.random.default_rng(3), duration=20), 3, duration=20.0, rounded=False, noise=EXACT)


@pytest.fixture(scope="module")
def metric(run):
    return StrengthMetric(ASOC, run)


def test_all_radii_wrong_on_a_straight_drive_as_the_closed_form():
    # J steps, each too long by a, and poses alone noisy: covariance sigma^2 tridiag(-1, 2, -1), whose inverse sums up
    # to J (J + 1) (J + 2) / (12 sigma^2). A log that begins at speed has one step more, which the clock's offset takes.
    robot, sigma, part = preset("differential"), 1e-3, 0.002
    radii = np.array([wheel.radius for wheel in robot.wheels])
    metric = StrengthMetric(robot, straight(robot, 10.0, radii), NoiseModel(counts=1e-12, slip=1e-12, position=sigma))
    a, steps = SPEED * (1 - 1 / (1 + part)), 10 - 1
    z = np.linalg.norm(metric.signal(straight(robot, 10.0, radii * (1 + part))))
    assert z == pytest.approx(a / sigma * math.sqrt(steps * (steps + 1) * (steps + 2) / 12), rel=1e-4)


def test_one_radius_wrong_under_slip_alone_as_the_closed_form():
    # Rolled straight, every row slips by the same variance, so parity is white: z^2 = windows (part distance)^2
    # (1 - leverage of the row) / (slip^2 distance).
    part, slip, noise_model = 1e-4, 3e-5, NoiseModel(counts=1e-12, position=1e6, heading=1e6)
    radii = np.array([wheel.radius for wheel in ASOC.wheels])
    metric = StrengthMetric(ASOC, straight(ASOC, 10.0, radii), noise_model)
    wrong = radii * np.array([1, 1 + part, 1, 1, 1, 1])
    z = np.linalg.norm(metric.signal(straight(ASOC, 10.0, wrong)))
    a = constraint_matrix(Geometry.of(ASOC), np.zeros(3))[0][[0, 1, 2, 3, 4, 5, 6, 8, 10]]
    leverage = (a @ np.linalg.solve(a.T @ a, a.T))[1, 1]
    distance = SPEED * 0.1
    assert z == pytest.approx(part / slip * math.sqrt(100 * distance * (1 - leverage)), rel=1e-3)


def test_redundancy_is_that_of_the_parity_residual():
    for name in preset_names():
        robot = preset(name)
        course = wander(np.random.default_rng(1), duration=2, holonomic=moves_sideways(robot))
        assert redundancy(robot) == Parity(robot, drive(robot, course, 1, duration=2.0)).redundancy
    blind = dataclasses.replace(ASOC.castors[0], pivot_counts_per_rev=None)
    with pytest.raises(InputError, match="do not determine its motion"):
        redundancy(dataclasses.replace(ASOC, castors=(blind,) * 3))


def test_without_a_reference_only_encoders_count(run, metric):
    """What only the reference shows is gone; what encoders show of each other is weaker, not other."""
    untracked = StrengthMetric(ASOC, run, reference=False)
    assert run.reference is not None
    shifted = dataclasses.replace(run, reference=run.reference + [0.1, 0.0, 0.2] * run.t[:, None])
    assert np.linalg.norm(metric.signal(shifted)) > 100
    assert np.linalg.norm(untracked.signal(shifted)) == 0.0
    with_it, without_it = (np.linalg.norm(one.signal(one.read(ECCENTRIC))) for one in (metric, untracked))
    assert 0.5 * with_it < without_it < with_it


def test_declared_noise_becomes_white(run):
    metric, random, squares = StrengthMetric(ASOC, run, NoiseModel(slip=1e-9)), np.random.default_rng(5), []
    size = len(metric.signal(run))
    assert run.reference is not None
    for _ in range(4):
        noisy = dataclasses.replace(
            run,
            wheel=run.wheel + random.uniform(-0.5, 0.5, run.wheel.shape),
            pivot=run.pivot + random.uniform(-0.5, 0.5, run.pivot.shape),
            reference=run.reference + random.normal(size=run.reference.shape) * 1e-3,
        )
        signal = metric.signal(noisy)
        squares.append(signal @ signal / (size - 4))
    assert np.mean(squares) == pytest.approx(1.0, abs=5 * math.sqrt(2 / (4 * size)))


def test_start_pose_does_not_matter(run, metric):
    assert run.reference is not None
    c, s = math.cos(0.7), math.sin(0.7)
    x, y, psi = run.reference.T
    moved = dataclasses.replace(run, reference=np.column_stack([c * x - s * y + 2, s * x + c * y - 1, psi + 0.7]))
    assert np.linalg.norm(metric.signal(moved)) < 1e-6
    before, after = (StrengthMetric(ASOC, log).signature(ECCENTRIC) for log in (run, moved))
    assert np.linalg.norm(after) == pytest.approx(np.linalg.norm(before), rel=1e-6)


@pytest.mark.parametrize("effect", [ReferenceLeverX(value=1e-3), ReferenceYaw(value=1e-3), ClockOffset(value=-1e-3)])
def test_what_is_fitted_anyway_has_no_strength(metric, effect):
    raw = metric._whitening.whitened(metric._of(metric.read(effect)) - metric._base)
    assert np.linalg.norm(raw) > 0.5
    assert np.linalg.norm(metric.signal(metric.read(effect))) < 0.02 * np.linalg.norm(raw)


@pytest.mark.parametrize("size", [0.01, 0.26])
def test_the_pivot_of_a_robot_with_one_castor_turns_the_tracker(size):
    robot = preset("1-castor")
    course = wander(np.random.default_rng(1), duration=20.0, holonomic=moves_sideways(robot))
    metric = StrengthMetric(robot, drive(robot, course, 1, duration=20.0, rounded=False, noise=EXACT))
    assert np.linalg.norm(metric.signal(metric.read(PivotBias(castor=1, value=size)))) < 0.5


def test_twice_the_size_is_twice_the_strength(metric):
    one, two = (WheelEccentricity(castor=1, wheel=1, value=value) for value in (1e-3, 2e-3))
    assert np.linalg.norm(metric.signal(metric.read(two))) == pytest.approx(
        2 * np.linalg.norm(metric.signal(metric.read(one)))
    )


def test_dimensions_look_like_their_signatures_where_contact_is_stiff():
    # Of a differential robot nothing fights anything: physics make what kinematics say.
    robot, motion = preset("differential"), wander(np.random.default_rng(2), duration=20, holonomic=False)
    nominal = drive(robot, motion, 1, duration=20.0, rounded=False, noise=EXACT)
    metric, effect = StrengthMetric(robot, nominal), next(one for one in catalogue(robot) if one.name == "wheel_radius")
    real = drive(robot.with_effects(effect), motion, 1, duration=20.0, rounded=False, noise=EXACT)
    made, expected = metric.signal(real), metric.signature(effect) * effect.value
    assert np.linalg.norm(made - expected) < 0.05 * np.linalg.norm(expected)


@pytest.mark.parametrize("name", ["pymunk", "mujoco"])
def test_soft_tyres_look_like_their_signature(name):
    """Wheels that disagree creep, which hides a part of it; what is left has its shape."""
    pytest.importorskip(name)
    effect, motion, make = LoadRadius(value=1e-6), wander(np.random.default_rng(2), duration=20), generator(name).drive
    nominal, real = (
        make(robot, motion, 1, duration=20.0, rounded=False, noise=EXACT) for robot in (ASOC, ASOC.with_effects(effect))
    )
    metric = StrengthMetric(ASOC, nominal)
    made, expected = metric.signal(real), metric.signature(effect) * effect.value
    assert made @ expected > 0.9 * np.linalg.norm(made) * np.linalg.norm(expected)
    assert 0.5 < made @ expected / (expected @ expected) < 1.2


def test_projections(metric):
    random = np.random.default_rng(1)
    a, b = random.normal(size=(2, 50))
    left = without(a, b)
    assert left @ b == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(without(left, b), left)
    np.testing.assert_allclose(without(a, b, 2 * b, np.zeros(50)), left)
    sine = math.sqrt(1 - (a @ b) ** 2 / (a @ a) / (b @ b))
    assert apart([a, b]) == pytest.approx([np.linalg.norm(a) * sine, np.linalg.norm(b) * sine])


def test_separation_is_from_other_classes(metric):
    effect = WheelEccentricity(castor=1, wheel=1, value=1e-3, phase=0.4)
    signal = metric.signal(metric.read(effect))
    far, nearest = metric.separation(signal, class_of(effect))
    assert 0 < far <= np.linalg.norm(signal)
    assert nearest != class_of(effect)
    assert metric.separation(signal, "")[1] == class_of(effect)  # any phase is in the span of both
    assert metric.cosine(signal) == pytest.approx(1.0, abs=1e-6)
    assert metric.separation(signal, class_of(effect), signal)[0] == pytest.approx(0.0, abs=1e-9)


def test_strength_of_a_wider_gaussian(metric):
    # KL(N(0, v) || N(0, 1)) = (v - 1 - log v) / 2
    assert gaussian_strength(np.array([1.5])) == pytest.approx(math.sqrt(1.5 - math.log(2.5)))
    assert metric.jitter_strength(0.0) == 0.0
    ratio = metric.jitter_strength(2e-5) / metric.jitter_strength(1e-5)
    assert ratio == pytest.approx(4.0, rel=1e-2)  # variances count, where there is little


def test_jitter_adds_the_stated_variance(metric):
    sigma, draws, squares = 2e-4, 40, []
    for seed in range(draws):
        signal = metric.signal(metric.read(SampleJitter(value=sigma, seed=seed)))
        squares.append(signal @ signal)
    added = sigma**2 * metric.jitter
    spread = math.sqrt(2 * np.sum(added**2) / draws)  # of a sum of squares of Gaussians
    assert np.mean(squares) == pytest.approx(added.sum(), abs=4 * spread)
    assert 4 * spread < 0.9 * added.sum()


def test_classes_are_those_of_the_finder():
    ours, theirs = {}, {}
    for k, effect in enumerate(catalogue(ASOC)):
        ours.setdefault(class_of(effect), []).append(k)
        theirs.setdefault(Candidate("", (effect,)).family, []).append(k)
    assert sorted(ours.values()) == sorted(theirs.values())


def test_what_moves_the_robot():
    still = {effect.name for effect in catalogue(ASOC) if not is_physical(ASOC, effect)}
    assert {"pivot_bias", "counts_per_rev", "encoder_latency", "clock_skew", "tick_loss"} <= still
    assert not still & {"wheel_radius", "track", "pivot_offset", "pivot_position_x", "slip_stiffness", "floor_slope"}
