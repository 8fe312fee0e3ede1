"""Which effects come into the model: those that the posterior names beside it, unless fits contradict them, until the
names stay the same."""

import dataclasses
import itertools
from collections.abc import Callable, Collection, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit, softmax

from castor_envs.geometry.arrays import Array
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.answers import Answer, Cause, Place, Seen, answers_of, mixed
from discrepancy.posterior.calibrated import FAULT, LOG_ODDS, SIGNATURE, prior_log_odds
from discrepancy.posterior.model.exchange import exchanged, log_prior
from discrepancy.posterior.model.refit import (
    Effects,
    Look,
    S,
    Sized,
    families_of,
    fit_with,
    in_place_of,
    possible,
    refitted,
    sizes_of,
    statistics_of,
)
from discrepancy.posterior.priors import directions_in_model, parts_about_fitted
from discrepancy.posterior.random_effects import GoodOrder, Statistics, agreeing, summed
from discrepancy.posterior.single_effects import Hypothesis, Posterior, SingleEffects
from estimators.likelihood.statistics import least_squares, pseudo_inverse

MOST_SEARCHES = 6
"""Most rounds in which the posterior of all candidates is computed beside the effects named before, and most times
that a search begins anew."""

BESIDE = 2
"""Number of likeliest effects, beside those in the model, that are fitted while the noise is estimated: until it is in
the model, an effect counts as noise, and may hide itself."""

SECOND = 0.2
"""Least part of the deviance explained by the largest new effect that another new effect must explain to enter the
model in the same round; if the set of effects is then one tried before, all new effects enter."""


class Asked(NamedTuple):
    """A posterior over all hypotheses, the answers that it gives, and what robots in good order show."""

    posterior: Posterior
    answers: list[Answer]
    order: GoodOrder


def named_together(
    vehicle: Any,
    look: Look[S],
    ask: Callable[[S, Sequence[Sized], Collection[str]], Asked],
    first: S,
    begin: Sequence[Sized] = (),
    displaced: Callable[[S], float] = lambda seen: 0.0,
) -> tuple[Effects, S, Posterior, list[Answer]]:
    """Add the effects that the answers name to the model until the names stay the same; return these effects, the
    statistics beside them, the posterior and the answers.

    first: statistics of the logs with the effects `begin` in the model; displaced: see `exchanged`. ask: returns the
    posterior without hypotheses of some families. The posterior compares effects by signatures, which are wrong of
    large ones, so that an effect which takes the place of another, or may do so, is refused if fits with both in turn
    are at odds with that. An answer on an effect that fits have shown to be needless beside others is none.
    """
    seen, named, refused, compared = first, tuple(begin), set[tuple[str, str]](), frozenset[str]()
    tried, needless = {families_of(named): seen.log_evidence}, set[tuple[frozenset[str], str]]()
    exchanges = set[frozenset[str]]()  # sets of effects that were exchanged before: what is better was tried then
    while True:
        in_model = families_of(named)
        posterior, answers, order = ask(seen, named, {new for old, new in refused if old in {*in_model, ""}})
        odds = prior_log_odds(len(posterior.names))
        answers = [
            answer
            for answer in answers
            if not any(answer.candidate.family == family and kept <= in_model for kept, family in needless)
        ]
        still = {answer.candidate for answer in answers}
        if still < {effect.candidate for effect in named}:  # nothing else takes the place of what is lost
            kept, by_fits = _by_fits(vehicle, look, named, answers, seen, order, odds)
            if kept is not None:
                needless |= {(families_of(kept), family) for family in in_model - families_of(kept)}
                named = kept
                seen = look(named, seen, None)
                continue
            answers = [*answers, *by_fits]
        for least in (SECOND, 0.0):
            new = _taken_in(vehicle, answers, named, least)
            families = families_of(new)
            if families not in tried:
                break
        if len(tried) > MOST_SEARCHES:
            return named, seen, posterior, _as_fitted(vehicle, look, answers, named, seen)[0]
        if families not in tried:
            better = refitted(vehicle, look, named, new, seen)
            tried[families] = better[1].log_evidence if families_of(better[0]) == families else -np.inf
            if families_of(better[0]) == in_model < families:  # with no part of the new ones the logs are as likely
                refused |= {("", new) for new in families - in_model}
                continue
            if unlikely := _unlikely(named, seen, *better, odds):
                refused |= unlikely
                continue
        elif families < in_model:  # something unnamed takes the place of what fits, without it, put into the model
            named = tuple(effect for effect in named if effect.candidate.family in families)
            seen = look(named, seen, None)
            continue
        elif tried[families] < seen.log_evidence - LOG_ODDS and not (pairs := _pairs(in_model, families)) <= refused:
            refused |= pairs
            continue
        else:
            if in_model != compared:
                compared, unlikely = in_model, set[tuple[str, str]]()
                for rival in _ambiguous(answers, named, seen):
                    fit = refitted(vehicle, look, named, rival, seen, seen.log_evidence - LOG_ODDS)
                    unlikely |= _unlikely(named, seen, rival, fit[1] if fit[0] else None, odds)
                if unlikely:
                    refused |= unlikely
                    continue
            better = None
            if in_model not in exchanges:
                exchanges.add(in_model)
                explained = seen.redundant and all(answer.effect is not None for answer in answers)
                more = [] if explained else most_explaining(vehicle, posterior.names, seen, named)
                same = _same(answers, seen)
                better = exchanged(vehicle, look, named, _large(answers), seen, more, odds, same, displaced)
            if better is None or families_of(better[0]) in tried:  # what is returned belongs to these answers
                fitted, better = _as_fitted(vehicle, look, answers, named, seen)
                likeliest = tried.get(in_model, seen.log_evidence)  # so far, as log evidence scatters
                if better is None or better[1].log_evidence <= likeliest + LOG_ODDS:
                    return named, seen, posterior, fitted
            tried[families_of(better[0])] = better[1].log_evidence
            if families_of(better[0]) < in_model:
                needless |= {(families_of(better[0]), family) for family in in_model - families_of(better[0])}
        named, seen = better
        seen = look(named, seen, None)


