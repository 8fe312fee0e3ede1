"""Verdicts follow from probabilities, held-out logs and cost: on statistics that are written down by hand."""

import dataclasses
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from castor_envs.effects.dimensions import WheelRadius
from castor_envs.effects.encoders import TickLoss
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.posterior.model.refit import Sized
from discrepancy.posterior.random_effects import Statistics
from discrepancy.posterior.verdicts import MATERIAL, Material, by_all_logs, judged, weakest

CAUSE = Candidate("wheel radius", (WheelRadius(castor=1, wheel=1, value=0.01),))
ANSWER = Answer(
    probabilities={"wheel_radius 1 1": 1.0},
    credible=("wheel_radius 1 1",),
    unnamed=False,
    candidate=CAUSE,
    amplitudes=np.array([0.01]),
    covariance=np.array([[1e-8]]),
    cost=np.array([1.0, 1.0]),
)
UNKNOWN = Answer.judged_apart(Candidate("wheel_1l slips more and more"), 1.0, 0.01, 1e-4, 0.01 * ANSWER.cost)
"""An unnamed alternative of the same size and cost."""
ORDER: Any = SimpleNamespace(beyond=lambda logs: logs[0])


def seen(log_evidence, gap) -> Any:
    """Held-out logs that say 10 ± 0.1 mm, by the formula."""
    said = Statistics(np.array([[1e8]]), np.array([0.0]))
    return SimpleNamespace(
        candidates=(CAUSE,), columns={CAUSE: np.array([0])}, logs=(said,), usual=np.array([np.nan]),
        lasting=np.zeros(0, dtype=np.intp), redundant=True, masked=1.0, cost=np.ones((2, 1)),
        log_evidence=log_evidence, gap=gap,
    )  # fmt: skip


def verdict(without, with_named, material=MATERIAL, answer=ANSWER, fit=None):
    named = [Sized(CAUSE, ANSWER.amplitudes)]
    return weakest(answer.verdict for answer in judged([answer], named, (without, with_named), ORDER, material, fit))


@pytest.mark.parametrize(
    ("likelier", "gap", "expected"),
    [
        (LOG_ODDS + 1, (5e-3, 5e-3), "named"),
        (LOG_ODDS - 1, (5e-3, 5e-3), "unconfirmed"),
        (-500.0, (3.9e-3, 5e-3), "named"),
        (-500.0, (4.1e-3, 5e-3), "unconfirmed"),
        (-500.0, (5e-3, 3.9e-3), "named"),
        (LOG_ODDS + 1, (7e-3, 5e-3), "unconfirmed"),
        (LOG_ODDS + 1, (7e-3, 2e-3), "unconfirmed"),
        (LOG_ODDS + 1, (6.5e-3, 2e-3), "named"),
        (LOG_ODDS + 1, None, "named"),
        (LOG_ODDS - 1, None, "unconfirmed"),
    ],
)
def test_names_explain_held_out_logs_better_or_are_not_confirmed(likelier, gap, expected):
    """Better: 19 times as likely, fitted anew, or a gap that is smaller by what matters; and no larger gap, unless the
    heading's is smaller by more than the position's is larger: 6.5 and 2 are together less than 5 and 5."""
    without = seen(0.0, None if gap is None else (5e-3, 5e-3))
    assert verdict(without, seen(likelier, gap)) == expected


def test_one_effect_that_leaves_no_linear_trace_is_judged_by_fits_with_and_without_it():
    def untraced(log_evidence):
        held_out = seen(log_evidence, None)
        held_out.logs = (Statistics(np.zeros((1, 1)), np.zeros(1)),)
        return held_out

    assert verdict(untraced(0.0), untraced(LOG_ODDS + 1)) == "named"
    assert verdict(untraced(0.0), untraced(LOG_ODDS - 1)) == "unconfirmed"


def test_an_effect_that_costs_less_than_matters_is_negligible_whatever_held_out_logs_say():
    assert verdict(seen(0.0, None), seen(-500.0, None), Material(1.0, 1.0)) == "negligible"


