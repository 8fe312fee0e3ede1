"""Search for the most likely mistake, or combination of mistakes, in logs of a robot."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import count
from typing import Any

import numpy as np
from scipy.optimize import minimize_scalar

from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.preflight.hypotheses import Misreading, Table
from discrepancy.preflight.likelihood import Misfit, WiringLikelihood

ALIKE = math.log(2)
"""Explanations at least half as likely as the best are reported with it."""

GROSS, LARGEST = math.log(1.5), math.log(1e3)
"""Logarithms of factors of counts per turn: smaller ones are no gross mistake, larger ones are not tried."""

FINE = GROSS / 2
"""Step in which logarithms of factors, and angles of pivots in rad, are tried at first: fine enough for pivots, whose
angles affect all rows."""

MOST_TURNED = math.pi / 4
"""rad: a zero that is off by more is nearer to a quarter turn, which is a gross mistake."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Mistakes together, the reading of the log with them, and the misfit that remains."""

    mistakes: tuple[Misreading, ...]
    reading: Array
    misfit: Misfit

    @property
    def cost(self) -> float:
        """Minus the log-posterior: the odds are 19 to 1 against each mistake, and against a turned reference."""
        return self.misfit.cost + LOG_ODDS * (len(self.mistakes) + (self.misfit.turn != 0))


def search(robot: RobotDescription, likelihood: WiringLikelihood) -> tuple[Explanation, Explanation, list[Explanation]]:
    """Return the log read as it is, the most likely explanation, which may be the same, and others about as likely; or,
    where it is the same, the mistake that leaves least, if it explains the log better.

    One mistake of wiring after another is added, until none makes the log likelier; two at least, as they may mask each
    other, so that neither helps alone. Last come pivots' counts per turn, and small errors of their zeros and of
    wheels' counts per turn, which take longest; if such an error is about as likely as any mistake, none is returned.
    """
    table = Table(robot, likelihood.headed)
    nominal = Explanation((), table.nominal, likelihood.of(table.nominal))
    found = {table.nominal.tobytes(): nominal}

    def extended(starts: Iterable[Explanation], mistakes: Iterable[Misreading]) -> list[Explanation]:
        """Return explanations with a mistake more, and note them."""
        known = len(found)
        for start, mistake in ((start, mistake) for start in starts for mistake in mistakes):
            made, reading = (*start.mistakes, mistake), mistake.reading @ start.reading
            key = (np.round(reading, 9) + 0.0).tobytes()  # a zero has no sign
            same = found.get(key)
            if same is None or _size(made) < _size(same.mistakes):
                found[key] = Explanation(made, reading, same.misfit if same else likelihood.of(reading))
        return list(found.values())[known:]

    def best() -> Explanation:
        return min(found.values(), key=lambda each: round(each.cost, 1))  # the first of those alike

    if nominal.cost < LOG_ODDS:
        return nominal, nominal, []
    wheels, pivots = ([of for of in table.places if (of[0] >= table.pivots) == kind] for kind in (True, False))
    level = extended([nominal], [*table.all, *(_scaled(table, likelihood, of) for of in wheels)])
    for depth in count(2):
        if best().misfit.cost < LOG_ODDS or (depth > 2 and best() not in level):
            break
        level.sort(key=lambda each: each.cost)
        likeliest, others = np.split(np.array(level), [len(robot.wheels)])
        masked = [each for each in others if depth == 2 and each.mistakes[0] in table.wiring]
        level = extended([*likeliest, *masked], table.wiring)
    if best().misfit.cost > LOG_ODDS:
        extended([nominal], [_scaled(table, likelihood, of) for of in pivots])
        extended([nominal], [_turned(table, likelihood, of[0]) for of in pivots if len(of) == 1])
        extended([nominal], [_scaled(table, likelihood, of, gross=False) for of in wheels])
    chosen = best()
    near = [each for each in found.values() if each.mistakes and each.cost < chosen.cost + ALIKE]
    small = any(not mistake.gross for each in near for mistake in each.mistakes)
    if small or (chosen is nominal and not nominal.misfit.turn):
        least = min(found.values(), key=lambda each: each.cost if each.mistakes else math.inf)
        return nominal, nominal, [least] if least.misfit.cost < nominal.misfit.cost - ALIKE else []
    turned = bool(chosen.misfit.turn)
    return nominal, chosen, [each for each in near if each is not chosen and (turned or not each.misfit.turn)]


def _size(mistakes: Iterable[Misreading]) -> int:
    """Return how many single mistakes there are."""
    return sum(len(mistake.effects) or 1 for mistake in mistakes)


def _turned(table: Table, likelihood: WiringLikelihood, pivot: int) -> Misreading:
    """Return the likeliest small error of a pivot's zero."""

    def cost(angle: float) -> float:
        return likelihood.of(table.turned(pivot, angle).reading).cost

    at = min(np.arange(-MOST_TURNED, MOST_TURNED, FINE).tolist(), key=cost)
    bounds = np.clip([at - FINE, at + FINE], -MOST_TURNED, MOST_TURNED).tolist()
    best: Any = minimize_scalar(cost, bounds=bounds, method="bounded")
    return table.turned(pivot, float(best.x))


def _scaled(table: Table, likelihood: WiringLikelihood, columns: tuple[int, ...], *, gross: bool = True) -> Misreading:
    """Return the likeliest factor, gross or small, on the counts of these encoders, rounded where that is about as
    likely."""

    def cost(log_factor: float) -> float:
        return likelihood.of(table.multiplied(columns, math.exp(log_factor))).cost

    tried = np.arange(-LARGEST, LARGEST, FINE)
    at = min(tried[(np.abs(tried) > GROSS) == gross].tolist(), key=cost)
    fine: Any = minimize_scalar(cost, bounds=(at - FINE, at + FINE), method="bounded")
    best = math.exp(fine.x if (abs(fine.x) >= GROSS) == gross else at)
    rounded = (float(f"{best:.{digits}g}") for digits in (1, 2))
    rounded = (by for by in rounded if (abs(math.log(by)) >= GROSS) == gross)
    return table.scaled(columns, next((by for by in rounded if round(cost(math.log(by)) - fine.fun) == 0), best), gross)
