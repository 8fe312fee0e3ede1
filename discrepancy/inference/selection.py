"""Takes effects in one after another, refitted together; each the best one beside the others.

A candidate's gain is linear; what it is worth is seen when it has been refitted. One that vanishes in this was nothing,
and one that leaves much of what it stands for gives way to a rival. Held-out logs decide between near ones: as large as
the logs ask for, which foretells them better?
"""

import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, candidates_of, finer
from discrepancy.inference.evidence import Evidence
from discrepancy.inference.findings import Rank
from discrepancy.inference.ranking import (
    EACH_MORE,
    LEAST_GAIN,
    LEAST_SOBER,
    MARGIN,
    alike,
    creeps,
    enough,
    margin,
    pick,
    rank_of,
    ranks_of,
)

MOST = 4
"""Effects are found one after another, at most so many."""

WIDER = 3.0
"""Margins within which held-out logs decide: which candidate, as large as the logs ask for, takes away more there."""

SINGLES = 8
"""Effects with an amplitude each, the best ones, of which two are tried in the place of one with two."""

NEXT = 0.025
"""The part of what the first effect takes away that the next ones must."""

BESIDE = 0.1
"""What has no name is told beside effects if it takes away more than this part of what the first one does: amplitudes
that are a little wrong, and creep, leave some."""

TOGETHER = 1.5
"""Times more that two effects must take away together than anything alone, to be taken in where no effect was."""

FAINT = 15.0
"""The deviance that an effect must take away where held-out logs make up for what is missing."""

STILL = 0.75
"""Of what an effect had to take away where wheels may creep: enough to stay."""

CLOSE, LESS = 0.7, 15.0
"""The part of the best one's gain from which on a rival is refitted too; and deviance by which it must leave less."""

COARSELY = 2
"""Of the numbers that say where an effect is, one in so many is tried before it is found."""

REFITS, EXCHANGES, RIVALS = 4, 2, 3

MOST_AHEAD = 0.6
"""Part of a change that the next one is taken to be, at most, to go all their way at once."""


@dataclass(frozen=True)
class Found:
    """An effect on its way: of which candidate, and how large, with the standard error of its size."""

    candidate: Candidate
    effect: Effect
    error: float


class Look(Protocol):
    """Looks at what is left of logs beside some effects, by all candidates or only some (`Looks`)."""

    def __call__(self, effects: Sequence[Effect], among: Sequence[Candidate] | None = None) -> Evidence:
        """Return the evidence beside effects; among: candidates to look at, None: all."""
        ...


def one_after_another(
    robot: RobotDescription, look: Look, again: Look | None, first: Evidence, least: float, faint: bool
) -> tuple[list[Found], Evidence]:
    """Return the effects that take something away, refitted together, and the evidence of what is left.

    faint: whether held-out logs may make up for what the first one takes away too little.
    """
    found: list[Found] = []
    left, first_gain = first, 0.0
    tried_before: list[set[str]] = []
    vanished: list[Candidate] = []
    while len(found) < MOST:
        effects = [one.effect for one in found]
        best = pick(left, vanished)
        if (more_places := _with_other_places(robot, look, effects, best, least)) is not None:
            left = more_places
            best = pick(left, vanished)
        if best is not None and best.gain < max(least, NEXT * first_gain):
            break
        if best is None and not found and again is not None and faint:
            best = _faint(left, again([]), least)
        if best is None or best.candidate in vanished:
            break
        families = {one.candidate.family for one in found}
        if best.candidate.family in families:  # which cannot be as large as the logs want
            break
        first_gain = max(first_gain, best.gain)
        near, held = _near(left, best, effects, again)
        chosen = _chosen(left, held, [one for one in near if one.candidate not in vanished] or [best])
        if not chosen:
            break
        more = [one for rank in chosen for one in _as_found(robot, rank)]
        tried = _settled(robot, look, [*found, *more]) if more else None
        if tried is None:
            break
        rivals = _rivals(left, [*found, *more])
        if rivals and (
            creeps(chosen[0]) or rivals[0].gain > CLOSE * best.gain or _wanting(*tried) > BESIDE * best.gain
        ):
            more, tried = _or_another(robot, look, found, rivals, more, tried)
        kept = [one.candidate for one in tried[0]]
        gone = [one.candidate for one in more if one.candidate not in kept]
        vanished += gone
        if len(gone) == len(more):
            continue
        more = _exchanged(robot, look, *_sharpened(robot, look, *tried))
        if len(more[0]) == 2:
            more = _or_two_others(robot, look, first, *more)
        families = {one.candidate.family for one in more[0]}
        if not families or families in tried_before:
            break
        tried_before.append(families)
        found, left = more
    if len(found) < 2:
        found, left = _or_two_others(robot, look, first, found, left)
    return _without_the_needless(robot, look, found, left)