def test_what_does_not_matter_is_hardly_among_what_is_missing():
    """Probabilities are of what is missing and matters; that this costs less is 95 % certain."""
    either = dataclasses.replace(
        ANSWER, probabilities={"radius": 0.9, "track": 0.08, "nothing": 0.02}, credible=("radius", "track")
    )
    (answer,) = judged([either], [Sized(CAUSE, ANSWER.amplitudes)], None, None, Material(1.0, 1.0))
    assert answer.verdict == "negligible"
    assert answer.probabilities == pytest.approx({"radius": 0.045, "track": 0.004, "nothing": 0.951})
    inclusion = by_all_logs({"radius": 0.9, "track": 0.08, "offset": 0.01}, [either], [answer])
    assert inclusion == pytest.approx({"radius": 0.045, "offset": 0.01, "track": 0.004})


def test_an_uncertain_size_is_no_excuse_for_a_larger_gap():
    unsure = dataclasses.replace(ANSWER, covariance=np.array([[1e-4]]))
    without, with_named = seen(0.0, (64e-3, 5e-3)), seen(500.0, (99e-3, 5e-3))
    assert verdict(without, with_named, answer=unsure) == "unconfirmed"


@pytest.mark.parametrize(("error", "expected"), [(0.0049, "named"), (0.0052, "unconfirmed")])
def test_an_effect_whose_size_may_be_zero_is_not_confirmed(error, expected):
    """It is there for certain, for what else it does, as to wheels that mask it; its size is 0.01."""
    unsure = dataclasses.replace(ANSWER, covariance=np.array([[error**2]]))
    (answer,) = judged([unsure], [Sized(CAUSE, ANSWER.amplitudes)], None, None, MATERIAL)
    assert (answer.verdict, "may be 0" in answer.reason) == (expected, expected == "unconfirmed")


@pytest.mark.parametrize(("size", "error", "expected"), [(0.49, 0.004, "named"), (0.49, 0.006, "unexplained")])
@pytest.mark.parametrize("sign", [1, -1])
def test_an_effect_that_may_be_as_large_as_it_can_be_at_all_is_not_named(size, error, expected, sign):
    """No radius is wrong by more than a half: logs that ask for that show something else."""
    large = dataclasses.replace(ANSWER, amplitudes=np.array([sign * size]), covariance=np.array([[error**2]]))
    (answer,) = judged([large], [Sized(CAUSE, large.amplitudes)], None, None, MATERIAL)
    assert (answer.verdict, "cannot be as large" in answer.reason) == (expected, expected == "unexplained")


@pytest.mark.parametrize(("costs_more", "expected", "probability"), [(0.9, "named", 1.0), (1.1, "unconfirmed", 0.5)])
def test_beside_something_unexplained_that_costs_more_a_name_is_not_sure(costs_more, expected, probability):
    """It may be a part of that, as likely as not."""
    unknown = dataclasses.replace(UNKNOWN, cost=costs_more * ANSWER.cost)
    answers = judged([ANSWER, unknown], [Sized(CAUSE, ANSWER.amplitudes)], None, None, MATERIAL)
    assert [answer.verdict for answer in answers] == [expected, "unexplained"]
    assert answers[0].probability == probability
    assert [sum(answer.probabilities.values()) for answer in answers] == [1.0, 1.0]


@pytest.mark.parametrize(
    ("stays", "usual", "expected"),
    [(0.49, None, "named"), (0.51, None, "unconfirmed"), (0.51, 0.2, "unconfirmed"), (0.51, 0.3, "named")],
)
def test_nor_is_one_with_which_half_of_the_held_out_gap_stays_whatever_it_costs(stays, usual, expected):
    """As counts lost in bursts, of which a name for other lost counts explains little."""
    unknown = dataclasses.replace(UNKNOWN, cost=0.5 * ANSWER.cost)
    held_out = seen(0.0, (20e-3, 5e-3)), seen(LOG_ODDS + 1, (20e-3 * stays, 5e-3))
    usual_gap = None if usual is None else (20e-3 * usual, 0.0)
    answers = judged([ANSWER, unknown], [Sized(CAUSE, ANSWER.amplitudes)], held_out, ORDER, MATERIAL, None, usual_gap)
    assert [answer.verdict for answer in answers] == [expected, "unexplained"]


