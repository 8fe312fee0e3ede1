"""Cases of a trial: the robot, hidden effects, motion and strengths of each, and the files that the finder is given.

Of every twenty cases, in an order that the seed draws:

    stratum   cases   hidden                                       motion
    clean     4       nothing                                      wander, to and fro, or circles
    one       5       an effect of the catalogue                   wander
    two       2       two, of different classes                    wander
    three     2       three, of different classes                  wander
    outside   3       something that the catalogue does not have   wander
    poor      2       an effect of the catalogue                   straight to and fro, or always the same circle
    wiring    2       encoders exchanged or reversed               wander

Of all cases, whatever the stratum:

    robot       each of the trial's in turn, in an order that the seed draws
    strength    by cost in use in one half, by z in the other (`BOUNDS`), unless no effect can have such a z, as in
                motions that small changes alter more; wiring has no size
    clean logs  three in half of the cases by pymunk, and in four of five by another simulator; else none
    reference   none in one half of the cases of robots whose encoders are redundant; all others have one

A case is determined by its number, the trial's seed and its robots. `strength.solve_size` finds the sizes.
"""

import contextlib
import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from castor_envs.effects.catalogue import catalogue
from castor_envs.motion.mobility import moves_sideways
from castor_envs.motion.trajectories import Leg, Run, Trajectory, wander
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.hidden import Hidden, Outside, class_of, outsider
from discrepancy.trials.strength.separation import FITTED_ANYWAY
from discrepancy.validation.sufficient import redundancy

Stratum = Literal["clean", "one", "two", "three", "outside", "poor", "wiring"]
Course = Literal["wander", "to and fro", "circles"]
COURSES: tuple[Course, ...] = get_args(Course)
Measure = Literal["cost", "z"]

MIX: dict[Stratum, int] = {"clean": 4, "one": 5, "two": 2, "three": 2, "outside": 3, "poor": 2, "wiring": 2}
"""Number of cases of each stratum among twenty."""

SEVERAL: dict[Stratum, int] = {"two": 2, "three": 3}

BOUNDS: dict[Measure, tuple[float, float]] = {"cost": (3e-4, 1.0), "z": (5.0, 60.0)}
"""Bounds of strengths, drawn log-uniform: m per 10 m (`validation.cost`), and z (`strength.separation`)."""

CLEAN_LOGS = {"own": 0.5, "foreign": 0.8}
"""Part of the cases with clean logs."""

LOST_ABOVE = (0.1, 0.5)
"""Bounds of the speed above which counts are lost, as a part of the largest; wheels of slow robots may not reach it:
then there is no effect, and others are drawn."""

UNTRACKED = 0.5
"""Part of the cases without a reference, of robots that need none."""

ONE_WAY = frozenset(("tick_loss", "encoder_latency", "all_latency"))
"""Effects that are drawn with values above 0 only, though files may hold others."""


@dataclass(frozen=True)
class Case:
    """A case. robot: a preset's name. seeds: of the log and of the held-out log. clean, reference: whether the finder
    is given clean logs, and reference poses. hidden: the effects hidden in it; targets: the cost or z (`measure`) to
    aim for.
    """

    number: int
    stratum: Stratum
    robot: str
    course: Course
    seeds: tuple[int, int]
    clean: bool
    reference: bool
    measure: Measure
    hidden: tuple[Hidden, ...] = ()
    targets: tuple[float, ...] = ()

    def motion(self, log_number: int, duration: float) -> Trajectory:
        """Return the motion of the log (0) or of the held-out log (1)."""
        return motion(preset(self.robot), self.course, self.seeds[log_number], duration)


