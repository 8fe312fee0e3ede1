"""The pre-flight: gross mistakes, reported before any small effect is looked for.

Mistakes of assembly are the most common: encoders swapped or reversed, castors in the wrong order, counts per turn
wrong by a factor, degrees for radians. Each is a hypothesis about how the log was read (`hypotheses`) that has a
likelihood (`likelihood`). The likeliest is reported (`search`), with all others at least half as likely.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from castor_envs.geometry.mounting import AGREED
from castor_envs.logs.log import Log
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.preflight.checks import dead_columns, listed, mistakes_in, remarks, stops
from discrepancy.preflight.likelihood import USUAL, Misfit, WiringLikelihood
from discrepancy.preflight.search import Explanation, search
from estimators.likelihood.channels import Channels
from estimators.likelihood.measurements.gyro_check import gyro_against_wheels

ROUNDED = 1e-6
"""Parts of a motion that are the rounding of squares."""


@dataclass(frozen=True)
class Mistake:
    """A gross mistake. what: where, evidence in numbers, and what to do, in one sentence.

    effects: of wiring and the like that explain it, for the robot file; empty where the log or the robot file must be
    corrected. alternatives: other mistakes that explain it as well, or nearly. taken: whether logs are accepted in
    spite of it, as a tracker may be mounted in any direction.
    """

    what: str
    effects: tuple[Effect, ...] = ()
    alternatives: tuple[str, ...] = ()
    taken: bool = False


@dataclass(frozen=True)
class Preflight:
    """Gross findings. remarks: those that are no mistakes. slid: whether wheels, driven by wrong readings, slid so much
    that logs tell nothing else. blind: whether logs show too little to look for wrong wiring."""

    mistakes: tuple[Mistake, ...] = ()
    remarks: tuple[str, ...] = ()
    slid: bool = False
    blind: bool = False

    @property
    def fatal(self) -> bool:
        """Whether the log or the robot file must be corrected first, as no effect explains a mistake."""
        return any(not mistake.effects and not mistake.taken for mistake in self.mistakes)

    @property
    def serious(self) -> "Preflight":
        """The same findings, with mistakes that are taken among the remarks."""
        taken = [mistake for mistake in self.mistakes if mistake.taken]
        reported = ["; or: ".join((mistake.what, *mistake.alternatives)) for mistake in taken]
        serious = tuple(mistake for mistake in self.mistakes if not mistake.taken)
        return Preflight(serious, (*reported, *self.remarks), self.slid, self.blind)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects of all mistakes, in order: with them, the robot's simulation reads like the log."""
        return tuple(effect for mistake in self.mistakes for effect in mistake.effects)


def preflight(robot: RobotDescription, logs: Sequence[Log], names: Sequence[str] = ()) -> Preflight:
    """Return the gross mistakes in logs of a robot, and remarks on them.

    names: of the logs; "log 1" and so on if left out. Small effects are ignored here.
    """
    numbered = ["the log"] if len(logs) == 1 else [f"log {k}" for k in range(1, len(logs) + 1)]
    named = list(zip(names or numbered, logs, strict=True))
    mistakes = [Mistake(f"{name}: {what}") for name, log in named for what in mistakes_in(robot, log)]
    if mistakes:
        return Preflight(tuple(mistakes))
    reported = [f"{name}: {remark}" for name, log in named for remark in remarks(robot, log)]
    likelihood, slid = WiringLikelihood(robot, logs, dead_columns(logs)), False
    if likelihood.sees:
        nominal, best, alike = search(robot, likelihood)
        if best.misfit.cost > LOG_ODDS:
            stopped = [f"{name}: {what}" for name, log in named for what in _stopped(robot, log)]
            if stopped:
                return Preflight(tuple(map(Mistake, stopped)))
        mistakes = [*_dead(robot, logs, best), *_mistakes(nominal.misfit, best, alike)]
        reported += _poses_off(named, likelihood, best) if likelihood.sees_poses else ()
        left = max(best.misfit.encoders, best.misfit.reference)
        if not mistakes and left > 10 * USUAL:
            reported.append(f"{_contradiction(best.misfit)}, which is no mistake of wiring or units alone")
            left_by = ((_named(rival), _parts(rival.misfit)) for rival in alike)
            reported += [f"the likeliest: {what}; then encoders contradict {parts}" for what, parts in left_by]
        if slid := left > 2 * USUAL and any(effect.wiring for mistake in mistakes for effect in mistake.effects):
            reported.append(
                "wheels that were driven by wrong readings slid: with these put right, encoders contradict "
                f"{_parts(best.misfit)} of the motion, so nothing else is looked for; correct the wiring, and record "
                "again"
            )
    else:
        reported.append(
            "too little motion, or too few encoders and reference poses, to look for swapped or reversed encoders"
        )
    for name, log in named if robot.gyro is not None and not mistakes else ():
        check = gyro_against_wheels(robot, log)
        if check is not None and check.mistaken:
            turns = f"it turns {check.scale:.3g} times as much as the wheels say"
            mistakes.append(Mistake(f"{name}: gyro_z {check.verdict} ({turns})"))
    return Preflight(tuple(mistakes), tuple(reported), slid, blind=not likelihood.sees)


