"""The rate of the reference's clock, of several logs."""

import numpy as np
import pytest

from discrepancy.hypotheses.clocks import skew_of


def test_the_rate_of_several_clocks_is_their_weighted_mean():
    clocks, errors = np.array([[0.1, 1e-3], [0.2, 3e-3]]), np.array([[1, 1e-3], [1, 2e-3]])
    found = skew_of(clocks, errors)
    assert found.value == pytest.approx((1e-3 / 1 + 3e-3 / 4) / (1 / 1 + 1 / 4))
    assert found.error == pytest.approx(1e-3 / np.sqrt(1.25))
    assert found.gain == pytest.approx((found.value / found.error) ** 2)


def test_clocks_that_differ_by_more_than_their_errors_are_less_sure():
    alike, apart = (np.array([[0, 1e-3], [0, other]]) for other in (1e-3, 2e-3))
    errors = np.full((2, 2), 1e-5)
    assert skew_of(apart, errors).error > 10 * skew_of(alike, errors).error
