"""Trains with hidden effects: what the posterior says of them, on perfect rolling."""

import dataclasses
import json
from contextlib import redirect_stdout
from io import StringIO
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from castor_envs.cli import command_line
from castor_envs.effects.train import DeadGauge, SensorStops
from castor_envs.errors import InputError
from castor_envs.logs.csv import write_log
from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.train import TrainDescription
from discrepancy import cli
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.calibrated import CREDIBLE, NOTHING
from discrepancy.posterior.verdicts import Material
from discrepancy.report import sentences
from discrepancy.trains.candidates import Candidate
from discrepancy.trains.gauges import with_dead_gauges
from discrepancy.trains.posterior import _less_certain, diagnose_train


def found_in(*logs, **more):
    """What the finder says of such logs."""
    return diagnose_train(logs[0][1], [log for log, _ in logs], **more)


def only(found):
    """The one answer that matters."""
    (answer,) = (answer for answer in found.answers if answer.verdict != "negligible")
    return answer


def named(found):
    """The sizes of effects that are named, by their names and axles."""
    sure = [(one.candidate, one.size) for one in found.answers if one.verdict == "named"]
    return {(candidate.kind.name, candidate.axle): size for candidate, size in sure}


@pytest.mark.parametrize("seed", [1, 2])
def test_a_train_in_good_order_raises_no_alarm(driven, seed):
    found = found_in(driven(seed=seed, reference=seed > 1))
    assert found.verdict in ("no discrepancy", "negligible")
    assert found.found == found.robot
    assert (found.before.gap is None) == (seed == 1)


def test_an_effect_is_named_within_its_interval(driven, hidden_effect):
    how, effect, axle = hidden_effect
    found = found_in(driven(**how), held_out=[driven(seed=2, **how)[0]])
    answer = only(found)
    assert (found.verdict, type(answer.effect)) == ("named", type(effect)), answer.reason
    assert [*named(found)] == [(effect.name, axle)]
    assert abs(answer.size - effect.value) < 3 * answer.error < abs(effect.value)
    assert answer.probability > 0.95
    assert found.found.as_described() == found.robot


def test_a_dead_gauge_is_there_or_not(driven):
    found = found_in(driven(dead=(3,)), held_out=[driven(seed=2, dead=(3,))[0]])
    assert found.verdict == "named"
    assert only(found).effect == DeadGauge(frame=1, gauge=3)
    assert found.held_out is not None
    before, after = (seen.gap for seen in found.held_out)
    assert before is not None
    assert after is not None
    assert after[1] < before[1]


@pytest.mark.parametrize("more", [8.0, 9.5])
def test_probabilities_of_dead_gauges_are_those_of_fits(more):
    """Of one frame's four gauges, of which logs are likelier by `more` with the second dead, by 3 less with the first;
    the answer by the linear formula is another."""
    gauges = tuple(Candidate.of(DeadGauge(frame=1, gauge=k), cfmmr(2)) for k in (1, 2, 3, 4))
    evidence = dict(zip(gauges, (more - 3, more, -50.0, -60.0), strict=True))
    seen: Any = SimpleNamespace(train=cfmmr(2), candidates=gauges, cost=np.ones((2, 4)), log_evidence=0.0)
    linear = Answer.judged_apart(gauges[3], 0.9, 1.0, 0.0, np.ones(2))

    def look(named, *_) -> Any:
        return SimpleNamespace(log_evidence=evidence[named[0].candidate])

    names = 5
    (answer,) = with_dead_gauges([linear], [], look, seen, names)
    odds = np.exp([more - 3, more]) * (1 - NOTHING) / NOTHING / names
    _, second, nothing = np.array([*odds, 1.0]) / (1 + odds.sum())
    assert (answer.candidate, answer.absent) == (gauges[1], pytest.approx(nothing))
    assert answer.probabilities["nothing"] == pytest.approx(nothing)
    assert answer.probabilities[gauges[1].family] == pytest.approx(second)
    enough = second >= CREDIBLE * (1 - nothing)
    assert answer.credible == (gauges[1].family, gauges[0].family)[: 1 if enough else 2]


