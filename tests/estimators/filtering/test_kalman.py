"""The update with unknowns of which hardly anything is known, against the textbook's with one large state."""

import numpy as np
import pytest

from estimators.filtering.kalman import FREE, beside, corrected, factored

SIZE, FIRST, MEASURED = 9, 2, 5


@pytest.fixture(name="case")
def _case():
    random = np.random.default_rng(4)
    root = random.standard_normal((SIZE, SIZE))
    moves = random.standard_normal((3, SIZE))
    return {
        "state": random.standard_normal(SIZE),
        "covariance": root @ root.T,
        "moves": moves,
        "residual": random.standard_normal(MEASURED),
        "variance": random.uniform(0.5, 1.5, MEASURED),
    }


def room():
    return np.zeros((2, MEASURED, MEASURED)), np.zeros((5, MEASURED)), np.zeros((4, 3))


def textbook(case):
    """State, covariance, log-likelihood and the inverse of the residuals' covariance, by matrices with u in them."""
    whole = case["covariance"] + FREE * case["moves"].T @ case["moves"]
    measured = slice(FIRST, FIRST + MEASURED)
    joint = whole[measured, measured] + np.diag(case["variance"])
    gain = whole[:, measured] @ np.linalg.inv(joint)
    state = case["state"] + gain @ case["residual"]
    explained = case["residual"] @ np.linalg.solve(joint, case["residual"])
    return state, whole - gain @ whole[measured], explained, np.linalg.slogdet(joint)[1], np.linalg.inv(joint)


def test_update_is_that_of_one_large_state(case):
    factor, whitened, small = room()
    state, covariance = case["state"].copy(), case["covariance"].copy()
    found = factored(covariance, FIRST, case["moves"], case["residual"], case["variance"], factor, whitened, small)
    corrected(state, covariance, FIRST, case["moves"], factor, whitened, small, np.zeros((MEASURED + 3, SIZE)))
    expected = textbook(case)
    np.testing.assert_allclose(state, expected[0], rtol=1e-9)
    np.testing.assert_allclose(covariance, expected[1], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found[0], expected[2], rtol=1e-9)
    np.testing.assert_allclose(found[1] + 3 * np.log(FREE), expected[3], rtol=1e-9)


def test_residuals_beside_all_others(case):
    factor, whitened, small = room()
    factored(case["covariance"], FIRST, case["moves"], case["residual"], case["variance"], factor, whitened, small)
    *_, inverse = textbook(case)
    squares, of_inverse = zip(*(beside(i, factor, whitened, small) for i in range(MEASURED)), strict=True)
    np.testing.assert_allclose(squares, (inverse @ case["residual"]) ** 2 / np.diag(inverse), rtol=1e-9)
    np.testing.assert_allclose(of_inverse, np.diag(inverse), rtol=1e-9)
