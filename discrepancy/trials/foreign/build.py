"""The numbers of a robot file as foreign simulators take them, and how effects on dimensions change them.

Written independently from the definitions in `castor_envs.vehicles.robot` and `castor_envs.effects.dimensions`: foreign
simulators share no geometry code with the project's own.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from castor_envs.effects.contact import ContactCreep, SlipStiffness, SlipStiffnessLateral
from castor_envs.effects.dimensions import (
    AllWheelRadius,
    CountsPerRev,
    LoadRadius,
    PivotBias,
    PivotOffset,
    PivotPositionX,
    PivotPositionY,
    Track,
    WheelRadius,
)
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription

AT_REST = 1e-6
"""m/s: a slower pivot has no direction of motion."""


@dataclass(frozen=True, eq=False)
class Build:
    """Numbers of a robot of n castors and w wheels.

    pivot (n, 2), offset (n,), angle (n,) of fixed castors, zero (n,) of pivot encoders, m and rad. steering (n,).
    castor (w,): the wheels' castors, from 0. lateral (w,), radius (w,), m. counts (w,), pivot_counts (n,): a turn, NaN
    without encoder. shrinking: of radii, m for each N more than average. long, side: excess slip of wheels over the
    description, as a part of the distance rolled, per unit ratio of force to load. viscous: excess slip in m/s per N of
    force.
    """

    pivot: Array
    offset: Array
    angle: Array
    zero: Array
    steering: tuple[str, ...]
    castor: NDArray[np.intp]
    lateral: Array
    radius: Array
    counts: Array
    pivot_counts: Array
    shrinking: float = 0.0
    long: float = 0.0
    side: float = 0.0
    viscous: float = 0.0

    @classmethod
    def of(cls, robot: RobotDescription) -> "Build":
        """Return the numbers of a robot with its effects on dimensions; other effects change nothing here.

        Raises InputError for a castor or wheel that the robot does not have.
        """
        castors, wheels = robot.castors, robot.wheels
        angle = np.array([castor.angle for castor in castors])
        build = cls(
            np.array([castor.pivot for castor in castors], dtype=float),
            np.array([castor.offset for castor in castors], dtype=float),
            angle,
            np.array([castor.pivot_zero for castor in castors], dtype=float),
            tuple(castor.steering for castor in castors),
            np.array(robot.wheel_castors, dtype=np.intp),
            np.array([wheel.lateral for wheel in wheels], dtype=float),
            np.array([wheel.radius for wheel in wheels], dtype=float),
            np.array([wheel.counts_per_rev or np.nan for wheel in wheels], dtype=float),
            np.array([castor.pivot_counts_per_rev or np.nan for castor in castors], dtype=float),
        )
        for effect in robot.effects:
            build = build._with(robot, effect)
        return build

    def _with(self, robot: RobotDescription, effect: Effect) -> "Build":
        """Return the numbers with an effect; the arrays of this build are its own, so they are changed in place."""
        match effect:
            case WheelRadius():
                self.radius[self.wheel(effect.castor, effect.wheel)] *= 1 + effect.value
            case AllWheelRadius():
                self.radius[:] *= 1 + effect.value
            case CountsPerRev():
                self.counts[self.wheel(effect.castor, effect.wheel)] *= 1 + effect.value
            case Track():
                self.lateral[self.castor == self.place(effect.castor)] *= 1 + effect.value
            case PivotOffset():
                self.offset[self.place(effect.castor)] += effect.value
            case PivotPositionX():
                self.pivot[self.place(effect.castor), 0] += effect.value
            case PivotPositionY():
                self.pivot[self.place(effect.castor), 1] += effect.value
            case PivotBias():
                self.zero[self.place(effect.castor)] += effect.value
            case LoadRadius():
                return dataclasses.replace(self, shrinking=self.shrinking + effect.value)
            case SlipStiffness():
                softer = _softer(robot.contact.slip_stiffness_long, effect.value)
                return dataclasses.replace(self, long=self.long + softer)
            case SlipStiffnessLateral():
                softer = _softer(robot.contact.slip_stiffness_lat, effect.value)
                return dataclasses.replace(self, side=self.side + softer)
            case ContactCreep():
                return dataclasses.replace(self, viscous=self.viscous + effect.value)
        return self

    @property
    def driven(self) -> NDArray[np.intp]:
        """Wheels with motor and encoder."""
        return np.flatnonzero(np.isfinite(self.counts))

    @property
    def steered(self) -> NDArray[np.intp]:
        """Castors that a motor turns."""
        return np.array([i for i, kind in enumerate(self.steering) if kind == "driven"], dtype=np.intp)

    @property
    def turning(self) -> NDArray[np.bool_]:
        """Which castors (n,) turn."""
        return np.array([kind != "fixed" for kind in self.steering])

    def place(self, castor: int) -> int:
        """Return the index of a castor numbered from 1."""
        if not 1 <= castor <= len(self.offset):
            raise InputError(f"the robot has no castor {castor}; give one of 1 to {len(self.offset)}")
        return castor - 1

    def wheel(self, castor: int, wheel: int) -> int:
        """Return the index of a wheel, castor and wheel numbered from 1."""
        castor_wheels = np.flatnonzero(self.castor == self.place(castor))
        if not 1 <= wheel <= len(castor_wheels):
            raise InputError(f"castor {castor} has no wheel {wheel}; give one of 1 to {len(castor_wheels)}")
        return int(castor_wheels[wheel - 1])

    def counter(self, castor: int, wheel: int) -> int:
        """Return which column of wheel counts is a wheel's, castor and wheel numbered from 1."""
        found = np.flatnonzero(self.driven == self.wheel(castor, wheel))
        if not len(found):
            raise InputError(f"wheel {wheel} of castor {castor} has no encoder; give one that has")
        return int(found[0])

    def pivot_speed(self, twist: Array) -> Array:
        """Return the velocity (n, 2) in B of the pivots of a body that moves with a twist (3,)."""
        return np.column_stack([twist[0] - twist[2] * self.pivot[:, 1], twist[1] + twist[2] * self.pivot[:, 0]])

    def trailing(self, twist: Array) -> Array:
        """Return the angles (n,) at which castors trail in a motion; 0 where the pivot is at rest."""
        speed = self.pivot_speed(twist)
        along = np.where(np.hypot(*speed.T) > AT_REST, np.arctan2(speed[:, 1], speed[:, 0]), 0.0)
        return np.where(self.turning, along, self.angle)


