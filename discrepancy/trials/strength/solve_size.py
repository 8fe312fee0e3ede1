"""Finds the size at which a case's effects have the strength asked for, and measures it in both of its logs."""

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.cases import Case, Hidden
from discrepancy.trials.generators import Generator
from discrepancy.trials.noise import EXACT
from discrepancy.trials.outside import Outside
from discrepancy.trials.strength.separation import JITTER, StrengthMetric, apart, is_physical

TRIES, CLOSE = 4, 0.1
"""Of sizes, until z is so close to what was drawn, as a part of it."""

FASTER = 1e-4
"""Part by which the second run of a floor is faster."""

OVER_FLOOR = 3.0
"""Effects on the physics must be so many times stronger than what another seed changes."""


@dataclass(frozen=True, eq=False)
class Strength:
    """How strong what is hidden is in one log. z, z_sep: of each; nearest: the class that z_sep is to.

    cosine: of the first one's signal with the nearest class of the catalogue. floor: z of what is no effect at all.
    Rivals that were not looked at: None.
    """

    z: tuple[float, ...]
    z_sep: tuple[float, ...] | None
    nearest: tuple[str, ...]
    cosine: float | None
    floor: float | None


class TrialRun:
    """One of a case's two motions, driven by the nominal robot and by others."""

    def __init__(self, robot: RobotDescription, case: Case, which: int, generator: Generator, duration: float) -> None:
        self.robot, self.seed = robot, case.seeds[which]
        self._motion, self._drive, self._duration = case.motion(which, duration), generator.drive, duration

    def drive(self, *effects: Any, outside: Any = None, faster: float = 0.0) -> Log:
        """Return the exact log of the robot with effects, maybe a little faster."""
        runs = [dataclasses.replace(run, speed=run.speed * (1.0 + faster)) for run in self._motion.runs]
        return self._drive(
            self.robot.with_effects(*effects),
            dataclasses.replace(self._motion, runs=tuple(runs)),
            self.seed,
            duration=self._duration,
            outside=outside,
            rounded=False,
            noise=EXACT,
        )

    @cached_property
    def nominal(self) -> Log:
        """The log of the robot without effects."""
        return self.drive()

    @cached_property
    def metric(self) -> StrengthMetric:
        """Of the robot without effects."""
        return StrengthMetric(self.robot, self.nominal)

    @cached_property
    def floor(self) -> float:
        """The z of no effect: of two runs that differ in what is nothing.

        Simulators repeat themselves to the last bit, and what a seed draws (start angles, phases) is the same with and
        without an effect. So the second run drives the same motion by `FASTER` faster: what hangs on trifles, such as
        which way round a castor swings, then shows.
        """
        return float(np.linalg.norm(self.metric.signal(self.drive(faster=FASTER))))

    def signal(self, hidden: Hidden) -> Array:
        """Return the signal of one thing: of sensors, on the nominal run; else of a run of its own less the nominal."""
        effects = () if hidden.effect is None else (hidden.effect,)
        outside = hidden.what if hidden.effect is None else None
        make = self.drive if self._moves(hidden) else self.metric.read
        return self.metric.signal(make(*effects, outside=outside))

    def z(self, hidden: Hidden, signal: Array | None = None) -> float:
        """Return z of one thing; 0 where it is not well above the floor."""
        if hidden.effect is not None and hidden.effect.name == JITTER:
            return self.metric.jitter_strength(hidden.size)
        size = float(np.linalg.norm(self.signal(hidden) if signal is None else signal))
        return self.above_floor(hidden, size)

    def above_floor(self, hidden: Hidden, size: float) -> float:
        """Return a norm less the floor, in quadrature, where the physics differ; 0 below `OVER_FLOOR` times it."""
        if not self._moves(hidden):
            return size
        return float(np.sqrt(size**2 - self.floor**2)) if size > OVER_FLOOR * self.floor else 0.0

    def strength(self, hidden: tuple[Hidden, ...], *, alternatives: bool) -> Strength:
        """Return how strong things are, each with the others projected out.

        alternatives: whether to look at those too, or else at the floor in any case.
        """
        metric = self.metric
        nothing = np.zeros_like(metric.signal(self.nominal))
        jitters = [item.effect is not None and item.effect.name == JITTER for item in hidden]
        signals = [nothing if jitter else self.signal(item) for item, jitter in zip(hidden, jitters, strict=True)]
        alone = apart(signals)
        z, z_sep, nearest = [], [], []
        for k, item in enumerate(hidden):
            z.append(metric.jitter_strength(item.size) if jitters[k] else self.above_floor(item, alone[k]))
            if alternatives and not jitters[k]:
                far, name = metric.separation(signals[k], item.label, *signals[:k], *signals[k + 1 :])
                z_sep.append(far)
                nearest.append(name)
            else:  # nothing else looks like jitter
                z_sep.append(z[k])
                nearest.append("")
        cosine = metric.cosine(signals[0])[0] if alternatives and signals[0].any() else None
        floor = None if alternatives and not any(map(self._moves, hidden)) else self.floor
        return Strength(tuple(z), tuple(z_sep) if alternatives else None, tuple(nearest), cosine, floor)

    def _moves(self, hidden: Hidden) -> bool:
        """Whether something changes the physics."""
        if hidden.effect is None:
            return not isinstance(hidden.what, Outside)
        return is_physical(self.robot, hidden.effect)


def solve_size(case: Case, trial_run: TrialRun) -> Case | None:
    """Return a case with what it hides in a size of about the strength wanted; None where that cannot be had."""
    try:
        hidden = tuple(_sized(item, target, trial_run) for item, target in zip(case.hidden, case.targets, strict=True))
    except (InputError, ValueError, ArithmeticError):
        return None
    return dataclasses.replace(case, hidden=hidden)


def _sized(hidden: Hidden, target: float, trial_run: TrialRun) -> Hidden:
    """Return something in the size that makes z the target, to `CLOSE`; raises ValueError where there is none.

    By secants of log z over log size, from a slope of `power` on.
    """
    if hidden.effect is not None and hidden.effect.wiring:
        return hidden
    hidden, slope, before = _begun(hidden, target, trial_run), hidden.power, None
    for _ in range(TRIES):
        if hidden.effect is not None:
            trial_run.robot.with_effects(hidden.effect).as_built()  # refuses what cannot be
        z = trial_run.z(hidden)
        if z <= 0.0:
            raise ValueError(f"{hidden.label} does not show")
        if abs(z / target - 1.0) < CLOSE:
            return hidden
        now = np.log([abs(hidden.size), z])
        if before is not None and abs(now[0] - before[0]) > 1e-9:
            slope = float((now[1] - before[1]) / (now[0] - before[0])) or slope
        before = now
        step = np.clip(np.log(target / z) / slope, -3.0, 3.0)
        hidden = hidden.scaled(float(hidden.size * np.exp(step)))
    return hidden


def _begun(hidden: Hidden, target: float, trial_run: TrialRun) -> Hidden:
    """Return a physical effect in the size that its signature would need; others in the size of their step."""
    effect = hidden.effect
    if effect is None or effect.name == JITTER or not is_physical(trial_run.robot, effect):
        return hidden
    alone = float(np.linalg.norm(trial_run.metric.signature(effect)))
    return (
        hidden.scaled(float(np.copysign(target / alone, effect.value))) if alone * abs(effect.value) > 0.01 else hidden
    )
