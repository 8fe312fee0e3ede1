"""Puts effects into the model and finds at which sizes logs pull them no more, what truly happened fitted anew."""

import dataclasses
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import reduce
from typing import Any, TypeVar

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect
from discrepancy.posterior.answers import Cause, Seen
from discrepancy.posterior.priors import bounds_of
from discrepancy.posterior.random_effects import together

S = TypeVar("S", bound=Seen)

REFITS, SETTLED, HALVINGS = 6, 0.1, 4
"""Rounds at most; the part of its standard error by which no size changes in the end; and how often a change is halved
that no robot can have, or with which logs are explained worse."""


@dataclass(frozen=True, eq=False)
class Sized:
    """A candidate of the catalogue and its amplitudes (columns,)."""

    candidate: Cause
    amplitudes: Array

    @property
    def effect(self) -> Effect:
        """The effect; raises ValueError for amplitudes that it cannot have."""
        return self.candidate.effect(self.amplitudes)

    def moved(self, by: Array) -> "Sized":
        """Return the candidate with its amplitudes changed, within what they can be."""
        amplitudes = self.amplitudes + by
        if len(amplitudes) == 1:
            amplitudes = np.clip(amplitudes, *bounds_of(self.candidate.kinds[0]))
        return dataclasses.replace(self, amplitudes=amplitudes)


Look = Callable[[Sequence[Sized], S, Sequence[Cause] | None], S]
"""Returns what logs say with effects in the model, given what they said of something similar, to begin with: of some
candidates, or of all (None)."""

V = TypeVar("V")


def with_them(vehicle: V, named: Sequence[Sized]) -> V:
    """Return a robot, or a train, with effects beside its own."""
    return reduce(lambda built, one: one.candidate.added(built, one.amplitudes), named, vehicle)


def possible(vehicle: Any, named: Sequence[Sized]) -> bool:
    """Whether a robot, or a train, can have these effects together."""
    try:
        with_them(vehicle, named).as_built()
    except ValueError:  # an InputError is one
        return False
    return True


def refitted(
    vehicle: Any, look: Look[S], worse: float, before: Sequence[Sized], named: Sequence[Sized], seen: S
) -> tuple[tuple[Sized, ...], S]:
    """Return effects as large as logs ask for, and what is seen beside them, of their own candidates only.

    worse: by how much (natural logarithm) logs may be less likely and count as explained no worse. before: effects that
    are in the model already, as `seen`.
    """
    sizes = {one.candidate: one for one in before}
    known = tuple(
        sizes.get(one.candidate, dataclasses.replace(one, amplitudes=np.zeros_like(one.amplitudes))) for one in named
    )
    now, seen = _nearer(vehicle, look, worse, known, tuple(named), seen)
    for _ in range(REFITS):
        now = tuple(one for one in now if np.any(one.amplitudes))
        if not now:
            break
        said = together(seen.logs)
        columns = np.concatenate([seen.columns[seen.candidates.index(one.candidate)] for one in now])
        information = said.information[np.ix_(columns, columns)]
        changes = np.linalg.lstsq(information, said.score[columns], rcond=1e-9)[0]
        errors = np.sqrt(np.diag(np.linalg.pinv(information, rcond=1e-9, hermitian=True))) + 1e-30
        if np.all(np.abs(changes) < SETTLED * errors):
            break
        ends = np.cumsum([one.candidate.columns for one in now])[:-1]
        moves = [np.asarray(by, dtype=np.float64) for by in np.split(changes, ends)]
        wanted = tuple(one.moved(by) for one, by in zip(now, moves, strict=True))
        last = now
        now, seen = _nearer(vehicle, look, worse, now, wanted, seen)
        if now == last:  # no step is any better
            break
    return now, seen


def _nearer(
    vehicle: Any, look: Look[S], worse: float, now: tuple[Sized, ...], wanted: tuple[Sized, ...], seen: S
) -> tuple[tuple[Sized, ...], S]:
    """Return effects as large as wanted, or half-way there and so on, until logs are not explained worse."""
    for _ in range(HALVINGS):
        if possible(vehicle, wanted):
            with suppress(np.linalg.LinAlgError, InputError):  # it does not fit at all
                found = look(wanted, seen, [one.candidate for one in wanted])
                if found.log_evidence > seen.log_evidence - worse:
                    return wanted, found
        halves = zip(now, wanted, strict=True)
        wanted = tuple(one.moved((other.amplitudes - one.amplitudes) / 2) for one, other in halves)
    now = tuple(one for one in now if np.any(one.amplitudes))
    return now, look(now, seen, [one.candidate for one in now])
