"""Search for the simplest mistake, or combination of two or three, that makes a log agree with its robot."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight.hypotheses import Hypothesis, hypotheses, pivots_to_scale, places_to_scale, scale, wiring
from discrepancy.preflight.misfit import ALIKE, SEEN, Misfit, Misfits
from discrepancy.preflight.reading import Channels, Reading

MUCH, BETTER, BETTER_OF_MUCH = 0.02, 10.0, 4.0
"""A mistake must explain nearly the whole misfit: at most a tenth may remain, or a quarter where it exceeded `MUCH`, as
the motion of a robot that was steered by wrong readings is rough. There half suffices, if every other mistake leaves
more than twice as much (`ALIKE`): wheels then slide at every turn."""

FLOOR, SAME = 2e-5, 1.2
"""Shares below the first number count as equal; so do shares within the factor."""

OBEDIENT = 0.01
"""Disobedience of motors that all do as they are told."""

GROSS = 1.5
"""Smaller factors of counts per turn are no gross mistake."""

GRID, FINE_GRID = 1.25 ** np.arange(-31.0, 32.0), 1.06 ** np.arange(-40.0, 41.0)
"""Factors that are tried: of wheels a thousandth to a thousand; of pivots a tenth to ten, as their angles affect all
rows."""

YAW = np.radians(20.0)
"""rad: a reference turned by more is reported."""

TOGETHER, KEPT = 3, 8
"""Most mistakes in a combination; number of best candidates that are extended."""


@dataclass(frozen=True)
class Candidate:
    """A combination of mistakes, the reading of the log with it, and the misfit that remains."""

    mistakes: tuple[Hypothesis, ...]
    reading: Reading
    misfit: Misfit

    @property
    def left(self) -> float:
        """The unexplained share, at least `FLOOR`."""
        return max(self.misfit.total, FLOOR)

    @property
    def straight(self) -> bool:
        """Whether the reference is not turned."""
        return abs(self.misfit.yaw) < YAW

    @property
    def rank(self) -> tuple[bool, int]:
        """Sort key of simplicity; the simplest first."""
        return not self.straight, sum(not mistake.plain for mistake in self.mistakes)

    def like(self, rival: "Candidate") -> bool:
        """Whether it explains about as much as a rival, or more, of what encoders contradict, and of what motors do
        against their commands."""
        mine, other = self.misfit, rival.misfit
        contradiction, of_rival = (max(misfit.parity + misfit.reference, FLOOR) for misfit in (mine, other))
        obeys = mine.disobedience <= ALIKE * max(other.disobedience, OBEDIENT)
        return contradiction <= ALIKE * of_rival and obeys

    def explains(self, rival: "Candidate") -> bool:
        """Whether it explains nearly all that a rival leaves."""
        return rival.left >= (BETTER_OF_MUCH if rival.left > MUCH else BETTER) * self.left


@dataclass(frozen=True)
class Found:
    """nominal: the log read as it is. best: the simplest explanation, then others that explain it as well; nominal if
    none does."""

    nominal: Candidate
    best: Candidate
    alike: tuple[Candidate, ...] = ()


def search(robot: RobotDescription, misfits: Misfits) -> Found:
    """Return the simplest mistakes that explain a log; no mistakes where the log agrees with the robot, or nothing
    explains it."""
    plain = Channels(robot).nominal()
    nominal = Candidate((), plain, misfits.of(plain))
    if nominal.left < SEEN and nominal.straight:
        return Found(nominal, nominal)
    single = [_with(misfits, nominal, hypothesis) for hypothesis in hypotheses(robot)]
    single += [_scaled(misfits, nominal, robot, *place, GRID) for place in places_to_scale(robot).items()]
    level = _different(single)
    if nominal.left < SEEN:  # the reference alone is turned
        return Found(
            nominal, nominal, tuple(mistake for mistake in level if mistake.like(nominal) and mistake.straight)
        )
    best, chosen, partners = nominal, level, wiring(robot)
    for depth in range(TOGETHER):
        if depth > 0:
            level = _extended(misfits, level, partners, depth)
        first = min(level, key=lambda candidate: candidate.left, default=nominal)
        if first.explains(best) or (depth == 0 and _alone(first, [nominal, *level])):
            near = [candidate for candidate in level if candidate.like(first)]
            best = _simplest(near)
            # An explanation that also needs a turned reference counts as one mistake more.
            chosen = [candidate for candidate in near if candidate.straight or not best.straight]
        if best.left < SEEN:
            break
    if best.left > MUCH:
        pivots = [_scaled(misfits, nominal, robot, *place, FINE_GRID) for place in pivots_to_scale(robot).items()]
        first = min(pivots, key=lambda candidate: candidate.left, default=nominal)
        if first.explains(best):
            best, chosen = first, [candidate for candidate in pivots if candidate.like(first)]
    if best is nominal:
        return Found(nominal, nominal)
    chosen = [candidate for candidate in chosen if candidate.like(best)]
    return Found(nominal, best, tuple(candidate for candidate in chosen if candidate is not best))


def _extended(misfits: Misfits, level: list[Candidate], partners: list[Hypothesis], depth: int) -> list[Candidate]:
    """Return the best combinations with one mistake of wiring more; of single mistakes those of wiring, too, as two
    mistakes may mask each other, so that neither of them helps alone."""
    names = [partner.what for partner in partners]
    by_rest = sorted(level, key=lambda candidate: candidate.left)
    starts = by_rest[:KEPT]
    starts += [start for start in by_rest[KEPT:] if depth == 1 and start.mistakes[0].what in names]
    return _different(
        _with(misfits, start, partner)
        for start in starts
        for partner in partners
        if partner.what not in [mistake.what for mistake in start.mistakes]
    )


def _simplest(near: list[Candidate]) -> Candidate:
    """Return the simplest candidate; among equally simple ones the candidate that explains most or, where they hardly
    differ, the first."""
    rank = min(candidate.rank for candidate in near)
    simple = [candidate for candidate in near if candidate.rank == rank]
    least = min(candidate.left for candidate in simple)
    return next(candidate for candidate in simple if candidate.left <= SAME * least)


def _alone(candidate: Candidate, candidates: list[Candidate]) -> bool:
    """Whether a candidate stands out where much contradicts the robot: all other candidates, and no mistake, leave far
    more."""
    return all(rival.left > max(MUCH, ALIKE * candidate.left) for rival in candidates if rival is not candidate)


def _with(misfits: Misfits, start: Candidate, mistake: Hypothesis) -> Candidate:
    reading = mistake.read(start.reading)
    return Candidate((*start.mistakes, mistake), reading, misfits.of(reading))


def _scaled(
    misfits: Misfits, start: Candidate, robot: RobotDescription, place: str, channels: tuple[int, ...], factors: Array
) -> Candidate:
    """Return the candidate with the best gross factor on the counts of these channels, refined near the best of a
    grid."""

    def left(log_factor: float) -> float:
        return misfits.of(start.reading.scaled(channels, float(np.exp(log_factor)))).total

    logs, gross, step = np.log(factors), np.log(GROSS), np.log(factors[1] / factors[0])
    at = min(logs[np.abs(logs) > gross], key=left)
    fine = minimize_scalar(left, bounds=(at - step, at + step), method="bounded", options={"xatol": 1e-3})
    factor = float(np.exp(fine.x if abs(fine.x) >= gross else at))
    return _with(misfits, start, scale(robot, place, channels, factor))


def _different(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Return one candidate for each reading."""
    found: dict[Reading, Candidate] = {}
    for candidate in candidates:
        if candidate.reading not in found or candidate.rank < found[candidate.reading].rank:
            found[candidate.reading] = candidate
    return list(found.values())
