"""What is left of logs beside effects, beyond what clean logs have; each looked at once."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from castor_envs.effects.dimensions import AllWheelRadius
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, finest_of
from discrepancy.inference.evidence import Evidence, evidence_of
from discrepancy.inference.ranking import LEAST_GAIN

BACKGROUND = 5
"""At most so many effects are taken from clean logs as background."""

Background = Sequence[tuple[Candidate, float, Array]]


@dataclass(eq=False)
class Known:
    """What is known whichever logs are looked at.

    usual: evidence of clean logs, background: the effects in it. Candidates beside those of every robot, in the order
    in which they were found: places on the floor, and `finest` ones, where effects are that no other is.
    """

    robot: RobotDescription
    usual: Evidence | None = None
    background: Background = ()
    places: dict[Candidate, None] = field(default_factory=dict)
    finest: dict[Candidate, None] = field(default_factory=dict)

    @classmethod
    def of(cls, robot: RobotDescription, usual: Evidence | None) -> "Known":
        """Return what clean logs tell, if there are any."""
        if usual is None:
            return cls(robot)
        return cls(robot, usual, background_of(usual), dict.fromkeys(usual.places))

    def admit(self, effects: Sequence[Effect]) -> None:
        """Take in the candidates of effects that are where no other is."""
        own = (finest_of(self.robot, effect) for effect in effects)
        self.finest.update(dict.fromkeys(one for one in own if one is not None))


class Looks:
    """Looks at what is left of some logs beside effects, by all candidates or only some.

    finds: whether what these logs speak for is known from then on, as it is not of held-out ones.
    """

    def __init__(self, known: Known, logs: Sequence[Log], finds: bool) -> None:
        self._known, self._logs, self._finds = known, logs, finds
        self._seen: dict[tuple[tuple[Candidate, ...] | tuple[Effect, ...] | None, ...], Evidence] = {}
        self._last: Evidence | None = None

    def __call__(self, effects: Sequence[Effect], among: Sequence[Candidate] | None = None) -> Evidence:
        """Return the evidence beside effects; among: candidates to look at, None: all."""
        known = self._known
        if self._finds:
            known.admit(effects)
        more = () if self._finds else tuple(known.places)
        key = tuple(effects), None if among is None else tuple(among), tuple(known.finest), more
        if key not in self._seen:
            self._seen[key] = self._beyond(effects, among)
            if self._finds:
                known.places.update(dict.fromkeys(self._seen[key].places))
        self._last = self._seen[key]
        return self._last

    def _beyond(self, effects: Sequence[Effect], among: Sequence[Candidate] | None) -> Evidence:
        """Return the evidence beyond the background, which has to be among the candidates for that."""
        known, robot = self._known, self._known.robot.with_effects(*effects)
        if among is not None:
            among = list(dict.fromkeys([*among, *(one for one, _, _ in known.background)]))
        seen = evidence_of(
            robot,
            self._logs,
            start=self._last,
            among=among,
            places=(*known.places, *known.finest),
            usual=known.usual,
        )
        return seen.less(known.background)


def background_of(clean: Evidence) -> Background:
    """Return the effects, one by one, that take something away from clean logs, with hidden parts and amplitudes.

    And the radius of all wheels in any case, however little: where contacts are soft it is never quite as described.
    """
    chosen = clean.greedily(BACKGROUND, LEAST_GAIN)
    soft = next((k for k, one in enumerate(clean.candidates) if one.is_of(AllWheelRadius(value=0.0))), None)
    if soft is not None and soft not in dict(chosen):
        chosen.append((soft, clean.parted(soft, chosen)))
    amplitudes = iter(clean.best(chosen)[0].tolist())
    sizes = [np.array([next(amplitudes) for _ in clean.columns[k]]) for k, _ in chosen]
    return [(clean.candidates[k], part, size) for (k, part), size in zip(chosen, sizes, strict=True)]