@pytest.mark.parametrize(
    ("stays", "usual", "expected"), [(0.49, None, "named"), (0.51, None, "unconfirmed"), (0.51, 0.3, "named")]
)
def test_nor_is_one_with_which_half_of_the_logs_own_gap_stays(stays, usual, expected):
    """As a radius for counts lost in bursts, which shrinks the gap of the held-out logs by chance."""
    unknown = dataclasses.replace(UNKNOWN, cost=0.5 * ANSWER.cost)
    held_out = seen(0.0, (20e-3, 5e-3)), seen(LOG_ODDS + 1, (5e-3, 5e-3))
    own = seen(0.0, (20e-3, 5e-3)), seen(0.0, (20e-3 * stays, 5e-3))
    usual_gap = None if usual is None else (20e-3 * usual, 0.0)
    named = [Sized(CAUSE, ANSWER.amplitudes)]
    answers = judged([ANSWER, unknown], named, held_out, ORDER, MATERIAL, usual_gap=usual_gap, own=own)
    assert [answer.verdict for answer in answers] == [expected, "unexplained"]


@pytest.mark.parametrize(("heading", "expected"), [(0.49, "named"), (0.51, "unconfirmed")])
def test_nor_is_one_with_which_half_of_the_gap_in_heading_stays_where_that_is_larger(heading, expected):
    """As a reference turned on its mount, for an encoder of the only steered wheel that jumps."""
    unknown = dataclasses.replace(UNKNOWN, cost=0.5 * ANSWER.cost)
    held_out = seen(0.0, (2e-3, 50e-3)), seen(LOG_ODDS + 1, (2e-3, 50e-3 * heading))
    usual_gap = 2e-3, 2e-3
    answers = judged([ANSWER, unknown], [Sized(CAUSE, ANSWER.amplitudes)], held_out, ORDER, MATERIAL, None, usual_gap)
    assert [answer.verdict for answer in answers] == [expected, "unexplained"]


def test_nor_is_a_name_that_is_not_confirmed_and_its_reason_stays():
    unknown = dataclasses.replace(UNKNOWN, cost=1.1 * ANSWER.cost)
    unsure = dataclasses.replace(ANSWER, covariance=np.array([[0.0052**2]]))
    answer, _ = judged([unsure, unknown], [Sized(CAUSE, ANSWER.amplitudes)], None, None, MATERIAL)
    assert (answer.verdict, answer.probability, "may be 0" in answer.reason) == ("unconfirmed", 0.5, True)


@pytest.mark.parametrize(("absent", "expected"), [(1e-2, "no discrepancy"), (0.0, "unconfirmed")])
def test_an_effect_that_all_logs_together_deny_is_no_discrepancy(absent, expected):
    """By the formula the held-out logs are exp(50) times less likely with it."""
    said = Statistics(np.array([[1e6]]), np.array([-1e4]))
    held_out = seen(0.0, None)
    held_out.logs = (said,)
    assert verdict(seen(0.0, None), held_out, answer=dataclasses.replace(ANSWER, absent=absent)) == expected


@pytest.mark.parametrize(("truth", "expected"), [(0.01, "named"), (0.002, "unconfirmed")])
def test_a_small_effect_is_confirmed_by_the_linear_formula(truth, expected):
    """Of 0.01, by held-out logs that say 0.01 or 0.002, with an error of 0.003, whatever the fits' evidences are."""
    without, with_named = seen(0.0, None), seen(-100.0, None)
    without.logs = (Statistics(np.array([[1e5]]), np.array([1e5 * truth])),)
    assert verdict(without, with_named) == expected


@pytest.mark.parametrize(("other", "expected"), [(0.0, "named"), (-0.001, "named"), (-0.004, "unconfirmed")])
def test_an_effect_has_one_size_in_all_logs(other, expected):
    """Signatures may be wrong by 5 %, 0.5 mm of 10 mm; what is 40 % smaller in held-out logs is something else, even
    if they are much likelier with it."""
    held_out = seen(500.0, None)
    held_out.logs = (Statistics(np.array([[1e8]]), np.array([1e8 * other])),)
    assert verdict(seen(0.0, None), held_out) == expected


