"""Events at certain times or places only, found beside the effects: in them contacts slip by unknown amounts.

A slippery patch of the floor is searched first, then rows that contradict the other rows intermittently. The steps of
events are released (`LogLikelihood.release`: slip has no prior there), so that they do not bias other effects.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.linearise import Linearised
from discrepancy.posterior.variances import at_times, slippery
from discrepancy.posterior.variances.bursts import bursts_of

Released = list[NDArray[np.bool_]]
"""Steps (K - 1, rows) of each log."""


@dataclass(frozen=True)
class Events:
    """Rows that contradict the other rows intermittently, and a slippery patch; looked: whether a patch was
    searched."""

    faulty: tuple[at_times.Faulty, ...] = ()
    patch: slippery.Slippery | None = None
    looked: bool = False

    def extended(
        self,
        robot: RobotDescription,
        logs: Sequence[Log],
        seen: Linearised,
        clean: Linearised | None,
        answers: Sequence[Answer],
        names: int,
    ) -> "Events | None":
        """Return these events with new ones beside them and the effects in `answers`; None if there are no new ones.

        robot: with the effects named. names: number of other possible answers, all of the same prior probability.
        """
        if not self.looked:
            patch = slippery.slippery_in(robot, logs, seen, names)
            if patch is not None:
                return replace(self, patch=patch, looked=True)
        faulty = {fault.row: fault for fault in self.faulty}
        new = at_times.at_times(logs, seen, clean, answers, names, faulty)
        new = new or at_times.sliding(logs, seen, clean, names, faulty)
        for fault in new:
            known = faulty.get(fault.row)
            faulty[fault.row] = fault if known is None else known.together(fault)
        return replace(self, faulty=tuple(faulty.values()), looked=True) if new else None

    def released(self, robot: RobotDescription, logs: Sequence[Log], seen: Linearised) -> Released:
        """Return the steps in which contacts may slip freely."""
        faulty = at_times.steps_of(seen, self.faulty)
        if self.patch is None:
            return faulty
        on_patch = slippery.inside(robot, logs, seen, self.patch)
        return [contradicting | sliding for contradicting, sliding in zip(faulty, on_patch, strict=True)]

    def lossy(self, robot: RobotDescription, logs: Sequence[Log], seen: Linearised) -> RobotDescription:
        """Return a robot whose encoders lose counts in bursts where these rows contradict the others, those whose
        bursts keep a steady beat."""
        return lossy(robot, logs, seen, [fault for fault in self.faulty if fault.of_others])

    def in_other_logs(
        self, robot: RobotDescription, logs: Sequence[Log], seen: Linearised
    ) -> tuple["Events", list[float]]:
        """Return the same events in other logs, and the log Bayes factor of each in these."""
        faulty, confirmed = at_times.recurring(logs, seen, self.faulty)
        if self.patch is not None:
            confirmed.append(slippery.confirmed_by(robot, logs, seen, self.patch))
        return replace(self, faulty=tuple(faulty)), confirmed

    def answers(
        self,
        robot: RobotDescription,
        logs: Sequence[Log],
        seen: Linearised,
        confirmed: Sequence[float | None],
        unnamed: Collection[str],
    ) -> list[Answer]:
        """Return the answer for each event; confirmed: as `in_other_logs` returns it, or None for each; unnamed: names
        of encoders on which there is an unnamed alternative."""
        answers = [
            at_times.answer_of(robot, logs, seen, fault, log_factor, unnamed)
            for fault, log_factor in zip(self.faulty, confirmed, strict=False)
        ]
        if self.patch is not None:
            cost = _cost(slippery.inside(robot, logs, seen, self.patch), seen)
            answers.append(slippery.answer_of(self.patch, cost, confirmed[-1]))
        return answers

    @property
    def of_reference(self) -> bool:
        """Whether there are events, and the reference alone tells of all."""
        return bool(self.faulty) and self.patch is None and not any(fault.of_others for fault in self.faulty)

    def __len__(self) -> int:
        """Return the number of events."""
        return len(self.faulty) + (self.patch is not None)


@dataclass(frozen=True)
class Alone:
    """Rows that contradict the other rows, or the reference, intermittently beside no effect, and the steps in which
    they do; lossy: the robot whose encoders lose counts in bursts then, those whose bursts keep a steady beat."""

    events: Events
    released: Released
    lossy: RobotDescription

    @classmethod
    def found(
        cls, robot: RobotDescription, logs: Sequence[Log], seen: Linearised, clean: Linearised | None, names: int
    ) -> "Alone | None":
        """Return these of logs linearised with no effect in the model; None if no row contradicts the others. names:
        see `Events.extended`."""
        faulty = at_times.at_times(logs, seen, clean, (), names)
        if not faulty:
            return None
        return cls._of(faulty, seen, lossy(robot, logs, seen, faulty))

    @classmethod
    def sliding(
        cls,
        robot: RobotDescription,
        logs: Sequence[Log],
        seen: Linearised,
        clean: Linearised | None,
        names: int,
        among_rows: "Alone | None",
    ) -> "Alone | None":
        """Return the rows that contradict the reference, if others do than those that contradict each other
        (among_rows)."""
        faulty = at_times.sliding(logs, seen, clean, names)
        known = set[int]() if among_rows is None else {fault.row for fault in among_rows.events.faulty}
        return cls._of(faulty, seen, robot) if {fault.row for fault in faulty} - known else None

    @classmethod
    def _of(cls, faulty: Sequence[at_times.Faulty], seen: Linearised, lossy: RobotDescription) -> "Alone":
        return cls(Events(tuple(faulty), looked=True), at_times.steps_of(seen, faulty), lossy)


def lossy(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, faulty: Sequence[at_times.Faulty]
) -> RobotDescription:
    """Return a robot whose encoders lose counts in bursts where rows contradict the others, those whose bursts keep a
    steady beat."""
    bursts = [bursts_of(robot, logs, seen, fault.row, fault.active) for fault in faulty]
    return robot.with_effects(*(one.effect for one in bursts if one is not None and one.effect.seed is None))


def _cost(released: Released, seen: Linearised) -> Array:
    """Return the odometry error (2,) that slips of wheels in the released steps cause: m after 10 m, rad after a
    turn."""
    slipping = []
    for design, steps, slips in zip(seen.designs, released, seen.slips, strict=True):
        rows, w = design.model.rows, slips.shape[1]
        of_wheels = steps & (rows < w)
        slipping.append((of_wheels * np.nan_to_num(slips[:, np.minimum(rows, w - 1)]))[..., None])
    return seen.cost_of_slips(slipping)
