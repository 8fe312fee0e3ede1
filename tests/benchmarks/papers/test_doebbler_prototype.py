"""Doebbler's Table III beside physics: hidden parameter errors, all seven estimators."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.papers import select_tables
from benchmarks.papers.assumptions import Assumptions
from benchmarks.papers.comparison import Effort
from benchmarks.papers.doebbler_prototype import TABLE_3, episode
from benchmarks.tasks.kinematic import true_robot


def test_estimators_get_the_nominal_robot_and_the_world_another():
    """The true square closes; odometry by the nominal wheels does not, and counts show the other radii."""
    assumed = Assumptions(corners="fixed", speed=0.5)  # soon driven
    driven = episode(0, assumed)
    assert driven.robot == true_robot()
    for run in driven.runs:
        assert np.hypot(*run.truth[-1, :2]) < 0.05
    assert episode(0, assumed).digest == driven.digest
    assert episode(1, assumed).digest != driven.digest
    for change in ({"seed": 1}, {"distribution": "normal"}, {"speed": 0.4}):
        assert episode(0, replace(assumed, **change)).digest != driven.digest


@pytest.mark.slow
def test_means_over_robots_come_beside_the_paper_and_three_castors_beat_two():
    (source,) = select_tables(["doebbler-3"])
    table = source.compute(Effort(sets=2))
    computed = {c.row: float(c.ours) for c in table.comparisons}
    assert {c.row: c.printed for c in table.comparisons} == {name.upper(): float(e) for name, e in TABLE_3.items()}
    for i in (1, 2, 3):
        assert computed[f"IPEC-{i}"] == pytest.approx(computed[f"CAST-{i}"], rel=0.05)
    assert computed["CAST-0"] < np.mean([computed[f"CAST-{i}"] for i in (1, 2, 3)])
    assert all(100 < error < 900 for error in computed.values())
    assert "of 2. CAST-1 to -3 over CAST-0: printed 2.50" in table.notes[1]


def test_assumptions_are_those_of_the_drive():
    (source,) = select_tables(["doebbler-3"])
    assumed = Assumptions(robots=2, corners="rounded", corner_radius=0.2)
    table = source.compute(Effort(assumptions=assumed))
    conditions = {condition.key: condition.value for condition in table.conditions}
    assert (conditions["robots"], conditions["corners"], conditions["corner_radius_m"]) == (2, "rounded", 0.159)
    assert "rounds corners with 0.159 m, and no other radius" in table.notes[-1]
    assert "mean of 2 robots" in table.comparisons[0].column
    run = episode(0, assumed).runs[0]
    assert run.log.t[-1] == pytest.approx(5.727 / 0.25 + 0.25 / 0.5, abs=0.06)
