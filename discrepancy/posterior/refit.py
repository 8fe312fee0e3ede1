"""Puts effects into the model and finds at which sizes logs pull them no more, what truly happened fitted anew."""

import dataclasses
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.priors import bounds_of
from discrepancy.posterior.random_effects import together

REFITS, SETTLED, HALVINGS = 5, 0.1, 5
"""Rounds at most; the part of its standard error by which no size changes in the end; and how often a change is halved
that no robot can have."""

MOST_AHEAD = 0.6
"""Part of a change that the next one is taken to be, at most, to go all their way at once."""


@dataclass(frozen=True, eq=False)
class Sized:
    """A candidate of the catalogue and its amplitudes (columns,)."""

    candidate: Candidate
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


def robot_with(robot: RobotDescription, named: Sequence[Sized]) -> RobotDescription:
    """Return the robot with effects beside its own."""
    return robot.with_effects(*(one.effect for one in named))


def possible(robot: RobotDescription, named: Sequence[Sized]) -> bool:
    """Whether the robot can have these effects together."""
    try:
        robot_with(robot, named).as_built()
    except ValueError:  # an InputError is one
        return False
    return True


def refitted(
    robot: RobotDescription, logs: Sequence[Log], named: Sequence[Sized], seen: Linearised, creep: Array | None
) -> tuple[tuple[Sized, ...], Linearised]:
    """Return effects as large as logs ask for, and what is seen beside them, of their own candidates only."""
    now, before = tuple(named), None
    for turn in range(REFITS):
        now, seen = _beside(robot, logs, now, seen, creep)
        now = tuple(one for one in now if np.any(one.amplitudes))
        if not now or turn == REFITS - 1:
            break
        said = together(seen.logs)
        columns = np.concatenate([seen.columns[seen.candidates.index(one.candidate)] for one in now])
        information = said.information[np.ix_(columns, columns)]
        changes = np.linalg.lstsq(information, said.score[columns], rcond=1e-9)[0]
        errors = np.sqrt(np.diag(np.linalg.pinv(information, rcond=1e-9, hermitian=True))) + 1e-30
        scaled = changes / errors
        if before is not None and len(before) == len(scaled) and before @ before > 0:
            scaled = scaled / (1 - float(np.clip(scaled @ before / (before @ before), 0.0, MOST_AHEAD)))
        before = changes / errors
        if np.all(np.abs(before) < SETTLED):
            break
        ends = np.cumsum([one.candidate.columns for one in now])[:-1]
        now = tuple(one.moved(by) for one, by in zip(now, np.split(scaled * errors, ends), strict=True))
    return now, seen


def _beside(
    robot: RobotDescription,
    logs: Sequence[Log],
    named: tuple[Sized, ...],
    seen: Linearised,
    creep: Array | None,
) -> tuple[tuple[Sized, ...], Linearised]:
    """Return effects, smaller if no robot can have them or no motion explains logs with them, and what is seen."""
    among = [one.candidate for one in named]
    for _ in range(HALVINGS):
        if possible(robot, named):
            with suppress(np.linalg.LinAlgError):
                return named, linearise(robot_with(robot, named), logs, start=seen, creep=creep, among=among)
        named = tuple(one.moved(-one.amplitudes / 2) for one in named)
    raise InputError("no motion explains the logs with the effects that they ask for")
