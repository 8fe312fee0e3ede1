"""Trajectories of the drives: manoeuvres in random order, and laps of a warehouse. None ends where it starts."""

import math
from typing import NamedTuple

import numpy as np

from castor_envs.motion.mobility import moves_sideways
from castor_envs.motion.trajectories import Leg, Run, Trajectory, chained, figure_eight, wander
from castor_envs.vehicles.robot import RobotDescription

SPEED, ACCELERATION = 0.4, 0.5
"""m/s and m/s2, of the body's origin: about half of what the slowest preset's wheels reach."""
HARD_SPEED, HARD_ACCELERATION = 0.6, 2.5
"""m/s and m/s2, of hard accelerations: near the limit of wheels and motors, well below that of friction."""
STEERED = 0.5
"""Part of the steering motors' speed that accelerations ask of castors that they turn round."""
TURN, TURN_ACCELERATION = math.radians(60), math.radians(120)
LONG, WIDE = (8.0, 12.0), (3.0, 5.0)
"""m: between racks of a warehouse, and from one gangway to the next."""


def manoeuvres(robot: RobotDescription, random: np.random.Generator, duration: float) -> Trajectory:
    """Return manoeuvres of at least `duration` s in random order, each kind again only after all others.

    A figure eight, pivoting, random driving as by a person, hard accelerations and, of holonomic bases, driving
    sideways. Bases that are not holonomic pivot about their origin.
    """
    able = _Able.of(robot)
    kinds = [_eight, _pivoting, _teleoperation, _hard, *([_crab] if able.holonomic else [])]
    driven: list[Trajectory] = []
    while sum(part.duration for part in driven) < duration:
        driven += [kind(random, able) for kind in random.permutation(np.array(kinds, dtype=object))]
    return chained("manoeuvres", driven)


class _Able(NamedTuple):
    """What a robot can do: drive in any direction or not, and accelerate, m/s2."""

    holonomic: bool
    acceleration: float

    @classmethod
    def of(cls, robot: RobotDescription) -> "_Able":
        """Return what a robot can do.

        A castor that trails by r_c turns round in about its offset's way: an acceleration a brings sqrt(2 a r_c) there,
        so the castor turns at sqrt(2 a / r_c), which its motor, if it has one, must follow.
        """
        steered = [castor.offset for castor in robot.castors if castor.steering == "driven" and castor.offset > 0]
        followed = [(STEERED * robot.max_steering_speed) ** 2 * offset / 2 for offset in steered]
        return cls(moves_sideways(robot), min(followed, default=math.inf))


def laps(random: np.random.Generator, length: float) -> Trajectory:
    """Return laps of a warehouse with turns on the spot, `length` m: each lap another way round or of another size.

    The last lap ends where the length is reached.
    """
    runs: list[Run] = []
    left = length
    while left > 0:
        sense, sides = random.choice((-1.0, 1.0)), (random.uniform(*LONG), random.uniform(*WIDE)) * 2
        for side in sides:
            ahead = min(side, left)
            if ahead > 0:
                runs.append(_straight(ahead))
                runs.append(_turn(sense * math.pi / 2))
            left -= ahead
    return Trajectory("laps of a warehouse", tuple(runs))


def _straight(length: float, way: float = 0.0, speed: float = SPEED, acceleration: float = ACCELERATION) -> Run:
    return Run((Leg((math.cos(way), math.sin(way), 0.0), length),), speed, acceleration)


def _turn(angle: float, about: tuple[float, float] = (0.0, 0.0)) -> Run:
    """Return a turn by `angle` (rad) about a point of the body (m)."""
    sense = math.copysign(1.0, angle)
    return Run((Leg((sense * about[1], -sense * about[0], sense), abs(angle)),), TURN, TURN_ACCELERATION)


def _eight(random: np.random.Generator, able: _Able) -> Trajectory:
    eight = figure_eight(radius=random.uniform(0.5, 0.9), speed=SPEED, acceleration=ACCELERATION)
    return chained("figure eight", (Trajectory("turn", (_turn(random.uniform(-2.0, 2.0)),)), eight))


def _pivoting(random: np.random.Generator, able: _Able) -> Trajectory:
    about = (random.uniform(-0.3, 0.3), random.uniform(-0.3, 0.3)) if able.holonomic else (0.0, 0.0)
    angle = random.choice((-1.0, 1.0)) * random.uniform(1.0, 2.0) * 2 * math.pi
    return Trajectory("pivoting", (_turn(angle, about),))


def _teleoperation(random: np.random.Generator, able: _Able) -> Trajectory:
    return wander(
        random,
        duration=12.0,
        holonomic=able.holonomic,
        speed=random.uniform(0.2, SPEED),
        acceleration=min(ACCELERATION, able.acceleration),
        arena=100.0,
    )


def _hard(random: np.random.Generator, able: _Able) -> Trajectory:
    runs = []
    for _ in range(3):
        way = random.uniform(-math.pi, math.pi) if able.holonomic else 0.0
        runs.append(_straight(random.uniform(0.6, 1.5), way, HARD_SPEED, min(HARD_ACCELERATION, able.acceleration)))
        runs.append(_turn(random.uniform(-2.0, 2.0)))
    return Trajectory("hard accelerations", tuple(runs))


def _crab(random: np.random.Generator, able: _Able) -> Trajectory:
    side = random.choice((-1.0, 1.0)) * math.pi / 2
    ways = ((side, random.uniform(0.5, 1.5)), (side / 2, random.uniform(0.5, 1.5)))
    acceleration = min(ACCELERATION, able.acceleration)
    return Trajectory("crab", tuple(_straight(length, way, SPEED, acceleration) for way, length in ways))
