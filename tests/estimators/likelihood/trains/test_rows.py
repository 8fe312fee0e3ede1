"""The equations of a train's log: their derivatives, and the statics of pulled frames behind them."""

import dataclasses

import numpy as np
import pytest

from castor_envs.effects.train import AxleSlip
from castor_envs.vehicles.presets import cfmmr
from discrepancy.trials.trains.simulate import log_at_random
from estimators.likelihood.trains import bending
from estimators.likelihood.trains.bending import newtons
from estimators.likelihood.trains.rows import TrainLog

TRAIN = cfmmr(3)
FRAME = TRAIN.frames[0]


@pytest.fixture(scope="module")
def log():
    return log_at_random(TRAIN, 12, 1.0, "servo")


def test_derivatives_of_residuals_are_what_small_changes_make(log):
    train = TRAIN.with_effects(AxleSlip(axle=2, value=9.0))
    rows, built, random = TrainLog(train, log), train.as_built(), np.random.default_rng(1)
    somewhere = random.standard_normal((rows.k, rows.block)) * np.repeat([1e-4, 1e-4, 1.0], [9, 6, 2])
    motion = rows.start(built).moved(somewhere, 0.1 * rows.prior(train) * random.standard_normal(rows.numbers))
    sample, number = 1e-6 * random.standard_normal((rows.k, rows.block)), 1e-5 * random.standard_normal(rows.numbers)
    more, less = (rows.residuals(built, motion.moved(sign * sample, sign * number)) for sign in (1, -1))
    derivatives = rows.jacobians(built, motion, rows.bends(built, motion))
    for kind in ("counts", "rolling", "side", "tension", "shape", "gauges0", "gauges1"):
        change = (more[kind] - less[kind]).ravel() / 2
        said = derivatives[kind].by_sample @ sample.ravel() + derivatives[kind].by_number @ number
        assert np.linalg.norm(said - change) < 1e-4 * np.linalg.norm(change), kind
    still = np.zeros_like(sample)
    more, less = (rows.residuals(built, motion.moved(still, sign * number)) for sign in (1, -1))
    for kind in ("position", "heading"):
        change, said = (more[kind] - less[kind]).ravel() / 2, derivatives[kind].by_number @ number
        assert np.linalg.norm(said - change) < 1e-6 * np.linalg.norm(change), kind


@pytest.mark.parametrize("age", [0.0, 0.03, 0.12])
def test_readings_count_when_they_were_taken(log, age):
    """Readings that arrive later, with their age, say the same; those that are told again say nothing more."""
    apart = np.round((log.t - age - log.t[0]) / TRAIN.sample_period).astype(int)
    late = (
        log.rps[np.maximum(apart, 0)],
        np.where((apart >= 0)[:, None], log.t[:, None] - log.t[np.maximum(apart, 0)][:, None], np.nan),
    )
    frames = late[1] * np.ones(2)
    told = dataclasses.replace(
        log, rps=np.where(np.repeat(np.isfinite(frames), 3, axis=1), late[0], np.nan), rps_age=np.nan_to_num(frames)
    )
    at_once, later = TrainLog(TRAIN, log), TrainLog(TRAIN, told)
    known = slice(0, apart[-1] + 1)
    np.testing.assert_array_equal(later.rps[known], at_once.rps[known])
    np.testing.assert_array_equal(later.read[known], at_once.read[known])
    assert not later.read[apart[-1] + 1 :].any()


@pytest.mark.parametrize("tension", [-20.0, 5.0, 20.0])
def test_a_pulled_frame_bows_as_a_beam_does(tension):
    """kappa'' = tension kappa / E I: a cosh and a sinh, whose integrals along the frame, twice, stay the same."""
    root = np.sqrt(complex(tension * FRAME.length**2 / FRAME.bending_stiffness))
    mean, apart = 0.8, 0.5
    even = mean * (root / 2) / np.tanh(root / 2)
    first_moment = np.cosh(root / 2) / root - 2 * np.sinh(root / 2) / root**2
    odd = apart / 12 / first_moment * np.sinh(root / 2)
    ends = np.array([mean - apart / 2, mean + apart / 2])
    alike, further = bending.bow(FRAME, ends, np.array(tension))
    assert mean + alike == pytest.approx(even.real, rel=0.01)
    assert apart / 2 + further == pytest.approx(odd.real, rel=0.01)


@pytest.mark.parametrize("tension", [-20.0, 5.0, 20.0])
@pytest.mark.parametrize(("mean", "apart"), [(0.8, 0.0), (0.8, 0.5), (-1.0, 0.6)])
def test_a_pulled_frame_is_as_short_as_a_beam(tension, mean, apart):
    """The beam of the test above, its heading integrated in small steps; the bow changes how short it is, not where it
    ends to its side."""
    u = np.linspace(0.0, 1.0, 4001)
    root = np.sqrt(complex(tension * FRAME.length**2 / FRAME.bending_stiffness))
    even = mean * (root / 2) * np.cosh(root * (u - 0.5)) / np.sinh(root / 2)
    first_moment = np.cosh(root / 2) / root - 2 * np.sinh(root / 2) / root**2
    curved = (even + apart / 12 / first_moment * np.sinh(root * (u - 0.5))).real
    heading = FRAME.length * np.concatenate([[0.0], np.cumsum((curved[1:] + curved[:-1]) / 2) * u[1]])
    x = FRAME.length * np.trapezoid(np.cos(heading), u)
    ends = np.array([mean - apart / 2, mean + apart / 2])
    straight = bending.posture_of(FRAME, ends)
    bowed = bending.bow(FRAME, ends, np.array(tension))[0]
    pulled = bending.posture_of(FRAME, ends, bowed)
    assert FRAME.length - pulled[0] == pytest.approx(FRAME.length - x, rel=0.004)
    assert pulled[1:] == pytest.approx(straight[1:], abs=1e-4)


def test_frames_without_mass_are_in_balance():
    """What a frame does to its two axles adds up to no force and to no moment."""
    train, random = cfmmr(2), np.random.default_rng(2)
    ends = random.uniform(-1.2, 1.2, (20, 1, 2))
    relative = bending.posture_of(FRAME, ends)
    front, rear = bending.loads(train, relative, ends, random.uniform(-20, 20, (20, 1))).transpose(1, 0, 2)
    c, s = np.cos(relative[:, 0, 2]), np.sin(relative[:, 0, 2])
    seen = np.stack([c * front[:, 0] - s * front[:, 1], s * front[:, 0] + c * front[:, 1]], axis=1)
    np.testing.assert_allclose(seen + rear[:, :2], 0.0, atol=1e-12)
    lever = relative[:, 0, 0] * seen[:, 1] - relative[:, 0, 1] * seen[:, 0]
    np.testing.assert_allclose(front[:, 2] + rear[:, 2] + lever, 0.0, atol=1e-12)


def test_steps_in_which_axles_are_pulled_as_hard_as_they_grip_may_slide(log):
    rows = TrainLog(TRAIN, log)
    motion = rows.start(TRAIN)
    assert not rows.sliding(TRAIN, motion).any()
    module = TRAIN.modules[0]
    grip = module.contact.friction * (module.mass + module.castors[0].mass) * 9.81
    tension = motion.tension.copy()
    tension[40:50, 0] = 1.1 * grip / newtons(TRAIN)[0]
    loose = rows.sliding(TRAIN, dataclasses.replace(motion, tension=tension))
    assert loose[40:50, :2].all()
    assert not loose[:30].any()
    assert not loose[60:].any()
    assert not loose[:, 2].any()
