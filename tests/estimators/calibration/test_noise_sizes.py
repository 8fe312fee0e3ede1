"""The sizes of noise on their way to those that explain the squares."""

from dataclasses import astuple

import numpy as np
import pytest

from estimators.calibration.maximum_likelihood.noise import LEAST, Pace
from estimators.likelihood.log_likelihood import Noise

LIMIT = np.array([2e-4, 5e-5, 2e-3, 1e-3, 1e-3, 4e-4])
START = Noise(2e-3, 1e-4, 1e-2, 4e-3, 1e-3, 2e-3)


def rounds_needed(contract, extrapolating, limit=LIMIT, most=400):
    """Rounds until all sizes are within 1 % of the limit, where a plain round makes `contract` of their logarithms."""
    sizes, pace = START, None
    for k in range(most):
        if np.all(np.abs(np.log(np.array(astuple(sizes)) / limit)) < 0.01):
            return k
        changed = Noise(*np.maximum(np.exp(contract(np.log(astuple(sizes)))), astuple(LEAST)).tolist())
        sizes, pace = Pace.extrapolated(sizes, changed, pace) if extrapolating else (changed, None)
    return most


def towards(limit, part):
    return lambda sizes: sizes + np.asarray(part) * (np.log(limit) - sizes)


@pytest.mark.parametrize("part", [0.02, 0.1, 0.5])
def test_sizes_that_approach_slowly_are_extrapolated_to_the_same_limit(part):
    plain, extrapolated = (rounds_needed(towards(LIMIT, part), extrapolating) for extrapolating in (False, True))
    assert extrapolated <= max(plain / 8, 8)


def test_sizes_of_different_pace_and_such_as_depend_on_each_other_reach_it_too():
    parts = np.diag([0.03, 0.5, 0.1, 0.05, 1.0, 0.2])
    parts[0, 3] = parts[3, 0] = 0.02  # what one explains, the other need not

    def contract(sizes):
        return sizes + parts @ (np.log(LIMIT) - sizes)

    assert rounds_needed(contract, True) < rounds_needed(contract, False) / 4


@pytest.mark.parametrize("part", [1.0, 1.3, 1.8])
def test_a_way_that_overshoots_takes_no_more_rounds(part):
    contract = towards(LIMIT, part)
    assert rounds_needed(contract, True) <= rounds_needed(contract, False) < 40


def test_a_noise_of_which_there_is_none_falls_to_its_bound_and_no_lower():
    limit = np.array([2e-4, 1e-9, 2e-3, 1e-9, 1e-3, 4e-4])
    bounded = np.maximum(limit, astuple(LEAST))
    plain, extrapolated = (rounds_needed(towards(limit, 0.03), way, bounded) for way in (False, True))
    assert extrapolated < plain / 3