def setting(number: int, seed: int, robots: Sequence[str], *, foreign: bool) -> Case:
    """Return case `number` (from 1) of a trial without hidden effects yet. foreign: whether another simulator makes
    logs."""
    strata = [stratum for stratum, count in MIX.items() for _ in range(count)]
    random = np.random.default_rng([seed, number])
    robot = _in_turn(robots, number, seed, 1)
    stratum = _in_turn(strata, number, seed, 2)
    poor: Course = random.choice(["to and fro", "circles"])
    clean, untracked, by_cost = random.random(3) < (CLEAN_LOGS["foreign" if foreign else "own"], UNTRACKED, 0.5)
    first = 2 * (10_000 * seed + number)
    courses: dict[Stratum, Course] = {"poor": poor, "clean": COURSES[random.integers(len(COURSES))]}
    return Case(
        number,
        stratum,
        robot,
        courses.get(stratum, "wander"),
        (first, first + 1),
        clean=bool(clean),
        reference=redundancy(preset(robot)) == 0 or not untracked,
        measure="cost" if by_cost else "z",
    )


def hide(case: Case, attempt: int, seed: int, outsiders: Sequence[type[Outside]]) -> Case:
    """Return a case with hidden effects, in the size of their steps, and the strengths to aim for.

    attempt: from 0; a further attempt draws other effects, where those drawn before could not have the strength.
    """
    robot, random = preset(case.robot), np.random.default_rng([seed, case.number, attempt])
    if case.stratum == "clean":
        return case
    if case.stratum == "outside":
        hidden: list[Hidden] = [outsider(outsiders, robot, random)]
    else:
        hidden = _drawn(robot, random, SEVERAL.get(case.stratum, 1), wiring=case.stratum == "wiring")
    low, high = np.log(BOUNDS[case.measure])
    targets = np.exp(random.uniform(low, high, len(hidden))).tolist()
    return dataclasses.replace(case, hidden=tuple(hidden), targets=() if case.stratum == "wiring" else tuple(targets))


def motion(robot: RobotDescription, course: Course, seed: int, duration: float) -> Trajectory:
    """Return a motion of a course that a robot can drive and that lasts `duration` s at least."""
    random, sideways = np.random.default_rng([seed, 1]), moves_sideways(robot)
    if course == "wander":
        return wander(random, duration=duration, holonomic=sideways)
    way, side = random.uniform(-math.pi, math.pi) * sideways, float(random.choice([-1.0, 1.0]))
    radius, runs, time, forth = random.uniform(0.4, 1.0), [], 0.0, 1.0
    while time < duration:
        if course == "circles":
            leg = Leg((math.cos(way), math.sin(way), side / radius), 2 * math.pi * radius)
        else:
            leg, forth = Leg((forth * math.cos(way), forth * math.sin(way), 0.0), random.uniform(0.5, 1.5)), -forth
        runs.append(Run((leg,), 0.25, 0.5))
        time += runs[-1].duration
    return Trajectory(course, tuple(runs))


def _in_turn(choices: Sequence[Any], number: int, seed: int, stream: int) -> Any:
    """Return the choice for a case: each comes once before any comes again, in a new random order each round."""
    turn, place = divmod(number - 1, len(choices))
    order = np.random.default_rng([seed, turn, stream]).permutation(len(choices))
    return choices[order[place]]


def _drawn(robot: RobotDescription, random: np.random.Generator, count: int, wiring: bool) -> list[Hidden]:
    """Draw effects of different classes, each by its name, then its place, its phase or speed, and its sign."""
    named: dict[str, list[Effect]] = {}
    for effect in catalogue(robot):
        if effect.name not in FITTED_ANYWAY and effect.wiring == wiring:
            named.setdefault(effect.name, []).append(effect)
    found: dict[str, Hidden] = {}
    while len(found) < count:
        variants = named[sorted(named)[random.integers(len(named))]]
        effect = variants[random.integers(len(variants))]
        if hasattr(effect, "phase"):
            effect = dataclasses.replace(effect, **{"phase": float(random.uniform(-math.pi, math.pi))})
        if effect.name == "tick_loss":
            above = float(random.uniform(*LOST_ABOVE)) * robot.max_wheel_speed
            effect = dataclasses.replace(effect, **{"above": above})
        if effect.name == "sample_jitter":
            effect = dataclasses.replace(effect, **{"seed": int(random.integers(2**31))})
        if random.random() < 0.5 and effect.name not in ONE_WAY:
            with contextlib.suppress(ValueError):  # where there is no such thing
                effect = dataclasses.replace(effect, value=-effect.value)
        found.setdefault(class_of(effect), effect)
    return list(found.values())
