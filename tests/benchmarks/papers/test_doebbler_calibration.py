"""Doebbler's Table I: the simulation against the estimator on rolled logs, and against an independent recomputation."""

import dataclasses

import numpy as np
import pytest

from benchmarks.papers import select_tables
from benchmarks.papers.assumptions import Assumptions
from benchmarks.papers.comparison import Effort
from benchmarks.papers.simulations import errors_left
from castor_envs.vehicles.presets import preset


def percent(left):
    return [100 * mean for mean, _ in (left.offset, left.radius, left.half_track)] + [np.degrees(left.pivot_zero[0])]


def test_before_calibration_errors_have_the_printed_means():
    before, _ = errors_left(1000)
    np.testing.assert_allclose(percent(before), [0.21, 2.07, 0.89, 7.98], rtol=0.05)


def test_after_calibration_errors_are_those_of_an_independent_recomputation():
    """One full turn: D exact .089, .004, .013 %, .008 deg; D known to 0.05-0.07 % .098, .040, .042 %, .008 deg."""
    _, exact = errors_left(1000, exact=True)
    r_c, r_w, d, beta = percent(exact)
    assert r_c == pytest.approx(0.089, rel=0.1)
    assert 0.002 < r_w < 0.005
    assert 0.008 < d < 0.014
    assert beta == pytest.approx(0.008, rel=0.1)
    _, known = errors_left(1000)
    np.testing.assert_allclose(percent(known), [0.098, 0.040, 0.042, 0.008], rtol=0.12)


def test_errors_scale_as_they_must():
    """What rounding leaves is not what D leaves: lengths inherit D's relative error, the pivot's bias none of it."""
    _, exact = errors_left(400, exact=True)
    _, off = errors_left(400, Assumptions(distance_error=1.0))
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


def test_twice_the_turns_halve_what_rounding_leaves_of_wheels(tmp_path):
    """Counts of wheels are rounded once a run; pivots are read finely, so that nothing else is left."""
    robot = preset("asoc-prototype")
    castors = tuple(dataclasses.replace(castor, pivot_counts_per_rev=10**8) for castor in robot.castors)
    dataclasses.replace(robot, castors=castors).save(tmp_path / "fine.json")
    once, twice = (
        errors_left(400, Assumptions(robot=str(tmp_path / "fine.json"), turns=turns), exact=True)[1] for turns in (1, 2)
    )
    assert twice.radius[0] / once.radius[0] == pytest.approx(0.5, rel=0.05)
    assert twice.half_track[0] / once.half_track[0] == pytest.approx(0.5, rel=0.05)


def test_normal_errors_have_the_same_mean_size_and_seeds_differ():
    uniform, normal = (percent(errors_left(1000, Assumptions(distribution=name))[0]) for name in ("uniform", "normal"))
    np.testing.assert_allclose(normal, uniform, rtol=0.05)
    first, second = (percent(errors_left(50, Assumptions(seed=seed))[0]) for seed in (0, 1))
    assert first != second


def test_robots_of_another_size_and_number_of_castors_are_calibrated_too():
    """A larger base with the same encoders keeps its relative errors; its wheels turn as often."""
    small, large = (errors_left(300, Assumptions(robot=name))[1] for name in ("asoc-prototype", "asoc-full-scale"))
    np.testing.assert_allclose(percent(large), percent(small), rtol=1e-6)
    _, two = errors_left(300, Assumptions(robot="omnimate"))
    assert two.radius[0] == pytest.approx(6e-4, rel=0.2)  # one pair of pivots: the error of its distance


def test_the_last_column_names_its_distance_error():
    (source,) = select_tables(["doebbler-1"])
    table = source.compute(Effort(20, assumptions=Assumptions(distance_error=0.2)))
    assert {comparison.column for comparison in table.comparisons} == {
        "before",
        "after, D exact",
        "after, D known to 0.2 %",
    }
    assert {condition.key: condition.value for condition in table.conditions}["distance_error_percent"] == 0.2