def test_a_weaker_effect_is_named_beside_a_dead_gauge(driven):
    """The dead gauge is in the model as it is: no error of its signature, however much it explains, hides others."""
    found = found_in(driven(dead=(4,), tracks=(0.98, 1.0)))
    assert [*named(found)] == [("dead_gauge", None), ("track", 1)]


def test_a_sensor_that_stops_is_named_at_its_time(driven):
    found = found_in(driven(stops=7.0), held_out=[driven(seed=2, stops=7.0)[0]])
    answer = only(found)
    assert (found.verdict, type(answer.effect)) == ("named", SensorStops)
    assert answer.size == pytest.approx(7.0, abs=0.06)
    denied = found_in(driven(stops=7.0), held_out=[driven(seed=2)[0]])
    assert only(denied).verdict == "unconfirmed"


def test_clocks_of_logs_may_begin_anywhere(driven):
    """As at a Unix time: when a sensor stops, and how far gauges have drifted, counts from the start of each log."""
    (log, train), (other, _) = driven(stops=7.0), driven(seed=2, stops=7.0)
    late, earlier = (dataclasses.replace(of, t=of.t + start) for of, start in ((log, 1.7e9), (other, -50.0)))
    found = diagnose_train(train, [late], held_out=[earlier])
    answer = only(found)
    assert (found.verdict, type(answer.effect)) == ("named", SensorStops)
    assert answer.size == pytest.approx(7.0, abs=0.06)
    assert found.before.log_evidence == pytest.approx(diagnose_train(train, [log]).before.log_evidence, abs=0.5)


def test_without_a_reference_sensors_and_wheels_suffice(driven):
    found = found_in(driven(tracks=(1.0, 0.97), reference=False))
    assert [*named(found)] == [("track", 2)]
    answer = only(found)
    assert abs(answer.size + 0.03) < 3 * answer.error < 0.03


def test_two_effects_are_named_together(driven):
    hidden = {"gains": (1.15,) * 4, "radii": (1.0, 1.015, 1.0, 1.0)}
    found = found_in(driven(**hidden), held_out=[driven(seed=2, **hidden)[0]])
    assert named(found) == {
        ("gauge_gain", None): pytest.approx(0.15, abs=0.02),
        ("wheel_radius", 1): pytest.approx(0.015, abs=1e-3),
    }
    assert found.verdict == "named"
    assert TrainDescription.from_dict(json.loads(json.dumps(found.found.to_dict()))) == found.found
    assert found.held_out is not None
    for before, after in ((found.before.gap, found.after.gap), [seen.gap for seen in found.held_out]):
        assert before is not None
        assert after is not None
        assert after[0] < 0.5 * before[0]


def test_a_wheel_that_loses_counts_for_a_while_is_unexplained(driven):
    found = found_in(driven(lost=(2, 4.5, 6.0, 0.08)))
    assert found.verdict == "unexplained"
    assert any(answer.credible == ("wheel 2l counts otherwise",) for answer in found.answers)
    assert found.found == found.robot


def test_a_name_that_held_out_logs_contradict_is_not_confirmed(driven):
    found = found_in(driven(tracks=(1.03, 1.0)), held_out=[driven(seed=2)[0]])
    assert only(found).verdict == "unconfirmed"


def test_a_motion_that_does_not_show_it_confirms_nothing(driven):
    hidden = {"tracks": (1.03, 1.0)}
    found = found_in(driven(**hidden), held_out=[driven(seed=2, straight=True, **hidden)[0]])
    assert only(found).verdict == "unconfirmed"
    assert found.found == found.robot


