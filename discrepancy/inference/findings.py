"""What a diagnosis is made of: candidates ranked, findings with their verdicts, and what is left of the logs."""

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np

from castor_envs.effects.clocks import ClockSkew, SampleJitter
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate
from estimators.calibration.log_likelihood import Noise
from estimators.calibration.maximum_likelihood import State

Verdict = Literal["named", "ambiguous", "unconfirmed", "unexplained", "no discrepancy"]

BORNE_OUT = 0.5
"""The part of itself by which held-out logs may want an effect changed."""

WEAKEST_FIRST: tuple[Verdict, ...] = ("unexplained", "ambiguous", "unconfirmed", "named")


@dataclass(frozen=True)
class Rank:
    """A candidate on its own, beside what was found before. gain: deviance; sober: where all wheels may creep; part:
    what wheels hide of it; amplitudes (columns,) and their standard errors, in the effect's unit."""

    candidate: Candidate
    gain: float
    sober: float
    part: float
    amplitudes: tuple[float, ...]
    errors: tuple[float, ...]

    @property
    def size(self) -> float:
        """The amplitude; of an effect of any phase how large it is."""
        return self.amplitudes[0] if len(self.amplitudes) == 1 else float(np.linalg.norm(self.amplitudes))

    @property
    def error(self) -> float:
        """The standard error of the size, roughly."""
        return max(self.errors)


@dataclass(frozen=True, eq=False)
class Left:
    """What a robot's description leaves of logs: how far odometry is off the reference (rms, m, rad; None without one),
    noise, and state: what truly happened, most likely, with clocks and mount of the reference."""

    position: float | None
    heading: float | None
    noise: Noise
    state: State


@dataclass(frozen=True)
class Finding:
    """One thing that was found. verdict: of it alone, with a reason.

    effect: the best one of the catalogue with its amplitude refitted, error: its standard error; None where no effect
    explains it. chosen: the candidates that cannot be told apart; beaten: others, the best first. families: the names
    of those chosen.
    """

    verdict: Verdict
    reason: str
    chosen: tuple[Rank, ...]
    beaten: tuple[Rank, ...]
    effect: Effect | None = None
    error: float | None = None

    @property
    def gain(self) -> float:
        """The deviance that it takes away."""
        return self.chosen[0].gain

    @property
    def families(self) -> tuple[str, ...]:
        """The names, each with its place, that cannot be told apart; the most likely first."""
        return tuple(dict.fromkeys(one.candidate.family for one in self.chosen if one.candidate.kinds))


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What was found. verdict: the weakest of all effects', "unexplained" only where there are none.

    ranks: all candidates beside nothing, the best first.
    before, after: what is left of the logs without and with the effects that were found, and of held-out logs if there
    are such. clean: of clean logs.
    """

    robot: RobotDescription
    verdict: Verdict
    reason: str
    findings: tuple[Finding, ...]
    ranks: tuple[Rank, ...]
    before: Left
    after: Left | None = None
    held_out: tuple[Left, Left] | None = None
    clean: Left | None = None

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects that are named."""
        return tuple(one.effect for one in self.findings if one.verdict == "named" and one.effect is not None)

    @property
    def found(self) -> RobotDescription | None:
        """The robot with the effects that are named; None if there are none."""
        return self.robot.with_effects(*self.effects) if self.effects else None

    @property
    def nominal(self) -> RobotDescription:
        """The robot, but for its effects on time."""
        return without(without(self.robot, SampleJitter), ClockSkew)

    @property
    def explained(self) -> RobotDescription:
        """The robot with the effects that are named, but for those on time, which the states' clocks hold."""
        return without(without(self.found or self.robot, SampleJitter), ClockSkew)


def without(robot: RobotDescription, kind: type[Effect]) -> RobotDescription:
    """Return a robot without its effects of some kind."""
    return dataclasses.replace(robot, effects=tuple(one for one in robot.effects if not isinstance(one, kind)))
