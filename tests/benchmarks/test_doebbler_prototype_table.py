"""Doebbler's Table III beside physics: hidden parameter errors, all seven estimators."""

import numpy as np
import pytest

from benchmarks.comparison import Effort
from benchmarks.tables import select_tables
from benchmarks.tables.doebbler_prototype import TABLE_3, episode
from benchmarks.tasks.kinematic import true_robot


def test_estimators_get_the_nominal_robot_and_the_world_another():
    """The true square closes; odometry by the nominal wheels does not, and counts tell the other radii."""
    driven = episode(0)
    assert driven.robot == true_robot()
    for run in driven.runs:
        assert np.hypot(*run.truth[-1, :2]) < 0.05
    assert episode(0).digest == driven.digest != episode(1).digest


def test_means_over_robots_come_beside_the_paper_and_three_castors_beat_two():
    (source,) = select_tables(["doebbler-3"])
    table = source.compute(Effort(sets=6))
    ours = {c.row: float(c.ours) for c in table.comparisons}
    assert {c.row: c.printed for c in table.comparisons} == {name.upper(): float(e) for name, e in TABLE_3.items()}
    for i in (1, 2, 3):
        assert ours[f"IPEC-{i}"] == pytest.approx(ours[f"CAST-{i}"], rel=0.05)
    assert ours["CAST-0"] < np.mean([ours[f"CAST-{i}"] for i in (1, 2, 3)])
    assert all(100 < error < 900 for error in ours.values())
    assert "of 6. CAST-1 to -3 over CAST-0: printed 2.50" in table.notes[1]
