"""Factors of information matrices that are hardly positive definite."""

import numpy as np
import pytest
from scipy.linalg import cho_solve_banded

from estimators.likelihood.reduction import factored


def chain(weight):
    """The information on positions along a line of which only the first is known, to 1, and each step by `weight`."""
    diagonal = np.full(2000, 2.0 * weight)
    diagonal[0], diagonal[-1] = 1.0 + weight, weight
    return np.stack([np.append(0.0, np.full(1999, -weight)), diagonal])


@pytest.mark.parametrize("weight", [1e4, 1e16])
def test_what_rounding_takes_from_a_chain_is_given_back(weight):
    """With 1e16 nothing of the first position's information is left at the other end in double precision."""
    factor = factored(lambda: chain(weight))
    pulled = np.zeros(2000)
    pulled[0] = 1.0
    moved = cho_solve_banded((factor, False), pulled)
    if weight == 1e4:
        assert moved == pytest.approx(np.ones(2000), rel=1e-6)
    assert np.all(np.isfinite(moved))


def test_what_is_no_information_has_no_factor():
    information = chain(1.0)
    information[1, 1000] = -1.0
    with pytest.raises(np.linalg.LinAlgError):
        factored(information.copy)