class Controller:
    """Turns twists into wheel and steering rates by the rolling of the described robot, for angles half a period on.

    Castors with an offset turn as rolling requires; steered ones without, to their pivot's direction or its opposite,
    within a period where the motor can. speed: of steering motors at most, rad/s. period: s.
    """

    def __init__(self, build: Build, period: float, speed: float) -> None:
        self._build, self._period, self._speed = build, period, speed
        self._trails = build.turning & (build.offset > 0)

    def commands(self, theta: Array, twist: Array) -> tuple[Array, Array]:
        """Return the rates of driven wheels and steered castors for castor angles (n,) now and a twist (3,)."""
        build, speed = self._build, self._build.pivot_speed(twist)
        steering = self._steering(theta, speed)
        half_on = theta + self._period / 2 * self._turning(theta, speed, twist[2], steering)
        rate = self._turning(half_on, speed, twist[2], steering)
        ahead = speed[:, 0] * np.cos(half_on) + speed[:, 1] * np.sin(half_on)
        rolled = ahead[build.castor] - (twist[2] + rate)[build.castor] * build.lateral
        return (rolled / build.radius)[build.driven], rate[build.steered]

    def _turning(self, theta: Array, speed: Array, spin: float, steering: Array) -> Array:
        """Return the castors' rates (n,) against the body, within the motors' limits."""
        aside = speed[:, 1] * np.cos(theta) - speed[:, 0] * np.sin(theta)
        offset = np.where(self._trails, self._build.offset, 1.0)
        rate = np.where(self._trails, aside / offset - spin, steering)
        rate[self._build.steered] = np.clip(rate[self._build.steered], -self._speed, self._speed)
        return rate

    def _steering(self, theta: Array, speed: Array) -> Array:
        away = np.arctan2(speed[:, 1], speed[:, 0]) - theta
        away -= math.pi * np.round(away / math.pi)
        moves = np.hypot(*speed.T) > AT_REST
        rate = np.zeros(len(theta))
        rate[self._build.steered] = np.where(moves, away / self._period, 0.0)[self._build.steered]
        return rate


def check_drivable(robot: RobotDescription, simulator: str) -> None:
    """Raise InputError for a robot that no foreign simulator can drive; simulator: its name, for the message."""
    if any(wheel.grip != "standard" for wheel in robot.wheels):
        raise InputError(f"robot {robot.name!r} has omni wheels; the {simulator} generator has none")
    blind = [castor for castor in robot.castors if castor.steering != "fixed" and castor.pivot_counts_per_rev is None]
    if blind or not robot.driven_wheels:
        missing = f"the castor at {blind[0].pivot} has no pivot encoder" if blind else "no wheel has a motor"
        raise InputError(f"robot {robot.name!r} cannot be driven: {missing}; give it counts per turn")


def _softer(stiffness: float, stiffer: float) -> float:
    """Return the change of compliance where a slip stiffness is larger by the fraction `stiffer`."""
    return 1 / (stiffness * (1 + stiffer)) - 1 / stiffness
