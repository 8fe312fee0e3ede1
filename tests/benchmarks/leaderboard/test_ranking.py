"""Intervals cover what they should; ranks follow paired differences."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.leaderboard.ranking import FEWEST_CASES, interval, ranks, resampled_means


def test_intervals_cover_the_mean_as_often_as_they_say():
    """95 % within the bootstrap's known undercoverage of small samples and three standard errors of 400 trials."""
    random = np.random.default_rng(1)
    hits = 0
    for seed in range(400):
        found = interval(random.normal(3.0, 2.0, size=50), seed)
        assert found.low is not None
        assert found.high is not None
        hits += found.low <= 3.0 <= found.high
    assert 0.90 <= hits / 400 <= 0.98


def test_resampled_means_spread_as_the_standard_error():
    scores = np.random.default_rng(2).normal(size=200)
    means = resampled_means(scores, resamples=8000)
    assert np.mean(means) == pytest.approx(np.mean(scores), abs=0.005)
    assert np.std(means) == pytest.approx(np.std(scores) / np.sqrt(200), rel=0.05)


def test_the_same_numbers_give_the_same_interval():
    scores = np.random.default_rng(3).normal(size=30)
    assert interval(scores) == interval(scores)


def test_few_cases_show_no_difference():
    clear = {"good": [1.0] * (FEWEST_CASES - 1), "bad": [9.0] * (FEWEST_CASES - 1)}
    assert ranks(clear) == {"good": 1, "bad": 1}
    assert interval(clear["good"]).low is None
    assert ranks({name: [*scores, scores[0]] for name, scores in clear.items()}) == {"good": 1, "bad": 2}


def test_ranks_skip_after_a_shared_one():
    random = np.random.default_rng(4)
    first = random.normal(10, 1, 60)
    scores = {"a": first, "b": first + random.normal(0, 1, 60), "c": first + 5, "d": first + 9}
    assert ranks(scores) == {"a": 1, "b": 1, "c": 3, "d": 4}


def test_pairing_finds_what_single_intervals_hide():
    """The cases differ by far more than the estimators, but one of these is worse in each case."""
    hard = np.random.default_rng(5).uniform(1, 1000, 40)
    scores = {"a": hard, "b": hard + 0.5}
    low, high = interval(scores["b"]).low, interval(scores["a"]).high
    assert low is not None
    assert high is not None
    assert low < high
    assert ranks(scores) == {"a": 1, "b": 2}


def test_without_any_difference_hardly_anybody_is_put_second():
    random = np.random.default_rng(6)
    second = sum(
        max(ranks({"a": random.normal(5, 1, 40), "b": random.normal(5, 1, 40)}).values()) == 2 for _ in range(200)
    )
    assert second / 200 <= 0.10


def test_rounding_is_no_difference():
    scores = np.random.default_rng(7).uniform(1, 2, 50)
    assert ranks({"a": scores, "b": scores * (1 + 1e-13)}) == {"a": 1, "b": 1}


def test_nobody_is_ranked_for_nothing():
    assert ranks({}) == {}
    assert ranks({"a": [0.0] * 9}) == {"a": 1}


@given(st.permutations(["a", "b", "c", "d"]), st.integers(0, 50))
def test_ranks_do_not_depend_on_the_order_of_entry(order, seed):
    random = np.random.default_rng(seed)
    scores = {name: random.normal(5 + k / 4, 1, 20) for k, name in enumerate("abcd")}
    assert ranks({name: scores[name] for name in order}) == ranks(scores)


@given(st.integers(0, 50))
def test_ranks_do_not_depend_on_the_unit(seed):
    random = np.random.default_rng(seed)
    scores = {name: random.uniform(1, 2 + k / 4, 20) for k, name in enumerate("abcd")}
    assert ranks({name: 1000 * values for name, values in scores.items()}) == ranks(scores)
