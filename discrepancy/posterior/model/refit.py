"""Puts effects into the model and finds their maximum-likelihood sizes, with the states fitted anew at each step."""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import reduce
from typing import Any, TypeVar

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect
from discrepancy.posterior.answers import Cause, Seen, size_of
from discrepancy.posterior.calibrated import FAULT, LOG_ODDS, SIGNATURE
from discrepancy.posterior.priors import ALIKE, bounds_of, directions_in_model
from discrepancy.posterior.random_effects import Statistics, summed
from estimators.likelihood.statistics import least_squares

S = TypeVar("S", bound=Seen)

REFITS, CONVERGED, HALVINGS = 6, 0.1, 4
"""Most rounds; the change of sizes, in their standard errors, at which they end; and how often a change is halved if no
robot can have it, or if it makes the logs less likely."""

MOST_FOLLOWING = 3.0
"""Most steps of the same shrinking kind that are taken in one: steps of which each is three quarters of the last."""

STRETCHES = (1.1, 1 / 1.1, 2.0)
"""Factors by which sizes are tried that Newton's method may have left too small: finely, as noise and size change
together, and coarsely, as log evidence is uneven where a fit is far off."""


@dataclass(frozen=True, eq=False)
class Sized:
    """A candidate of the catalogue and its amplitudes (columns,); that of a binary effect is 0 or 1."""

    candidate: Cause
    amplitudes: Array

    def __post_init__(self) -> None:
        if self.candidate.kinds[0].binary:
            object.__setattr__(self, "amplitudes", (self.amplitudes != 0).astype(np.float64))

    @property
    def effect(self) -> Effect:
        """The effect; raises ValueError for amplitudes that it cannot have."""
        return self.candidate.effect(self.amplitudes)

    @property
    def size(self) -> float:
        """The size, in the unit of the amplitudes."""
        return size_of(self.amplitudes)

    def moved(self, by: Array) -> "Sized":
        """Return the candidate with its amplitudes changed, clipped to their bounds."""
        amplitudes = self.amplitudes + by
        if len(amplitudes) == 1:
            amplitudes = np.clip(amplitudes, *bounds_of(self.candidate.kinds[0]))
        return dataclasses.replace(self, amplitudes=amplitudes)


Effects = tuple[Sized, ...]
"""Effects in a model."""

Look = Callable[[Sequence[Sized], S, Sequence[Cause] | None], S]
"""Returns the statistics of logs with effects in the model, of given candidates or of all (None). The second argument
is an earlier result for similar effects, as starting point."""

V = TypeVar("V")


def with_effects(vehicle: V, named: Sequence[Sized]) -> V:
    """Return a robot, or a train, with these effects added."""
    return reduce(lambda built, effect: effect.candidate.added(built, effect.amplitudes), named, vehicle)


def possible(vehicle: Any, named: Sequence[Sized]) -> bool:
    """Whether a robot, or a train, can have these effects together."""
    try:
        with_effects(vehicle, named).as_built()
    except ValueError:  # an InputError is one
        return False
    return True


def sizes_of(effects: Sequence[Sized], seen: Seen, masked: float | None = None) -> Array:
    """Return b (m,) of effects in the model; masked: see `directions_in_model`."""
    directions = directions_in_model(seen, [effect.candidate for effect in effects], masked)
    return directions @ np.concatenate([np.zeros(0), *(effect.amplitudes for effect in effects)])


def moved_by(effects: Sequence[Sized], changes: Array) -> Effects:
    """Return effects with their amplitudes changed, and clipped to their bounds; changes (columns of all,)."""
    each = np.split(changes, np.cumsum([effect.candidate.columns for effect in effects])[:-1])
    return tuple(effect.moved(np.asarray(by)) for effect, by in zip(effects, each, strict=True))


def families_of(effects: Sequence[Sized]) -> frozenset[str]:
    """Return the families of effects."""
    return frozenset(effect.candidate.family for effect in effects)


def in_place_of(effect: Sized, rival: Cause, seen: Seen) -> Sized:
    """Return a rival of the size with which its signature is the nearest to what logs show of an effect in the
    model."""
    shown = summed(seen.logs).at(-sizes_of([effect], seen)).of_combinations(directions_in_model(seen, [rival]))
    return Sized(rival, np.zeros(rival.columns)).moved(least_squares(*shown))


