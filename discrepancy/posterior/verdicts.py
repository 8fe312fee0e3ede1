"""The verdict on an answer: it follows from its probabilities, from held-out logs, and from its cost in use."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import logit

from castor_envs.geometry.arrays import Array
from discrepancy.posterior.answers import Answer, Seen, Verdict
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.posterior.priors import place_in_model, sizes_of
from discrepancy.posterior.random_effects import GoodOrder, Statistics, agreeing
from discrepancy.posterior.refit import Sized
from estimators.calibration.identifiability import COVERAGE

WEAKEST_FIRST: tuple[Verdict, ...] = ("unexplained", "ambiguous", "unconfirmed", "named", "negligible")


class Material(NamedTuple):
    """Odometry error from which on an effect matters in use: m after 10 m, and rad after a turn."""

    position: float = 1e-3
    heading: float = 1e-3


MATERIAL = Material()


def judged(
    answers: Sequence[Answer],
    named: Sequence[Sized],
    held_out: Sequence[Seen] | None,
    order: GoodOrder | None,
    material: Material,
) -> tuple[Answer, ...]:
    """Return the answers with their verdicts, without those that held-out logs contradict so much that "nothing" is in
    the credible set of all logs together.

    named: all effects that are in the model. held_out: statistics of held-out logs without and with these effects, of
    these candidates only; order: what robots in good order show of them.
    """
    if held_out is not None and order is not None:
        answers = [answer for answer in answers if not _contradicted(answer, named, held_out[1], order)]
    grows = held_out is not None and _grows(held_out[0], held_out[1], material)
    verdicts = [_judgement(answer, named, held_out, order, material, grows) for answer in answers]
    return tuple(
        dataclasses.replace(answer, verdict=verdict, reason=reason)
        for answer, (verdict, reason) in zip(answers, verdicts, strict=True)
    )


def _contradicted(answer: Answer, named: Sequence[Sized], held_out: Seen, order: GoodOrder) -> bool:
    """Whether an effect whose logs make it likely is, with the held-out logs, less likely than a credible set needs."""
    if answer.effect is None or answer.confirmed is not None or answer.candidate not in held_out.candidates:
        return False
    return _log_odds(answer, named, held_out, order) < min(LOG_ODDS + float(logit(answer.absent)), 0.0)


def verdict_of(answers: Sequence[Answer]) -> Verdict:
    """Return the verdict of the whole diagnosis: the weakest verdict of answers that are not negligible."""
    verdicts = [answer.verdict for answer in answers if answer.verdict != "negligible"]
    if verdicts:
        return next(verdict for verdict in WEAKEST_FIRST if verdict in verdicts)
    return "negligible" if answers else "no discrepancy"


def _judgement(
    answer: Answer,
    named: Sequence[Sized],
    held_out: Sequence[Seen] | None,
    order: GoodOrder | None,
    material: Material,
    grows: bool,
) -> tuple[Verdict, str]:
    description, largest_cost = answer.candidate.what, (abs(answer.size) + COVERAGE * answer.error) * answer.cost
    if np.all(largest_cost < np.array(material)):
        return "negligible", f"{description} costs less than matters"
    if answer.learned:
        return "unexplained", answer.reason
    if answer.unnamed and answer.effect is None and len(answer.credible) == 1:
        return "unexplained", f"no effect of the catalogue explains it; it looks like: {description}"
    if len(answer.credible) > 1:
        verdict: Verdict = "ambiguous" if answer.effect is not None else "unexplained"
        return verdict, f"these motions cannot distinguish: {'; '.join(answer.credible)}"
    if answer.effect is None:
        return "unexplained", f"{description} looks most like it, and cannot be as large"
    if held_out is not None and order is not None:
        log_odds = _log_odds(answer, named, held_out[1], order) if answer.confirmed is None else answer.confirmed
        if log_odds < LOG_ODDS:
            return "unconfirmed", f"the held-out logs do not confirm {description}"
        if grows or (answer.confirmed is None and not _better(named, held_out[0], held_out[1], order, material)):
            return "unconfirmed", f"held-out logs are not explained better with {description}"
    return "named", description


def _better(named: Sequence[Sized], without: Seen, with_named: Seen, order: GoodOrder, material: Material) -> bool:
    """Whether effects together make the held-out logs likelier, or make the gap smaller by what matters.

    Likelier by the fits with them and without, or by the linear formula about the fit without them. The fits follow
    creep that is predicted from them, and so differ by tens of log-likelihood ratios by chance, which hides what a
    small effect explains; the linear formula is wrong for large ones.
    """
    if with_named.log_evidence - without.log_evidence > LOG_ODDS:
        return True
    in_both = without.candidates == with_named.candidates  # which `order` is about
    if in_both and all(effect.candidate in without.candidates for effect in named):
        places = [place_in_model(without, effect.candidate) for effect in named]
        size = sizes_of(places, [effect.amplitudes for effect in named], without)
        if _log_ratio(size, without.logs, without, order) > LOG_ODDS:
            return True
    if without.gap is None or with_named.gap is None:
        return False
    return any(
        before - after > matters for before, after, matters in zip(without.gap, with_named.gap, material, strict=True)
    )


def _grows(without: Seen, with_named: Seen, material: Material) -> bool:
    """Whether effects make the held-out gap larger by what matters. That a size is uncertain is no excuse: what makes
    odometry worse is not the cause, or not all of it."""
    if without.gap is None or with_named.gap is None:
        return False
    return with_named.gap[0] - without.gap[0] > material.position


def _log_odds(answer: Answer, named: Sequence[Sized], held_out: Seen, order: GoodOrder) -> float:
    """Return the log-likelihood ratio (natural logarithm) of held-out logs with an effect of the size found, and
    without it."""
    if answer.candidate not in held_out.candidates:
        return 0.0
    amplitudes = next(
        (effect.amplitudes for effect in named if effect.candidate == answer.candidate), answer.amplitudes
    )
    size = sizes_of([place_in_model(held_out, answer.candidate)], [amplitudes], held_out)
    return _log_ratio(size, [log.at(-size) for log in held_out.logs], held_out, order)


def _log_ratio(size: Array, logs: Sequence[Statistics], seen: Seen, order: GoodOrder) -> float:
    """Return the log-likelihood ratio of sizes (m,) against 0, beyond what robots in good order show."""
    statistics = order.beyond(agreeing(logs, seen.lasting))
    return float(statistics.score @ size - size @ statistics.information @ size / 2)
