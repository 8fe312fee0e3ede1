"""The verdict on an answer: it follows from its probabilities, from held-out logs, and from its cost in use."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import expit, logit

from castor_envs.geometry.arrays import Array
from discrepancy.posterior.answers import Answer, Cause, Seen, Verdict
from discrepancy.posterior.calibrated import CREDIBLE, FAULT, LOG_ODDS, SIGNATURE
from discrepancy.posterior.model.refit import Sized, sizes_of
from discrepancy.posterior.priors import bounds_of, directions_in_model
from discrepancy.posterior.random_effects import GoodOrder, Statistics, agreeing
from estimators.calibration.identifiability import COVERAGE

WEAKEST_FIRST: tuple[Verdict, ...] = (
    "unexplained",
    "ambiguous",
    "unconfirmed",
    "named",
    "negligible",
    "no discrepancy",
)

HALF = 0.5
"""Part of a gap from which on, if it stays, something that matters is still unknown."""


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
    fit: Callable[[Sequence[Sized]], Seen | None] | None = None,
    usual_gap: tuple[float, float] | None = None,
    own: Sequence[Seen] | None = None,
) -> tuple[Answer, ...]:
    """Return the answers with their verdicts and with their probabilities by all logs, without those that held-out logs
    contradict so much that "nothing" is in the credible set of all logs together.

    named: all effects that are in the model. held_out: statistics of held-out logs without and with these effects, of
    these candidates only; order: what robots in good order show of them; fit: returns statistics of these logs with
    other effects in the model, None where they do not fit. usual_gap: that of clean logs, if there are any. own:
    statistics of the logs themselves, without and with these effects.
    """
    kept = None if held_out is None or order is None else _Confirmation(named, held_out[0], held_out[1], order, fit)
    if kept is not None:
        answers = [kept.updated(answer) for answer in answers if not kept.contradict(answer)]
    verdicts = [_judgement(answer, kept, material) for answer in answers]
    told = [
        negligible(answer, reason)
        if verdict == "negligible"
        else dataclasses.replace(answer, verdict=verdict, reason=reason)
        for answer, (verdict, reason) in zip(answers, verdicts, strict=True)
    ]
    unexplained = max((_price(answer, material) for answer in told if answer.verdict == "unexplained"), default=0.0)
    for pair, which in ((held_out, "held-out gap"), (own, "gap")):
        if unexplained and pair is not None and _half_stays(pair[0], pair[1], usual_gap, material):
            return tuple(_doubted(answer, f"with which half of the {which} stays") for answer in told)
    return tuple(
        _doubted(answer, "which costs more") if _price(answer, material) < unexplained else answer for answer in told
    )


def negligible(answer: Answer, reason: str) -> Answer:
    """Return an answer on what does not matter, or was there before, told by `reason`.

    Probabilities are those of effects that are missing and matter. This verdict holds if an effect does neither with a
    probability of `CREDIBLE`, so that at most the rest of its probability stays.
    """
    kept = {name: (1 - CREDIBLE) * part for name, part in answer.probabilities.items() if name != "nothing"}
    probabilities = kept | {"nothing": 1 - sum(kept.values())}
    return dataclasses.replace(answer, probabilities=probabilities, verdict="negligible", reason=reason)


def by_all_logs(inclusion: Mapping[str, float], before: Sequence[Answer], after: Sequence[Answer]) -> dict[str, float]:
    """Return the probability of every name to be among the missing effects that matter, by all logs, the largest first.

    inclusion: that by the logs without the held-out ones; before, after: answers before and after these judged them. A
    name that they contradict has none.
    """
    told = [answer.candidate for answer in after]
    denied = {name for answer in before if answer.candidate not in told for name in answer.credible}
    found = {name: part for name, part in inclusion.items() if name not in denied}
    trifles = [answer for answer in after if answer.verdict == "negligible"]
    found |= {name: part for answer in trifles for name, part in answer.probabilities.items() if name in found}
    found |= {name: answer.probabilities[name] for answer in after for name in answer.credible[:1]}
    return dict(sorted(found.items(), key=lambda entry: -entry[1]))


def weakest(verdicts: Iterable[Verdict]) -> Verdict:
    """Return the verdict of several together: the weakest of them, or "no discrepancy" if there is none."""
    given = {*verdicts, WEAKEST_FIRST[-1]}
    return next(verdict for verdict in WEAKEST_FIRST if verdict in given)


def gap_shrinks(before: Seen, after: Seen, material: Material) -> bool:
    """Whether the gap is smaller by what matters, in position or in heading."""
    if before.gap is None or after.gap is None:
        return False
    return any(was - now > matters for was, now, matters in zip(before.gap, after.gap, material, strict=True))


def gap_grows(before: Seen, after: Seen, material: Material) -> bool:
    """Whether the gap is larger by what matters: in position, and in position and heading together, each in units of
    what matters. That a size is uncertain is no excuse: what makes odometry worse is not the cause, or not all of it.
    """
    if before.gap is None or after.gap is None or after.gap[0] - before.gap[0] <= material.position:
        return False
    return in_units(after.gap, material) > in_units(before.gap, material)


def in_units(gap: tuple[float, float], material: Material) -> float:
    """Return a gap in position and heading together, each in units of what matters; of positions alone the heading does
    not count."""
    return float(np.linalg.norm(np.nan_to_num(gap) / np.maximum(material, 1e-12)))


def _half_stays(before: Seen, after: Seen, usual_gap: tuple[float, float] | None, material: Material) -> bool:
    """Whether half of the gap of logs, or more, stays with all effects in the model, and clean logs have none as large:
    in position or in heading, of which was the larger in units of what matters."""
    if before.gap is None or after.gap is None:
        return False
    k = int(np.argmax(np.nan_to_num(before.gap) / np.maximum(material, 1e-12)))
    if usual_gap is not None and usual_gap[k] >= HALF * after.gap[k]:
        return False
    return after.gap[k] >= HALF * before.gap[k]


def _price(answer: Answer, material: Material) -> float:
    """Return the odometry error that an effect of the size found causes, in units of what matters."""
    return float(np.linalg.norm(answer.size * answer.cost / np.maximum(material, 1e-12)))


def _doubted(answer: Answer, why: str) -> Answer:
    """Return the answer on an effect beside something unexplained that costs more, or that leaves half of the gap, told
    by `why`: it is as likely a part of that."""
    if answer.verdict not in ("named", "unconfirmed"):
        return answer
    (name,) = answer.credible
    probabilities = answer.probabilities | {name: answer.probability / 2}
    probabilities["nothing"] = probabilities.get("nothing", 0.0) + answer.probability / 2
    doubted = f"{answer.candidate.what} may be a part of what is unexplained, {why}"
    reason = doubted if answer.verdict == "named" else answer.reason
    return dataclasses.replace(answer, probabilities=probabilities, verdict="unconfirmed", reason=reason)


def _judgement(answer: Answer, held_out: "_Confirmation | None", material: Material) -> tuple[Verdict, str]:
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
    if answer.effect is None or _may_be_at_its_end(answer):
        return "unexplained", f"{description} looks most like it, and cannot be as large"
    if abs(answer.size) < COVERAGE * answer.error:
        return "unconfirmed", f"these logs do not determine the size of {description}, which may be 0"
    if held_out is not None:
        if held_out.log_ratio(answer) < LOG_ODDS:
            return "unconfirmed", f"the held-out logs do not confirm {description}"
        grows = gap_grows(held_out.without, held_out.with_named, material)
        if grows or (answer.confirmed is None and not held_out.better(material)):
            return "unconfirmed", f"held-out logs are not explained better with {description}"
        if answer.probability < CREDIBLE and held_out.log_ratio_of_size(answer) < 0:
            return "unconfirmed", f"held-out logs show another size of {description}, so it is hardly constant"
    if answer.probability < CREDIBLE:
        return "unconfirmed", f"{description} is less than {CREDIBLE:.0%} certain"
    return "named", description


def _may_be_at_its_end(answer: Answer) -> bool:
    """Whether the 95 % interval of an effect's size reaches the end of what it can be, other than 0: logs would be
    likelier with one that is larger still."""
    kind, error = answer.candidate.kinds[0], COVERAGE * answer.error
    least, most = bounds_of(kind)
    return not kind.binary and (answer.size + error >= most or (least < 0 and answer.size - error <= least))


@dataclass(frozen=True, eq=False)
class _Confirmation:
    """Held-out logs: their statistics without and with the named effects in the model. Log-likelihood ratios are
    natural logarithms, beyond what robots in good order show.

    Fits with and without effects predict creep anew from their states, so their log evidences differ by chance as well,
    which may hide what a small effect explains. Of a large effect the linear formula about the fit without it is
    wrong.
    """

    named: Sequence[Sized]
    without: Seen
    with_named: Seen
    order: GoodOrder
    fit: Callable[[Sequence[Sized]], Seen | None] | None
    _of_sizes: dict[Cause, float] = dataclasses.field(default_factory=dict)

    def log_ratio(self, answer: Answer) -> float:
        """Return the log-likelihood ratio of an effect of the size found against none."""
        if answer.confirmed is not None:
            return answer.confirmed
        if answer.candidate not in self.with_named.candidates:
            return 0.0
        effect = self._sized(answer)
        others = [other for other in self.named if other.candidate != answer.candidate]
        together, of_others = self._about_without([*others, effect]), self._about_without(others)
        if together is not None and of_others is not None:
            gained = self.with_named.log_evidence - self.without.log_evidence
            if gained < together + LOG_ODDS:  # else the signature hardly shows, beside what passes for noise without it
                return together - of_others
            if len(self.named) == 1:  # without a reference, what wheels mask entirely leaves no linear trace
                return gained
        size = sizes_of([effect], self.with_named)
        return self._log_ratio(size, [log.at(-size) for log in self.with_named.logs])

    def contradict(self, answer: Answer) -> bool:
        """Whether an effect that logs make likely is less likely with the held-out logs than a credible set needs."""
        if answer.effect is None or answer.confirmed is not None:
            return False
        return self.log_ratio(answer) < min(LOG_ODDS + float(logit(answer.absent)), 0.0)

    def updated(self, answer: Answer) -> Answer:
        """Return an answer with the probability that its effect is the cause in these logs as well.

        What explains the other logs for certain is something else, which only looks like it, once in as many times as
        a credible set is wrong. In these logs that has another size of the same order, or leaves nothing, equally
        likely; the effect has the size found.
        """
        if answer.effect is None or len(answer.credible) != 1:
            return answer
        absent = self.log_ratio(answer)
        ratio = np.log(2) - np.logaddexp(-absent, -self.log_ratio_of_size(answer))
        part, (name,) = float(expit(LOG_ODDS + ratio)), answer.credible
        probabilities = answer.probabilities | {name: part * answer.probability}
        probabilities["nothing"] = probabilities.get("nothing", 0.0) + (1 - part) * answer.probability
        return dataclasses.replace(answer, probabilities=probabilities)

    def log_ratio_of_size(self, answer: Answer) -> float:
        """Return the log-likelihood ratio of an effect's size in held-out logs being the one found against another one
        of the same order. Effects of the catalogue have one size; what another cause mimics need not."""
        if answer.candidate not in self._of_sizes:  # it may take a fit
            self._of_sizes[answer.candidate] = self._log_ratio_of_size(answer)
        return self._of_sizes[answer.candidate]

    def _log_ratio_of_size(self, answer: Answer) -> float:
        if answer.confirmed is not None or answer.candidate not in self.with_named.candidates:
            return 0.0
        effect = self._sized(answer)
        shown = [other for other in self.named if other.candidate in self.with_named.candidates]
        effects = [effect, *(other for other in shown if other.candidate != answer.candidate)]
        sizes = [sized.amplitudes for sized in effects]
        logs = [log.at(-sizes_of(effects, self.with_named)) for log in self.with_named.logs]
        along = directions_in_model(self.with_named, [sized.candidate for sized in effects])
        statistics = self.order.beyond(agreeing(logs, self.with_named.lasting)).of_combinations(along)
        prior = np.repeat([1 / (FAULT**2 * (size @ size)) for size in sizes], [len(size) for size in sizes])
        covariance = np.linalg.inv(statistics.information + np.diag(prior))
        count, square = len(effect.amplitudes), float(effect.amplitudes @ effect.amplitudes)
        away = (covariance @ statistics.score)[:count] - effect.amplitudes
        same = covariance[:count, :count] + answer.covariance + SIGNATURE**2 * square * np.eye(count)
        other = same + square * np.eye(count)
        ratio = _log_density(away, same) - _log_density(away, other)
        if ratio > -LOG_ODDS or self.fit is None:
            return ratio
        moved = [one.moved(away) if one.candidate == answer.candidate else one for one in self.named]
        found = self.fit(moved)  # the formula may be far off
        likelier = found is not None and found.log_evidence - self.with_named.log_evidence > LOG_ODDS
        return ratio if likelier else 0.0

    def better(self, material: Material) -> bool:
        """Whether all effects together make the held-out logs likelier, or their gap smaller by what matters."""
        gained, ratio = self.with_named.log_evidence - self.without.log_evidence, self._about_without(self.named)
        likelier = gained > LOG_ODDS or (ratio is not None and ratio > LOG_ODDS)
        return likelier or gap_shrinks(self.without, self.with_named, material)

    def _sized(self, answer: Answer) -> Sized:
        """Return the effect of an answer as it is in the model."""
        found = (effect for effect in self.named if effect.candidate == answer.candidate)
        return next(found, Sized(answer.candidate, answer.amplitudes))

    def _about_without(self, effects: Sequence[Sized]) -> float | None:
        """Return the log-likelihood ratio of effects together against none, by the fit without them; None for effects
        so large that the error of their signatures exceeds noise, or where they pass for noise."""
        in_both = self.without.candidates == self.with_named.candidates  # which `order` is about
        if not (in_both and self.without.redundant) or any(
            effect.candidate not in self.without.candidates for effect in effects
        ):
            return None
        size = sizes_of(effects, self.without, self.with_named.masked)
        explained = sum(float(size @ log.information @ size) for log in self.without.logs)
        return self._log_ratio(size, self.without.logs) if explained * SIGNATURE**2 < 1 else None

    def _log_ratio(self, size: Array, logs: Sequence[Statistics]) -> float:
        return self.order.beyond(agreeing(logs, self.with_named.lasting)).gain(size)


def _log_density(away: Array, covariance: Array) -> float:
    """Return the logarithm of a normal density of mean 0, up to a constant."""
    return -float(np.linalg.slogdet(covariance)[1] + away @ np.linalg.solve(covariance, away)) / 2
