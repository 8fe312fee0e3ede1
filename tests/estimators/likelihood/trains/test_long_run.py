"""The variance of a score by parts of a log, against the closed form of noise that lasts (autoregressive)."""

from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.sparse import csr_array

from estimators.likelihood.trains.states import Equations, _banded

SAMPLES, PART = 40_000, 100


def equations(noise) -> Equations:
    """Each sample has one unknown, which two rows measure; `noise` (SAMPLES, 2) is all that is left."""
    by_sample = csr_array((np.ones(2 * SAMPLES), np.repeat(np.arange(SAMPLES), 2), np.arange(2 * SAMPLES + 1)))
    nothing: Any = None
    columns = noise.ravel(), by_sample, np.zeros((2 * SAMPLES, 0))
    return Equations(nothing, nothing, {}, {}, {}, {}, nothing, *columns, _banded(by_sample, 1))


@pytest.mark.parametrize(("lasting", "expected"), [(0.0, 1.0), (0.5, 2.0), (0.8, 5.0), (-0.5, 2 / 3)])
def test_the_variance_is_that_over_long_times(lasting, expected):
    """The first row's noise has the variance 1 and the correlation `lasting` of neighbours: over long times its
    variance is (1 + lasting) / (1 - lasting). The second row's is white; the parameter shows in their difference."""
    random = np.random.default_rng(3)
    noise = random.standard_normal((SAMPLES, 2))
    noise[:, 0] = lfilter([np.sqrt(1 - lasting**2)], [1, -lasting], noise[:, 0])
    made = equations(noise)
    of_first = np.tile([1.0, 0.0], SAMPLES)[:, None]
    at = made.sample_of_rows(1)
    assert at.tolist() == np.repeat(np.arange(SAMPLES), 2).tolist()
    ratio = made.long_run(of_first, np.zeros(0), at // PART, random.standard_normal((2 * SAMPLES, 32)))
    assert ratio == pytest.approx([expected], rel=0.12)


def test_parameters_without_a_trace_have_the_variance_of_white_noise():
    """As one that a log does not show, beside one that it does."""
    random = np.random.default_rng(3)
    made, draws = equations(random.standard_normal((SAMPLES, 2))), random.standard_normal((2 * SAMPLES, 32))
    columns, parts = (
        np.column_stack([np.tile([1.0, 0.0], SAMPLES), np.zeros(2 * SAMPLES)]),
        made.sample_of_rows(1) // PART,
    )
    ratio = made.long_run(columns, np.zeros(0), parts, draws)
    assert ratio[0] == pytest.approx(made.long_run(columns[:, :1], np.zeros(0), parts, draws)[0])
    assert ratio[1] == 1.0