def _faint(left: Evidence, held: Evidence, least: float) -> Rank | None:
    """Return the effect that takes away most from logs and, as large as these ask for, from held-out ones together, if
    it is enough; None if it is not, or if what has no name takes away more."""
    some = [
        (one.gain + held.foretold(one.candidate, one.part, one.amplitudes), one)
        for one in ranks_of(left)
        if one.gain >= FAINT and not (creeps(one) or one.candidate.at_a_place)
    ]
    told, best = max(some, key=lambda one: one[0], default=(0.0, None))
    if best is None or not best.candidate.kinds or best.sober < LEAST_SOBER:
        return None
    return best if told >= max(least, best.gain + LEAST_SOBER) else None


def _with_other_places(
    robot: RobotDescription, look: Look, effects: list[Effect], best: Rank | None, least: float
) -> Evidence | None:
    """Return the evidence with one candidate more, which says more exactly where an effect is; None if the best
    candidate is such a one, which is sharpened in any case, or if none takes away more.

    Counts lost above one speed look little like counts lost above another one.
    """
    if best is not None and best.candidate.kinds and finer(robot, best.candidate.kinds[0]):
        return None
    some = [one for own in candidates_of(robot) for one in finer(robot, own.kinds[0])[::COARSELY]]
    ranks = [one for one in ranks_of(look(effects, some)) if one.candidate in some] if some else []
    if not ranks or ranks[0].gain < (least if best is None else best.gain):
        return None
    for one in _as_found(robot, ranks[0]):
        look([*effects, one.effect])  # from now on its candidate is looked at
    return look(effects)


def _or_two_others(
    robot: RobotDescription, look: Look, first: Evidence, found: list[Found], left: Evidence
) -> tuple[list[Found], Evidence]:
    """Return at most two effects and what they leave, or two that do far better together beside nothing, and leave
    less.

    What two effects do together may look most like a third, beside which neither of them counts, or like nothing.
    """
    places = [first.index(one.candidate) for one in found]
    own = first.best([(place, rank_of(first, place).part) for place in places if place is not None])[2]
    gain, pair = _best_pair(first, None)
    least = own + margin(gain) + LEAST_GAIN * (2 - len(found))
    if not found:
        least = max(least, TOGETHER * max((one.gain for one in ranks_of(first)), default=0.0))
    if gain < least or {one.candidate.family for one in pair} == {one.candidate.family for one in found}:
        return found, left
    settled = _settled(robot, look, [one for rank in pair for one in _as_found(robot, rank)])
    if settled is None or len(settled[0]) < 2 or _remaining(settled[1]) > _remaining(left) - LESS:
        return found, left
    return settled


def _sharpened(robot: RobotDescription, look: Look, found: list[Found], left: Evidence) -> tuple[list[Found], Evidence]:
    """Return the effects with the numbers that say where each is at their best."""
    for k in range(len(found)):
        if not (some := finer(robot, found[k].effect)):
            continue
        apart = look([one.effect for one in found[:k] + found[k + 1 :]], some)
        ranks = [one for one in ranks_of(apart) if one.candidate in some]
        own = next((one.gain for one in ranks if one.candidate == found[k].candidate), 0.0)
        if ranks and ranks[0].gain > own + MARGIN:
            settled = _settled(robot, look, [*found[:k], *_as_found(robot, ranks[0]), *found[k + 1 :]])
            if settled is not None and len(settled[0]) == len(found):
                found, left = settled
    return found, left


def _without_the_needless(
    robot: RobotDescription, look: Look, found: list[Found], left: Evidence
) -> tuple[list[Found], Evidence]:
    """Return effects but for those that count no more beside the others, the least one first."""
    while len(found) > 1:
        ranks = []
        for k, one in enumerate(found):
            apart = look([other.effect for other in found[:k] + found[k + 1 :]])
            place = apart.index(one.candidate)
            ranks.append((0.0 if place is None else rank_of(apart, place).gain, k))
        gain, k = min(ranks)
        settled = _settled(robot, look, found[:k] + found[k + 1 :]) if gain < LEAST_GAIN else None
        if settled is None:
            break
        found, left = settled
    return found, left


def decided(
    robot: RobotDescription, look: Look, again: Look, found: list[Found], left: Evidence
) -> tuple[list[Found], Evidence]:
    """Return the effects, each exchanged for a rival if it foretells the held-out logs better."""
    for k in range(len(found)):
        near = foretold(look, again, found, k)
        best = max(near, key=lambda one: one.gain)
        if best.candidate.kinds and all(best.candidate.family != one.candidate.family for one in found):
            if best.gain - max(one.gain for one in near if one.candidate == found[k].candidate) < MARGIN:
                continue
            settled = _settled(robot, look, [*found[:k], *_as_found(robot, best), *found[k + 1 :]])
            if settled is not None:
                found, left = settled
    return found, left


