"""Doebbler's Table I: the simulation against the estimator on rolled logs, and against an independent recomputation."""

import numpy as np
import pytest

from benchmarks.calibration_simulation import errors_left
from benchmarks.comparison import Effort
from benchmarks.tables import select_tables


def percent(left):
    return [100 * mean for mean, _ in (left.offset, left.radius, left.half_track)] + [np.degrees(left.pivot_zero[0])]


def test_before_calibration_errors_have_the_printed_means():
    before, _ = errors_left(1000)
    np.testing.assert_allclose(percent(before), [0.21, 2.07, 0.89, 7.98], rtol=0.05)


def test_after_calibration_errors_are_those_of_an_independent_recomputation():
    """One full turn: D exact .089, .004, .013 %, .008 deg; D known to 0.05-0.07 % .098, .040, .042 %, .008 deg."""
    _, exact = errors_left(1000)
    r_c, r_w, d, beta = percent(exact)
    assert r_c == pytest.approx(0.089, rel=0.1)
    assert 0.002 < r_w < 0.005
    assert 0.008 < d < 0.014
    assert beta == pytest.approx(0.008, rel=0.1)
    _, known = errors_left(1000, 0.0006)
    np.testing.assert_allclose(percent(known), [0.098, 0.040, 0.042, 0.008], rtol=0.12)


def test_errors_scale_as_they_must():
    """What rounding leaves is not what D leaves: lengths inherit D's relative error, the pivot's bias none of it."""
    _, exact = errors_left(400)
    _, off = errors_left(400, 0.01)
    assert off.pivot_zero == pytest.approx(exact.pivot_zero)
    assert off.radius[0] / 0.01 == pytest.approx(off.half_track[0] / 0.01, rel=0.05)
    assert 0.5 < off.radius[0] / 0.01 < 0.8  # the mean of two uniform errors


def test_the_table_compares_by_ratio_and_says_what_is_open():
    (source,) = select_tables(["doebbler-1"])
    table = source.compute(Effort(sets=200))
    assert len(table.comparisons) == 12
    ratios = {(dict(c.place)["column"], dict(c.place)["parameter"]): c.ratio or 0.0 for c in table.comparisons}
    assert all(0.8 < ratios["before", part] < 1.2 for part in ("offset", "radius", "half_track", "pivot_zero"))
    assert ratios["after, D exact", "radius"] < 0.2
    assert 0.8 < ratios["after, D known to 0.06 %", "radius"] < 1.3
    assert any("does not mention" in note for note in table.notes)