def _by_fits(
    vehicle: Any, look: Look[S], named: Effects, answers: Sequence[Answer], seen: S, order: GoodOrder, odds: float
) -> tuple[Effects | None, list[Answer]]:
    """Return the answers on effects in the model that the posterior does not hold possible, as fits without each tell:
    of what wheels mask, statistics beside the effect show a small part. If one of them is likelier not there, return
    the effects without it instead.

    What robots in good order show makes up the same part of the gain by fits as of the largest gain that any size of
    the effect has by the linear formula; none where that is so wrong that it explains nothing.
    """
    told, least, kept = list[Answer](), 0.0, None
    possible_names = {name for answer in answers for name in (*answer.credible, *answer.alike)}
    possible_names |= {answer.candidate.family for answer in answers}
    in_model = sizes_of(named, seen)
    logs = [log.at(-in_model) for log in seen.logs]
    statistics = summed(logs), order.beyond(logs)
    for effect in named:
        if effect.candidate.family in possible_names:
            continue
        left = tuple(other for other in named if other is not effect)
        others, without = refitted(vehicle, look, named, left, seen)
        gain = max(seen.log_evidence - without.log_evidence, 0.0)
        beside = sizes_of(left, seen)
        change = (in_model - beside)[:, None]
        explained, beyond = (_most(of.at(beside).of_combinations(change)) for of in statistics)
        part = float(np.clip(beyond / explained, 0.0, 1.0)) if explained > 0 else 1.0
        log_odds = part * gain + log_prior([effect], seen) + odds
        if log_odds <= least:
            least, kept = log_odds, others
        told.append(_answer_by_fit(effect, float(log_odds), gain, seen))
    return kept, told