def refitted(
    vehicle: Any, look: Look[S], before: Sequence[Sized], named: Sequence[Sized], seen: S, threshold: float = -np.inf
) -> tuple[Effects, S]:
    """Return effects of maximum-likelihood size, and the statistics beside them, of their candidates only.

    before: effects that are in the model already, in which `seen` was computed; if others only come to these, and no
    part of the proposed sizes is in the credible set, these are returned. Each further step makes the logs likelier.
    threshold: log evidence that is to be exceeded; sizes that cannot reach it after a step, by twice the gain that the
    linear formula predicts, are not refined. One step is always taken, as the formula does not know by how much noises
    become smaller. No effects are returned if the proposed sizes do not fit at all.
    """
    sizes = {effect.candidate: effect for effect in before}
    known = tuple(
        sizes.get(effect.candidate, dataclasses.replace(effect, amplitudes=np.zeros_like(effect.amplitudes)))
        for effect in named
    )
    current, at_first = tuple(named), seen.log_evidence
    if threshold == -np.inf:
        least = seen.log_evidence - LOG_ODDS if families_of(before) <= families_of(named) else -np.inf
        nearer = _nearer(vehicle, look, least, known, current, seen)
        if nearer is None:
            return tuple(effect for effect in known if np.any(effect.amplitudes)), seen
        current, seen = nearer
    else:
        found = fit_with(vehicle, look, current, seen)
        if found is None:
            return (), seen
        seen = found
    current, seen = _newton(vehicle, look, current, seen, threshold)
    if seen.log_evidence > threshold:
        longer, beside = _stretched(vehicle, look, current, seen, sizes, seen.log_evidence - at_first)
        if longer != current:
            return _newton(vehicle, look, longer, beside, threshold)
    return current, seen


def _newton(vehicle: Any, look: Look[S], current: Effects, seen: S, threshold: float) -> tuple[Effects, S]:
    """Return effects of sizes by Newton's method, each step of which makes the logs likelier; threshold: see
    `refitted`.

    A step that does not is halved, unless it is within the standard errors, which changes log evidence by less than it
    scatters, or unless the threshold is out of reach. What an effect leaves unexplained passes for noise, beside which
    each step covers only a part of what is left, so that those which would follow are taken with it.
    """
    last: tuple[Effects, Array] | None = None
    for step in range(REFITS):
        shown = set(seen.candidates)  # no longer an effect that leaves no trace in the fitted states
        current = tuple(effect for effect in current if np.any(effect.amplitudes) and effect.candidate in shown)
        if not current:
            break
        changes, errors, gain = _step(current, seen)
        if np.all(np.abs(changes) < CONVERGED * errors) or (step > 0 and seen.log_evidence + gain < threshold):
            break
        proposed = moved_by(current, _accelerated(current, changes, errors, last))
        last = current, changes
        refine = bool(np.any(np.abs(changes) > errors)) and seen.log_evidence + gain >= threshold
        nearer = _nearer(vehicle, look, seen.log_evidence, current, proposed, seen, HALVINGS if refine else 1)
        if nearer is None:
            break
        current, seen = nearer
    return current, seen


def _accelerated(current: Effects, changes: Array, errors: Array, last: tuple[Effects, Array] | None) -> Array:
    """Return the changes (columns of all,) of effects by Anderson's acceleration of depth 1 (Walker and Ni, SIAM
    Journal on Numerical Analysis 49(4), 2011). last: the effects before the last step, and the changes proposed
    there."""
    if last is None or [effect.candidate for effect in last[0]] != [effect.candidate for effect in current]:
        return changes
    before, at = (np.concatenate([effect.amplitudes for effect in effects]) for effects in (last[0], current))
    turned = (changes - last[1]) / errors
    part = float(np.clip(changes / errors @ turned / max(float(turned @ turned), 1e-30), -MOST_FOLLOWING, 1.0))
    return changes - part * (at - before + changes - last[1])


