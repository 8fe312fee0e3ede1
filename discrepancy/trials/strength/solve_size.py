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
from discrepancy.trials.strength.separation import JITTER, Yardstick, apart, is_physical

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


class Track:
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
    def yardstick(self) -> Yardstick:
        """Of the robot without effects."""
        return Yardstick(self.robot, self.nominal)

    @cached_property
    def floor(self) -> float:
        """The z of no effect: of two runs that differ in what is nothing.

        Simulators repeat themselves to the last bit, and what a seed draws (start angles, phases) is the same with and
        without an effect. So the second run drives the same motion by `FASTER` faster: what hangs on trifles, such as
        which way round a castor swings, then shows.
        """
        return float(np.linalg.norm(self.yardstick.signal(self.drive(faster=FASTER))))

    def signal(self, hidden: Hidden) -> Array:
        """Return the signal of one thing: of sensors, on the nominal run; else of a run of its own less the nominal."""
        effects = () if hidden.effect is None else (hidden.effect,)
        outside = hidden.what if hidden.effect is None else None
        make = self.drive if self._moves(hidden) else self.yardstick.read
        return self.yardstick.signal(make(*effects, outside=outside))

    def z(self, hidden: Hidden, signal: Array | None = None) -> float:
        """Return z of one thing; 0 where it is not well above the floor."""
        if hidden.effect is not None and hidden.effect.name == JITTER:
            return self.yardstick.jitter_strength(hidden.size)
        size = float(np.linalg.norm(self.signal(hidden) if signal is None else signal))
        return self.above_floor(hidden, size)

    def above_floor(self, hidden: Hidden, size: float) -> float:
        """Return a norm less the floor, in quadrature, where the physics differ; 0 below `OVER_FLOOR` times it."""
        if not self._moves(hidden):
            return size
        return float(np.sqrt(size**2 - self.floor**2)) if size > OVER_FLOOR * self.floor else 0.0

    def strength(self, hidden: tuple[Hidden, ...], *, rivals: bool) -> Strength:
        """Return how strong things are, each with the others projected out.

        rivals: whether to look at those too, or else at the floor in any case.
        """
        yard = self.yardstick
        nothing = np.zeros_like(yard.signal(self.nominal))
        jitters = [one.effect is not None and one.effect.name == JITTER for one in hidden]
        signals = [nothing if jitter else self.signal(one) for one, jitter in zip(hidden, jitters, strict=True)]
        alone = apart(signals)
        z, z_sep, nearest = [], [], []
        for k, one in enumerate(hidden):
            z.append(yard.jitter_strength(one.size) if jitters[k] else self.above_floor(one, alone[k]))
            if rivals and not jitters[k]:
                far, name = yard.separation(signals[k], one.label, *signals[:k], *signals[k + 1 :])
                z_sep.append(far)
                nearest.append(name)
            else:  # nothing else looks like jitter
                z_sep.append(z[k])
                nearest.append("")
        cosine = yard.cosine(signals[0])[0] if rivals and signals[0].any() else None
        floor = None if rivals and not any(map(self._moves, hidden)) else self.floor
        return Strength(tuple(z), tuple(z_sep) if rivals else None, tuple(nearest), cosine, floor)

    def _moves(self, hidden: Hidden) -> bool:
        """Whether something changes the physics."""
        if hidden.effect is None:
            return not isinstance(hidden.what, Outside)
        return is_physical(self.robot, hidden.effect)


def settled(case: Case, track: Track) -> Case | None:
    """Return a case with what it hides in a size of about the strength wanted; None where that cannot be had."""
    try:
        hidden = tuple(_sized(one, target, track) for one, target in zip(case.hidden, case.targets, strict=True))
    except (InputError, ValueError, ArithmeticError):
        return None
    return dataclasses.replace(case, hidden=hidden)


def _sized(hidden: Hidden, target: float, track: Track) -> Hidden:
    """Return something in the size that makes z the target, to `CLOSE`; raises ValueError where there is none.

    By secants of log z over log size, from a slope of `power` on.
    """
    if hidden.effect is not None and hidden.effect.wiring:
        return hidden
    hidden, slope, before = _begun(hidden, target, track), hidden.power, None
    for _ in range(TRIES):
        if hidden.effect is not None:
            track.robot.with_effects(hidden.effect).as_built()  # refuses what cannot be
        z = track.z(hidden)
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


def _begun(hidden: Hidden, target: float, track: Track) -> Hidden:
    """Return a physical effect in the size that its signature would need; others in the size of their step."""
    effect = hidden.effect
    if effect is None or effect.name == JITTER or not is_physical(track.robot, effect):
        return hidden
    alone = float(np.linalg.norm(track.yardstick.signature(effect)))
    return (
        hidden.scaled(float(np.copysign(target / alone, effect.value))) if alone * abs(effect.value) > 0.01 else hidden
    )
