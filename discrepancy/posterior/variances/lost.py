"""Counts that a wheel's encoder loses at speed, where the candidates of the catalogue do not show it.

Of a large loss no linear signature does: the fitted wheel follows its encoder, so that it seems too slow to lose any.
How far it rolls by the other wheels, or, where these do not tell, by the reference, is compared with what it turns if
its encoder loses a part; the part with which both agree best is where the whole model is fitted from.

From which speed on counts are lost, nobody knows beforehand. Beside the effects in the model, and with each of them
left out, losses above several speeds are compared by their signatures. The speed of the best, as that of a loss in the
model, is refined by fits.
"""

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from operator import itemgetter

import numpy as np

from castor_envs.effects.dimensions import WheelRadius
from castor_envs.effects.encoders import TickLoss
from castor_envs.effects.parts import channel
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, candidates_of, described, place_of
from discrepancy.measurement.fit_states import wheel_readings
from discrepancy.posterior.answers import Cause
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.posterior.linearise import Linearised
from discrepancy.posterior.model.named_together import by_formula
from discrepancy.posterior.model.refit import Effects, Sized, families_of, moved_by, statistics_of
from discrepancy.posterior.priors import alike, bounds_of
from discrepancy.posterior.random_effects import summed
from estimators.likelihood.channels import Channels
from estimators.likelihood.statistics import least_squares

PARTS = np.arange(1, 21) / 20
"""Losses that are tried, as parts of the largest."""

SPEEDS = np.arange(1, 8) / 8
"""Speeds from which on counts may be lost, as parts of the wheel's fastest."""

FASTEST = 99.0
"""Percentile of a wheel's speeds that counts as its fastest, as single readings may be wrong."""

HALVINGS = 3
"""How often the distance to the speeds beside the best one is halved."""

Look = Callable[[Sequence[Sized], Sequence[Cause]], Linearised | None]
"""Returns the statistics of logs with effects in the model, of these candidates; None where they do not fit."""


def lossy_encoders(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, least: float, besides: Collection[str] = ()
) -> list[Sized]:
    """Return the loss of a wheel's encoder with which it agrees better with the other wheels or the reference, by a log
    likelihood ratio of more than `least` and the most of all; besides: families that are not considered."""
    channels, found = Channels(robot), list[Sized]()
    for candidate in candidates_of(robot):
        kind = candidate.kinds[0]
        if not isinstance(kind, TickLoss) or candidate.family in besides:
            continue
        sizes = PARTS * bounds_of(kind)[1]
        losses = [replace(kind, value=size) for size in sizes.tolist()]
        before, after, count = 0.0, np.zeros(len(sizes)), 0
        for design, log in zip(seen.designs, logs, strict=True):
            read, likely, per_count = wheel_readings(
                robot, channels, design.model, design.state, kind, design.model.counts
            )
            turned = [loss.turned(np.diff(log.t), read, likely, per_count) for loss in losses]
            before += float(np.sum((likely - read) ** 2))
            after += np.sum((likely - turned) ** 2, axis=1)
            count += len(read)
        best = int(np.argmin(after))
        if (likelier := count / 2 * float(np.log(before / after[best]))) > least:
            found, least = [Sized(candidate, sizes[best : best + 1])], likelier
    return found


def as_one_loss(robot: RobotDescription, logs: Sequence[Log], named: Sequence[Sized], look: Look) -> Effects:
    """Return the effects in the model (`named`), each loss of counts above the speed with which fits are the likeliest,
    and those of one wheel forward and backward as one either way.

    robot: without effects.
    """
    found = _either_way(named)
    for effect in found:
        if isinstance(effect.candidate.kinds[0], TickLoss):
            speeds = {loss: step for loss, step in _at_speeds(robot, logs) if loss.family == effect.candidate.family}
            kept = (other for other in found if other is not effect)
            found = _refined((*kept, effect), next(iter(speeds.values())), look, list(speeds))
    return found


def without_wheels_of_losses(named: Sequence[Sized]) -> Effects:
    """Return effects without those, other than losses, of wheels that lose counts: above a wrong speed, a loss leaves
    some of what it does to another effect of its wheel."""
    losses = [effect for effect in named if isinstance(effect.candidate.kinds[0], TickLoss)]
    lossy = {_wheel_of(effect.candidate) for effect in losses}
    return tuple(effect for effect in named if effect in losses or _wheel_of(effect.candidate) not in lossy)


