"""Eliminated states, against dense matrices."""

import numpy as np
import pytest
from scipy.linalg import cholesky_banded

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
