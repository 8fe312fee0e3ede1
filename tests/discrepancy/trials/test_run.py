"""Trials from end to end: what the finder gets, that trials go on where they stopped, and what is kept of answers."""

import dataclasses
import json
from collections import Counter

import numpy as np
import pytest

from castor_envs.effects.clocks import ClockSkew, SampleJitter
from castor_envs.effects.dimensions import WheelRadius
from castor_envs.errors import InputError
from castor_envs.logs.csv import read_log
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials import folder as trials
from discrepancy.trials import run
from discrepancy.trials.cases import BOUNDS, SEVERAL
from discrepancy.trials.generators import generator
from discrepancy.trials.hidden import class_of
from discrepancy.trials.reading import as_recorded
from discrepancy.trials.results import scores
from discrepancy.trials.said import Said, Single

CASES, SEED, ROBOT = 5, 18, "2-castor"
PLAN = run.Plan(CASES, SEED, "pymunk", [ROBOT], 12.0)


@pytest.fixture(autouse=True, scope="module")
def _here():
    """Do all tasks in this process: what other processes do is tested by the command."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trials, "do_all", lambda tasks, jobs: [work(*given) for work, given in tasks])
        yield


def make(folder, **more):
    trials.make(dataclasses.replace(PLAN, **more), folder)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trial")
    make(folder)
    return folder


def read(path):
    return json.loads(path.read_text(encoding="utf-8"))


def labels(folder):
    return [read(path) for path in sorted((folder / "labels").glob("*.json"))]


def judged(folder, monkeypatch, finder):
    """The outcomes of a trial by a finder that is a function."""
    monkeypatch.setattr(run, "say", finder)
    for path in (folder / "outcomes" / "posterior").glob("*.json"):
        path.unlink()
    trials.judge(PLAN, folder)
    return [read(path) for path in sorted((folder / "outcomes" / "posterior").glob("*.json"))]


def test_there_is_something_of_each(folder):
    """The seed was chosen so that few cases have it all."""
    found = labels(folder)
    assert {label["stratum"] for label in found} >= {"clean", "one", "outside", "wiring"}
    for key in ("clean", "reference", "measure"):
        assert len({label[key] for label in found}) == 2


def test_labels_are_what_number_and_seed_say(folder, tmp_path):
    for label in labels(folder):
        case = PLAN.setting(label["case"])
        told = ("stratum", "robot", "course", "clean", "reference", "measure")
        assert [label[key] for key in told] == [getattr(case, key) for key in told]
    for part in ("cases", "labels"):
        (tmp_path / part).mkdir()
    for number in (2, 3):
        name = f"case-{number:04}"
        trials._make_case(PLAN, number, tmp_path)
        first, second = (read(base / "labels" / f"{name}.json") for base in (folder, tmp_path))
        assert {**first, "seconds": 0} == {**second, "seconds": 0}
        for path in (folder / "cases" / name).iterdir():
            assert path.read_bytes() == (tmp_path / "cases" / name / path.name).read_bytes()


def test_strengths_are_within_their_bounds(folder):
    for label in labels(folder):
        hidden = label["hidden"]
        if label["stratum"] in ("clean", "wiring"):
            assert not label["targets"]
            continue
        assert len(hidden) == SEVERAL.get(label["stratum"], 1)
        low, high = BOUNDS[label["measure"]]
        low = low if len(hidden) == 1 or label["measure"] == "cost" else 0.0
        assert all(low / run.SLACK <= size <= high * run.SLACK for size in label["log"][label["measure"]])
        for log in (label["log"], label["holdout"]):
            assert len(log["cost"]) == len(log["z"]) == len(log["z_sep"]) == len(hidden)
            assert all(z_sep <= z * (1 + 1e-6) for z, z_sep in zip(log["z"], log["z_sep"], strict=True))


def test_the_finder_gets_logs_and_the_nominal_robot_alone(folder, monkeypatch):
    given = []
    judged(folder, monkeypatch, lambda *what: given.append(what) or Said("no discrepancy"))
    assert len(given) == CASES
    for label, (robot, logs, held_out, clean) in zip(labels(folder), given, strict=True):
        own = folder / "cases" / f"case-{label['case']:04}"
        assert sorted(path.name for path in own.iterdir()) == ["holdout.csv", "log.csv", "robot.json"]
        assert robot == RobotDescription.load(own / "robot.json") == preset(ROBOT)
        (log,), (other,) = logs.values(), held_out.values()
        np.testing.assert_array_equal(log.wheel, read_log(own / "log.csv", robot).wheel)
        assert len(log) == len(other) == 241
        assert not np.array_equal(log.wheel[-1], other.wheel[-1])
        assert len(clean) == (run.CLEAN if label["clean"] else 0)
        for one in (log, other, *clean.values()):
            assert (one.reference is not None) == label["reference"]
            assert one.reference is None or np.isfinite(one.reference[:, 0]).sum() == 13
    assert sorted(path.name for path in (folder / "clean" / ROBOT).iterdir()) == ["1.csv", "2.csv", "3.csv"]


def test_a_trial_goes_on_where_it_stopped(folder, monkeypatch):
    times = {path: path.stat().st_mtime_ns for part in ("cases", "clean") for path in (folder / part).rglob("*.csv")}
    (folder / "labels" / "case-0002.json").unlink()
    make(folder)
    changed = {path.parent.name for path, time in times.items() if path.stat().st_mtime_ns != time}
    assert changed == {"case-0002"}
    with pytest.raises(InputError, match="another trial"):
        make(folder, duration=14.0)

    judged(folder, monkeypatch, lambda *_: Said("no discrepancy"))
    (folder / "outcomes" / "posterior" / "case-0003.json").unlink()
    monkeypatch.setattr(run, "say", lambda *_: Said("unexplained"))
    trials.judge(PLAN, folder)
    said = Counter(read(path)["verdict"] for path in (folder / "outcomes" / "posterior").glob("*.json"))
    assert said == {"no discrepancy": CASES - 1, "unexplained": 1}


def test_a_finder_that_knows_the_truth_is_right_throughout(folder, monkeypatch):
    truths = iter(
        [[RobotDescription.from_dict({**preset(ROBOT).to_dict(), "effects": [hidden["what"]]}).effects[0]
          for hidden in label["hidden"] if hidden["from"] != "outside"] for label in labels(folder)]
    )  # fmt: skip

    def knows(robot, *_):
        effects: list[Effect] = next(truths)
        named = [(class_of(one), one.value - 1e-9, one.value + 1e-9, one) for one in effects]
        sizes = [
            {"class": name, "low": low, "high": high, "effect": one, "cost": None} for name, low, high, one in named
        ]
        return Said.of([Single("named", {size["class"]: 1.0}, (size["class"],), size) for size in sizes])

    outcomes = judged(folder, monkeypatch, knows)
    for label, outcome in zip(labels(folder), outcomes, strict=True):
        hidden = [one["what"] for one in label["hidden"] if one["from"] != "outside"]
        assert [size["effect"] for size in outcome["sizes"]] == hidden
    gaps = [outcome["gap"] for outcome in outcomes if outcome["gap"]]
    assert gaps
    assert all(gap["after"] <= 1.05 * gap["before"] for gap in gaps)
    every = scores.report(folder)["all"]
    rates = {rate["what"]: rate for rate in every["rates"]}
    assert rates["clean: any alarm"]["count"] == 0
    assert rates["wiring: named, or refused with a reason"]["share"] == 1.0
    assert rates[scores.COVERED]["share"] == 1.0
    assert every["calibration_error"] == pytest.approx(0.0, abs=1e-9)


def test_a_finder_that_breaks_fails_its_own_case(folder, monkeypatch):
    for error, verdict in ((InputError("too short"), "refused"), (ZeroDivisionError("oh"), "broken")):

        def fails(*_, error=error):
            raise error

        outcomes = judged(folder, monkeypatch, fails)
        assert {outcome["verdict"] for outcome in outcomes} == {verdict}
        assert all(str(error) in outcome["reason"] for outcome in outcomes)


def test_what_cannot_be_is_refused(tmp_path):
    with pytest.raises(InputError, match="unknown generator"):
        run.Plan.of(1, 0, "magic", None, 12.0)
    with pytest.raises(InputError, match="unknown robot"):
        run.Plan.of(1, 0, "pymunk", "magic", 12.0)
    with pytest.raises(InputError, match="no trial"):
        scores.report(tmp_path)


def test_robots_are_those_that_a_generator_can_drive():
    source = generator("pymunk")

    def only_on_two_wheels(robot, *given, **more):
        if len(robot.wheels) > 2:
            raise InputError("too many wheels")
        return source.drive(robot, *given, **more)

    choosy = source._replace(drive=only_on_two_wheels)
    assert run.robots_for(choosy) == ["1-castor", "differential"]
    with pytest.raises(InputError, match="too many wheels"):
        run.robots_for(choosy, "swerve")


def test_the_gap_is_that_of_the_path_by_encoders_alone():
    """Effects of clocks and jitter change when robots are seen, not how they move: with the truth in the model, only
    the encoders' rounding is left."""
    robot, case = preset("3-castor"), dataclasses.replace(PLAN, robots=["3-castor"]).setting(1)
    radius, skew = WheelRadius(castor=1, wheel=1, value=5e-3), ClockSkew(value=2e-2)
    jitter = SampleJitter(value=0.01, seed=0)
    trial_run = run.TrialRun(case, 1, generator("pymunk"), 20.0)
    log = as_recorded(robot, trial_run.drive(radius, skew), np.random.default_rng(1))
    path = trial_run.drive(*(effect for effect in (radius, skew) if not run._of_reference(effect))).reference
    assert path is not None

    def gap(*effects):
        sizes = [
            {"class": class_of(effect), "low": 0.0, "high": 1.0, "effect": effect, "cost": None} for effect in effects
        ]
        names = [Single("named", {size["class"]: 1.0}, (size["class"],), size) for size in sizes]
        found = run._gap(Said.of(names), robot, log, path)
        assert found is not None
        return found["before"], found["after"]

    before, after = gap(radius, skew)
    assert after < min(before / 5, 2e-3)
    before, after = gap(jitter)
    assert after == before


def test_a_report_that_breaks_down_counts_as_the_finder(tmp_path, monkeypatch):
    plan = run.Plan(1, 3, "pymunk", ["differential"], 10.0)
    trials.make(plan, tmp_path, jobs=1)

    def broken(*_):
        raise KeyError("size")

    monkeypatch.setattr("discrepancy.report.sentences.sentence", broken)
    trials._judge_case(plan, 1, tmp_path)
    (outcome,) = [outcome for _, outcome in trials.judged(tmp_path)]
    assert outcome["verdict"] == "broken"
    assert "KeyError" in outcome["reason"]
