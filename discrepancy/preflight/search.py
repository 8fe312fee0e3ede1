"""The search for the simplest mistake, or two or three together, that makes a log agree with its robot."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight.hypotheses import Hypothesis, hypotheses, pivots_to_scale, places_to_scale, scale, wiring
from discrepancy.preflight.misfit import SEEN, Misfit, Misfits
from discrepancy.preflight.reading import Channels, Reading

MUCH, BETTER, BETTER_OF_MUCH = 0.02, 10.0, 4.0
"""A mistake must take away nearly all: leave a tenth, or a quarter where more than `MUCH` was there, as the motion of
a robot that was steered by wrong readings is rough."""

ALONE = 2.0
"""Times less that is left will do there, if any other mistake leaves so many times more: wheels slide at every turn."""

FLOOR, ALIKE, SAME = 2e-5, 2.0, 1.2
"""Shares below are all the same; shares within the factors are alike, or the same."""

GROSS = 1.5
"""Factors of counts a turn below are no gross mistake."""

GRID, FINE_GRID = 1.25 ** np.arange(-31.0, 32.0), 1.06 ** np.arange(-40.0, 41.0)
"""Factors tried of wheels, a thousandth to a thousand; and of pivots, a tenth to ten, whose angles turn everything."""

YAW = np.radians(20.0)
"""A reference turned by more is told."""

TOGETHER, KEPT = 3, 8
"""So many mistakes together are looked for; so many of the best are carried on."""


@dataclass(frozen=True)
class Candidate:
    """Mistakes made together, how the log then reads, and what it leaves unexplained."""

    mistakes: tuple[Hypothesis, ...]
    reading: Reading
    misfit: Misfit

    @property
    def left(self) -> float:
        """The share that is left; below `FLOOR`, `FLOOR`."""
        return max(self.misfit.total, FLOOR)

    @property
    def rank(self) -> tuple[bool, int]:
        """How simple it is; the simplest first."""
        return abs(self.misfit.yaw) > YAW, sum(not mistake.plain for mistake in self.mistakes)


@dataclass(frozen=True)
class Found:
    """nominal: the log as it is. best: the simplest explanation, and what explains it as well; nominal if none does."""

    nominal: Candidate
    best: Candidate
    alike: tuple[Candidate, ...] = ()


def search(robot: RobotDescription, misfits: Misfits) -> Found:
    """Return the simplest mistakes that explain a log; none where nothing is wrong, or nothing explains it."""
    plain = Channels(robot).nominal()
    nominal = Candidate((), plain, misfits.of(plain))
    if nominal.left < SEEN and abs(nominal.misfit.yaw) < YAW:
        return Found(nominal, nominal)
    single = [_with(misfits, nominal, hypothesis) for hypothesis in hypotheses(robot)]
    single += [_scaled(misfits, nominal, robot, *place, GRID) for place in places_to_scale(robot).items()]
    level = _different(single)
    if nominal.left < SEEN:
        return Found(
            nominal,
            nominal,
            tuple(candidate for candidate in level if _alike(candidate, nominal) and _straight(candidate)),
        )
    best, chosen, partners = nominal, level, wiring(robot)
    for depth in range(TOGETHER):
        if depth > 0:
            by_rest = sorted(level, key=lambda candidate: candidate.left)
            # Two mistakes may hide each other, so that neither of them helps alone.
            names = {partner.what for partner in partners}
            starts = [
                candidate
                for k, candidate in enumerate(by_rest)
                if k < KEPT or (depth == 1 and candidate.mistakes[0].what in names)
            ]
            level = _different(
                _with(misfits, start, partner)
                for start in starts
                for partner in partners
                if partner.what not in [mistake.what for mistake in start.mistakes]
            )
        first = min(level, key=lambda candidate: candidate.left, default=nominal)
        if _explains(first, best) or (depth == 0 and _alone(first, [nominal, *level])):
            near = [candidate for candidate in level if _alike(candidate, first)]
            best = _simplest(near)
            # Whatever needs a reference that is turned besides is one mistake more.
            chosen = [candidate for candidate in near if _straight(candidate) or not _straight(best)]
        if best.left < SEEN:
            break
    if best.left > MUCH:
        pivots = [_scaled(misfits, nominal, robot, *place, FINE_GRID) for place in pivots_to_scale(robot).items()]
        first = min(pivots, key=lambda candidate: candidate.left, default=nominal)
        if _explains(first, best):
            best, chosen = first, [candidate for candidate in pivots if _alike(candidate, first)]
    return Found(
        nominal, best, tuple(candidate for candidate in chosen if candidate is not best) if best is not nominal else ()
    )


def _simplest(near: list[Candidate]) -> Candidate:
    """Return the simplest; of several the one that explains most or, where they hardly differ, the first."""
    simple = [candidate for candidate in near if candidate.rank == min(rival.rank for rival in near)]
    least = min(candidate.left for candidate in simple)
    return next(candidate for candidate in simple if candidate.left <= SAME * least)


def _explains(candidate: Candidate, rival: Candidate) -> bool:
    return rival.left >= (BETTER_OF_MUCH if rival.left > MUCH else BETTER) * candidate.left


def _alone(candidate: Candidate, candidates: list[Candidate]) -> bool:
    """Whether one stands out where much contradicts the robot: all others, and none, leave far more."""
    return all(rival.left > max(MUCH, ALONE * candidate.left) for rival in candidates if rival is not candidate)


def _alike(candidate: Candidate, rival: Candidate) -> bool:
    return candidate.left <= ALIKE * rival.left


def _straight(candidate: Candidate) -> bool:
    return abs(candidate.misfit.yaw) < YAW


def _with(misfits: Misfits, start: Candidate, mistake: Hypothesis) -> Candidate:
    reading = mistake.read(start.reading)
    return Candidate((*start.mistakes, mistake), reading, misfits.of(reading))


def _scaled(
    misfits: Misfits, start: Candidate, robot: RobotDescription, place: str, channels: tuple[int, ...], factors: Array
) -> Candidate:
    """Return the best factor, other than about one, on the counts of some wheels, near the best of some."""

    def left(log_factor: float) -> float:
        return misfits.of(start.reading.scaled(channels, float(np.exp(log_factor)))).total

    grid = [np.log(factor) for factor in factors if abs(np.log(factor)) > np.log(GROSS)]
    at = min(grid, key=left)
    step = np.log(factors[1] / factors[0])
    bounds = (at - step, at + step)
    fine = minimize_scalar(left, bounds=bounds, method="bounded", options={"xatol": 1e-3})
    factor = float(np.exp(fine.x))
    if abs(np.log(factor)) < np.log(GROSS):
        factor = float(np.exp(at))
    return _with(misfits, start, scale(robot, place, channels, factor))


def _different(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Return one candidate for each reading."""
    found: dict[Reading, Candidate] = {}
    for candidate in candidates:
        if candidate.reading not in found or candidate.rank < found[candidate.reading].rank:
            found[candidate.reading] = candidate
    return list(found.values())
