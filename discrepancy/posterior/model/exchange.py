"""Exchanges effects in the model for others with which the logs are likelier, by fits of the whole model."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.special import gammaln

from discrepancy.posterior.answers import Cause, Seen
from discrepancy.posterior.calibrated import FAULT, LOG_ODDS
from discrepancy.posterior.model.refit import (
    CONVERGED,
    Effects,
    Look,
    S,
    Sized,
    families_of,
    fit_with,
    in_place_of,
    refitted,
    statistics_of,
)
from discrepancy.posterior.priors import directions_in_model
from discrepancy.posterior.random_effects import summed

RIVALS, SIMILAR = 2, 0.5
"""Most rivals with which a large effect is compared, those of the most similar signatures; and the least squared cosine
of the signatures of a rival."""


def exchanged(
    vehicle: Any,
    look: Look[S],
    named: Sequence[Sized],
    large: Sequence[Cause] | None,
    seen: S,
    more: Sequence[Sized] = (),
    odds: float = 0.0,
    same: Mapping[Cause, Sequence[Cause]] = MappingProxyType({}),
    displaced: Callable[[S], float] = lambda seen: 0.0,
) -> tuple[Effects, S] | None:
    """Return effects with which logs are likelier than with those in the model, and the statistics beside them; None if
    there are none.

    Each effect is left out, if that makes the logs hardly less likely, and each large effect is exchanged for a similar
    one. The posterior compares effects linearly, by statistics about one state, which is inexact for large effects.
    Here the whole model is fitted with each, and effects that take the place of others are also compared by how likely
    their sizes are (`log_prior`). large: None where each was left out and exchanged before, without anything better.
    more: effects of which each is also added, with prior log odds `odds`, and in the first size given of it put in the
    place of each in the model. same: of effects in the model, those that no motion distinguishes from them, or no more
    than by where the reference is mounted; one that is likelier by more than fits converge to is taken.
    displaced: how far the reference is mounted from where it is expected, in units of what matters, about which it is
    Cauchy distributed: of `same` the likeliest with that is taken.
    """
    best, found = seen.log_evidence, None

    def fitted_again() -> float:
        """The states of the model itself may not have converged either."""
        again = fit_with(vehicle, look, tuple(named), seen)
        return best if again is None else max(best, again.log_evidence)

    of_named = log_prior(named, seen)
    added = [((*named, effect), LOG_ODDS - odds) for effect in more]
    first_sizes = {effect.candidate: effect for effect in reversed(more)}.values()
    added += [((*named[:k], effect, *named[k + 1 :]), LOG_ODDS) for k in range(len(named)) for effect in first_sizes]
    decided = set[frozenset[str]]()
    unlikely = float(np.log1p(displaced(seen) ** 2))
    for k, effect in enumerate(named):
        for other in (in_place_of(effect, cause, seen) for cause in same.get(effect.candidate, ())):
            effects = (*named[:k], other, *named[k + 1 :])
            refit_effects, fitted = refitted(vehicle, look, named, effects, seen, best - max(unlikely, LOG_ODDS))
            least = CONVERGED + float(np.log1p(displaced(fitted) ** 2)) - unlikely
            if len(refit_effects) == len(effects) and fitted.log_evidence > best + least:
                best = fitted_again()
                if fitted.log_evidence > best + least:
                    return refit_effects, fitted
            decided.add(families_of(effects))
    for effects, advantage in [*_alternatives(named, large, seen), *added]:
        if families_of(effects) in decided:
            continue
        refit_effects, fitted = refitted(vehicle, look, named, effects, seen, best + advantage)
        if fitted.log_evidence <= best + advantage or len(refit_effects) < len(effects):
            continue
        if len(effects) == len(named):
            advantage += max(of_named - log_prior(refit_effects, fitted), 0.0)
        if found is None:
            best = fitted_again()
        if fitted.log_evidence > best + advantage:
            best, found = fitted.log_evidence - advantage, (refit_effects, fitted)
    return found


def log_prior(effects: Sequence[Sized], seen: Seen) -> float:
    """Return the prior log probability (natural logarithm) that effects have these sizes, to within their standard
    errors: faults are Cauchy distributed (`priors`), those of c amplitudes as a c-variate Cauchy distribution."""
    present = [effect for effect in effects if effect.candidate in seen.candidates]
    if not present:
        return 0.0
    scales = [FAULT * effect.candidate.kinds[0].tolerance for effect in present]
    counts = [effect.candidate.columns for effect in present]
    information = statistics_of(present, seen).information + np.diag(np.repeat(scales, counts) ** -2.0)
    variances, total = np.diag(np.linalg.inv(information)), 0.0
    each = np.split(variances, np.cumsum(counts)[:-1])
    for effect, scale, count, variance in zip(present, scales, counts, each, strict=True):
        if not effect.candidate.kinds[0].binary:
            total += float(gammaln((1 + count) / 2) - gammaln(1 / 2) + count / 2 * np.log(2))
            total += float(np.sum(np.log(variance / scale**2)) - (1 + count) * np.log1p((effect.size / scale) ** 2)) / 2
    return total


def _alternatives(named: Sequence[Sized], large: Sequence[Cause] | None, seen: Seen) -> Iterator[tuple[Effects, float]]:
    """Yield alternatives to the effects in the model, and the increase of the log evidence from which each is better:
    negative if it has an effect less."""
    if large is None:
        return
    if len(named) > 1:
        for sized in named:
            yield tuple(effect for effect in named if effect is not sized), -LOG_ODDS
    compared = [sized for sized in named if sized.candidate in large and sized.candidate.columns == 1]
    if not compared:
        return
    statistics, in_model = summed(seen.logs), {sized.candidate for sized in named}
    rivals = {
        candidate: directions_in_model(seen, [candidate])[:, 0]
        for candidate in seen.candidates
        if candidate.columns == 1 and candidate.kinds and candidate not in in_model
    }
    square = {rival: float(direction @ statistics.information @ direction) for rival, direction in rivals.items()}
    for sized in compared:
        of_effect = directions_in_model(seen, [sized.candidate])[:, 0]
        by_effect = statistics.information @ of_effect
        product = {rival: float(rivals[rival] @ by_effect) for rival in rivals if square[rival] > 0}
        cosine = {rival: product[rival] ** 2 / (square[rival] * (of_effect @ by_effect)) for rival in product}
        for rival in sorted((rival for rival in cosine if cosine[rival] > SIMILAR), key=cosine.__getitem__)[-RIVALS:]:
            instead = in_place_of(sized, rival, seen)
            yield tuple(instead if effect is sized else effect for effect in named), LOG_ODDS
