"""Scores of trials, from labels and outcomes made by hand."""

import dataclasses
import json

import pytest

from castor_envs.errors import InputError
from discrepancy.trials.results import scores
from discrepancy.trials.results.scores import Trial, calibration_error, confusion, rates, reliability, size_as, wilson
from discrepancy.trials.run import Plan


def trial(stratum, truth=(), named=(), credible=None, z=30.0, z_sep=20.0, cost=0.01, held_out=30.0, **more):
    """A case in which classes `truth` were hidden and `named` said."""
    strength = {"z": [z] * len(truth), "z_sep": [z_sep] * len(truth), "cost": [cost] * len(truth)}
    strength |= {"nearest": ["track 9"] * len(truth)}  # type: ignore[dict-item]
    hidden = [{"class": own, "from": "catalogue", "what": {"name": own.split()[0], "value": 0.01}} for own in truth]
    label = {"stratum": stratum, "robot": "swerve", "clean": False, "reference": True, "hidden": hidden, "seconds": 1.0}
    label |= {
        "log": strength if truth else None,
        "holdout": {**strength, "z": [held_out] * len(truth)} if truth else None,
    }
    outcome = {
        "verdict": "named" if named else "no discrepancy",
        "named": dict.fromkeys(named, 1.0),
        "credible": [[name] for name in named] if credible is None else credible,
        "probabilities": dict.fromkeys(named, 1.0),
        "unnamed": False,
        "sizes": [],
        "gap": None,
        "seconds": 2.0,
    }
    return Trial(label | {key: more.pop(key) for key in ("clean", "robot") if key in more}, outcome | more)


def rate_of(trials, start, after=0):
    """Count and total of the rate that starts so, or of one some places after it."""
    found = rates(trials)
    (place,) = [k for k, one in enumerate(found) if one["what"].startswith(start)]
    return found[place + after]["count"], found[place + after]["total"]


def test_wilson_interval_as_published():
    # Brown, Cai and DasGupta (2001): centre (x + z^2/2) / (n + z^2)
    low, high = wilson(5, 10)
    assert (low, high) == pytest.approx((0.2366, 0.7634), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)


def test_calibration_error_by_hand():
    """Four names reported with 0.7, three of them right: off by 0.05. Two with 0.97, one right: off by 0.47."""
    reported = [(0.7, True)] * 3 + [(0.7, False), (0.97, True), (0.97, False)]
    bins = reliability(reported)
    assert [(one["what"], one["count"], one["total"]) for one in bins] == [("0.6 to 0.8", 3, 4), ("0.95 to 0.99", 1, 2)]
    assert [one["probability"] for one in bins] == pytest.approx([0.7, 0.97])
    assert calibration_error(bins) == pytest.approx((4 * 0.05 + 2 * 0.47) / 6)
    assert calibration_error(reliability([])) is None
    assert [one["total"] for one in reliability([(1.0, True), (0.99, True), (0.05, False)])] == [1, 2]


def test_names_are_reported_from_five_percent_on():
    one = trial("one", ["track 1"], probabilities={"track 1": 0.9, "track 2": 0.06, "track 3": 0.04})
    assert sorted(one.reported()) == [(0.06, False), (0.9, True)]
    assert trial("wiring", ["encoders_swapped 1"], ["encoders_swapped 1"]).reported() == []


def test_a_name_that_no_log_tells_from_what_was_hidden_is_right():
    alike = trial("one", ["track 1"], ["track 9"], z_sep=0.1)
    assert (alike.exact(), alike.among(), alike.wrong(), alike.reported()) == (True, True, False, [(1.0, True)])
    other = trial("one", ["track 1"], ["track 9"])
    assert (other.exact(), other.among(), other.wrong(), other.reported()) == (False, False, True, [(1.0, False)])


def test_a_name_that_is_said_to_be_the_same_as_what_was_hidden_is_right():
    same = {"pivot_position_x 1": ["pivot_position_x 2"]}
    told = trial("one", ["pivot_position_x 2"], ["pivot_position_x 1"], same_as=same)
    assert (told.exact(), told.among(), told.wrong(), told.reported()) == (True, True, False, [(1.0, True)])
    other = trial("one", ["pivot_position_x 3"], ["pivot_position_x 1"], same_as=same)
    assert (other.exact(), other.among(), other.wrong(), other.reported()) == (False, False, True, [(1.0, False)])
    itself = trial("one", ["pivot_position_x 1"], ["pivot_position_x 1"], same_as=same)
    assert (itself.exact(), itself.wrong()) == (True, False)


