"""Which candidate explains most of what logs say: what counts at all, what comes last, what cannot be told apart."""

import dataclasses
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from discrepancy.hypotheses.candidates import Candidate
from discrepancy.inference.evidence import Evidence
from discrepancy.inference.findings import Rank

LEAST_GAIN = 30.0
"""The deviance that a candidate must take away."""

LEAST_WITHOUT_NAME = 40.0
"""The same of what has no name; there are many of these."""

LEAST_OF_CREEP, MUCH_CREEP = 40.0, 2.0
"""The same of how contacts creep, which is predicted; and how many times more than any other
candidate these must take away, as wrong contacts look a little like everything."""

EACH_MORE = 10.0
"""Deviance that a candidate must take away more for a second amplitude, or for a number that suits the logs."""

LEAST_SOBER = 10.0
"""The deviance that it must take away where all wheels may creep."""

LEAST_OF_PLACE, MUCH_OF_PLACE = 60.0, 2.0
"""The same of something on the floor, whose place was looked for in the same logs: lines of all places and directions
look a little like everything too."""

MARGIN, PART, LIKENESS = 6.0, 0.015, 0.03
"""Deviance, and part of the gain, by which a candidate may be worse than the best and not be told from it; of the
latter no more than such a part of the sine between both: what signatures are wrong by is the same of like ones."""

ROUGHLY = 0.25
"""The part by which amplitudes may be wrong before they are refitted."""


@lru_cache(maxsize=32)
def ranks_of(seen: Evidence) -> tuple[Rank, ...]:
    """Return all candidates that can be, the one that takes away most first."""
    ranks = [rank_of(seen, k) for k in range(len(seen.candidates))]
    return tuple(sorted((one for one in ranks if _possible(one)), key=lambda one: -one.gain))


def rank_of(seen: Evidence, k: int) -> Rank:
    """Return candidate k, with the part of it that wheels hide most likely, and what it takes away."""
    part = seen.parted(k)
    amplitudes, covariance, gain = seen.best([(k, part)])
    _, _, sober = seen.best([(k, part)], sober=True)
    errors = np.sqrt(np.diag(covariance))
    more = len(amplitudes) - 1 + seen.candidates[k].sought
    gain, sober = (one - EACH_MORE * more for one in (gain, sober))
    return Rank(seen.candidates[k], gain, sober, part, tuple(amplitudes.tolist()), tuple(errors.tolist()))


def pick(seen: Evidence, but: Sequence[Candidate] = ()) -> Rank | None:
    """Return the candidate that takes away most of those that take away enough, but for some; None if none does."""
    some = [one for one in enough(seen) if one.candidate not in but]
    plain = [one for one in some if not (creeps(one) or one.candidate.at_a_place)]
    if plain and plain[0].gain * (MUCH_CREEP if creeps(some[0]) else MUCH_OF_PLACE) > some[0].gain:
        return plain[0]
    return some[0] if some else None


def enough(seen: Evidence) -> list[Rank]:
    """Return the candidates that take away enough to count, the one that takes away most first."""
    return [one for one in ranks_of(seen) if one.gain >= _least(one) and one.sober >= LEAST_SOBER]


def alike(seen: Evidence, best: Rank, wider: float = 1.0) -> tuple[Rank, ...]:
    """Return the candidates that cannot be told from the best one, it first; `wider` for so many times the margin."""
    limit = best.gain - wider * margin(best.gain)
    return tuple(one for one in ranks_of(seen) if limit <= one.gain <= best.gain and (creeps(best) or not creeps(one)))


def margin(gain: float, sine: float = 1.0) -> float:
    """Return by how much less than the best one's gain a candidate's may be and not be told from it.

    sine: of the angle between what both leave in logs, if it is known.
    """
    return MARGIN + min(PART, LIKENESS * sine) * gain


def sine(seen: Evidence, one: Rank, other: Rank) -> float:
    """Return the sine of the angle between what a candidate leaves in logs and the most of it that another can be."""
    k, j = seen.index(one.candidate), seen.index(other.candidate)
    if k is None or j is None:
        return 1.0
    expected = seen.expecting(k, one.part, one.amplitudes)
    own, rivals = (expected.best([place])[2] for place in ((k, one.part), (j, other.part)))
    return float(np.sqrt(max(1.0 - rivals / own, 0.0))) if own > 0 else 1.0


def creeps(one: Rank) -> bool:
    """Whether it is about how contacts creep."""
    return bool(one.candidate.kinds) and one.candidate.kinds[0].creep == "compliance"


def _least(one: Rank) -> float:
    if one.candidate.at_a_place:
        return LEAST_OF_PLACE
    if not one.candidate.kinds:
        return LEAST_WITHOUT_NAME
    return LEAST_OF_CREEP if creeps(one) else LEAST_GAIN


def _possible(one: Rank) -> bool:
    """Whether an effect can have an amplitude within three standard errors, or `ROUGHLY`, of this one."""
    if not one.candidate.kinds or one.candidate.columns > 1:
        return True
    kind, far = one.candidate.kinds[0], max(3 * one.errors[0], ROUGHLY * abs(one.size))
    low, high = one.size - far, one.size + far
    for value in (one.size, low, high, *(end for end in (kind.step, 0.0) if low <= end <= high)):
        try:
            dataclasses.replace(kind, value=value)
        except ValueError:
            continue
        return True
    return False