def _most(statistics: Statistics) -> float:
    """Return the largest log-likelihood ratio of one size, of the sign of 1, against 0."""
    information, score = float(statistics.information[0, 0]), float(statistics.score[0])
    return max(score, 0.0) ** 2 / (2 * information) if information > 0 else 0.0


def _answer_by_fit(effect: Sized, log_odds: float, gain: float, seen: Seen) -> Answer:
    """Return the answer on an effect in the model with log odds and a gain of log-likelihood by fits."""
    return Answer(
        probabilities={effect.candidate.family: float(expit(log_odds)), "nothing": float(expit(-log_odds))},
        absent=float(expit(-log_odds)),
        credible=(effect.candidate.family,),
        unnamed=False,
        candidate=effect.candidate,
        amplitudes=effect.amplitudes,
        covariance=_covariance(effect, seen),
        cost=np.max(seen.cost[:, seen.columns[effect.candidate]], axis=1),
        masked=seen.masked,
        explained=2 * gain,
    )


def _covariance(effect: Sized, seen: Seen) -> Array:
    """Return the covariance (c, c) of the amplitudes of an effect in the model: logs tell what is seen of it better
    than which part of it wheels mask. Its prior keeps a part of which they tell nothing regular."""
    prior = np.eye(len(effect.amplitudes)) / (FAULT * effect.candidate.kinds[0].tolerance) ** 2
    logs, sizes, log_weight = summed(seen.logs), list[tuple[Array, Array]](), list[float]()
    score = logs.at(-sizes_of([effect], seen)).score
    for part in parts_about_fitted(seen).tolist():
        direction = directions_in_model(seen, [effect.candidate], part)
        information, of_effect = direction.T @ logs.information @ direction + prior, direction.T @ score
        covariance = pseudo_inverse(information)
        sizes.append((covariance @ of_effect, covariance))
        log_weight.append(float(of_effect @ covariance @ of_effect - np.linalg.slogdet(information)[1]) / 2)
    return mixed(softmax(log_weight), sizes)[1]


def _as_fitted(
    vehicle: Any, look: Look[S], answers: Sequence[Answer], named: Sequence[Sized], seen: S
) -> tuple[list[Answer], tuple[Effects, S] | None]:
    """Return the answers with the sizes that effects have in the model, where a fit contradicts those that the
    posterior gives: logs are then less likely than the linear formula says, as it holds for small changes only. The
    second are the effects of the sizes that the posterior gives, and the statistics beside them, where logs are so much
    likelier that the fit of the model had ended too early; else None."""
    told = {answer.candidate: answer for answer in answers}
    there = [effect for effect in named if effect.candidate in told and effect.candidate in seen.candidates]
    changes = [told[effect.candidate].amplitudes - effect.amplitudes for effect in there]
    if not any(np.linalg.norm(by) > told[one.candidate].error for one, by in zip(there, changes, strict=True)):
        return list(answers), None
    moved = [effect.moved(by) for effect, by in zip(there, changes, strict=True)]
    gain = statistics_of(there, seen).gain(np.concatenate(changes))
    as_told = (*moved, *(effect for effect in named if effect not in there))
    found = fit_with(vehicle, look, as_told, seen)
    if found is not None and found.log_evidence > seen.log_evidence + gain - LOG_ODDS:
        likelier = found.log_evidence > seen.log_evidence + LOG_ODDS
        return list(answers), (as_told, found) if likelier else None
    fitted = {effect.candidate: effect.amplitudes for effect in there}
    of_fit = [
        dataclasses.replace(answer, amplitudes=fitted.get(answer.candidate, answer.amplitudes)) for answer in answers
    ]
    return of_fit, None


def _ambiguous(answers: Sequence[Answer], named: Sequence[Sized], seen: Seen) -> Iterator[Effects]:
    """Yield the effects of a model with one exchanged for an effect that these motions may not distinguish from it."""
    causes = _by_family(seen)
    for answer, k in itertools.product(answers, range(len(named))):
        if named[k].candidate == answer.candidate:
            for name in answer.credible:
                if name in causes and name not in families_of(named):
                    yield (*named[:k], in_place_of(named[k], causes[name], seen), *named[k + 1 :])


