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
from discrepancy.trains.candidates import Candidate, named_candidates
from discrepancy.trials import folder as trials
from discrepancy.trials.results import scores
from discrepancy.trials.trains import run
from discrepancy.trials.trains.cases import BOUNDS, MIX, ONE_WAY, draw
from discrepancy.trials.trains.outside import KINDS, Outside
from discrepancy.trials.trains.simulate import log_at_random

TRAIN = cfmmr(2)
PLAN = run.TrainPlan(4, 5, "pymunk", ["cfmmr-2"], 6.0)


def test_cases_follow_from_number_and_seed():
    cases = [draw(number, 3, TRAIN) for number in range(1, 2 * len(MIX) + 1)]
    assert cases == [draw(number, 3, TRAIN) for number in range(1, 2 * len(MIX) + 1)]
    assert [case.drive for case in cases[:4]] == ["yielding", "held", "yielding", "held"]
    assert [case.stratum for case in cases[::2]] == [case.stratum for case in cases[1::2]] == list(MIX)
    for case in cases:
        assert len(case.hidden) == {"one": 1, "two": 2}.get(case.stratum, 0)
        assert (case.outside is not None) == (case.stratum == "outside")
        effects = [kind for one in case.hidden for kind in one.kinds]
        assert len({effect.name for effect in effects}) == len(case.hidden)
        for effect in effects:
            if effect.name not in BOUNDS:
                assert effect.name == "dead_gauge"
                continue
            low, high = BOUNDS[effect.name]
            assert low <= abs(effect.value) <= high
            assert effect.value > 0 or effect.name not in ONE_WAY


def test_bounds_are_sizes_that_effects_can_have():
    for case in (draw(number, 0, TRAIN) for number in range(1, 101)):
        train = TRAIN
        for one in case.hidden:
            train = one.added(train, [kind.value for kind in one.kinds])
        assert train.as_described() == TRAIN
        assert TrainDescription.from_dict(train.to_dict()) == train


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("trial")
    trials.make(PLAN, folder, jobs=1)
    return folder


def test_strengths_are_in_proportion_to_small_effects():
    radius = next(one for one in named_candidates(TRAIN) if one.what == "wheel radius, left wheel of axle 1")
    found = []
    for value in (0.004, 0.008):
        effect = Candidate.of(radius.effect([value]), TRAIN, axle=1)
        real = effect.added(TRAIN, [value])
        found.append(run.strength_of(real, log_at_random(real, 1, 5.0), [effect]))
    for key in ("cost", "z", "z_sep"):
        assert found[1][key][0] / found[0][key][0] == pytest.approx(2.0, rel=0.15)


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
    assert one["hidden"][0]["class"] == draw(1, 5, TRAIN).hidden[0].what
    assert one["log"]["cost"][0] > 0
    assert 0 < one["log"]["z_sep"][0] < one["log"]["z"][0]
    assert (clean["stratum"], clean["hidden"], clean["log"]["cost"]) == ("clean", [], [])


def test_a_trial_is_continued_and_judged(folder):
    times = {path: path.stat().st_mtime_ns for path in (folder / "cases").rglob("*.*")}
    trials.make(PLAN, folder, jobs=1)
    assert times == {path: path.stat().st_mtime_ns for path in times}
    with pytest.raises(InputError, match="another trial"):
        trials.make(dataclasses.replace(PLAN, seed=6), folder, jobs=1)
    trials.judge(PLAN, folder, jobs=1)
    scored = scores.report(folder)
    assert scored["judged"] == 4
    for name in ("wheels that yield to each other", "wheels held at speed"):
        counts = {one["what"]: (one["count"], one["total"]) for one in scored["groups"][name]["rates"]}
        assert counts["clean: a sure name"] == (0, 1)
        assert counts["the finder broke down"] == (0, 2)
    assert "4 of 4 cases, generator pymunk, seed 5" in "\n".join(scores.lines(scored))


def test_a_finder_that_breaks_fails_its_own_case(folder, monkeypatch, tmp_path):
    shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
    for error, verdict in ((InputError("too short"), "refused"), (ZeroDivisionError("oh"), "broken")):

        def fails(*_, error=error, **__):
            raise error

        monkeypatch.setattr(run, "diagnose_train", fails)
        path = tmp_path / "outcomes" / "posterior" / "case-0003.json"
        path.unlink(missing_ok=True)
        trials._judge_case(PLAN, 3, tmp_path)
        outcome = json.loads(path.read_text(encoding="utf-8"))
        assert (outcome["verdict"], outcome["named"]) == (verdict, {})
        assert str(error) in outcome["reason"]


def test_the_command_makes_judges_and_scores_trains(capsys):
    asked = ["trial", "--robot", "cfmmr-2", "--cases", "1", "--seed", "1", "--duration", "10", "--jobs", "1", "--json"]
    with pytest.raises(SystemExit) as ended:
        command_line.run(cli.app, asked)
    assert ended.value.code == 0
    scored = json.loads(capsys.readouterr().out)
    assert (scored["format"], scored["judged"]) == ("castor-trial/3", 1)
    assert (scored["plan"]["robots"], scored["plan"]["duration"]) == (["cfmmr-2"], 10.0)


@pytest.mark.parametrize("name", sorted(KINDS))
def test_a_fault_outside_the_catalogue_changes_only_the_log(folder, name):
    log = read_log(folder / "cases" / "case-0003" / "log.csv", TRAIN)
    size = KINDS[name][1]
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