def _wheel_of(cause: Cause) -> tuple[int | None, int | None]:
    """Return the castor and wheel that an effect of the catalogue is of, None where it is of none."""
    kind = cause.kinds[0]
    return getattr(kind, "castor", None), getattr(kind, "wheel", None)


def _either_way(named: Sequence[Sized]) -> Effects:
    """Return effects with the losses of a wheel's counts forward and backward as one either way, of their mean."""
    found = tuple(named)
    for one, other in itertools.permutations(named, 2):
        (forward,), (backward,) = one.candidate.kinds[:1], other.candidate.kinds[:1]
        if isinstance(forward, TickLoss) and isinstance(backward, TickLoss) and forward.direction == "forward":
            both = replace(forward, direction="both", above=round((forward.above + backward.above) / 2, 3))
            if replace(backward, value=both.value, above=both.above, direction="both") == both:
                mean = (one.amplitudes + other.amplitudes) / 2
                found = (*(effect for effect in found if effect not in (one, other)), Sized(_loss(both), mean))
    return found


def _loss(effect: TickLoss) -> Candidate:
    """Return the candidate of one loss."""
    return Candidate(described(effect), (effect,))


def lossy_above(
    robot: RobotDescription, logs: Sequence[Log], named: Sequence[Sized], look: Look, odds: float
) -> Effects | None:
    """Return the effects in the model (`named`), or all but one of them, with the loss of a wheel's encoder above the
    speed with which logs are likeliest; None if none makes them likelier than `advantage` asks by the linear formula,
    or if the wheel is always faster, one way, so that it is one of another radius.

    robot: without effects. odds: prior log odds of an effect.
    """
    apart, best, found = dict(_at_speeds(robot, logs)), 0.0, None
    seen = look(named, [*apart, *(effect.candidate for effect in named)])
    if seen is None:
        return None
    for candidate, step in apart.items():
        for left_out in (None, *range(len(named))):
            if candidate.family in families_of([effect for k, effect in enumerate(named) if k != left_out]):
                continue  # a wheel loses counts above one speed
            proposed, gain = _proposed(candidate, named, left_out, seen)
            if gain > advantage(proposed, named, odds) + best and proposed[-1].size > 0:
                best, found = gain - advantage(proposed, named, odds), (proposed, step)
    if found is None:
        return None
    (*kept, loss) = refined = _refined(*found, look)
    return None if _is_radius(loss.candidate, robot, look, kept) else refined


def advantage(effects: Sequence[Sized], named: Sequence[Sized], odds: float) -> float:
    """Return the log-likelihood ratio from which on effects, a loss above a speed that was chosen among them, are
    likelier than those in the model (`named`) by the ratio of a credible set. odds: prior log odds of an effect."""
    return LOG_ODDS + math.log(len(SPEEDS)) - (len(effects) - len(named)) * odds


def of_same_wheel(loss: Sized, named: Sequence[Sized], seen: Linearised) -> list[Sized]:
    """Return the effect of the catalogue that is of the same wheel as a loss, and not in the model (`named`), with
    which logs are the likeliest by the linear formula, if there is one: above a speed that is nearly always exceeded,
    a loss looks like a wheel of another radius."""
    found = [
        by_formula(candidate, seen)
        for candidate in seen.candidates
        if candidate.kinds
        and _wheel_of(candidate) == _wheel_of(loss.candidate)
        and candidate.family not in families_of(named)
    ]
    return [max(found, key=itemgetter(1))[0]] if found else []


def _is_radius(loss: Cause, robot: RobotDescription, look: Look, beside: Sequence[Sized]) -> bool:
    """Whether a loss does to logs what another radius of its wheel does, beside effects in the model."""
    place = place_of(loss.kinds[0])
    radii = [
        candidate
        for candidate in candidates_of(robot)
        if isinstance(kind := candidate.kinds[0], WheelRadius) and place_of(kind).items() <= place.items()
    ]
    seen = look(beside, [loss, *radii])
    if seen is None or not {loss, *radii} <= set(seen.candidates):
        return False
    information = summed(seen.logs).information
    at, *others = (int(seen.columns[cause][0]) for cause in (loss, *radii))
    return any(alike(information, at, other) for other in others)


