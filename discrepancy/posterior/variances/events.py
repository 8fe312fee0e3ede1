"""What happens at some times or places only, found beside the effects: there contacts slip, and nothing else is known.

A slippery patch of the floor first, then rows that contradict the others at times. Steps in which these are at work are
released (`LogLikelihood.release`), so that nothing else is read into them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.linearise import Linearised
from discrepancy.posterior.variances import at_times, slippery

Released = list[NDArray[np.bool_]]
"""Steps (K - 1, rows) of each log."""


@dataclass(frozen=True)
class Events:
    """Rows that contradict the others at times, and a slippery patch; looked: whether one was looked for."""

    faulty: tuple[at_times.Faulty, ...] = ()
    patch: slippery.Slippery | None = None
    looked: bool = False

    def more(
        self,
        robot: RobotDescription,
        logs: Sequence[Log],
        seen: Linearised,
        clean: Linearised | None,
        told: Sequence[Answer],
        names: int,
    ) -> "Events | None":
        """Return these and what else is seen beside them and the effects told; None if that is nothing.

        robot: with the effects named. names: of what may be there, each as likely before logs are seen.
        """
        if not self.looked:
            patch = slippery.slippery_in(robot, logs, seen, names)
            if patch is not None:
                return replace(self, patch=patch, looked=True)
        new = at_times.at_times(seen, clean, told, names)
        return replace(self, faulty=(*self.faulty, *new), looked=True) if new else None

    def released(self, robot: RobotDescription, logs: Sequence[Log], seen: Linearised) -> Released:
        """Return the steps in which contacts slip as they like."""
        there = at_times.steps_of(seen, self.faulty)
        if self.patch is None:
            return there
        on_it = slippery.inside(robot, logs, seen, self.patch)
        return [one | other for one, other in zip(there, on_it, strict=True)]

    def there(self, robot: RobotDescription, logs: Sequence[Log], seen: Linearised) -> tuple["Events", list[float]]:
        """Return the same events in other logs, and by how much (natural logarithm) these are likelier for each."""
        faulty, confirmed = at_times.again(seen, self.faulty)
        if self.patch is not None:
            confirmed.append(slippery.confirmed_by(robot, logs, seen, self.patch))
        return replace(self, faulty=tuple(faulty)), confirmed

    def answers(
        self, robot: RobotDescription, logs: Sequence[Log], seen: Linearised, confirmed: Sequence[float | None]
    ) -> list[Answer]:
        """Return what is said of each; confirmed: as `there` has it, or None of each."""
        told = [
            at_times.answer_of(robot, logs, seen, fault, said)
            for fault, said in zip(self.faulty, confirmed, strict=False)
        ]
        if self.patch is not None:
            cost = _cost(slippery.inside(robot, logs, seen, self.patch), seen)
            told.append(slippery.answer_of(self.patch, cost, confirmed[-1]))
        return told

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.faulty) + (self.patch is not None)


def _cost(released: Released, seen: Linearised) -> Array:
    """Return what slips of wheels in some steps cost (2,): m after 10 m, rad after a turn."""
    every = []
    for design, steps, slips in zip(seen.designs, released, seen.slips, strict=True):
        rows = design.model.rows
        wheels = np.flatnonzero(rows < slips.shape[1])
        slipped = np.zeros((*steps.shape, 1))
        slipped[:, wheels, 0] = np.where(steps[:, wheels], np.nan_to_num(slips[:, rows[wheels]]), 0.0)
        every.append(slipped)
    return seen.cost_of_slips(every)