def test_any_word_on_a_clean_log_is_an_alarm_but_what_is_negligible():
    clean = [
        trial("clean"),
        trial("clean", verdict="negligible", credible=[["track 1"]]),
        trial("clean", verdict="unexplained", unnamed=True),
        trial("clean", verdict="unconfirmed", credible=[["track 1"]]),
        trial("clean", (), ["track 1"]),
    ]
    assert rate_of(clean, "clean: any alarm") == (3, 5)
    assert rate_of(clean, "clean: a sure name") == (1, 5)


def test_costly_names_count_where_there_are_no_clean_logs():
    def named(cost, clean=False):
        return trial("clean", (), ["track 1"], sizes=[{"class": "track 1", "cost": cost}], clean=clean)

    assert rate_of([named(5e-4), named(2e-3), named(2e-3, clean=True)], "clean, no clean logs given") == (1, 2)
    assert rate_of([trial("clean", (), ["encoders_swapped 1"])], "clean, no clean logs given") == (1, 1)


def test_an_effect_has_to_be_named_where_it_costs_and_stands_apart():
    right, wrong = trial("one", ["track 1"], ["track 1"]), trial("one", ["track 1"], ["track 2"])
    unsure = trial("one", ["track 1"], [], [["track 1", "track 2"]], verdict="ambiguous")
    beside = trial("one", ["track 1"], ["track 1"], verdict="unexplained", unnamed=True)
    asked = [right, wrong, unsure, beside]
    weak = [trial("one", ["track 1"], **one) for one in ({"cost": 1.9e-3}, {"z_sep": 4.9}, {"held_out": 4.9})]
    other = [trial("poor", ["track 1"]), trial("two", ["track 1", "track 2"])]
    every = [*asked, *weak, *other]
    assert rate_of(every, "one effect, 2 mm") == (1, 4)
    assert rate_of(every, "one effect, 2 mm", after=1) == (3, 4)
    assert rate_of(every, "one effect, 2 mm", after=2) == (1, 4)
    assert rate_of(every, "one effect of any cost") == (1, 5)


def test_several_effects_count_where_all_are_found():
    truth = ["track 1", "pivot_bias 2"]
    for stratum, more in (("two", []), ("three", ["wheel_radius 1 1"])):
        every = [*truth, *more]
        found = [trial(stratum, every, named) for named in (every[::-1], every[:1], [*every, "track 2"])]
        assert rate_of(found, f"{stratum} effects") == (1, 3)
        assert rate_of(found, f"{stratum} effects", after=1) == (2, 3)


def test_outside_the_catalogue():
    sure = trial("outside", ["Wobble"], ["track 1"])
    flagged = trial("outside", ["Wobble"], verdict="unexplained", unnamed=True)
    maybe = trial("outside", ["Wobble"], [], [["track 1"]], verdict="ambiguous", unnamed=True)
    quiet = trial("outside", ["Wobble"], z=10.0)
    assert rate_of([sure, flagged, maybe, quiet], "outside the catalogue: a sure name") == (1, 4)
    cheap = trial("outside", ["Wobble"], cost=1e-4)
    assert rate_of([sure, flagged, maybe, quiet, cheap], "outside the catalogue, 1 mm") == (2, 3)


def test_wiring_is_found_or_refused():
    truth = ["encoder_reversed 1 1"]
    assert rate_of([trial("wiring", truth, verdict="refused"), trial("wiring", truth, truth)], "wiring") == (2, 2)
    assert rate_of([trial("wiring", truth)], "wiring") == (0, 1)


def test_gaps_that_grow_and_finders_that_break():
    gaps = [None, {"before": 1e-3, "after": 2e-3}, {"before": 2e-3, "after": 1e-3}, {"before": 1e-3, "after": 1e-3}]
    assert rate_of([trial("one", ["track 1"], gap=gap) for gap in gaps], "something named") == (1, 3)
    assert rate_of([trial("clean", verdict="broken"), trial("clean")], "the finder broke") == (1, 2)


def test_wrong_names_count_whatever_is_hidden():
    cases = [trial("two", ["track 1", "track 2"], ["track 1", "track 3"]), trial("clean", [], ["track 1"])]
    cases += [trial("three", ["track 1"], ["track 1"]), trial("wiring", ["encoder_reversed 1 1"], ["track 1"])]
    assert rate_of(cases, "all but wiring: a sure name that is wrong") == (2, 3)


