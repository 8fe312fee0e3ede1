"""Effects that take the place of others: by the evidence of the logs, and by how likely effects of these sizes are."""

from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2

from castor_envs.effects.dimensions import PivotPositionX
from castor_envs.effects.encoders import PivotEccentricity, PivotGain
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.calibrated import FAULT, LOG_ODDS
from discrepancy.posterior.model.exchange import exchanged, log_prior
from discrepancy.posterior.model.refit import CONVERGED, Sized

ROBOT = preset("tricycle")
PLACE = Candidate("place", (PivotPositionX(castor=1, value=PivotPositionX.step),))
GAIN = Candidate("gain", (PivotGain(castor=1, value=PivotGain.step),))
FEW = 10 * PivotPositionX.tolerance, 10 * PivotGain.tolerance


@pytest.fixture
def exchange(statistics_of) -> Any:
    """The effect that stays, if another in its place makes logs likelier by so much; sizes are known to a tolerance."""

    def of(place, gain, likelier) -> Any:
        def look(effects, *_) -> Any:
            kinds = [effect.candidate for effect in effects]
            information = np.diag([kind.kinds[0].tolerance ** -2.0 for kind in kinds])
            return statistics_of(kinds, information, likelier if kinds == [GAIN] else 0.0)

        named = (Sized(PLACE, np.array([place])),)
        instead = [Sized(GAIN, np.array([gain]))]
        found = exchanged(ROBOT, look, named, (), look(named), instead, odds=-1e3)
        return None if found is None else found[0][0]

    return of


def test_of_effects_of_as_many_tolerances_the_one_with_which_logs_are_likelier_stays(exchange):
    assert exchange(*FEW, LOG_ODDS - 0.1) is None
    assert exchange(*FEW, LOG_ODDS + 0.1).candidate == GAIN


def test_an_effect_of_many_more_tolerances_must_make_logs_likelier_by_as_much_as_it_is_less_likely(exchange):
    """Faults are Cauchy distributed: 100 times as large is 5000 times less likely, where the other is of the scale."""
    many = 100 * FEW[1]
    against = np.log((1 + 100**2) / 2)
    assert exchange(FEW[0], many, LOG_ODDS + against - 0.1) is None
    effect = exchange(FEW[0], many, LOG_ODDS + against + 0.1)
    assert (effect.candidate, effect.size) == (GAIN, pytest.approx(many))
    assert exchange(100 * FEW[0], many, LOG_ODDS + 0.1).candidate == GAIN


def test_what_was_left_out_and_exchanged_before_is_not_again(statistics_of):
    fitted = list[int]()

    def look(effects, *_) -> Any:
        fitted.append(len(effects))
        kinds = [effect.candidate for effect in effects]
        return statistics_of(kinds, np.eye(len(kinds)), 0.0)

    named = Sized(PLACE, np.ones(1)), Sized(GAIN, np.ones(1))
    seen = look(named)
    for large, sizes in ((None, set()), ((), {1})):
        fitted.clear()
        exchanged(ROBOT, look, named, large, seen)
        assert set(fitted) == sizes


@pytest.mark.parametrize(("likelier", "taken"), [(CONVERGED - 0.01, None), (CONVERGED + 0.01, GAIN)])
def test_of_effects_that_no_motion_distinguishes_the_likeliest_is_taken(likelier, taken, statistics_of):
    """Their signatures are the same but for their units."""
    tolerance = np.array([kind.kinds[0].tolerance for kind in (PLACE, GAIN)])

    def look(effects, *_) -> Any:
        kinds = [effect.candidate for effect in effects] or [PLACE, GAIN]
        per_unit = np.array([1 / kind.kinds[0].tolerance for kind in kinds])
        return statistics_of(kinds, np.outer(per_unit, per_unit), likelier if kinds == [GAIN] else 0.0)

    named, seen = (Sized(PLACE, 10 * tolerance[:1]),), look(())
    found: Any = exchanged(ROBOT, look, named, (), seen, same={PLACE: [GAIN]})
    assert (found and found[0][0].candidate) == taken
    if taken:
        assert found[0][0].size == pytest.approx(10 * tolerance[1])


@pytest.mark.parametrize(("less_likely", "taken"), [(5.9 - CONVERGED, GAIN), (6.1 - CONVERGED, None)])
def test_an_effect_beside_which_the_reference_is_where_it_should_be_may_be_less_likely_by_as_much(
    less_likely, taken, statistics_of
):
    """20 times what matters off: by a Cauchy distribution exp(6) times less likely."""

    def look(effects, *_) -> Any:
        kinds = [effect.candidate for effect in effects] or [PLACE, GAIN]
        return statistics_of(kinds, 1e6 * np.ones((len(kinds), len(kinds))), -less_likely if kinds == [GAIN] else 0.0)

    def displaced(seen):
        return 20.0 if seen.log_evidence == 0.0 else 0.0

    named, seen = (Sized(PLACE, np.array([0.1])),), look(())
    found: Any = exchanged(ROBOT, look, named, (), seen, same={PLACE: [GAIN]}, displaced=displaced)
    assert (found and found[0][0].candidate) == taken


@pytest.mark.parametrize("columns", [1, 2])
@pytest.mark.parametrize("size", [0.0, 0.3, 30.0])
def test_the_prior_of_a_size_to_within_its_errors_is_that_of_a_cauchy_distribution(columns, size, statistics_of):
    """A narrow normal likelihood times the prior, integrated, is the maximum of the former times what is computed."""
    cause = Candidate("one", (PivotEccentricity(castor=1, value=1e-3),), columns=columns)
    scale, error = FAULT * PivotEccentricity.tolerance, 1e-3 * FAULT * PivotEccentricity.tolerance
    seen = statistics_of([cause], np.eye(columns) / error**2, 0.0)
    amplitudes = size * scale * np.eye(columns)[0]

    def normal(precision: float) -> float:
        """The density of normal sizes, of which a Cauchy distribution is a mixture."""
        spread = precision / (2 * np.pi * scale**2)
        return float(spread ** (columns / 2) * np.exp(-precision * size**2 / 2) * chi2.pdf(precision, 1))

    density = sum(quad(normal, *ends)[0] for ends in ((0.0, 0.01), (0.01, 1.0), (1.0, np.inf)))
    expected = density * (2 * np.pi * error**2) ** (columns / 2)
    assert log_prior([Sized(cause, amplitudes)], seen) == pytest.approx(np.log(expected), abs=1e-5)
