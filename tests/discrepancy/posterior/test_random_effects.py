"""Random effects from log to log: against the joint Gaussian they stand for, and clean logs drawn from it."""

import numpy as np
import pytest

from discrepancy.posterior.calibrated import REFITTED, SIGNATURE
from discrepancy.posterior.random_effects import Statistics, agreeing, good_order, log_likelihood_of, summed


def drawn(random, design, sizes):
    """Return the statistics of a log in which sizes show through a design (n, m), with unit noise."""
    values = design @ sizes + random.normal(size=len(design))
    return Statistics(design.T @ design, design.T @ values)


def test_scatter_blurs_a_log_as_the_joint_normal_distribution_of_its_values_says():
    random = np.random.default_rng(0)
    design, scatter = random.normal(size=(50, 4)), np.diag([0.5, 0.1, 2.0, 0.0])
    values = random.normal(size=50)
    covariance = np.linalg.inv(np.eye(50) + design @ scatter @ design.T)
    seen = Statistics(design.T @ design, design.T @ values).scattered(scatter)
    assert seen.information == pytest.approx(design.T @ covariance @ design, rel=1e-9, abs=1e-9)
    assert seen.score == pytest.approx(design.T @ covariance @ values, rel=1e-9, abs=1e-9)


def test_sizes_that_are_known_are_taken_off():
    random = np.random.default_rng(1)
    design, known = random.normal(size=(30, 3)), np.array([1.0, -2.0, 0.5])
    log = drawn(np.random.default_rng(2), design, known)
    left = drawn(np.random.default_rng(2), design, np.zeros(3))
    assert log.at(known).score == pytest.approx(left.score, abs=1e-9)


def test_doubt_in_signatures_leaves_no_more_than_a_part_of_what_is_explained():
    log, none = Statistics(np.eye(2), np.ones(2)), np.zeros(2)
    assert log.doubted(none, none).score == pytest.approx(log.score)
    for part, place in ((SIGNATURE, 0), (REFITTED, 1)):
        sizes = [none, none]
        sizes[place] = np.array([1e4, 0.0])
        assert 1e4**2 * log.doubted(*sizes).information[0, 0] == pytest.approx(part**-2, rel=0.01)


def test_without_clean_logs_the_tolerances_stand():
    told = good_order(np.array([0.1, 0.2]))
    assert told.scatter == pytest.approx(np.diag([0.005, 0.02]))
    assert told.doubt == pytest.approx(np.diag([0.005, 0.02]))
    assert not told.background.any()


def test_clean_logs_tell_background_and_scatter():
    random = np.random.default_rng(3)
    truth, spread = np.array([3.0, 0.0, -1.0]), np.array([0.5, 0.05, 0.05])
    clean = [
        drawn(random, 30 * random.normal(size=(100, 3)), truth + spread * random.normal(size=3)) for _ in range(60)
    ]
    told = good_order(np.full(3, 0.05), clean)
    assert told.background == pytest.approx(truth, abs=0.25)
    assert np.sqrt(np.diag(told.scatter)) == pytest.approx(spread, rel=0.35)


def test_sizes_of_a_group_scatter_alike():
    """Three logs say little of each of eight sizes, and nothing of the last; together they say how all scatter."""
    random, spread, tolerance = np.random.default_rng(8), 0.6, np.array([0.1] * 8 + [0.2])
    visible = np.diag([1.0] * 8 + [0.0])
    alone, together = [], []
    for _ in range(20):
        sizes = [spread * random.normal(size=9) for _ in range(3)]
        clean = [drawn(random, 30 * random.normal(size=(100, 9)) @ visible, size) for size in sizes]
        alone.append(np.sqrt(np.diag(good_order(tolerance, clean).scatter)))
        together.append(np.sqrt(np.diag(good_order(tolerance, clean, np.zeros(9, dtype=int)).scatter)))
    together = np.array(together) / (tolerance / tolerance[0])
    assert np.ptp(together, axis=1) == pytest.approx(0.0, abs=1e-12)
    seen = together[:, 0]
    assert np.std(seen) < np.std(np.array(alone)[:, :8]) / 2
    assert spread / 1.5 < seen.mean() < 1.2 * spread


