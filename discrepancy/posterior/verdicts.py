"""What is said of an answer: it follows from its probabilities, from held-out logs, and from what it costs in use."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from discrepancy.posterior.answers import Answer, Seen, Verdict
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.posterior.random_effects import GoodOrder
from discrepancy.posterior.refit import Sized
from estimators.calibration.identifiability import COVERAGE

WEAKEST_FIRST: tuple[Verdict, ...] = ("unexplained", "ambiguous", "unconfirmed", "named", "negligible")


class Material(NamedTuple):
    """What matters in use: m after 10 m, and rad after a turn."""

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
    """Return the answers with their verdicts.

    named: all effects that are in the model. held_out: what held-out logs say without and with these, of these alone;
    order: what robots in good order show of them.
    """
    grows = held_out is not None and _grows(answers, *held_out)
    verdicts = [_judgement(answer, named, held_out, order, material, grows) for answer in answers]
    return tuple(
        dataclasses.replace(answer, verdict=verdict, reason=reason)
        for answer, (verdict, reason) in zip(answers, verdicts, strict=True)
    )


def verdict_of(answers: Sequence[Answer]) -> Verdict:
    """Return the verdict of all answers: the weakest of what matters."""
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
    what, most = answer.candidate.what, (abs(answer.size) + COVERAGE * answer.error) * answer.cost
    if np.all(most < np.array(material)):
        return "negligible", f"{what} costs less than matters"
    if answer.learned:
        return "unexplained", answer.reason
    if answer.unnamed and answer.effect is None and len(answer.credible) == 1:
        return "unexplained", f"no effect of the catalogue explains it; it looks like: {what}"
    if len(answer.credible) > 1:
        verdict: Verdict = "ambiguous" if answer.effect is not None else "unexplained"
        return verdict, f"these motions cannot distinguish: {'; '.join(answer.credible)}"
    if answer.effect is None:
        return "unexplained", f"{what} looks most like it, and cannot be as large"
    if held_out is not None and order is not None:
        log_odds = _log_odds(answer, named, held_out[1], order) if answer.confirmed is None else answer.confirmed
        if log_odds < LOG_ODDS:
            return "unconfirmed", f"the held-out logs do not confirm {what}"
        if grows:
            return "unconfirmed", f"the held-out gap does not shrink with {what}"
    return "named", what


def _grows(answers: Sequence[Answer], without: Seen, with_them: Seen) -> bool:
    """Whether effects make the held-out gap larger by more than what their own errors cost."""
    if without.gap is None or with_them.gap is None:
        return False
    error = np.linalg.norm([COVERAGE * answer.error * answer.cost[0] for answer in answers])
    return bool(with_them.gap[0] - without.gap[0] > error)


def _log_odds(answer: Answer, named: Sequence[Sized], held_out: Seen, order: GoodOrder) -> float:
    """Return by how much (natural logarithm) an effect, as large as found, makes held-out logs more likely."""
    if answer.candidate not in held_out.candidates:
        return 0.0
    size = np.zeros(len(held_out.logs[0].score))
    amplitudes = next((one.amplitudes for one in named if one.candidate == answer.candidate), answer.amplitudes)
    size[held_out.columns[held_out.candidates.index(answer.candidate)]] = amplitudes
    said = order.beyond([log.at(-size) for log in held_out.logs])
    return float(said.score @ size - size @ said.information @ size / 2)
