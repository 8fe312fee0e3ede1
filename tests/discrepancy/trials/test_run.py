"""Trials from end to end: what the finder gets, that trials go on where they stopped, what a diagnosis says."""

import dataclasses
import json
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import pytest

from castor_envs.effects.dimensions import Track, WheelRadius
from castor_envs.effects.wiring import EncodersSwapped
from castor_envs.errors import InputError
from castor_envs.logs.csv import read_log
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight import Mistake
from discrepancy.trials import run, scores

ROBOT = preset("asoc-prototype")


@dataclass
class Candidate:
    kinds: tuple = ()


@dataclass
class Rank:
    candidate: Candidate


@dataclass
class Finding:
    verdict: str
    chosen: tuple = ()
    effect: object = None
    error: float | None = None


@dataclass
class Diagnosed:
    findings: tuple = ()


@dataclass
class Examined:
    data: dict
    diagnosis: Diagnosed = field(default_factory=Diagnosed)
    mistakes: tuple = ()
    found: object = None


def examined(verdict, findings=(), mistakes=(), found=None):
    return Examined({"verdict": verdict, "reason": "so"}, Diagnosed(findings), mistakes, found)


def said_by(*given: Any) -> run.Said:
    """What an examination of a verdict and findings says."""
    return run.said_by(cast("Any", examined(*given)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trial")
    run.make(2, 12, "pymunk", folder, duration=12.0, jobs=1)
    return folder


def test_the_finder_gets_logs_and_the_nominal_robot_alone(folder):
    for k in (1, 2):
        own = folder / "cases" / f"case-000{k}"
        assert sorted(path.name for path in own.iterdir()) == ["holdout.csv", "log.csv", "robot.json"]
        robot = RobotDescription.load(own / "robot.json")
        assert robot == ROBOT
        log, held_out = (read_log(own / name, robot) for name in ("log.csv", "holdout.csv"))
        assert len(log) == len(held_out) == 241
        assert not np.array_equal(log.wheel[-1], held_out.wheel[-1])
        assert log.reference is not None
        assert np.isfinite(log.reference[:, 0]).sum() == 13
    assert len(list((folder / "clean").glob("*.csv"))) == run.CLEAN


def test_labels_tell_what_is_hidden_and_how_strong(folder):
    label = json.loads((folder / "labels" / "case-0001.json").read_text(encoding="utf-8"))
    assert label["stratum"] == "one"
    assert len(label["hidden"]) == 1
    assert 5 / run.SLACK <= label["log"]["z"][0] <= 60 * run.SLACK
    assert label["log"]["z_sep"][0] <= label["log"]["z"][0] * 1.5
    clean = json.loads((folder / "labels" / "case-0002.json").read_text(encoding="utf-8"))
    assert clean["stratum"] == "clean"
    assert not clean["hidden"]


def test_a_trial_goes_on_where_it_stopped(folder):
    times = {
        path: path.stat().st_mtime_ns for part in ("cases", "labels", "clean") for path in (folder / part).rglob("*.*")
    }
    run.make(2, 12, "pymunk", folder, duration=12.0, jobs=1)
    assert times == {path: path.stat().st_mtime_ns for path in times}
    with pytest.raises(InputError, match="another trial"):
        run.make(2, 13, "pymunk", folder, duration=12.0, jobs=1)
    assert run.plan_of(folder).seed == 12


def test_unknown_generators_are_refused(tmp_path):
    with pytest.raises(InputError, match="unknown generator"):
        run.make(1, 0, "magic", tmp_path)
    with pytest.raises(InputError, match="no trial"):
        run.judge(tmp_path)


def test_what_was_found_is_driven_again(folder, monkeypatch):
    label = json.loads((folder / "labels" / "case-0001.json").read_text(encoding="utf-8"))
    truth = label["hidden"][0]["what"]
    plan, name, left = run.plan_of(folder), "case-0001", folder / "left" / "case-0001.json"
    true = RobotDescription.from_dict({**ROBOT.to_dict(), "effects": [truth]})
    for found, expected in ((true, 0.0), (None, 1.0)):
        monkeypatch.setattr(run, "examine", lambda *_, found=found, **__: examined("no discrepancy", found=found))
        run._judge_case(folder / "cases" / name, [], folder / "outcomes" / f"{name}.json")
        run._resimulate_case(plan, name, folder)
        assert json.loads(left.read_text(encoding="utf-8"))["left"] == pytest.approx(expected, abs=1e-6)
    assert scores.signal_left(scores.trials_of(folder))[0] == pytest.approx(1.0)


def test_a_finder_that_breaks_fails_its_own_case(folder, monkeypatch, tmp_path):
    for error, verdict in ((InputError("too short"), "refused"), (ZeroDivisionError("oh"), "broken")):

        def fails(*_, error=error, **__):
            raise error

        monkeypatch.setattr(run, "examine", fails)
        run._judge_case(folder / "cases" / "case-0002", [], tmp_path / "outcome.json")
        outcome = json.loads((tmp_path / "outcome.json").read_text(encoding="utf-8"))
        assert outcome["verdict"] == verdict
        assert str(error) in outcome["reason"]


def test_what_a_diagnosis_says():
    track, radius = Track(castor=1, value=1e-3), WheelRadius(castor=1, wheel=2, value=1e-3)
    known, other, nameless = (Rank(Candidate(kinds)) for kinds in ((track,), (radius,), ()))
    sure = Finding("named", (known,), track, 1e-4)
    assert said_by("named", (sure,)) == run.Said("named", ("track 1",), ("track 1",))
    unsure = Finding("ambiguous", (other, known))
    both = said_by("ambiguous", (sure, unsure))
    assert both == run.Said("ambiguous", ("track 1",), ("track 1", "wheel_radius 1 2"))
    assert said_by("ambiguous", (Finding("ambiguous", (known, nameless)),)).unnamed_rival
    unexplained = said_by("unexplained", (Finding("unexplained", (nameless,)),))
    assert unexplained == run.Said("unexplained", (), (), True)
    swapped = Mistake("left and right are swapped: so", (EncodersSwapped(castor=1),))
    assert said_by("named", (), (swapped,)).named == ("encoders_swapped 1",)
    assert said_by("ambiguous", (), (dataclasses.replace(swapped, alternatives=("or not",)),)).named == ()
    assert said_by("unconfirmed", (Finding("unconfirmed", (known,), track),)).possible == ()