def _at_speeds(robot: RobotDescription, logs: Sequence[Log]) -> Iterator[tuple[Candidate, float]]:
    """Yield losses of each wheel, one way and either way, above each of `SPEEDS`, and how far these are apart,
    rad/s."""
    one_way = TickLoss.variants(robot)
    both = [replace(kind, direction="both") for kind in one_way if kind.direction == "forward"]
    for kind in (*one_way, *both):
        k = channel(robot, kind.castor, kind.wheel, kind.name)
        per_count = 2 * np.pi / float(robot.wheels[k].counts_per_rev or 1)
        speeds = [np.abs(np.diff(log.wheel[:, k])) * per_count / np.diff(log.t) for log in logs]
        fastest = float(np.percentile(np.concatenate(speeds), FASTEST))
        for part in SPEEDS.tolist():
            yield _loss(replace(kind, above=round(part * fastest, 3))), fastest * float(SPEEDS[0])


def _proposed(
    candidate: Candidate, named: Sequence[Sized], left_out: int | None, seen: Linearised
) -> tuple[Effects, float]:
    """Return effects in the model without one of them, and a candidate, in the sizes that make logs the likeliest by
    the linear formula, and by how much."""
    shown = [(k, effect) for k, effect in enumerate(named) if effect.candidate in seen.candidates]
    if candidate not in seen.candidates:
        return (*named, Sized(candidate, np.zeros(1))), 0.0
    loss = Sized(candidate, np.zeros(1))
    statistics = statistics_of([*(effect for _, effect in shown), loss], seen)
    information, score = statistics
    each = np.split(np.arange(len(score)), np.cumsum([len(effect.amplitudes) for _, effect in shown]))
    change, free = np.zeros(len(score)), np.ones(len(score), dtype=bool)
    for (k, effect), at in zip(shown, each, strict=False):
        if k == left_out:
            change[at], free[at] = -effect.amplitudes, False
    left = score - information @ change
    change[free] = least_squares(information[np.ix_(free, free)], left[free])
    moved = {k: effect.moved(change[at]) for (k, effect), at in zip(shown, each, strict=False)}
    kept = [moved.get(k, effect) for k, effect in enumerate(named) if k != left_out]
    return (*kept, loss.moved(change[-1:])), statistics.gain(change)


def _refined(effects: Effects, apart: float, look: Look, others: Sequence[Candidate] = ()) -> Effects:
    """Return effects of which the last is a loss above one of several speeds that are so far apart (rad/s), with the
    speed and the sizes with which logs are the likeliest, by fits and a linear step from these.

    others: the same loss above other speeds, of which the best by the linear formula is compared with it, too.
    """
    *kept, loss = effects
    (kind,) = loss.candidate.kinds
    assert isinstance(kind, TickLoss)

    def above(speed: float) -> tuple[float, float, Effects]:
        proposed = *kept, replace(loss, candidate=_loss(replace(kind, above=round(speed, 3))))
        seen = look(proposed, [effect.candidate for effect in proposed])
        if seen is None:
            return -math.inf, speed, proposed
        moved, gain = _stepped(proposed, seen)
        return seen.log_evidence + gain, speed, moved

    best, step = above(kind.above), apart / 2
    if others and (seen := look(kept, others)) is not None and seen.candidates:
        (likeliest,) = max(seen.candidates, key=lambda one: by_formula(one, seen)[1]).kinds
        best = max(best, above(likeliest.above), key=itemgetter(0))
    for _ in range(HALVINGS):
        best = max(best, above(best[1] - step), above(best[1] + step), key=itemgetter(0))
        step /= 2
    return best[2]


def _stepped(effects: Effects, seen: Linearised) -> tuple[Effects, float]:
    """Return effects in the model in the sizes that the linear formula gives, and by how much the logs are likelier."""
    shown = [effect for effect in effects if effect.candidate in seen.candidates]
    if not shown:
        return effects, 0.0
    statistics = statistics_of(shown, seen)
    change = least_squares(*statistics)
    moved = {effect.candidate: effect for effect in moved_by(shown, change)}
    return tuple(moved.get(effect.candidate, effect) for effect in effects), statistics.gain(change)
