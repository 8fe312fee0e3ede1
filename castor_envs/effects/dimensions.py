"""Effects on the robot's dimensions: what is built otherwise than described."""

import math
from functools import partial
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from castor_envs.description import CONFIG
from castor_envs.effects.parts import castor_of, pivot_encoders, wheel_channel, wheel_encoders, with_castor, with_wheels
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Slip
from castor_envs.vehicles.effect import Contacts, Effect, Number, RadiusChange
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.weight import swung_loads, wheel_loads

Fraction = Annotated[float, Field(ge=-0.5, le=0.5)]
Metres = Annotated[float, Field(ge=-1.0, le=1.0)]
GRAVITY = Floor().normal_gravity
"""m/s2, on a level floor: where radii under load are measured."""


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class WheelRadius(Effect[RobotDescription]):
    """A wheel (castor and wheel counted from 1; wheel 1 is the left one) is larger by the fraction `value`."""

    name: Literal["wheel_radius"] = "wheel_radius"
    castor: Number
    wheel: Number
    value: Fraction
    title = "wheel radius"
    unit = "1"
    step = 1e-3
    tolerance = 1e-4  # relative: 5 um on 50 mm
    check = "Measure the wheel's diameter under load; look for wear and dirt on the tread."
    indistinguishable_from = ("wheel_radius", "counts_per_rev")

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["WheelRadius", ...]:
        """Return an instance for each wheel with an encoder."""
        return tuple(cls(castor=i, wheel=j, value=cls.step) for i, j in wheel_encoders(robot))

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot with this wheel's radius scaled by 1 + value."""
        return with_wheels(robot, self.castor, self.name, self.wheel, radius=1.0 + self.value)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class AllWheelRadius(Effect[RobotDescription]):
    """All wheels of the robot are larger by the fraction `value`."""

    name: Literal["all_wheel_radius"] = "all_wheel_radius"
    value: Fraction
    title = "radius of all wheels"
    unit = "1"
    step = 1e-3
    tolerance = 1e-4  # relative: as one wheel's
    check = "Measure the diameters under load; compare a straight drive with a tape measure."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["AllWheelRadius", ...]:
        """Return a single instance."""
        return (cls(value=cls.step),)

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot with all radii scaled by 1 + value."""
        for i in range(len(robot.castors)):
            robot = with_wheels(robot, i + 1, self.name, radius=1.0 + self.value)
        return robot


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class CountsPerRev(Effect[RobotDescription]):
    """A wheel's encoder has more counts per turn, by the fraction `value`: as a radius smaller by value/(1 + value)."""

    name: Literal["counts_per_rev"] = "counts_per_rev"
    castor: Number
    wheel: Number
    value: Fraction
    title = "wheel counts a turn"
    unit = "1"
    step = 1e-3
    tolerance = 1e-4  # relative: as the radius that it looks like
    check = "Turn the wheel ten times by hand and read the counts; check gear ratio and encoder settings."
    indistinguishable_from = ("wheel_radius", "counts_per_rev")

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["CountsPerRev", ...]:
        """Return an instance for each wheel with an encoder."""
        return tuple(cls(castor=i, wheel=j, value=cls.step) for i, j in wheel_encoders(robot))

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot with this wheel's counts a turn scaled by 1 + value."""
        wheel_channel(robot, self.castor, self.wheel, self.name)
        return with_wheels(robot, self.castor, self.name, self.wheel, counts_per_rev=1.0 + self.value)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Track(Effect[RobotDescription]):
    """The wheels of a castor are farther apart by the fraction `value`."""

    name: Literal["track"] = "track"
    castor: Number
    value: Fraction
    title = "track (distance between the wheels)"
    unit = "1"
    step = 1e-3
    tolerance = 2e-4  # relative: 50 um on 0.25 m
    check = "Measure the distance between the wheels' contact lines; look for play along the axle."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["Track", ...]:
        """Return an instance for each castor with more than one wheel."""
        return tuple(cls(castor=i, value=cls.step) for i, c in enumerate(robot.castors, start=1) if len(c.wheels) > 1)

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot with all laterals of this castor scaled by 1 + value."""
        return with_wheels(robot, self.castor, self.name, lateral=1.0 + self.value)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class PivotOffset(Effect[RobotDescription]):
    """A castor's axle trails its pivot by `value` (m) more."""

    name: Literal["pivot_offset"] = "pivot_offset"
    castor: Number
    value: Metres
    title = "offset of axle behind pivot"
    unit = "m"
    step = 1e-4
    tolerance = 1e-4  # m: as good as parts are machined and measured
    check = "Measure from the pivot's axis to the wheels' axle; look for play of the pivot's bearing and a bent fork."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["PivotOffset", ...]:
        """Return an instance for each castor that turns about a pivot ahead of its axle."""
        trailing = [i for i, c in enumerate(robot.castors, start=1) if c.steering != "fixed" and c.offset > 0]
        return tuple(cls(castor=i, value=cls.step) for i in trailing)

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot with `value` added to this castor's offset."""
        offset = castor_of(robot, self.castor, self.name).offset + self.value
        return with_castor(robot, self.castor, self.name, offset=offset)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class PivotPositionX(Effect[RobotDescription]):
    """A castor's pivot stands `value` (m) further forward in the body."""

    name: Literal["pivot_position_x"] = "pivot_position_x"
    castor: Number
    value: Metres
    title = "pivot position, forward"
    unit = "m"
    step = 1e-4
    tolerance = 5e-5  # m: as good as a chassis is machined
    check = "Measure the pivots' distances from each other and from the point that the reference tracks."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["PivotPositionX", ...]:
        """Return an instance for each castor."""
        return tuple(cls(castor=i + 1, value=cls.step) for i in range(len(robot.castors)))

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot with `value` added to this pivot's x."""
        x, y = castor_of(robot, self.castor, self.name).pivot
        return with_castor(robot, self.castor, self.name, pivot=(x + self.value, y))


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class PivotPositionY(Effect[RobotDescription]):
    """A castor's pivot stands `value` (m) further to the left in the body."""

    name: Literal["pivot_position_y"] = "pivot_position_y"
    castor: Number
    value: Metres
    title = "pivot position, to the left"
    unit = "m"
    step = 1e-4
    tolerance = 5e-5  # m: as good as a chassis is machined
    check = "Measure the pivots' distances from each other and from the point that the reference tracks."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["PivotPositionY", ...]:
        """Return an instance for each castor."""
        return tuple(cls(castor=i + 1, value=cls.step) for i in range(len(robot.castors)))

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot with `value` added to this pivot's y."""
        x, y = castor_of(robot, self.castor, self.name).pivot
        return with_castor(robot, self.castor, self.name, pivot=(x, y + self.value))


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class PivotBias(Effect[RobotDescription]):
    """The pivot encoder of a castor (counted from 1) reads `value` (rad) more than the model's `pivot_zero` says."""

    name: Literal["pivot_bias"] = "pivot_bias"
    castor: Number
    value: Annotated[float, Field(ge=-math.pi, le=math.pi)]
    title = "pivot bias"
    unit = "rad"
    step = 1e-3
    tolerance = 1e-4  # rad: as good as a calibration finds it
    check = "Align the castor with the body by a straight edge and read its pivot; check the encoder's clamp."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["PivotBias", ...]:
        """Return an instance for each castor with a pivot encoder."""
        return tuple(cls(castor=i, value=cls.step) for i in pivot_encoders(robot))

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot with the bias added to the true beta."""
        zero = castor_of(robot, self.castor, self.name).pivot_zero + self.value
        return with_castor(robot, self.castor, self.name, pivot_zero=zero)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class LoadRadius(Effect[RobotDescription]):
    """Tyres yield: a wheel's radius is smaller by `value` (m/N) times its load beyond the mean at rest.

    The mean is over the wheels with encoders. As castors turn, loads shift (`castor_envs.vehicles.weight.swung_loads`);
    shifts by acceleration are left out. `apply` takes each wheel's load at rest.
    """

    name: Literal["load_radius"] = "load_radius"
    value: Annotated[float, Field(ge=0.0, le=1e-3)]
    title = "tyres that give way under load"
    unit = "m/N"
    step = 1e-6
    tolerance = 1e-7  # m/N: 1 um under 10 N
    check = "Measure the height of the axles above the floor, with and without a known weight on the robot."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["LoadRadius", ...]:
        """Return an instance if loads on wheels with encoders differ, or change as castors turn, by over 1 %."""
        try:
            loads = _shifting_loads(robot)[:, list(robot.driven_wheels)]
        except InputError:  # its weight is not described well enough for it to stand
            return ()
        return (cls(value=cls.step),) if loads.size and np.ptp(loads) > 0.01 * np.mean(loads) else ()

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return the robot with the radii under its loads at rest."""
        loads, radius = wheel_loads(robot, GRAVITY), np.array([wheel.radius for wheel in robot.wheels])
        shrinkage = self.value * (_shifting_loads(robot) - np.mean(loads[list(robot.driven_wheels)]))
        if np.any(gone := np.max(shrinkage, axis=0) >= radius):
            castor = robot.wheel_castors[int(np.argmax(gone))] + 1
            raise InputError(f"effect {self.name} is too large for castor {castor}: its wheels would be gone")
        shrinkage = iter(shrinkage[0].tolist())
        for i, castor in enumerate(robot.castors, start=1):
            for j, wheel in enumerate(castor.wheels, start=1):
                robot = with_wheels(robot, i, self.name, j, radius=1.0 - next(shrinkage) / wheel.radius)
        return robot

    def radius_change(self, robot: RobotDescription) -> RadiusChange | None:
        """Return the relative change of radii from those under the loads at rest; None where loads do not shift."""
        if self.value == 0.0 or not _swinging(robot):
            return None
        radius, standing = np.array([wheel.radius for wheel in self.apply(robot).wheels]), wheel_loads(robot, GRAVITY)
        return partial(self._change, robot, standing, radius)

    def _change(self, robot: RobotDescription, standing: Array, radius: Array, castor_angle: Array) -> Array:
        return self.value * (standing - swung_loads(robot, GRAVITY, castor_angle)) / radius

    def slip(self, contacts: Contacts[RobotDescription]) -> Slip | None:
        """Return how much further contacts move than wheels with the radii under the loads at rest roll."""
        robot, half_way = contacts.robot, contacts.motion.half_way
        if (larger := self.radius_change(robot)) is None:
            return None
        path, part = contacts.of(self.apply(robot)).paths()[:, : len(robot.wheels)], larger(half_way)
        return Slip(path * part / (1.0 + part), np.zeros_like(half_way))


def _shifting_loads(robot: RobotDescription) -> Array:
    """Return loads on wheels (5, w), N: at rest, and with all swinging castors turned to each side of B."""
    angles = np.array([castor.angle for castor in robot.castors]) + np.zeros((4, 1))
    angles[:, _swinging(robot)] = np.arange(4)[:, None] * np.pi / 2
    return np.vstack([wheel_loads(robot, GRAVITY), swung_loads(robot, GRAVITY, angles)])


def _swinging(robot: RobotDescription) -> list[int]:
    """Return the castors (from 0) whose axles move as they turn."""
    return [i for i, castor in enumerate(robot.castors) if castor.steering != "fixed" and castor.offset]
