"""Scores of trials, from labels and outcomes made by hand."""

import json

import pytest

from castor_envs.errors import InputError
from discrepancy.trials import scores
from discrepancy.trials.scores import Trial, confusion, coverage, rates, signal_left, size_as, wilson


def trial(stratum, truth=(), named=(), possible=None, z=20.0, z_sep=20.0, held_out=20.0, **more):
    """A case in which classes `truth` were hidden and `named` said."""
    strength = {"z": [z] * len(truth), "z_sep": [z_sep] * len(truth)} if truth else None
    hidden = [{"class": own, "from": "catalogue", "what": {"name": own.split()[0], "value": 0.01}} for own in truth]
    label = {"stratum": stratum, "hidden": hidden, "log": strength, "seconds": 1.0}
    label["holdout"] = {"z": [held_out] * len(truth)} if truth else None
    outcome = {
        "verdict": "named" if named else "no discrepancy",
        "named": list(named),
        "possible": list(named if possible is None else possible),
        "unnamed_rival": False,
        "found": [],
        "seconds": 2.0,
    }
    return Trial(label, outcome | more, {"left": None})


def rate_of(trials, start):
    (found,) = [one for one in rates(trials) if one.what.startswith(start)]
    return found.count, found.total


def test_wilson_interval_as_published():
    # Brown, Cai and DasGupta (2001): centre (x + z^2/2) / (n + z^2)
    low, high = wilson(5, 10)
    assert (low, high) == pytest.approx((0.2366, 0.7634), abs=1e-4)
    assert wilson(0, 0) == (0.0, 1.0)


def test_named_exactly_needs_strength_separation_and_a_held_out_log_that_shows_it():
    right, wrong = trial("one", ["track 1"], ["track 1"]), trial("large", ["track 1"], ["track 2"])
    weak = [
        trial("one", ["track 1"], ["track 2"], z=7.9),
        trial("one", ["track 1"], ["track 2"], z_sep=4.9),
        trial("one", ["track 1"], ["track 2"], held_out=7.9),
        trial("poor", ["track 1"], ["track 2"]),
    ]
    assert rate_of([right, wrong, *weak], "one effect, z >= 8, z_sep >= 5: named exactly") == (1, 2)
    assert rate_of([right, wrong, *weak], "one effect, z >= 8: a wrong name") == (2, 3)


def test_a_set_with_the_truth_in_it_is_not_wrong():
    unsure = trial("one", ["track 1"], [], ["track 1", "track 2"], verdict="ambiguous")
    assert rate_of([unsure], "one effect, z >= 8: the truth among") == (1, 1)
    assert rate_of([unsure], "one effect, z >= 8: a wrong name") == (0, 1)
    assert rate_of([unsure], "one effect, z >= 8, z_sep") == (0, 1)


def test_the_right_name_with_something_unexplained_beside_it_is_not_exact():
    both = trial("one", ["track 1"], ["track 1"], verdict="unexplained", unnamed_rival=True)
    assert rate_of([both], "one effect, z >= 8, z_sep") == (0, 1)


def test_any_name_on_a_clean_log_is_false():
    clean = [trial("clean"), trial("clean", (), ["track 1"]), trial("clean", (), [], ["track 1", "track 2"])]
    assert rate_of(clean, "clean") == (2, 3)


def test_two_effects_count_where_both_are_found():
    truth = ["track 1", "pivot_bias 2"]
    found = [trial("two", truth, named) for named in (truth[::-1], truth[:1], [*truth, "track 2"])]
    assert rate_of([*found, trial("two", truth, [], z=9.0)], "two effects") == (1, 3)


def test_outside_the_catalogue():
    sure = trial("outside", ["Wobble"], ["track 1"], z=30.0)
    flagged = trial("outside", ["Wobble"], z=30.0, verdict="unexplained", unnamed_rival=True)
    maybe = trial("outside", ["Wobble"], [], ["track 1"], z=30.0, verdict="ambiguous", unnamed_rival=True)
    quiet = trial("outside", ["Wobble"], z=10.0)
    assert rate_of([sure, flagged, maybe, quiet], "outside the catalogue: a name") == (1, 4)
    assert rate_of([sure, flagged, maybe, quiet], "outside the catalogue, z >= 20") == (2, 3)


def test_wiring_is_counted_on_its_own():
    wired = trial("large", ["encoder_reversed 1 1"], z=9e3, verdict="refused")
    assert rate_of([wired], "wiring") == (1, 1)
    assert rate_of([wired], "one effect, z >= 8, z_sep") == (0, 0)


def test_bounds_are_those_of_the_generator():
    one = scores.Rate("", 90, 100, 0.8, 0.95, least=(0.97, 0.85))
    assert (one.reached(foreign=False), one.reached(foreign=True)) == (False, True)
    assert scores.Rate("", 0, 0, 0.0, 1.0, least=(0.97, 0.85)).reached(foreign=False) is None
    assert scores.Rate("", 2, 100, 0.0, 0.1, most=(0.01, 0.05)).reached(foreign=False) is False


def test_sizes_of_equivalent_effects():
    radius, counts = {"name": "wheel_radius", "value": 0.01}, {"name": "counts_per_rev", "value": -0.01 / 1.01}
    assert size_as(radius, counts) == pytest.approx(counts["value"])
    assert size_as(counts, radius) == pytest.approx(0.01)
    wave = {"name": "wheel_eccentricity", "value": 0.02, "phase": 1.0}
    assert size_as(wave, {**wave, "phase": 1.0 - 3.141592653589793}) == pytest.approx(-0.02)


def test_coverage_counts_true_sizes_within_two_errors():
    trials = []
    for value in (0.0115, 0.0081, 0.0301):
        found = {"class": "track 1", "effect": {"name": "track", "value": value}, "error": 1e-3}
        trials.append(trial("one", ["track 1"], ["track 1"], found=[found]))
    assert (coverage(trials)["track"].count, coverage(trials)["track"].total) == (2, 3)


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


def test_the_median_is_of_strong_single_effects():
    trials = []
    for left, z in ((0.1, 20.0), (0.3, 20.0), (0.2, 20.0), (1.0, 5.0)):
        one = trial("one", ["track 1"], ["track 1"], z=z)
        trials.append(Trial(one.label, one.outcome, {"left": left}))
    assert signal_left(trials) == (0.2, 3)


def test_report_is_plain_data_and_text(tmp_path):
    (tmp_path / "trial.json").write_text(json.dumps({"cases": 2, "seed": 0, "generator": "pymunk"}), encoding="utf-8")
    with pytest.raises(InputError, match="judge"):
        scores.report(tmp_path)
    for k, one in enumerate([trial("one", ["track 1"], ["track 1"]), trial("clean")], start=1):
        for part, data in (("labels", one.label), ("outcomes", one.outcome), ("left", one.left)):
            (tmp_path / part).mkdir(exist_ok=True)
            (tmp_path / part / f"case-{k:04}.json").write_text(json.dumps(data), encoding="utf-8")
    found = json.loads(json.dumps(scores.report(tmp_path), allow_nan=False))
    assert found["format"] == "castor-trial/2"
    text = "\n".join(scores.lines(found))
    assert "100.0 % (  1/  1, 20.7 to 100.0)  one effect, z >= 8, z_sep >= 5: named exactly" in text
    assert "track: track 1" in text