def _same(answers: Sequence[Answer], seen: Seen) -> dict[Cause, list[Cause]]:
    """Return the effects that are the same as those of answers on this vehicle, whatever it does."""
    causes = _by_family(seen)
    return {answer.candidate: [causes[name] for name in answer.alike if name in causes] for answer in answers}


def _by_family(seen: Seen) -> dict[str, Cause]:
    """Return the candidates of the catalogue by their families."""
    return {cause.family: cause for cause in seen.candidates if cause.kinds}


def _unlikely(
    named: Sequence[Sized], seen: Seen, new: Sequence[Sized], beside: Seen | None, odds: float
) -> set[tuple[str, str]]:
    """Return the families of effects that take the place of others in a model, each with the family of one of these, or
    "" if they only come to it, where logs are so much less likely with them that they are not in the credible set, or
    where their motion is: how far wheels in good order disagree is known less well than how a vehicle moves.

    beside: None where the new effects do not fit. odds: prior log odds (natural logarithm) of an effect.
    """
    before, after = families_of(named), families_of(new)
    if beside is not None:
        fewer = odds * (len(named) - len(new))
        lost = seen.log_evidence - beside.log_evidence + fewer
        of_motion = seen.log_evidence_of_motion - beside.log_evidence_of_motion + min(fewer, 0.0)
        if max(lost, of_motion) < LOG_ODDS:
            return set()
    return _pairs(before, after)


def _pairs(before: frozenset[str], after: frozenset[str]) -> set[tuple[str, str]]:
    """Return the families of effects that come into a model, each with the family of one that leaves it, or ""."""
    return set(itertools.product(before - after or {""}, after - before))


def most_explaining(vehicle: Any, names: Collection[str], seen: Seen, named: Sequence[Sized]) -> list[Sized]:
    """Return the effects, `BESIDE` of them, that would explain most of what those in the model leave, in the sizes that
    the formula gives; of too few wheels for any to contradict the others also in half and twice these.

    What wheels cannot contradict, as there are too few or as all contacts give way, passes for noise, beside which the
    formula hardly sees it: an effect that explains most of it is as likely as its rivals. If it is much more than
    signatures can be extrapolated by, as a latency of 0.2 s is, only a fit with it in the model shows that. Sizes and
    noise change together, so logs may be likely at sizes far apart, and much less likely between. names: of possible
    answers, of which each stands for all that are the same on this vehicle.
    """
    in_model, explained, found = families_of(named), dict[Sized, float](), list[Sized]()
    for candidate in seen.candidates:
        searched = isinstance(candidate, Candidate) and candidate.at_a_place  # for the place that explains most
        if candidate.kinds and candidate.family in names and candidate.family not in in_model and not searched:
            effect, gain = by_formula(candidate, seen)
            explained[effect] = gain - candidate.columns / 2  # which noise alone explains
    for effect in sorted(explained, key=explained.__getitem__)[: -BESIDE - 1 : -1]:
        others = () if seen.redundant else (-0.5, 1.0)
        sizes = {effect.amplitudes.tobytes(): effect}  # different ones, within their bounds
        for part in others:
            moved = effect.moved(part * effect.amplitudes)
            sizes.setdefault(moved.amplitudes.tobytes(), moved)
        found += [sized for sized in sizes.values() if possible(vehicle, [sized]) and np.any(sized.amplitudes)]
    return found


def by_formula(candidate: Cause, seen: Seen) -> tuple[Sized, float]:
    """Return a candidate beside the effects in the model in the size that the linear formula gives, and what it then
    explains of the log-likelihood."""
    none = Sized(candidate, np.zeros(candidate.columns))
    statistics = statistics_of([none], seen)
    effect = none.moved(least_squares(*statistics))
    return effect, statistics.gain(effect.amplitudes)


