"""Cases of a trial: which effects each hides, in which motion, and how strong they are to be.

A case is determined by its number, the trial's seed and the robot. Its strength z (`strength.separation`) is drawn;
`strength.solve_size` finds the size of the effect that has this strength. Strata:

    clean      nothing
    one        one effect of the catalogue, z log-uniform in 5 to 60
    large      the same, z in 60 to 600, or wrong wiring
    two        two effects of different classes, each as in `one`
    outside    one effect that the catalogue does not have, z as in `one`
    poor       as `one`, in a motion of little information: straight to and fro, or always the same circle
"""

import contextlib
import dataclasses
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from castor_envs.effects.catalogue import catalogue
from castor_envs.motion.trajectories import Leg, Run, Trajectory, wander
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.strength.separation import FITTED_ANYWAY, class_of

Stratum = Literal["clean", "one", "large", "two", "outside", "poor"]
Course = Literal["wander", "to and fro", "circles"]

MIX: tuple[Stratum, ...] = (
    *("one", "clean", "two", "outside", "one", "poor", "one", "two", "outside", "one"),
    *("clean", "one", "outside", "large", "one", "two", "poor", "clean", "one", "outside"),
)
"""Of every twenty cases, in order: 7 one, 1 large, 3 two, 4 outside, 2 poor, 3 clean."""

RANGE, LARGE = (5.0, 60.0), (60.0, 600.0)
"""z, drawn log-uniform."""

ONE_WAY = frozenset(("tick_loss", "encoder_latency", "all_latency"))
"""Effects that are drawn with values above 0 only, though files may hold others."""


@dataclass(frozen=True)
class Hidden:
    """Something hidden: an effect of the catalogue, or what a generator has outside of it, whose size is `field`.

    power: z grows about as the size to this power.
    """

    what: Any
    field: str = "value"
    power: float = 1.0

    @property
    def effect(self) -> Effect | None:
        """The effect of the catalogue, if it is one."""
        return self.what if isinstance(self.what, Effect) else None

    @property
    def label(self) -> str:
        """Its class, or the name of what is outside the catalogue."""
        return type(self.what).__name__ if self.effect is None else class_of(self.effect)

    @property
    def size(self) -> float:
        """Its size."""
        return float(getattr(self.what, self.field))

    def scaled(self, size: float) -> "Hidden":
        """Return the same of another size; raises ValueError for one that cannot be."""
        now = getattr(self.what, self.field)
        new = max(round(size), 1) if isinstance(now, int) else size
        return dataclasses.replace(self, what=dataclasses.replace(self.what, **{self.field: new}))


Outsiders = Callable[[RobotDescription, np.random.Generator], Iterator[Hidden]]


@dataclass(frozen=True)
class Case:
    """One case. seeds: of the log and of the held-out one. hidden: what is in it; targets: the z to aim for."""

    number: int
    stratum: Stratum
    course: Course
    seeds: tuple[int, int]
    hidden: tuple[Hidden, ...] = ()
    targets: tuple[float, ...] = ()

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects of the catalogue."""
        return tuple(hidden.effect for hidden in self.hidden if hidden.effect is not None)

    @property
    def outside(self) -> Any | None:
        """What is outside the catalogue; None for nothing."""
        return next((hidden.what for hidden in self.hidden if hidden.effect is None), None)

    @property
    def bounds(self) -> tuple[float, float]:
        """Within which z has to be."""
        return LARGE if self.stratum == "large" else RANGE

    def motion(self, which: int, duration: float) -> Trajectory:
        """Return the motion of the log (0) or of the held-out one (1)."""
        return motion(self.course, self.seeds[which], duration)


def draw(number: int, attempt: int, seed: int, robot: RobotDescription, outsiders: Outsiders) -> Case:
    """Return case `number` (from 1) of a trial, its effects in the size of their steps.

    attempt: from 0; another one where what was drawn before could not be had in that strength.
    """
    stratum = MIX[(number - 1) % len(MIX)]
    random = np.random.default_rng([seed, number, attempt])
    base = 2 * (1_000_000 * seed + 1000 * number + attempt)
    course: Course = random.choice(["to and fro", "circles"]) if stratum == "poor" else "wander"
    case = Case(number, stratum, course, (base, base + 1))
    if stratum == "clean":
        return case
    if stratum == "outside":
        choices = list(outsiders(robot, random))
        hidden = (choices[random.integers(len(choices))],)
    else:
        hidden = _two(robot, random) if stratum == "two" else (_one(robot, random, stratum == "large"),)
    low, high = case.bounds
    targets = tuple(float(np.exp(random.uniform(math.log(low), math.log(high)))) for _ in hidden)
    return dataclasses.replace(case, hidden=hidden, targets=targets)


def motion(course: Course, seed: int, duration: float) -> Trajectory:
    """Return a motion of a course that lasts `duration` s at least."""
    random = np.random.default_rng([seed, 1])
    if course == "wander":
        return wander(random, duration=duration)
    way, side = random.uniform(-math.pi, math.pi), float(random.choice([-1.0, 1.0]))
    radius, runs, time, forth = random.uniform(0.4, 1.0), [], 0.0, 1.0
    while time < duration:
        if course == "circles":
            leg = Leg((math.cos(way), math.sin(way), side / radius), 2 * math.pi * radius)
        else:
            leg, forth = Leg((forth * math.cos(way), forth * math.sin(way), 0.0), random.uniform(0.5, 1.5)), -forth
        runs.append(Run((leg,), 0.25, 0.5))
        time += runs[-1].duration
    return Trajectory(course, tuple(runs))


def _one(robot: RobotDescription, random: np.random.Generator, wiring: bool) -> Hidden:
    """Draw an effect by its name, then its place, its phase and its sign."""
    named: dict[str, list[Effect]] = {}
    for effect in catalogue(robot):
        if effect.name not in FITTED_ANYWAY and (wiring or not effect.wiring):
            named.setdefault(effect.name, []).append(effect)
    variants = named[sorted(named)[random.integers(len(named))]]
    effect = variants[random.integers(len(variants))]
    if hasattr(effect, "phase"):
        effect = dataclasses.replace(effect, **{"phase": float(random.uniform(-math.pi, math.pi))})
    if effect.name == "sample_jitter":
        effect = dataclasses.replace(effect, **{"seed": int(random.integers(2**31))})
    if random.random() < 0.5 and effect.name not in ONE_WAY:
        with contextlib.suppress(ValueError):  # where there is no such thing
            effect = dataclasses.replace(effect, value=-effect.value)
    return Hidden(effect)


def _two(robot: RobotDescription, random: np.random.Generator) -> tuple[Hidden, Hidden]:
    first = _one(robot, random, wiring=False)
    while (second := _one(robot, random, wiring=False)).label == first.label:
        pass
    return first, second