def _step(effects: Effects, seen: Seen) -> tuple[Array, Array, float]:
    """Return the changes of amplitudes by a step of Newton's method, their standard errors (columns of all,), and twice
    the gain of log-likelihood by the linear formula.

    Along combinations that logs hardly distinguish nothing but the prior of faults, a Cauchy distribution, keeps sizes
    small. It counts for no more than a small part of what is known of each effect by itself: of an effect that passes
    for noise little is known.
    """
    kinds = [effect.candidate.kinds[0] for effect in effects]
    scale = FAULT * np.repeat([kind.tolerance for kind in kinds], [effect.candidate.columns for effect in effects])
    sizes = np.concatenate([effect.amplitudes for effect in effects]) / scale
    information, score = statistics_of(effects, seen).of_combinations(np.diag(scale))
    known, prior = np.diag(information), 2 / (1 + sizes**2)
    prior = np.where(known > 0, np.minimum(ALIKE * known, prior), prior)
    posterior = information + np.diag(prior)
    changes, errors = np.linalg.solve(posterior, score - prior * sizes), np.sqrt(np.diag(np.linalg.inv(posterior)))
    return scale * changes, scale * errors, float(score @ changes)


def _stretched(
    vehicle: Any, look: Look[S], current: Effects, seen: S, before: Collection[Cause], gain: float
) -> tuple[Effects, S]:
    """Return effects, those that were not in the model `before` of sizes multiplied by one of `STRETCHES` as often as
    that makes the logs likelier, by more than by a likelihood ratio of 19: what is less Newton's method finds, or logs
    do not tell. Each time it does, the next factor is the square of the last.

    Where encoders cannot contradict each other, what a size leaves unexplained passes for noise, beside which Newton's
    method takes it for right: noise and size would have to change together. So it is with effects so large that the
    error of their signatures exceeds noise, on any vehicle. gain: of log evidence by these sizes so far.
    """
    for k, effect in enumerate(current):
        as_before = effect.candidate in before
        if as_before or (seen.redundant and not _is_large(effect, seen) and 2 * gain * SIGNATURE**2 < 1):
            continue
        for first in STRETCHES:
            shortest, factor = current[k], first
            for _ in range(2 * REFITS if not effect.candidate.kinds[0].binary else 0):
                longer = (*current[:k], current[k].moved((factor - 1) * current[k].amplitudes), *current[k + 1 :])
                found = fit_with(vehicle, look, longer, seen)
                if found is not None and found.log_evidence > seen.log_evidence + LOG_ODDS:
                    current, seen, factor = longer, found, factor**2
                elif current[k] is shortest or factor == first:
                    break
                else:
                    factor = first
            if current[k] is not shortest:
                break
    return current, seen


def _is_large(effect: Sized, seen: Seen) -> bool:
    """Whether an effect in the model explains so much that the error of its signature exceeds noise."""
    if effect.candidate not in seen.candidates:
        return False
    size = sizes_of([effect], seen)
    return float(size @ summed(seen.logs).information @ size) * SIGNATURE**2 > 1


def statistics_of(effects: Sequence[Sized], seen: Seen) -> Statistics:
    """Return the joint statistics of logs for the amplitudes of effects in the model."""
    return summed(seen.logs).of_combinations(directions_in_model(seen, [effect.candidate for effect in effects]))


def _nearer(
    vehicle: Any, look: Look[S], least: float, current: Effects, proposed: Effects, seen: S, tries: int = HALVINGS
) -> tuple[Effects, S] | None:
    """Return effects of the proposed sizes, or of sizes half as far from the current ones and so on, with which the log
    evidence exceeds `least`, and the statistics beside them; None if it does with none of as many as `tries`."""
    for _ in range(tries):
        found = fit_with(vehicle, look, proposed, seen)
        if found is not None and found.log_evidence > least:
            return proposed, found
        pairs = list(zip(current, proposed, strict=True))
        if all(np.array_equal(effect.amplitudes, target.amplitudes) for effect, target in pairs):
            break
        proposed = tuple(effect.moved((target.amplitudes - effect.amplitudes) / 2) for effect, target in pairs)
    return None


def fit_with(vehicle: Any, look: Look[S], effects: Effects, seen: S) -> S | None:
    """Return the statistics beside these effects, of their candidates only; None if they do not fit at all."""
    if possible(vehicle, effects):
        with suppress(np.linalg.LinAlgError, InputError), np.errstate(over="ignore", invalid="ignore"):
            return look(effects, seen, [effect.candidate for effect in effects])
    return None