def _large(answers: Sequence[Answer]) -> list[Cause]:
    """Return the effects that explain so much that their linear signatures may be wrong by more than noise, and the
    binary ones: what is there or not is no linear question."""
    return [
        answer.candidate
        for answer in answers
        if answer.explained * SIGNATURE**2 > 1 or any(kind.binary for kind in answer.candidate.kinds)
    ]


def asked(
    seen: Seen,
    hypotheses: Sequence[Hypothesis],
    places: Sequence[Place],
    order: GoodOrder,
    in_model: Array,
    without: Collection[str] = (),
) -> Asked:
    """Return the posterior over all hypotheses, and the answers that it gives, the most certain first.

    places: the candidate of each hypothesis. order: what robots in good order show. in_model: sizes in the model
    already. without: families of which there is no hypothesis.
    """
    kept = [k for k, place in enumerate(places) if place.candidate.family not in without]
    hypotheses, places = [hypotheses[k] for k in kept], [places[k] for k in kept]
    single, posterior, score = _posterior(hypotheses, order, seen, in_model)
    reestimated = seen.reestimate_noise(_likeliest(seen, posterior, places, in_model))
    if reestimated is not seen:
        seen = reestimated
        single, posterior, score = _posterior(hypotheses, order, seen, in_model)
    expected = sum((component.mean for component in posterior.components if component.nothing < 0.5), 0 * in_model)
    single, posterior, score = _posterior(hypotheses, order, seen, in_model, expected - in_model)
    return Asked(posterior, answers_of(seen, single, posterior, score, places, in_model), order)


def _likeliest(seen: Seen, posterior: Posterior, places: Sequence[Place], in_model: Array) -> list[Cause]:
    """Return the likeliest candidate of the catalogue in each component that is of one in the model, and in the most
    certain of the others; and the unnamed alternative in each that is expected, if one is likeliest there."""
    named = np.array([bool(place.candidate.kinds) for place in places])
    best = [int(np.argmax(component.probability * named)) for component in posterior.components]
    expected = [int(np.argmax(component.probability)) for component in posterior.components if component.nothing < 0.5]
    unnamed = [places[k].candidate for k in expected if not named[k]]
    causes = list(dict.fromkeys(places[k].candidate for k in best))
    fitted = [cause for cause in causes if np.any(in_model[seen.columns[cause]])]
    others = [cause for cause in causes if cause not in fitted][:BESIDE]
    return list(dict.fromkeys([*fitted, *others, *unnamed]))


def _taken_in(vehicle: Any, answers: Sequence[Answer], named: Sequence[Sized], least: float) -> Effects:
    """Return the effects to put into the model: those that stay, and new effects that explain at least the part `least`
    of the deviance that the largest new effect explains. A smaller effect may only be the linearisation error of the
    largest."""
    kept = {effect.candidate for effect in named}
    choices = [(answer, Sized(answer.candidate, answer.amplitudes)) for answer in answers if answer.effect is not None]
    choices = [(answer, effect) for answer, effect in choices if possible(vehicle, [effect])]
    largest = max((answer.explained for answer, effect in choices if effect.candidate not in kept), default=0.0)
    return tuple(
        effect for answer, effect in choices if effect.candidate in kept or answer.explained >= least * largest
    )


def _posterior(
    hypotheses: Sequence[Hypothesis], order: GoodOrder, seen: Seen, in_model: Array, far: Array | None = None
) -> tuple[SingleEffects, Posterior, Array]:
    """Return the posterior of hypotheses beyond what robots in good order show, and the score that it comes from.

    in_model: sizes in the model already (m,). far: sizes beyond these that are expected (m,), if any: the error of
    signatures depends on both (`Statistics.doubted`).
    """
    logs = agreeing([log.at(-in_model) for log in seen.logs], seen.lasting)
    logs = [log.doubted(np.zeros_like(in_model) if far is None else far, in_model) for log in logs]
    beyond = order.beyond(logs)
    single = SingleEffects(hypotheses, beyond.information)
    return single, single.posterior(beyond.score), beyond.score
