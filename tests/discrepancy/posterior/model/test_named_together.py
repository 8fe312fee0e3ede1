"""Which effects come into the model: what the linear posterior names, unless fits contradict it."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from castor_envs.effects.dimensions import PivotPositionX
from castor_envs.effects.encoders import PivotGain
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.calibrated import LOG_ODDS, prior_log_odds
from discrepancy.posterior.model.named_together import Asked, named_together
from discrepancy.posterior.model.refit import families_of
from discrepancy.posterior.random_effects import GoodOrder

ROBOT, NAMES = preset("tricycle"), ("a", "b", "c")
PLACE = Candidate("place", (PivotPositionX(castor=1, value=PivotPositionX.step),))
GAIN = Candidate("gain", (PivotGain(castor=1, value=PivotGain.step),))


def answer(candidate, *credible) -> Any:
    size = np.array([candidate.kinds[0].step])
    effect = candidate.effect(size)
    return SimpleNamespace(
        candidate=candidate, amplitudes=size, effect=effect, explained=10.0, credible=credible, alike=()
    )


def in_model(posterior, likelier, statistics_of):
    """The families in the model at the end. posterior: the names that it gives beside each model, the likeliest first
    for each single effect; likelier: log evidence by the families in the model."""

    def look(effects, *_) -> Any:
        kinds = [effect.candidate for effect in effects]
        return statistics_of(kinds, np.diag([1e6] * len(kinds)), likelier[families_of(effects)])

    def ask(seen, named, without) -> Any:
        beside = posterior[families_of(named)]
        left = ([candidate for candidate in names if candidate.family not in without] for names in beside)
        answers = [answer(names[0], *(candidate.family for candidate in names)) for names in left if names]
        none = np.zeros((len(seen.candidates), len(seen.candidates)))
        return Asked(posterior_of(NAMES), answers, GoodOrder(np.diag(none), none, none))

    def posterior_of(names) -> Any:
        return SimpleNamespace(names=names)

    named, *_, answers = named_together(ROBOT, look, ask, look(()))
    assert families_of(named) == {answer.candidate.family for answer in answers}
    return families_of(named)


NONE, BOTH = frozenset[str](), frozenset({PLACE.family, GAIN.family})
OF_PLACE, OF_GAIN = frozenset({PLACE.family}), frozenset({GAIN.family})


@pytest.mark.parametrize(("less_likely", "stays"), [(LOG_ODDS + 0.1, OF_PLACE), (LOG_ODDS - 0.1, OF_GAIN)])
def test_an_effect_takes_the_place_of_another_unless_fits_exclude_it(less_likely, stays, statistics_of):
    posterior = {NONE: [[PLACE]], OF_PLACE: [[GAIN, PLACE]], OF_GAIN: [[GAIN]]}
    assert in_model(posterior, {NONE: 0.0, OF_PLACE: 50.0, OF_GAIN: 50.0 - less_likely}, statistics_of) == stays


@pytest.mark.parametrize("likelier", [-0.1, 0.1])
def test_an_effect_comes_into_the_model_unless_fits_exclude_it(likelier, statistics_of):
    posterior = {NONE: [[PLACE]], OF_PLACE: [[PLACE], [GAIN]], BOTH: [[PLACE], [GAIN]]}
    with_both = 50.0 - LOG_ODDS - prior_log_odds(len(NAMES)) + likelier
    found = in_model(posterior, {NONE: 0.0, OF_PLACE: 50.0, OF_GAIN: 0.0, BOTH: with_both}, statistics_of)
    assert found == (BOTH if likelier > 0 else OF_PLACE)


@pytest.mark.parametrize(("gain", "stays"), [(40.0, OF_PLACE), (2.0, NONE)])
def test_an_effect_that_the_posterior_loses_stays_if_fits_without_it_exclude_that(gain, stays, statistics_of):
    posterior = {NONE: [[PLACE]], OF_PLACE: []}
    assert in_model(posterior, {NONE: 0.0, OF_PLACE: gain}, statistics_of) == stays


def test_of_two_effects_that_the_posterior_loses_the_needless_one_is_refused(statistics_of):
    posterior = {NONE: [[PLACE]], OF_PLACE: [[PLACE], [GAIN]], BOTH: []}
    likelier = {NONE: 0.0, OF_PLACE: 40.0, OF_GAIN: 35.0, BOTH: 42.0}
    assert in_model(posterior, likelier, statistics_of) == OF_PLACE
