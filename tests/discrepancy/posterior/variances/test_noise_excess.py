"""Noise beyond that of clean logs: Bayes factors of variances, wheels that slip at random, and a restless tracker."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.posterior.calibrated import FAULT, FREEDOM
from discrepancy.posterior.finder import diagnose
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.variances.noise_excess import (
    KINDS,
    LEVEL,
    SCATTER,
    Found,
    log_bayes_factor,
    noise_of,
    noisy_answers,
    profiles_of,
)
from discrepancy.trials.pymunk_generator import drive
from discrepancy.trials.reading import Noise
from estimators.calibration.maximum_likelihood.noise import MOST
from estimators.likelihood.creep_prediction import UNEVEN
from tests.estimators.likelihood import test_turning_slip

USUAL = 3e-4
ROBOT = preset("differential")


def noisy(*sizes, freedom=30.0):
    return [Found(size**2, freedom) for size in sizes]


def test_the_same_noise_is_no_fault_and_more_noise_is_the_more_of_one():
    factors = [log_bayes_factor(noisy(times * USUAL), noisy(*[USUAL] * 3)) for times in (1, 2, 4, 8, 16)]
    assert factors[0] < 0
    assert np.all(np.diff(factors) > 0)
    assert factors[-1] > 5


def test_noise_that_few_residuals_determine_decides_nothing():
    assert abs(log_bayes_factor(noisy(2 * USUAL, freedom=0.3), noisy(*[USUAL] * 3))) < 1


def test_clean_logs_that_scatter_make_more_noise_usual():
    steady, uneven = noisy(*[USUAL] * 3), noisy(USUAL / 2, USUAL, 2 * USUAL)
    assert log_bayes_factor(noisy(4 * USUAL), uneven) < log_bayes_factor(noisy(4 * USUAL), steady) - 2


def test_a_second_log_with_the_same_noise_confirms_it_and_a_quiet_one_contradicts_it():
    once, clean = noisy(4 * USUAL), noisy(*[USUAL] * 3)
    alone = log_bayes_factor(once, clean)
    assert log_bayes_factor(once * 2, clean) > alone
    assert log_bayes_factor([*once, *noisy(USUAL)], clean) < alone


def test_all_noise_that_logs_are_fitted_with_is_on_the_grid():
    assert np.exp(LEVEL[-1]) > max(dataclasses.asdict(MOST).values())


def test_within_the_grid_the_factor_of_a_rise_does_not_depend_on_the_usual_noise():
    factors = [log_bayes_factor(noisy(3 * usual), noisy(*[usual] * 3)) for usual in (5e-4, 2e-3, 3e-2)]
    assert np.ptp(factors) < 0.2


@pytest.mark.parametrize("logs", [0, 3])
def test_logs_without_a_reference_decide_nothing(logs):
    none, some = [Found(0.0, 0.0)] * 3, noisy(*[1e-3] * 3)
    assert abs(log_bayes_factor(*((none, some) if logs else (some, none)))) < 0.5


@pytest.mark.parametrize("times", [1.0, 2.0, 4.0])
def test_it_is_the_ratio_of_likelihoods_averaged_over_draws(times):
    """The same model by drawing scatter, level, rise and the noise of each log, without any grid."""
    random, draws = np.random.default_rng(1), 1_000_000
    clean, logs = noisy(USUAL, 1.2 * USUAL, 0.9 * USUAL, freedom=8.0), noisy(times * USUAL, freedom=8.0)
    scatter = SCATTER / np.sqrt(random.chisquare(FREEDOM, draws) / FREEDOM)
    level = random.uniform(np.log(USUAL) - 1.0, np.log(USUAL) + 1.0, draws)
    part = random.uniform(0, 2 / np.pi * np.arctan(5 / np.log(FAULT)), draws)  # of a Cauchy distribution, up to 5
    rise = np.log(FAULT) * np.tan(np.pi / 2 * part)

    def likelihood(found, middle):
        noise = middle + scatter * random.normal(size=draws)
        off = np.log(found.variance) - 2 * noise
        return np.exp(found.freedom / 2 * (off + 1 - np.exp(off)))

    usual = np.prod([likelihood(log, level) for log in clean], axis=0)
    good, raised = (np.mean(usual * likelihood(logs[0], level + by)) for by in (0.0, rise))
    assert log_bayes_factor(logs, clean) == pytest.approx(np.log(raised / good), abs=0.15)


@cache
def driven(seed, size=1e-3, turned=1e-3):
    """A log, with standard deviations of the reference's positions (m) and headings (rad)."""
    motion = wander(np.random.default_rng([seed, 1]), duration=25.0, holonomic=False)
    return drive(ROBOT, motion, seed, duration=25.0, noise=Noise(size, turned))


@cache
def usual():
    return linearise(ROBOT, [driven(seed) for seed in (1, 2, 3)], among=())