def test_statistics_and_order_of_combinations_are_those_of_the_sizes():
    random, basis = np.random.default_rng(5), np.array([[1.0, 1.0], [0.0, 1.0]])
    design, amounts = random.normal(size=(40, 2)), np.array([0.3, -0.2])
    log = drawn(np.random.default_rng(6), design, basis @ amounts)
    of_amounts = drawn(np.random.default_rng(6), design @ basis, amounts)
    combined = log.of_combinations(basis)
    assert combined.information == pytest.approx(of_amounts.information)
    assert combined.score == pytest.approx(of_amounts.score)
    order = good_order(np.array([0.1, 0.2]))
    of_sizes = order.of_sizes(basis)
    assert of_sizes.scatter == pytest.approx(basis @ order.scatter @ basis.T)
    beyond = of_sizes.beyond([log]).of_combinations(basis)
    assert beyond.information == pytest.approx(order.beyond([of_amounts]).information)
    assert beyond.score == pytest.approx(order.beyond([of_amounts]).score)


def test_the_likelihood_of_tolerances_is_that_of_the_values_drawn():
    random = np.random.default_rng(7)
    design, values, tolerance = random.normal(size=(20, 3)), random.normal(size=20), np.array([0.2, 1.0, 3.0])
    log = Statistics(design.T @ design, design.T @ values)
    of_values = []
    for sizes in (tolerance, 2 * tolerance):
        covariance = np.eye(20) + design @ np.diag(sizes**2) @ design.T
        of_values.append(-(values @ np.linalg.solve(covariance, values) + np.linalg.slogdet(covariance)[1]) / 2)
    found = [log_likelihood_of([log], sizes) for sizes in (tolerance, 2 * tolerance)]
    assert found[1] - found[0] == pytest.approx(of_values[1] - of_values[0])


@pytest.mark.parametrize("logs", [1, 4])
def test_a_robot_in_good_order_is_beyond_nothing_as_often_as_chance_says(logs):
    random = np.random.default_rng(4)
    tolerance = np.array([0.3, 0.1, 0.2])
    squares = []
    for _ in range(300):
        background = tolerance * random.normal(size=3) / np.sqrt(2)
        designs = [10 * random.normal(size=(20, 3)) for _ in range(logs)]
        every = [
            drawn(random, design, background + tolerance * random.normal(size=3) / np.sqrt(2)) for design in designs
        ]
        beyond = good_order(tolerance).beyond(every)
        squares.append(beyond.score @ np.linalg.solve(beyond.information, beyond.score))
    assert np.mean(squares) == pytest.approx(3.0, abs=4 * np.sqrt(6 / 300))


def test_logs_together_are_their_sum():
    one, other = Statistics(np.eye(2), np.ones(2)), Statistics(2 * np.eye(2), 3 * np.ones(2))
    both = summed([one, other])
    assert both.information == pytest.approx(3 * np.eye(2))
    assert both.score == pytest.approx(np.full(2, 4.0))


@pytest.mark.parametrize("noise", [0.5, 1.0])
def test_logs_that_agree_on_lasting_sizes_have_the_noise_that_their_agreement_shows(noise):
    random, lasting = np.random.default_rng(5), np.array([0, 2])
    designs = [random.normal(size=(60, 3)) for _ in range(200)]
    logs, expected = [], []
    for design in designs:
        onto = design[:, lasting] @ np.linalg.pinv(design[:, lasting])  # along their signatures there is less noise
        values = design @ [1.0, 0.0, 0.5] + (np.eye(60) - (1 - noise) * onto) @ random.normal(size=60)
        logs.append(Statistics(design.T @ design, design.T @ values))
        inverse = np.eye(60) + (noise**-2 - 1) * onto
        expected.append(Statistics(design.T @ inverse @ design, design.T @ inverse @ values))
    agreed, truly = summed(agreeing(logs, lasting)), summed(expected)
    assert agreed.information == pytest.approx(truly.information, rel=0.15, abs=0.02 * truly.information[0, 0])
    assert agreed.score == pytest.approx(truly.score, rel=0.15, abs=0.02 * abs(truly.score[0]))


def test_one_log_alone_and_logs_of_nothing_that_lasts_stay_as_they_are():
    log = drawn(np.random.default_rng(6), np.random.default_rng(7).normal(size=(20, 3)), np.ones(3))
    assert agreeing([log], np.array([0]))[0] is log
    assert agreeing([log, log], np.zeros(0, dtype=np.intp))[1] is log
