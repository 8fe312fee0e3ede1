"""Which effects come into the model: what the linear posterior names, unless fits contradict it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from castor_envs.effects.dimensions import PivotPositionX, PivotPositionY
from castor_envs.effects.encoders import PivotGain
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.calibrated import LOG_ODDS, prior_log_odds
from discrepancy.posterior.model.named_together import Asked, named_together
from discrepancy.posterior.model.refit import Sized, families_of
from discrepancy.posterior.random_effects import GoodOrder, Statistics

ROBOT, NAMES = preset("tricycle"), ("a", "b", "c")
PLACE = Candidate("place", (PivotPositionX(castor=1, value=PivotPositionX.step),))
GAIN = Candidate("gain", (PivotGain(castor=1, value=PivotGain.step),))
THIRD = Candidate("third", (PivotPositionY(castor=1, value=PivotPositionY.step),))


def answer(candidate, *credible, size=1.0) -> Answer:
    """The answer on an effect of a size in steps, known to a thousandth of a step."""
    amplitudes = size * np.array([candidate.kinds[0].step])
    return Answer(
        probabilities={candidate.family: 1.0},
        credible=credible,
        unnamed=False,
        candidate=candidate,
        amplitudes=amplitudes,
        covariance=np.diag((0.001 * amplitudes / size) ** 2),
        cost=np.zeros(2),
        explained=10.0,
    )


def posterior_of(names) -> Any:
    return SimpleNamespace(names=names)


def in_model(posterior, likelier, statistics_of, of_motion=None, usual=0.0):
    """The families in the model at the end. posterior: the names that it gives beside each model, the likeliest first
    for each single effect; likelier, of_motion: log evidence, and that of the motion, by the families in the model;
    usual: the size of each that robots in good order show."""

    def look(effects, *_) -> Any:
        kinds, families = [effect.candidate for effect in effects], families_of(effects)
        seen = statistics_of(kinds, np.diag([1e6] * len(kinds)), likelier[families])
        seen.log_evidence_of_motion = (of_motion or likelier)[families]
        return seen

    def ask(seen, named, without) -> Any:
        beside = posterior[families_of(named)]
        left = ([candidate for candidate in names if candidate.family not in without] for names in beside)
        answers = [answer(names[0], *(candidate.family for candidate in names)) for names in left if names]
        none = np.zeros((len(seen.candidates), len(seen.candidates)))
        order = GoodOrder(np.full(len(none), usual), none, none)
        return Asked(posterior_of(NAMES), answers, order)

    named, *_, answers = named_together(ROBOT, look, ask, look(()))
    assert families_of(named) == {answer.candidate.family for answer in answers}
    return families_of(named)


NONE, BOTH = frozenset[str](), frozenset({PLACE.family, GAIN.family})
OF_PLACE, OF_GAIN = frozenset({PLACE.family}), frozenset({GAIN.family})


@pytest.mark.parametrize(("less_likely", "stays"), [(LOG_ODDS + 0.1, OF_PLACE), (LOG_ODDS - 0.1, OF_GAIN)])
def test_an_effect_takes_the_place_of_another_unless_fits_exclude_it(less_likely, stays, statistics_of):
    posterior = {NONE: [[PLACE]], OF_PLACE: [[GAIN, PLACE]], OF_GAIN: [[GAIN]]}
    assert in_model(posterior, {NONE: 0.0, OF_PLACE: 50.0, OF_GAIN: 50.0 - less_likely}, statistics_of) == stays


def test_what_fits_have_excluded_is_no_answer_where_the_posterior_turns_back_to_it(statistics_of):
    """Beside each of two effects the other seems likelier; the one with which logs are likelier is the answer."""
    posterior = {NONE: [[PLACE]], OF_PLACE: [[GAIN]], OF_GAIN: [[PLACE, GAIN]]}
    assert in_model(posterior, {NONE: 0.0, OF_PLACE: 50.0, OF_GAIN: 217.0}, statistics_of) == OF_GAIN


@pytest.mark.parametrize("likelier", [-0.1, 0.1])
def test_an_effect_comes_into_the_model_unless_fits_exclude_it(likelier, statistics_of):
    posterior = {NONE: [[PLACE]], OF_PLACE: [[PLACE], [GAIN]], BOTH: [[PLACE], [GAIN]]}
    with_both = 50.0 - LOG_ODDS - prior_log_odds(len(NAMES)) + likelier
    found = in_model(posterior, {NONE: 0.0, OF_PLACE: 50.0, OF_GAIN: 0.0, BOTH: with_both}, statistics_of)
    assert found == (BOTH if likelier > 0 else OF_PLACE)


@pytest.mark.parametrize(("less_likely", "found"), [(LOG_ODDS - 0.1, OF_PLACE), (LOG_ODDS + 0.1, NONE)])
def test_an_effect_that_the_motion_contradicts_does_not_come_into_the_model(less_likely, found, statistics_of):
    """However much less wheels disagree with it."""
    posterior = {NONE: [[PLACE]], OF_PLACE: [[PLACE]]}
    of_motion = {NONE: 0.0, OF_PLACE: -less_likely}
    assert in_model(posterior, {NONE: 0.0, OF_PLACE: 50.0}, statistics_of, of_motion) == found


@pytest.mark.parametrize(("nearer", "fewer"), [(0.1, True), (-0.1, False)])
def test_one_effect_takes_the_place_of_two_unless_fits_exclude_it(nearer, fewer, statistics_of):
    """Beforehand one effect is likelier than two; so it is of the motion."""
    third = frozenset({THIRD.family})
    posterior = {NONE: [[PLACE], [GAIN]], BOTH: [[THIRD]], third: [[THIRD]]}
    of_third = 50.0 - LOG_ODDS + prior_log_odds(len(NAMES)) + nearer
    likelier = {NONE: 0.0, OF_PLACE: 0.0, OF_GAIN: 0.0, BOTH: 50.0, third: of_third}
    assert in_model(posterior, likelier, statistics_of) == (third if fewer else BOTH)


@pytest.mark.parametrize(("gain", "stays"), [(40.0, OF_PLACE), (2.0, NONE)])
def test_an_effect_that_the_posterior_loses_stays_if_fits_without_it_exclude_that(gain, stays, statistics_of):
    posterior = {NONE: [[PLACE]], OF_PLACE: []}
    assert in_model(posterior, {NONE: 0.0, OF_PLACE: gain}, statistics_of) == stays


@pytest.mark.parametrize(("usual", "stays"), [(0.7, OF_PLACE), (1.0, NONE)])
def test_robots_in_good_order_show_the_part_of_a_lost_effect_that_is_usual(usual, stays, statistics_of):
    """By the formula, 0.3 of its size explain 9 % of what all of it does, which is 36 of 400; all of its size beyond
    what is usual would make logs less likely."""
    posterior = {NONE: [[PLACE]], OF_PLACE: []}
    size = usual * PLACE.kinds[0].step
    assert in_model(posterior, {NONE: 0.0, OF_PLACE: 400.0}, statistics_of, usual=size) == stays


def test_of_two_effects_that_the_posterior_loses_the_needless_one_is_refused(statistics_of):
    posterior = {NONE: [[PLACE]], OF_PLACE: [[PLACE], [GAIN]], BOTH: []}
    likelier = {NONE: 0.0, OF_PLACE: 40.0, OF_GAIN: 35.0, BOTH: 42.0}
    assert in_model(posterior, likelier, statistics_of) == OF_PLACE


@pytest.mark.parametrize(("less_likely", "told"), [(LOG_ODDS + 0.1, "as fitted"), (LOG_ODDS - 0.1, "by the posterior")])
def test_a_size_is_told_as_fitted_where_a_fit_contradicts_the_posterior(less_likely, told, statistics_of):
    """The posterior gives twice the size in the model, which by its formula is as likely."""

    def look(effects, *_) -> Any:
        doubled = any(effect.size > effect.candidate.kinds[0].step for effect in effects)
        evidence = (50.0 if effects else 0.0) - less_likely * doubled
        return statistics_of([effect.candidate for effect in effects], np.zeros((len(effects), len(effects))), evidence)

    def ask(seen, named, _) -> Any:
        none = np.zeros((len(seen.candidates), len(seen.candidates)))
        answers = [answer(PLACE, PLACE.family, size=2.0 if named else 1.0)]
        return Asked(posterior_of(NAMES), answers, GoodOrder(np.diag(none), none, none))

    *_, (found,) = named_together(ROBOT, look, ask, look(()))
    assert found.size == pytest.approx(PLACE.kinds[0].step * (1 if told == "as fitted" else 2))


def test_the_model_is_fitted_on_where_logs_are_much_likelier_with_the_sizes_that_the_posterior_gives(statistics_of):
    """A fit may have ended too early."""
    step = PLACE.kinds[0].step

    def look(effects, *_) -> Any:
        off = sum(abs(effect.size / step - 2.0) for effect in effects)
        none = np.zeros((len(effects), len(effects)))
        return statistics_of([effect.candidate for effect in effects], none, 50.0 - 5.0 * off if effects else 0.0)

    def ask(seen, named, _) -> Any:
        none = np.zeros((len(seen.candidates), len(seen.candidates)))
        answers = [answer(PLACE, PLACE.family, size=2.0 if named else 1.0)]
        return Asked(posterior_of(NAMES), answers, GoodOrder(np.diag(none), none, none))

    (effect,), seen, *_ = named_together(ROBOT, look, ask, look(()))
    assert (effect.size, seen.log_evidence) == (pytest.approx(2 * step), pytest.approx(50.0))


def test_the_search_ends_though_fits_of_the_same_sizes_differ(statistics_of):
    """Here log evidence is 10 larger each time that the sizes of the posterior are fitted, and is lost again."""

    def look(effects, _=None, among=None) -> Any:
        none = np.zeros((len(effects), len(effects)))
        evidence = 50.0 + 10.0 * (among is not None) if effects else 0.0
        return statistics_of([effect.candidate for effect in effects], none, evidence)

    def ask(seen, named, _) -> Any:
        none = np.zeros((len(seen.candidates), len(seen.candidates)))
        size = 1.1 * float(named[0].amplitudes[0]) / PLACE.kinds[0].step if named else 1.0
        return Asked(
            posterior_of(NAMES), [answer(PLACE, PLACE.family, size=size)], GoodOrder(np.diag(none), none, none)
        )

    (effect,), *_ = named_together(ROBOT, look, ask, look(()))
    assert effect.candidate == PLACE


def test_what_a_model_is_exchanged_for_is_sought_once(statistics_of, monkeypatch):
    """Here the posterior loses it again."""
    sought = list[frozenset[str]]()

    def exchanged(vehicle, look, named, *_) -> Any:
        sought.append(families_of(named))
        effects = (Sized(PLACE, np.array([PLACE.kinds[0].step])),)
        return effects, look(effects)

    monkeypatch.setattr("discrepancy.posterior.model.named_together.exchanged", exchanged)
    assert in_model({NONE: [], OF_PLACE: []}, {NONE: 0.0, OF_PLACE: 2.0}, statistics_of) == NONE
    assert sought == [NONE]


@pytest.mark.parametrize(("shown_alone", "masked"), [(True, 0.5), (False, 0.5), (True, 1.0)])
def test_of_what_wheels_mask_a_size_is_known_no_better_than_the_part(shown_alone, masked, statistics_of):
    """Half of an effect is masked, give or take a quarter; its size is that uncertain, if logs tell what is seen of it
    and nothing else. Where all of it may be masked, they tell nothing."""
    possible = 0.5 / (1 - np.linspace(0.25, 0.75, 9))  # each the likelier, the less sizes change what is seen
    mean = np.average(possible, weights=possible)
    relative_error = np.average((possible - mean) ** 2, weights=possible) ** 0.5 if shown_alone else 0.01
    size, each = PivotPositionX.step, 1e8 / PivotPositionX.step**2
    information = each * np.array([[1.0, -1.0], [-1.0, 1.0]]) if shown_alone else each * np.eye(2)

    def look(effects, *_) -> Any:
        seen = statistics_of([effect.candidate for effect in effects], np.eye(len(effects)), 100.0 * len(effects))
        seen.masked = masked
        seen.logs = (Statistics(information, np.zeros(2)),) if effects else seen.logs
        return seen

    def ask(seen, named, without) -> Any:
        none = np.zeros((2, 2)) if named else np.zeros((0, 0))
        return Asked(posterior_of(NAMES), [] if named else [answer(PLACE, "a")], GoodOrder(np.diag(none), none, none))

    *_, (found,) = named_together(ROBOT, look, ask, look(()))
    assert found.size == pytest.approx(size)
    if masked < 1:
        assert found.error == pytest.approx(relative_error * size, rel=0.1, abs=0.01 * size)
    else:
        assert np.isfinite(found.error)
