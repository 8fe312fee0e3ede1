"""Eliminated states, against dense matrices."""

import numpy as np
import pytest
from scipy.linalg import cho_solve_banded, cholesky_banded

from estimators.likelihood import elimination


def information_of(samples, size):
    """Information of states that equations between neighbouring samples couple."""
    random, total = np.random.default_rng(5), np.eye(samples * size)
    for k in range(samples - 1):
        derivatives = random.standard_normal((size, 2 * size))
        total[k * size : (k + 2) * size, k * size : (k + 2) * size] += derivatives.T @ derivatives
    return total


@pytest.mark.parametrize("large", [3, 100], ids=["in blocks", "at once"])
def test_variances_are_the_diagonal_of_the_inverse(monkeypatch, large):
    monkeypatch.setattr(elimination, "LARGE", large)
    samples, size = 8, 4
    information = information_of(samples, size)
    banded = np.array([[information[max(j - back, 0), j] for j in range(samples * size)] for back in range(2 * size)])
    found = elimination.variances(cholesky_banded(banded[::-1]))
    np.testing.assert_allclose(found.ravel(), np.diag(np.linalg.inv(information)), rtol=1e-10)


def chain(weight):
    """The information on positions along a line of which only the first is known, to 1, and each step by `weight`."""
    diagonal = np.full(2000, 2.0 * weight)
    diagonal[0], diagonal[-1] = 1.0 + weight, weight
    return np.stack([np.append(0.0, np.full(1999, -weight)), diagonal])


@pytest.mark.parametrize("weight", [1e4, 1e16])
def test_what_rounding_takes_from_a_chain_is_given_back(weight):
    """With 1e16 nothing of the first position's information is left at the other end in double precision."""
    factor = elimination.factored(lambda: chain(weight), rounded=True)
    pulled = np.zeros(2000)
    pulled[0] = 1.0
    moved = cho_solve_banded((factor, False), pulled)
    if weight == 1e4:
        assert moved == pytest.approx(np.ones(2000), rel=1e-6)
    assert np.all(np.isfinite(moved))


@pytest.mark.parametrize("rounded", [False, True])
def test_what_is_no_information_has_no_factor(rounded):
    information = chain(1.0)
    information[1, 1000] = -1.0
    with pytest.raises(np.linalg.LinAlgError):
        elimination.factored(information.copy, rounded)


def test_where_poses_are_measured_rounding_does_not_take_information():
    """A fit that diverged had the log evidence of rounding, exp(299807) times as likely, and was named."""
    with pytest.raises(np.linalg.LinAlgError):
        elimination.factored(lambda: chain(1e16))