@pytest.mark.parametrize(("ratio", "log_odds"), [(1.0, 4.0), (2.0, -1.0), (5.0, -4.0)])
def test_what_lasting_slip_explains_as_well_counts_for_less(ratio, log_odds):
    """An effect that explains a deviance of 20 in white noise, of log odds of 4; its score varies `ratio` times as
    much."""
    odds, candidate = np.exp(4.0), Candidate("an effect", "an effect", "an effect")
    answer = Answer.judged_apart(candidate, odds / (1 + odds), 1.0, 0.3, np.ones(2))
    answer = dataclasses.replace(answer, explained=20.0, absent=answer.probabilities["nothing"])
    told = _less_certain(answer, ratio)
    assert np.log(told.probability / told.absent) == pytest.approx(log_odds)
    assert sum(told.probabilities.values()) == pytest.approx(1.0)
    assert told.error == pytest.approx(0.3 * ratio**0.5)


def test_effects_of_clean_logs_are_good_order(driven):
    worn = {"gains": (1.1,) * 4}
    clean = [driven(seed=seed, **worn)[0] for seed in (4, 5)]
    found = found_in(driven(tracks=(1.03, 1.0), **worn), clean=clean)
    assert [*named(found)] == [("track", 1)]


def test_an_effect_of_little_cost_is_negligible(driven):
    found = found_in(driven(drift=0.02), material=Material(10.0, 10.0))
    assert found.verdict == "negligible"
    assert found.found == found.robot


@pytest.fixture(scope="module", name="written")
def _written(driven, tmp_path_factory):
    """The folder of a log of a train with a wrong track, a held-out one and the train, and the report of these."""
    folder = tmp_path_factory.mktemp("written")
    for name, seed in (("log.csv", 1), ("held.csv", 2)):
        log, train = driven(seed=seed, tracks=(1.03, 1.0))
        write_log(folder / name, log, train)
    train.save(folder / "train.json")
    return folder


def told(folder, *options):
    """What castor-diagnose prints of the logs of a folder."""
    with redirect_stdout(StringIO()) as printed, pytest.raises(SystemExit) as end:
        command_line.run(cli.app, [str(folder / "log.csv"), "--holdout", str(folder / "held.csv"), *options])
    assert not end.value.code
    return printed.getvalue()


@pytest.fixture(scope="module", name="words")
def _words(written):
    """What it prints where it writes the folder `out`."""
    return told(written, "--out", str(written / "out"))


def test_json_and_text_agree(written, words):
    data = json.loads((written / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert (data["format"], data["verdict"]) == ("castor-diagnosis/2", "named")
    (answer,) = data["answers"]
    assert (answer["effect"]["name"], answer["effect"]["axle"]) == ("track", 1)
    lines = words.splitlines()
    assert lines == [*sentences.as_lines(data), f"written: {written / 'out'}"]
    assert any("track (distance between the wheels), axle 1" in line for line in lines)
    assert any("with train.json" in line for line in lines)


@pytest.mark.usefixtures("words")
def test_the_folder_holds_page_data_and_train(written):
    assert sorted(path.name for path in (written / "out").iterdir()) == ["diagnosis.json", "report.html", "train.json"]
    data = json.loads((written / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    assert data["robot_file"] == str(written / "out" / "train.json")
    page = (written / "out" / "report.html").read_text(encoding="utf-8")
    for said in (data["answers"][0]["what"], "log.csv", "held.csv", data["robot_file"]):
        assert said in page
    found, described = (TrainDescription.load(folder / "train.json") for folder in (written / "out", written))
    assert found.as_described() == described
    assert [effect.name for effect in found.modules[0].effects] == ["track"]
    again = json.loads(told(written, "--robot", str(written / "out" / "train.json"), "--json"))
    assert (again["verdict"], again["answers"]) == ("no discrepancy", [])
    for key in ("gap", "held_out_gap"):
        assert again[key][0] == pytest.approx(data[key][1], rel=1e-3)


def test_a_log_that_shows_nothing_or_is_of_another_train_is_refused(driven):
    log, train = driven(seconds=1.0, reference=False)
    with pytest.raises(InputError, match="neither relative poses nor a reference"):
        diagnose_train(train, [dataclasses.replace(log, rps=None, rps_age=None)])
    with pytest.raises(InputError, match="counts of 4 wheels; train 'CFMMR, 3 axles' has 6"):
        diagnose_train(cfmmr(3), [log])
    with pytest.raises(InputError, match="no log"):
        diagnose_train(train, [])
