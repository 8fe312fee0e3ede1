"""Estimators that are given whole logs: judged as others are, and marked on every board."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from benchmarks.leaderboard.board import build
from benchmarks.results.rows import ResultsStore
from benchmarks.run.plan import Assignment, run
from benchmarks.run.worker_estimate import Failure, Timed, estimate_singly, observed_runs, time_updates, update_cost
from castor_envs.vehicles.load import load_vehicle
from estimators.plugins.conformance.check import check, refusal
from estimators.plugins.registry import load_estimator


def followed(plugin, name, episode):
    entry = load_estimator(plugin(f"smoothers:{name}"))
    return estimate_singly(entry.spec, entry.source_hash, observed_runs(episode))


def test_a_whole_log_gives_the_poses_of_the_samples(fake_tasks, fake_trains, plugin):
    for episode in (fake_tasks.Arcs().record(0), fake_trains.moving_train()):
        train = episode.runs[0].axles is not None
        online = load_estimator("train-odometry" if train else "wheel-odometry")
        expected = estimate_singly(online.spec, online.source_hash, observed_runs(episode))
        found = followed(plugin, "Whole", episode)
        assert isinstance(found, list)
        assert isinstance(expected, list)
        for whole, alone in zip(found, expected, strict=True):
            np.testing.assert_array_equal(whole.poses, alone.poses)
            assert whole.covariance is None


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Shortened", r"returned shape (60, 3) instead of (61, 3) in estimate"),
        ("LosesItself", "returned NaN or infinity at sample 5 of run 1"),
    ],
)
def test_other_answers_fail_the_case(fake_tasks, plugin, name, reason):
    assert followed(plugin, name, fake_tasks.Arcs().record(0)) == Failure(reason)


def test_who_writes_into_a_log_keeps_no_state_by_that(fake_tasks, plugin):
    """Each pass over a run gets the log as it was."""
    entry, runs = load_estimator(plugin("smoothers:Spoils")), observed_runs(fake_tasks.Arcs().record(0))
    wheel = runs[0].observations.wheel.copy()
    cost = time_updates(entry.spec, entry.source_hash, runs)
    assert isinstance(cost, Timed)
    assert cost.repeats
    np.testing.assert_array_equal(runs[0].observations.wheel, wheel)


def test_boards_mark_it_and_what_has_update_is_judged_by_that(tmp_path, fake_tasks, plugin, jobs_here):
    task = dataclasses.replace(fake_tasks.Arcs(), metric="ate")
    entries = tuple(load_estimator(plugin(f"smoothers:{name}")) for name in ("Whole", "Both"))
    assert [entry.name for entry in entries] == ["smoothers:Whole (smoother)", "smoothers:Both"]
    run([Assignment(task, (0, 1), entries)], tmp_path)
    (board,) = build([task], tmp_path).boards
    whole, both = board.entries
    assert (whole.estimator, both.estimator) == ("smoothers:Whole (smoother)", "smoothers:Both")
    assert both.stands_still
    row = ResultsStore(tmp_path).load(task.name, 1, entries[0].name, entries[0].source_hash, 0)
    assert row is not None
    assert row.failure is None
    timed = time_updates(entries[0].spec, entries[0].source_hash, observed_runs(task.record(0)))
    assert isinstance(timed, Timed)
    cost = update_cost([timed])
    assert cost.mean == pytest.approx(cost.worst, rel=0.5)


@pytest.mark.parametrize("preset", ["asoc-prototype", "differential", "cfmmr-3"])
def test_the_check_passes_a_smoother(plugin, preset):
    findings = check(load_estimator(plugin("smoothers:Whole")), load_vehicle(preset))
    assert [finding for finding in findings if not finding.passed] == []


def test_the_example_of_the_tutorial_is_one(tmp_path, fake_tasks):
    page = (Path(__file__).parents[3] / "docs" / "tutorials" / "own_estimator.md").read_text(encoding="utf-8")
    code, said = page.partition("# whole_log.py\n")[2].split("```")[:2]
    (tmp_path / "whole_log.py").write_text(code)
    entry, robot = load_estimator(str(tmp_path / "whole_log.py")), load_vehicle("differential")
    assert entry.name == "whole_log:WholeLog (smoother)"
    assert [finding for finding in check(entry, robot) if not finding.passed] == []
    assert refusal(entry, load_vehicle("swerve")) == "needs a differential robot"
    assert refusal(entry, load_vehicle("cfmmr-3")) == "is written for robots: it asks for 'castors'"
    episode = fake_tasks.Arcs().record(0)
    found, expected = (
        estimate_singly(of.spec, of.source_hash, observed_runs(episode))
        for of in (entry, load_estimator("dead-reckoning-1"))
    )
    assert isinstance(found, list)
    assert isinstance(expected, list)
    for whole, alone in zip(found, expected, strict=True):
        np.testing.assert_allclose(whole.poses, alone.poses, atol=1e-4)
    observations, k = episode.runs[0].log.observations(), len(episode.runs[0].log.t)
    shapes = {name: getattr(observations, name).shape for name in ("wheel", "pivot", "time")}
    assert shapes == {"wheel": (k, 2), "pivot": (k, 0), "time": (k,)}
    assert (observations.gyro, len(observations), len([*observations])) == (None, k, k)
    assert all(f"`{name}`" in said or f"`observations.{name}`" in said for name in shapes)


def test_the_check_hears_who_declines(plugin):
    entry = load_estimator(plugin("smoothers:Whole"))
    assert refusal(entry, load_vehicle("6-castor")) == "has too many castors"
    assert refusal(entry, load_vehicle("4-castor")) is None


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Shortened", "estimate returns shape (200, 3) instead of (201, 3): return an array of three numbers"),
        ("Spoils", "estimate changes 'wheel' that it is given: copy it"),
        ("Backwards", "returns the start pose first"),
        ("LosesItself", "return finite numbers"),
    ],
)
def test_the_check_names_what_is_wrong(plugin, name, words):
    findings = check(load_estimator(plugin(f"smoothers:{name}")), load_vehicle("differential"))
    wrong = [f"{finding.name}: {finding.message}" for finding in findings if not finding.passed]
    assert any(words in text for text in wrong), wrong
