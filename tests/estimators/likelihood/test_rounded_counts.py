"""Rounding errors of counts: against their covariance written out, and of a steering encoder that stands still."""

from dataclasses import replace

import numpy as np
import pytest

from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.presets import preset
from estimators.calibration.maximum_likelihood.fit import fitted
from estimators.likelihood.log_likelihood import LogLikelihood

TRICYCLE = Geometry.of(preset("tricycle"))


def covariance(runs) -> np.ndarray:
    """Of rounding errors, in counts, of runs of equal readings. If the shaft stands, the error of a run is even over
    one count."""
    total, first = np.zeros((sum(runs), sum(runs))), 0
    for run in runs:
        alike = np.exp(-2 * np.abs(np.subtract.outer(np.arange(run), np.arange(run))) / run)
        total[first : first + run, first : first + run] = alike * np.linalg.inv(alike).sum() / 12
        first += run
    return total


def test_errors_of_a_run_of_equal_counts_correlate():
    pivot, wheel = np.array([0.0, 0, 0, 0, 1, 2, 2, 2]), np.array([0.0, 3, 6, 6, 6, 7, 7, 9])
    model = LogLikelihood(TRICYCLE, Log(0.05 * np.arange(8), wheel[:, None], pivot[:, None]))
    off = np.random.default_rng(1).normal(size=(8, 2))
    state = np.column_stack([np.zeros((8, 3)), model.counts - off])
    for column, runs in enumerate(([4, 1, 3], [1, 1, 3, 2, 1])):
        expected = np.linalg.solve(covariance(runs), off[:, column])
        np.testing.assert_allclose(model.score_by_counts(state)[:, column], expected, rtol=1e-9)


def test_within_a_play_nothing_holds_the_shaft():
    """Errors of four equal readings are then independent, and tell as much as one reading that is off by the play."""
    model = LogLikelihood(TRICYCLE, Log(0.05 * np.arange(4), 3.0 * np.arange(4)[:, None], np.zeros((4, 1))))
    model.correct(np.zeros((4, 2)), np.array([5.0, 0.0]))
    off = np.random.default_rng(1).normal(size=(4, 2))
    state = np.column_stack([np.zeros((4, 3)), model.counts - off])
    np.testing.assert_allclose(model.score_by_counts(state), off / np.array([4 * (1 / 12 + 25), 1 / 12]), rtol=1e-9)


@pytest.fixture(scope="module")
def to_and_fro():
    """A tricycle goes straight, ahead and back, for 20 m; its steering encoder reads 0 all the time, rightly."""
    t = 0.05 * np.arange(800)
    x = 0.8 * np.sin(0.8 * t)
    turned = np.round(x / TRICYCLE.radius[0] * TRICYCLE.counts_per_rev[0] / (2 * np.pi))
    pose = np.column_stack([x, np.zeros((800, 2))]) + 1e-3 * np.random.default_rng(2).normal(size=(800, 3))
    return LogLikelihood(TRICYCLE, Log(t, turned[:, None], np.zeros((800, 1)), reference=pose))


def test_a_castor_whose_encoder_stands_still_stays_within_a_count(to_and_fro):
    at, _, _ = fitted([to_and_fro], TRICYCLE, (), np.zeros(0), None)
    assert np.abs(at.states[0][:, 3]).max() < 0.5


def test_straight_ways_do_not_tell_how_long_the_robot_is(to_and_fro):
    """Nor does log evidence depend on where a fit starts."""

    def log_evidence(geometry: Geometry, start=None) -> tuple[float, tuple]:
        at, noise, _ = fitted([to_and_fro], geometry, (), np.zeros(0), None, start)
        nothing = np.zeros(0), at.states[0], at.clocks[0], at.mount, noise
        return to_and_fro.reduce(geometry, geometry, *nothing).log_evidence(), (at, noise)

    longer = TRICYCLE.pivot.copy()
    longer[0, 0] *= 2
    as_described, start = log_evidence(TRICYCLE)
    twice, elsewhere = log_evidence(replace(TRICYCLE, pivot=longer))
    assert abs(twice - as_described) < 2
    assert log_evidence(TRICYCLE, elsewhere)[0] == pytest.approx(as_described, abs=0.5)
    assert log_evidence(TRICYCLE, start)[0] == pytest.approx(as_described, abs=0.5)
