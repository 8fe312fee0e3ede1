"""The cases of a trial that count against the finder, from labels and outcomes made by hand, and from stored ones."""

import json
from pathlib import Path

import pytest

from discrepancy.trials.results.missed import as_line, missed
from tests.discrepancy.trials.test_scores import trial

TRIALS = json.loads((Path(__file__).parents[3] / "docs" / "trials.json").read_text(encoding="utf-8"))["trials"]


def case(*given, **more):
    found = trial(*given, **{"reason": "", **more})
    found.label.update(case=7, course="wander")
    return found


def misses_of(one):
    (found,) = missed([one]) or [{"missed": []}]
    return found["missed"]


def test_right_answers_are_no_misses():
    right = [
        case("clean"),
        case("clean", verdict="negligible"),
        case("one", ["track 1"], ["track 1"]),
        case("one", ["track 1"], cost=1e-3),  # too little to be named
        case("one", ["track 1"], z_sep=4.0),
        case("two", ["track 1", "track 2"], ["track 1", "track 2"]),
        case("outside", ["Glitches"], verdict="unexplained", unnamed=True),
        case("wiring", ["encoders_swapped 1"], verdict="refused"),
    ]
    assert missed(right) == []


def test_each_wrong_answer_is_what_its_rate_counts():
    assert misses_of(case("clean", verdict="unconfirmed")) == ["alarm"]
    assert misses_of(case("clean", (), ["track 1"])) == ["alarm", "wrong sure name"]
    assert misses_of(case("one", ["track 1"], ["track 2"])) == ["wrong sure name", "not named"]
    assert misses_of(case("one", ["track 1"], ["track 1"], verdict="unexplained")) == ["not named exactly"]
    assert misses_of(case("outside", ["Glitches"])) == ["not flagged"]
    assert misses_of(case("wiring", ["encoders_swapped 1"])) == ["not found"]
    assert misses_of(case("one", ["track 1"], ["track 1"], gap={"before": 0.01, "after": 0.02})) == ["gap grew"]
    assert misses_of(case("clean", verdict="broken")) == ["broke down"]


def test_of_several_effects_only_those_count_that_are_costly_and_separate():
    one = case("two", ["track 1", "track 2"], ["track 1"])
    assert misses_of(one) == ["not named"]
    one.label["log"]["cost"][1] = 1e-3
    assert misses_of(one) == []


def test_a_miss_tells_sizes_in_units_that_people_read():
    named = {"class": "track 1", "effect": {"name": "track", "value": 0.02, "castor": 1}, "low": 0.018, "high": 0.022}
    wrong = {"class": "encoder_latency 1 None", "effect": {"name": "encoder_latency", "value": 0.004, "castor": 1}}
    wrong |= {"low": 0.0035, "high": 0.0045}
    found = case("one", ["track 1"], ["track 1", "encoder_latency 1 None"], sizes=[named, wrong], clean=True)
    assert as_line(missed([found])[0]) == (
        "case 7, wrong sure name, not named exactly (swerve, wander, clean logs, reference): track 1 1.00 % (10 mm)"
        " -> named: track 1 2.00 ± 0.20 %; encoder_latency 1 4.00 ± 0.50 ms"
    )


@pytest.mark.parametrize(
    "stored", [trial for trial in TRIALS if "missed" in trial], ids=lambda trial: trial["plan"]["seed"]
)
def test_as_many_cases_count_against_the_finder_as_the_rates_say(stored):
    hits = {rate["what"]: rate["count"] for rate in stored["rates"]}
    counted = {what: sum(what in miss["missed"] for miss in stored["missed"]) for what in ("alarm", "wrong sure name")}
    assert counted["alarm"] == hits["clean: any alarm"]
    assert counted["wrong sure name"] == hits["all but wiring: a sure name that is wrong"]
    plain = [
        rate for rate in stored["rates"] if rate["what"].endswith(": named exactly") and "any cost" not in rate["what"]
    ]
    not_exact = sum(rate["total"] - rate["count"] for rate in plain)
    assert (
        sum({"not named", "not named exactly"} & set(miss["missed"]) != set() for miss in stored["missed"]) >= not_exact
    )
