"""Curves of growth: every kind is measured, and page and picture show the stored ones."""

import json
from pathlib import Path

import pytest

from benchmarks.speed.figures import Effort
from benchmarks.speed.growth import diagnosis, memory, steps, stored
from benchmarks.speed.growth.curve import cost_of
from castor_envs.discovery import offers

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def script(script_called):
    return script_called("make_growth_plot")


def test_a_process_costs_its_own_time_and_memory():
    little, much = (cost_of(["-c", f"x = bytearray({size}); print(len(x))"]) for size in (10, 400_000_000))
    assert (little.said, much.said) == ("10\n", "400000000\n")
    assert much.memory > 380
    assert much.memory > little.memory
    with pytest.raises(RuntimeError, match="NameError"):
        cost_of(["-c", "unknown"])


def test_every_curve_has_a_cost_for_each_size(monkeypatch):
    monkeypatch.setattr(steps, "ROBOTS", (1, 2))
    monkeypatch.setattr(steps, "CASTORS", {1: "1-castor"})
    monkeypatch.setattr(steps, "AXLES", {2: "cfmmr-2"})
    monkeypatch.setattr(steps, "OBSTACLES", (0, 3))
    monkeypatch.setattr(stored, "ROWS", (5,))
    monkeypatch.setattr(stored, "ESTIMATORS", 1)
    monkeypatch.setattr(stored, "TASKS", ("configuration-static",))
    monkeypatch.setattr(memory, "CASES", (2,))
    monkeypatch.setattr(diagnosis, "diagnosed", lambda robot, length, logs: cost_of(["-c", "pass"]))
    found = [curve for curves in offers("benchmarks.speed.growth", "curves") for curve in curves(Effort(rounds=1))]
    assert {curve.over for curve in found} >= {
        "robots",
        "castors",
        "axles",
        "cables",
        "patches",
        "stored rows",
        "cases",
    }
    for curve in found:
        assert len(curve.sizes) == len(curve.costs) > 0
        assert min(curve.costs) > 0
        assert curve.unit in ("us", "s", "MB")


def test_a_straight_line_grows_with_the_power_of_one(script):
    assert script.steepness({"sizes": [1, 2, 6], "costs": [9, 4, 12]}) == pytest.approx(1)
    assert script.steepness({"sizes": [10, 1000], "costs": [5, 5]}) == pytest.approx(0)


def test_page_and_picture_show_the_stored_curves(script):
    page, curves = script.PAGE.read_text(encoding="utf-8"), json.loads(script.CURVES.read_text(encoding="utf-8"))
    assert curves["format"] == "castor-growth/1"
    assert script.with_table(page, curves) == page, "run python scripts/pictures/make_growth_plot.py"
    assert f"growth.json {script.digest(curves)}" in script.PICTURE.read_text(encoding="utf-8")


def test_what_growth_promises_holds_in_the_stored_curves(script):
    """Memory of a long run is flat; 1e5 rows and a diagnosis cost no more than in proportion to their size."""
    curves = {
        (of["title"], of["over"], of["unit"]): of for of in json.loads(script.CURVES.read_text("utf-8"))["curves"]
    }
    rows = curves["leaderboard", "stored rows", "s"]
    assert rows["sizes"][-1] == 100_000
    assert script.steepness(rows) < 1
    run = curves["a long run, its largest process", "cases", "MB"]["costs"]
    assert run[-1] < 1.1 * run[0]
    log = curves["diagnosis", "length of the log, s", "s"]
    assert log["costs"][-1] <= 0.2 * log["sizes"][-1]
    assert script.steepness(log) < 1.1