@pytest.mark.parametrize(("likelier", "expected"), [(LOG_ODDS - 1, "named"), (LOG_ODDS + 1, "unconfirmed")])
def test_another_size_counts_only_if_held_out_logs_are_likelier_with_it(likelier, expected):
    """Of large effects the formula may be far off."""
    held_out, tried = seen(500.0, None), []
    held_out.logs = (Statistics(np.array([[1e8]]), np.array([-4e5])),)

    def fit(effects):
        tried.extend(float(effect.size) for effect in effects)
        return seen(500.0 + likelier, None)

    assert verdict(seen(0.0, None), held_out, fit=fit) == expected
    assert tried == pytest.approx([0.006], abs=1e-4)


@pytest.mark.parametrize(
    ("information", "shown", "least", "most"),
    [
        (1e8, 0.01, 0.998, 0.9999),  # as large as found
        (1e-3, 0.0, 0.949, 0.951),  # nothing to see
        (1e8, 0.004, 0.0, 1e-3),  # another size
        (1e8, 0.0, 0.0, 1e-3),  # nothing there
        (1e5, 0.005, 0.94, 0.98),  # half of it, give or take a third
    ],
)
def test_the_probability_is_that_by_all_logs(information, shown, least, most):
    """Once in twenty what looks like an effect is something else, of which other logs show another size, or nothing."""
    held_out = seen(0.0, None)
    held_out.logs = (Statistics(np.array([[information]]), np.array([information * (shown - 0.01)])),)
    named = [Sized(CAUSE, ANSWER.amplitudes)]
    (answer,) = judged([ANSWER], named, (seen(0.0, None), held_out), ORDER, MATERIAL)
    assert least <= answer.probability < most
    assert sum(answer.probabilities.values()) == pytest.approx(1.0)


def test_without_held_out_logs_the_probability_is_that_of_the_posterior():
    (answer,) = judged([ANSWER], [Sized(CAUSE, ANSWER.amplitudes)], None, None, MATERIAL)
    assert answer.probability == ANSWER.probability


def test_a_name_that_held_out_logs_contradict_has_no_probability():
    """Else it would be told as certain beside "no discrepancy"."""
    by_first = {CAUSE.family: 1.0, "another": 0.01}
    assert by_all_logs(by_first, [ANSWER, UNKNOWN], [UNKNOWN]) == {UNKNOWN.credible[0]: 1.0, "another": 0.01}
    doubted = dataclasses.replace(ANSWER, probabilities={CAUSE.family: 0.5, "nothing": 0.5})
    assert by_all_logs(by_first, [ANSWER], [doubted]) == {CAUSE.family: 0.5, "another": 0.01}


@pytest.mark.parametrize(("probability", "expected"), [(0.951, "named"), (0.949, "unconfirmed")])
def test_a_name_is_certain_to_the_probability_of_a_credible_set(probability, expected):
    answer = dataclasses.replace(ANSWER, probabilities={CAUSE.family: probability, "nothing": 1 - probability})
    assert (
        weakest(answer.verdict for answer in judged([answer], [Sized(CAUSE, ANSWER.amplitudes)], None, None, MATERIAL))
        == expected
    )


def test_an_effect_of_which_held_out_logs_hold_nothing_is_no_obstacle():
    """As counts lost at a speed that these never reach."""
    elsewhere = Candidate("loss of counts", (TickLoss(castor=1, wheel=1, value=0.1, above=5.0),))
    named = [Sized(CAUSE, ANSWER.amplitudes), Sized(elsewhere, np.array([0.1]))]
    answers = [ANSWER, dataclasses.replace(ANSWER, candidate=elsewhere)]
    confirmed, unseen = judged(answers, named, (seen(0.0, None), seen(10.0, None)), ORDER, MATERIAL)
    assert (confirmed.verdict, unseen.verdict) == ("named", "unconfirmed")