def foretold(look: Look, again: Look | None, found: list[Found], k: int) -> list[Rank]:
    """Return effect k beside the others, first, and its near rivals, with what they take away from the logs and, as
    large as these ask for, from the held-out ones.

    Far better ones are no rivals: they left more when they were refitted.
    """
    others = [one.effect for one in found[:k] + found[k + 1 :]]
    apart = look(others)
    place = apart.index(found[k].candidate)
    best = ranks_of(apart)[0] if place is None else rank_of(apart, place)
    reach = WIDER * margin(best.gain)
    near = [best] + [
        one
        for one in ranks_of(apart)
        if abs(one.gain - best.gain) <= reach and one.candidate != best.candidate and (creeps(best) or not creeps(one))
    ]
    if again is None or len({one.candidate.family for one in near}) < 2:
        return near
    named = [one.candidate for one in near] if all(one.candidate.kinds for one in near) else None
    held = again(others, named)
    return [_beside(held, one) for one in near]


def _beside(held: Evidence, one: Rank) -> Rank:
    """Return a candidate with what it takes away from held-out logs besides, as large as the logs ask for."""
    return dataclasses.replace(one, gain=one.gain + held.foretold(one.candidate, one.part, one.amplitudes))


def _wanting(found: list[Found], left: Evidence) -> float:
    """Return what more of the effects found would take away: 0 if they explain what they stand for."""
    best = pick(left)
    return best.gain if best is not None and any(best.candidate == one.candidate for one in found) else 0.0


def _or_another(
    robot: RobotDescription,
    look: Look,
    found: list[Found],
    rivals: Sequence[Rank],
    more: list[Found],
    tried: tuple[list[Found], Evidence],
) -> tuple[list[Found], tuple[list[Found], Evidence]]:
    """Return the effects to take in, and all refitted with what is left: those tried, or a rival that leaves less.

    Where an effect is large, contacts creep much otherwise than predicted until it is in the model; the best candidate
    by then may be a rival of the right one.
    """
    options = [(more, tried, _remaining(tried[1]) - LESS)]
    for rival in rivals:
        other = _as_found(robot, rival)
        settled = _settled(robot, look, [*found, *other]) if other else None
        if settled is not None and len(settled[0]) > len(found):
            options.append((other, settled, _remaining(settled[1])))
    return min(options, key=lambda one: one[2])[:2]


def _rivals(left: Evidence, but: list[Found]) -> list[Rank]:
    """Return effects, but for some and those on creep, that take away half of what the best of them does, or more."""
    ranks = [one for one in enough(left) if one.candidate.kinds and not creeps(one)]
    families = {one.candidate.family for one in but}
    return [one for one in ranks if one.gain > ranks[0].gain / 2 and one.candidate.family not in families][:RIVALS]


def _remaining(left: Evidence) -> float:
    """Return what the best candidate would take away besides."""
    return max((one.gain for one in ranks_of(left)), default=0.0)


def _near(
    left: Evidence, best: Rank, effects: list[Effect], again: Look | None
) -> tuple[tuple[Rank, ...], Evidence | None]:
    """Return the candidates that cannot be told from the best one, it first; by held-out logs too, if it has no name
    and others nearly as good have: then the evidence of these besides."""
    near = alike(left, best)
    if again is None or best.candidate.kinds or not any(one.candidate.kinds for one in alike(left, best, WIDER)):
        return near, None
    held = again(effects)
    told = sorted((_beside(held, one) for one in alike(left, best, WIDER)), key=lambda one: -one.gain)
    return tuple(one for one in told if one.gain >= told[0].gain - margin(told[0].gain)), held


def _chosen(left: Evidence, held: Evidence | None, near: Sequence[Rank]) -> list[Rank]:
    """Return the effect to take in, or two where two with an amplitude each do better than any one with two, or than
    what has no name; none if there is none. held: evidence that counts in the gain of those near."""
    best, named = near[0], next((one for one in near if one.candidate.kinds), None)
    if named is not None and named.candidate.columns == 1:
        return [named]
    gain, pair = _best_pair(left)
    gain += 0.0 if held is None else _pair_foretold(left, held, pair)
    if named is None:
        return list(pair) if gain - EACH_MORE > best.gain + margin(best.gain) else []
    return list(pair) if gain - EACH_MORE > named.gain - margin(named.gain) else [named]


def _pair_foretold(left: Evidence, held: Evidence, pair: Sequence[Rank]) -> float:
    """Return what two effects with an amplitude each, as large as the logs ask for, take away from held-out ones."""
    amplitudes = left.best([(k, one.part) for one in pair if (k := left.index(one.candidate)) is not None])[0]
    told = 0.0
    for one, size in zip(pair, amplitudes, strict=True):
        told += held.foretold(one.candidate, one.part, [size])
        held = held.less([(one.candidate, one.part, np.array([size]))])
    return told