@pytest.mark.parametrize(("after", "grew"), [(2.04e-3, 0), (2.06e-3, 1)])
def test_a_gap_that_grows_by_more_than_the_errors_of_sizes_cost(after, grew):
    sizes = [
        {"class": "track 1", "low": 0.9, "high": 1.1, "cost": 6.3e-3, "effect": {"name": "track", "value": 1.0}},
        {"class": "track 2", "low": -2.2, "high": -1.8, "cost": 8.4e-3, "effect": {"name": "track", "value": -2.0}},
        {"class": "track 3", "low": None, "high": None, "cost": 9.0, "effect": {"name": "track", "value": 1.0}},
    ]  # 10 % of 6.3 and of 8.4 mm: 1.05 mm together
    case, exact = (trial("one", ["track 1"], sizes=of, gap={"before": 1e-3, "after": after}) for of in (sizes, []))
    assert case.cost_of_errors() == pytest.approx(1.05e-3)
    assert rate_of([case], "something named", 1) == (grew, 1)
    assert rate_of([exact], "something named", 1) == (1, 1)
    slight = trial("one", ["track 1"], sizes=[], gap={"before": 1e-3, "after": 1.9e-3})
    assert rate_of([slight], "something named", 1) == (0, 1)  # less than 1 mm


def test_sizes_of_equivalent_effects():
    radius, counts = {"name": "wheel_radius", "value": 0.01}, {"name": "counts_per_rev", "value": -0.01 / 1.01}
    assert size_as(radius, counts) == pytest.approx(counts["value"])
    assert size_as(counts, radius) == pytest.approx(0.01)
    wave = {"name": "wheel_eccentricity", "value": 0.02, "phase": 1.0}
    assert size_as(wave, {**wave, "phase": 1.0 - 3.141592653589793}) == pytest.approx(-0.02)


def test_intervals_count_where_the_name_is_right():
    trials = []
    for name, low, high in (
        ("track 1", 9e-3, 11e-3),
        ("track 1", 5e-3, 9.9e-3),
        ("track 2", 0.0, 1.0),
        ("track 1", None, None),
    ):
        effect = {"name": "track", "value": 0.01}
        size = {"class": name, "effect": effect, "low": low, "high": high, "cost": 0.01}
        trials.append(trial("one", ["track 1"], [name], sizes=[size]))
    assert rate_of(trials, "95 % intervals") == (1, 2)


def test_confusion_says_what_was_taken_for_what():
    table = confusion(
        [
            trial("one", ["track 1"], ["track 1"]),
            trial("one", ["track 1"], ["track 2"]),
            trial("one", ["track 1"], ["wheel_radius 1 1"]),
            trial("clean"),
        ]
    )
    assert table["track"] == {"track": 1, "track, another place": 1, "wheel_radius": 1}
    assert table["clean"] == {"no discrepancy": 1}


def test_report_is_plain_data_and_text(tmp_path):
    plan = Plan(3, 0, "pymunk", ["omni3", "swerve"], 60.0)
    (tmp_path / "trial.json").write_text(json.dumps(dataclasses.asdict(plan)), encoding="utf-8")
    with pytest.raises(InputError, match="judge"):
        scores.report(tmp_path)
    every = [trial("one", ["track 1"], ["track 1"]), trial("clean", robot="omni3"), trial("clean", clean=True)]
    for k, one in enumerate(every, start=1):
        for part, data in (("labels", one.label), ("outcomes/posterior", one.outcome)):
            (tmp_path / part).mkdir(exist_ok=True, parents=True)
            (tmp_path / part / f"case-{k:04}.json").write_text(json.dumps(data), encoding="utf-8")
    found = json.loads(json.dumps(scores.report(tmp_path), allow_nan=False))
    assert (found["format"], found["finder"], found["judged"]) == ("castor-trial/3", "posterior", 3)
    sizes = {name: group["cases"] for name, group in found["groups"].items()}
    parts = {"clean logs given": 1, "no clean logs given": 2, "with a reference": 3}
    assert sizes == {"omni3": 1, "swerve": 2, **parts}
    text = "\n".join(scores.lines(found))
    assert "100.0 % (  1/  1, 20.7 to 100.0)  one effect, 2 mm per 10 m and z_sep 5 or more: named exactly" in text
    assert "100.0 % (  1/  1, 20.7 to 100.0)  0.99 to 1, mean 1.000" in text
    assert "expected calibration error 0.000" in text
    assert "track: track 1" in text