@pytest.mark.parametrize(("kind", "noise"), [("position", (6e-3, 1e-3)), ("heading", (1e-3, 6e-3))])
def test_a_reference_that_scatters_more_than_in_clean_logs_costs_its_noise(kind, noise):
    (answer,) = noisy_answers(linearise(ROBOT, [driven(4, *noise)], among=()), None, usual())
    assert answer.credible[0].startswith(KINDS[kind].partition("{}")[0])
    assert answer.size == pytest.approx(6e-3, rel=0.4)
    position, heading = answer.size * answer.cost
    assert (position, heading)[kind == "heading"] == pytest.approx(answer.size, rel=0.1)
    assert (position, heading)[kind == "position"] == 0


def test_a_wheel_that_slips_more_as_it_is_steered_than_in_clean_logs_costs_its_slip():
    robot = test_turning_slip.ROBOT
    clean, faulty = (
        [test_turning_slip.driven(seed, 1e-3, turning) for seed in seeds]
        for seeds, turning in (((1, 2, 3), 1e-3), ((4,), 8e-3))
    )
    as_usual, more = (linearise(robot, logs, among=()) for logs in (clean, faulty))
    (answer,) = noisy_answers(more, None, as_usual)
    assert answer.credible[0].startswith(KINDS["turning"].partition("{}")[0])
    assert answer.size == pytest.approx(8e-3, rel=0.2)
    assert answer.size * answer.cost[0] > 1e-3
    as_clean = linearise(robot, [test_turning_slip.driven(5, 1e-3, 1e-3)], among=())
    assert noisy_answers(as_clean, None, as_usual) == []


def test_creep_that_effects_cause_is_doubted_and_its_doubt_is_no_noise():
    seen = linearise(ROBOT, [driven(4, 6e-3)], among=())
    (plain,) = noise_of(seen)
    (design,), along = seen.designs, seen.designs[0].model.rows < len(ROBOT.wheels)
    way = np.abs(design.model.rolled(design.geometry, design.state))
    caused = 0.02 * np.sqrt(way) * along  # m after 1 m
    (doubted,) = noise_of(dataclasses.replace(seen, caused=(caused,)))
    assert plain["along"].variance - doubted["along"].variance == pytest.approx(
        min((UNEVEN * 0.02) ** 2, plain["along"].variance), rel=1e-6
    )
    assert doubted["across"] == plain["across"]


def test_a_reference_that_scatters_as_usual_is_no_news():
    assert noisy_answers(linearise(ROBOT, [driven(4)], among=()), None, usual()) == []


@pytest.mark.slow
def test_a_tracker_that_scatters_is_unexplained_beside_clean_logs():
    clean = [driven(seed) for seed in (1, 2, 3)]
    diagnosis = diagnose(ROBOT, [driven(4, 6e-3)], [driven(5, 6e-3)], clean)
    assert diagnosis.verdict == "unexplained"
    (answer,) = diagnosis.answers
    assert answer.credible[0].startswith("positions of the reference")


def slipping(seed, size):
    """A log whose wheels also turn at random, by `size` (m) after 1 m, without moving the robot."""
    log, random, geometry = driven(seed), np.random.default_rng(seed), Geometry.of(ROBOT)
    count = 2 * np.pi * geometry.radius / geometry.counts_per_rev
    way = np.abs(np.diff(log.wheel, axis=0)) * count
    slipped = np.cumsum(size * np.sqrt(way) * random.normal(size=way.shape), axis=0) / count
    return dataclasses.replace(log, wheel=log.wheel + np.round(np.pad(slipped, ((1, 0), (0, 0)))))


@pytest.mark.slow
def test_wheels_that_slip_at_random_are_unexplained_beside_clean_logs():
    clean = [driven(seed) for seed in (1, 2, 3)]
    diagnosis = diagnose(ROBOT, [slipping(4, 2e-3)], [slipping(5, 2e-3)], clean)
    assert diagnosis.verdict == "unexplained"
    (answer,) = (answer for answer in diagnosis.answers if "less regularly" in answer.credible[0])
    assert answer.size == pytest.approx(2e-3, rel=0.4)
    assert "roll" in answer.credible[0]


@pytest.mark.slow
def test_wheels_that_slip_as_usual_or_without_clean_logs_to_compare_are_no_news():
    clean = [slipping(seed, 2e-3) for seed in (1, 2, 3)]
    assert diagnose(ROBOT, [slipping(4, 2e-3)], [], clean).verdict == "no discrepancy"
    alone = diagnose(ROBOT, [slipping(4, 2e-3)])
    assert not any("less regularly" in answer.credible[0] for answer in alone.answers)


@pytest.mark.parametrize("kind", ["position", "across"])
def test_what_other_noise_may_explain_is_less_certain(kind):
    """That noise is lower than found is as likely at least with the other noise as likely as it can be, and much more
    so where it is much lower: the other noise takes over."""
    seen = linearise(ROBOT, [driven(4)], among=())
    (noise,) = noise_of(seen)
    (profile,) = profiles_of(seen, kind)
    lower = np.log(noise[kind].variance) / 2 - LEVEL
    near = (lower > 0) & (lower < 1.0)
    assert np.all(profile.log_likelihood[near] > noise[kind].log_likelihood[near] - 1)
    assert profile.log_likelihood[0] > noise[kind].log_likelihood[0] / 8