def _best_pair(left: Evidence, among: int | None = SINGLES) -> tuple[float, tuple[Rank, ...]]:
    """Return what two effects with an amplitude each gain together at best, and these; 0 and none if there are none.

    among: so many that gain most alone; None: all.
    """
    single = [one for one in ranks_of(left) if one.candidate.kinds and one.candidate.columns == 1 and not creeps(one)]
    pairs = []
    for pair in itertools.combinations(single[:among], 2):
        places = [(left.index(one.candidate), one.part) for one in pair]
        pairs.append((left.best([(k, part) for k, part in places if k is not None])[2], pair))
    return max(pairs, key=lambda one: one[0], default=(0.0, ()))


def _settled(robot: RobotDescription, look: Look, found: list[Found]) -> tuple[list[Found], Evidence] | None:
    """Return effects with the amplitudes at which the logs pull them no more, and what is left; None: impossible."""
    own, before = [one.candidate for one in found], None
    for k in range(REFITS + 1 if found else 0):
        left = look([one.effect for one in found], own)
        places = [left.index(one) for one in own]
        if None in places:
            return None
        changes, covariance, _ = left.best([(place, 0.0) for place in places if place is not None])
        errors = np.sqrt(np.diag(covariance))
        ends = np.cumsum([one.columns for one in own])[:-1]
        changes, before = _ahead(changes / errors, before) * errors, changes / errors
        parts = list(zip(found, np.split(changes, ends), np.split(errors, ends), strict=True))
        found = [dataclasses.replace(one, error=float(error.max())) for one, _, error in parts]
        if np.all(np.abs(changes) < 0.1 * errors) or k == REFITS:
            break
        moved = [_moved(robot, new, by) for new, (_, by, _) in zip(found, parts, strict=True)]
        if None in moved:
            return _settled(robot, look, [one for one, new in zip(found, moved, strict=True) if new is not None])
        found = [one for one in moved if one is not None]
    return found, look([one.effect for one in found])


def _ahead(changes: Array, before: Array | None) -> Array:
    """Return changes, larger if each is a part of the one before: what truly happened follows only by and by."""
    if before is None or not before @ before > 0:
        return changes
    part = float(np.clip(changes @ before / (before @ before), 0.0, MOST_AHEAD))
    return changes / (1 - part)


def _moved(robot: RobotDescription, one: Found, by: Array) -> Found | None:
    """Return an effect with its amplitudes changed; as it is at the end of what can be; None if it would vanish."""
    before = one.candidate.amplitudes(one.effect)
    try:
        return dataclasses.replace(one, effect=_within(robot, one.candidate, before + by))
    except InputError:
        return one if before @ by > 0 else None


def _exchanged(robot: RobotDescription, look: Look, found: list[Found], left: Evidence) -> tuple[list[Found], Evidence]:
    """Return effects each of which is the best one beside the others."""
    for _ in range(EXCHANGES):
        for k in range(len(found)) if len(found) > 1 else ():
            others = found[:k] + found[k + 1 :]
            apart = look([one.effect for one in others])
            place = apart.index(found[k].candidate)
            own = None if place is None else rank_of(apart, place)
            best = pick(apart)
            if best is None:
                if own is not None and own.gain >= LEAST_GAIN and own.sober >= STILL * LEAST_SOBER:
                    continue
                settled = _settled(robot, look, others)
                return (found, left) if settled is None else settled
            if own is not None and creeps(best) and not creeps(own):  # it left more when it was refitted
                continue
            named = next((one for one in alike(apart, best) if one.candidate.kinds), None)
            if named is not None and named.candidate.family != found[k].candidate.family:
                if own is not None and named.gain - own.gain < margin(named.gain):
                    continue
                twice = any(named.candidate == one.candidate for one in others)
                settled = _settled(robot, look, others if twice else [*others, *_as_found(robot, named)])
                if settled is not None:
                    found, left = settled
                    break
        else:
            break
    return found, left


def _as_found(robot: RobotDescription, rank: Rank) -> list[Found]:
    """Return a candidate as an effect of its size, or of its step if it cannot have this size; none if neither."""
    for amplitudes in (np.array(rank.amplitudes), rank.candidate.amplitudes(rank.candidate.kinds[0])):
        try:
            return [Found(rank.candidate, _within(robot, rank.candidate, amplitudes), rank.error)]
        except InputError:
            continue
    return []


def _within(robot: RobotDescription, candidate: Candidate, amplitudes: Array) -> Effect:
    """Return the effect; raises InputError if it or the robot cannot have these amplitudes."""
    try:
        effect = candidate.effect(amplitudes)
        robot.with_effects(effect).as_built()
    except ValueError as error:
        raise InputError(str(error)) from None
    return effect
