"""The train finder's trial: what is drawn, what the finder gets, and how its words are scored."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

from castor_envs.cli import command_line
from castor_envs.errors import InputError
from castor_envs.logs.csv import read_log
from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.train import TrainDescription
from discrepancy import cli
from discrepancy.trials import folder as trials
from discrepancy.trials.trains import run, scores
from discrepancy.trials.trains.cases import BOUNDS, MIX, ONE_WAY, draw
from discrepancy.trials.trains.outside import KINDS, Outside
from discrepancy.trials.trains.scores import Trial

TRAIN = cfmmr(2)
PLAN = run.TrainPlan(4, 5, "cfmmr-2", 6.0)


def test_cases_follow_from_number_and_seed():
    cases = [draw(number, 3, TRAIN) for number in range(1, 2 * len(MIX) + 1)]
    assert cases == [draw(number, 3, TRAIN) for number in range(1, 2 * len(MIX) + 1)]
    assert [case.drive for case in cases[:4]] == ["yielding", "held", "yielding", "held"]
    assert [case.stratum for case in cases[::2]] == [case.stratum for case in cases[1::2]] == list(MIX)
    for case in cases:
        assert len(case.hidden) == {"one": 1, "two": 2}.get(case.stratum, 0)
        assert (case.outside is not None) == (case.stratum == "outside")
        assert len({one.effect.name for one in case.hidden}) == len(case.hidden)
        for one, third in zip(case.hidden, case.thirds, strict=True):
            if one.effect.name not in BOUNDS:
                assert (one.effect.name, third) == ("dead_gauge", "none")
                continue
            low, high = BOUNDS[one.effect.name]
            assert low <= abs(one.effect.value) <= high
            assert one.effect.value > 0 or one.effect.name not in ONE_WAY
            part = (abs(one.effect.value) / low) ** 3 / (high / low)
            assert (third == "small") == (part < 1)


def test_bounds_are_sizes_that_effects_can_have():
    for case in (draw(number, 0, TRAIN) for number in range(1, 101)):
        train = TRAIN
        for one in case.hidden:
            train = one.added(train)
        assert train.as_described() == TRAIN
        assert TrainDescription.from_dict(train.to_dict()) == train


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trial")
    trials.make(PLAN, folder, jobs=1)
    return folder


def test_the_finder_gets_only_logs_and_the_nominal_train(folder):
    for number in range(1, 5):
        own = folder / "cases" / f"case-000{number}"
        assert sorted(path.name for path in own.iterdir()) == ["holdout.csv", "log.csv", "train.json"]
        train = TrainDescription.load(own / "train.json")
        assert train == TRAIN
        log, held_out = (read_log(own / name, train) for name in ("log.csv", "holdout.csv"))
        assert log.t[-1] == pytest.approx(6.0, abs=3.0)
        assert log.wheel[-1].tolist() != held_out.wheel[-1].tolist()
    one, clean = (json.loads((folder / "labels" / f"case-000{k}.json").read_text()) for k in (1, 3))
    assert one["hidden"][0]["what"] == draw(1, 5, TRAIN).hidden[0].what(TRAIN)
    assert (clean["stratum"], clean["hidden"]) == ("clean", [])


def test_a_trial_is_continued_and_judged(folder):
    times = {path: path.stat().st_mtime_ns for path in (folder / "cases").rglob("*.*")}
    trials.make(PLAN, folder, jobs=1)
    assert times == {path: path.stat().st_mtime_ns for path in times}
    with pytest.raises(InputError, match="another trial"):
        trials.make(dataclasses.replace(PLAN, seed=6), folder, jobs=1)
    trials.judge(PLAN, folder, jobs=1)
    scored = scores.report(folder)
    assert scored["judged"] == 4
    for own in scored["drives"].values():
        counts = {one["what"]: (one["count"], one["total"]) for one in own["rates"]}
        assert counts["clean: an effect named (false positive)"] == (0, 1)
        assert counts["the finder broke down"] == (0, 2)
    text = "\n".join(scores.lines(scored))
    assert "Wheels held at speed:" in text
    assert "4 of 4 cases, cfmmr-2, seed 5" in text


def test_a_finder_that_breaks_fails_its_own_case(folder, monkeypatch, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    for error, verdict in ((InputError("too short"), "refused"), (ZeroDivisionError("oh"), "broken")):

        def fails(*_, error=error, **__):
            raise error

        monkeypatch.setattr(run, "diagnose_train", fails)
        path = tmp_path / "outcomes" / "case-0003.json"
        path.unlink(missing_ok=True)
        trials._judge_case(PLAN, 3, tmp_path)
        outcome = json.loads(path.read_text(encoding="utf-8"))
        assert (outcome["verdict"], outcome["named"]) == (verdict, [])
        assert str(error) in outcome["reason"]


def trial(hidden, named, possible=(), verdict="named", found=(), stratum="one"):
    """A case with these effects hidden, and the answer to it."""
    label = {
        "stratum": stratum,
        "hidden": [{"what": one, "name": one, "value": 1.0, "third": "large"} for one in hidden],
    }
    outcome = {"verdict": verdict, "named": list(named), "possible": [*named, *possible], "found": list(found)}
    return Trial(label, outcome)


def test_scores_compare_answers_with_what_was_hidden():
    right, missed = trial("a", "a"), trial("a", "", verdict="no discrepancy")
    unsure, other, more = trial("a", "", "ab", "ambiguous"), trial("a", "b"), trial("a", "ab")
    flagged = trial("a", "a", verdict="unexplained")
    every = (right, missed, unsure, other, more, flagged)
    assert [one.exact for one in every] == [True, False, False, False, False, False]
    assert [one.in_the_set for one in every] == [True, False, True, False, True, True]
    assert [one.wrong for one in every] == [False, False, False, True, False, False]
    assert [one.extra for one in every] == [False, False, False, True, True, False]
    counts = {one.what: (one.count, one.total) for one in scores.rates(every)}
    assert counts["one effect: named exactly"] == (1, 6)
    assert counts["  of large size"] == (1, 6)
    assert counts["  of small size"] == (0, 0)
    found = [{"what": "a", "value": value, "error": 0.1} for value in (1.1, 1.3)]
    covered = scores.rates([trial("a", "a", found=[one]) for one in found])[-1]
    assert (covered.count, covered.total) == (1, 2)


def test_the_command_makes_judges_and_scores_trains(capsys):
    asked = ["trial", "--robot", "cfmmr-2", "--cases", "1", "--seed", "1", "--duration", "10", "--jobs", "1", "--json"]
    with pytest.raises(SystemExit) as ended:
        command_line.run(cli.app, asked)
    assert ended.value.code == 0
    scored = json.loads(capsys.readouterr().out)
    assert (scored["format"], scored["judged"]) == ("castor-train-trial/3", 1)
    assert scored["plan"] == {"cases": 1, "seed": 1, "train": "cfmmr-2", "duration": 10.0}


@pytest.mark.parametrize("name", sorted(KINDS))
def test_a_fault_outside_the_catalogue_changes_only_the_log(folder, name):
    log = read_log(folder / "cases" / "case-0003" / "log.csv", TRAIN)
    size = KINDS[name][2]
    changed = Outside(name, wheel=1, frame=0, value=size, begins=0.3).changed(TRAIN, log)
    assert np.array_equal(changed.t, log.t)
    assert changed.reference is log.reference
    others = [0, 2, 3]
    assert np.array_equal(changed.wheel[:, others], log.wheel[:, others])
    assert changed.rps is not None
    assert log.rps is not None
    assert not (np.array_equal(changed.wheel, log.wheel) and np.array_equal(changed.rps, log.rps))


def test_trains_have_no_foreign_simulator(capsys):
    with pytest.raises(SystemExit) as ended:
        command_line.run(cli.app, ["trial", "--robot", "cfmmr-2", "--generator", "mujoco"])
    assert ended.value.code == 2
    assert "trains have pymunk alone" in capsys.readouterr().err