def _mistakes(nominal: Misfit, best: Explanation, alike: Sequence[Explanation]) -> Iterator[Mistake]:
    """Yield the mistakes found; of a combination each mistake separately."""
    misfit, turn = best.misfit, best.misfit.turn
    evidence = f"{_contradiction(nominal)}, and once this is undone {_parts(misfit)}"
    evidence += f" ({len(best.mistakes)} mistakes together)" if len(best.mistakes) > 1 else ""
    for mistake in best.mistakes:
        alternatives = tuple(_named(rival) for rival in alike if mistake not in rival.mistakes)
        yield Mistake(f"{mistake.what}: {evidence}; {mistake.remedy}", mistake.effects, alternatives)
    if turn and misfit.reference**2 < AGREED:
        yield Mistake(
            f"the reference's heading points {abs(np.degrees(turn)):.0f} degrees to the "
            f"{'left' if turn > 0 else 'right'} of the robot's front: it then agrees with the encoders, and is taken "
            "so; if it is not mounted so, correct ref_psi",
            alternatives=tuple(_named(rival) for rival in alike if not rival.misfit.turn),
            taken=True,
        )


def _named(explanation: Explanation) -> str:
    return " and ".join(mistake.what for mistake in explanation.mistakes)


def _stopped(robot: RobotDescription, log: Log) -> Iterator[str]:
    """Yield encoders that stand still from a row on although the other encoders and the reference require that they
    turn, and did not contradict them before: what does so all the time is another mistake."""
    nominal = np.eye(len(Channels(robot).names) + 4)

    def contradicts(column: int, rows: slice) -> bool | None:
        poses = None if log.reference is None else log.reference[rows]
        part = Log(log.t[rows], log.wheel[rows], log.pivot[rows], reference=poses)
        with_it, without = (WiringLikelihood(robot, [part], frozenset(out)) for out in ((), (column,)))
        if not (with_it.sees and without.sees):
            return None
        return with_it.of(nominal).cost > without.of(nominal).cost + LOG_ODDS

    for column, row in stops(log).items():
        if contradicts(column, slice(row, None)) and contradicts(column, slice(row + 1)) is False:
            yield (
                f"{Channels(robot).names[column]} never changes after row {row + 1} (t {log.t[row]:.6g} s), although "
                "the others say that it must; check its cable, or leave these rows out"
            )


def _dead(robot: RobotDescription, logs: Sequence[Log], best: Explanation) -> Iterator[Mistake]:
    """Yield encoders whose counts never change although the others require that they do."""
    for column in sorted(dead := dead_columns(logs)):
        without = WiringLikelihood(robot, logs, dead - {column}).of(best.reading)
        if without.cost > best.misfit.cost + LOG_ODDS:
            yield Mistake(
                f"{Channels(robot).names[column]} never changes, although the other encoders say that it must: with it "
                f"{_contradiction(without)}; check its cable and its column, or give it no encoder in the robot file"
            )


def _poses_off(named: Sequence[tuple[str, Log]], likelihood: WiringLikelihood, best: Explanation) -> Iterator[str]:
    """Yield the reference's jumps and outliers: where odometry misses a pose far more than elsewhere."""
    missed = list(likelihood.missed(best.reading))
    for number, (name, log) in enumerate(named):
        found = [
            f"{1000 * error:.0f} mm between rows {a + 1} and {b + 1} (t {log.t[a]:.6g} to {log.t[b]:.6g} s)"
            for error, k, a, b in missed
            if k == number
        ]
        if found:
            yield f"{name}: the reference jumps, or wheels slide: {listed(found)}"


def _contradiction(misfit: Misfit) -> str:
    return f"as read, the encoders contradict {_parts(misfit)} of the motion (rms)"


def _parts(misfit: Misfit) -> str:
    parts = {"each other": misfit.encoders, "the reference": misfit.reference, "the commands": misfit.commands}
    percents = {whom: 100 * part for whom, part in parts.items() if part > ROUNDED}
    texts = (f"{whom} by {part:{'.0f' if part >= 9.5 else '.1g'}} %" for whom, part in percents.items())
    return " and ".join(texts) or "nothing"
