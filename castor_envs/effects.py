"""Effects: what a real robot does that its description leaves out. Each is one class, with one meaning everywhere.

An effect stands in the robot file as ``{"name": "pivot_bias", "castor": 2, "value": 0.013}``. To add one,
add a class to this module and to `Effect`.
"""

import dataclasses
import math
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from castor_envs.description import CONFIG
from castor_envs.errors import InputError

if TYPE_CHECKING:
    from castor_envs.robot import Castor, RobotDescription

CastorNumber = Annotated[int, Field(ge=1)]


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class PivotBias:
    """The pivot encoder of a castor (counted from 1) reads `value` (rad) more than the model's `pivot_zero` says."""

    castor: CastorNumber
    value: Annotated[float, Field(ge=-math.pi, le=math.pi)]
    name: Literal["pivot_bias"] = "pivot_bias"

    def apply(self, robot: "RobotDescription") -> "RobotDescription":
        """Return the robot with the bias added to the true beta."""
        castor = castor_of(robot, self.castor, self.name)
        return with_castor(robot, self.castor, pivot_zero=castor.pivot_zero + self.value)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class WheelRadius:
    """A wheel (both counted from 1; wheel 1 is the left one) is larger than described by the fraction `value`."""

    castor: CastorNumber
    wheel: Annotated[int, Field(ge=1)]
    value: Annotated[float, Field(ge=-0.5, le=0.5)]
    name: Literal["wheel_radius"] = "wheel_radius"

    def apply(self, robot: "RobotDescription") -> "RobotDescription":
        """Return the robot with this wheel's radius scaled by 1 + value."""
        wheels = list(castor_of(robot, self.castor, self.name).wheels)
        if self.wheel > len(wheels):
            raise InputError(f"effect {self.name}: castor {self.castor} has no wheel {self.wheel}")
        old = wheels[self.wheel - 1]
        wheels[self.wheel - 1] = dataclasses.replace(old, radius=old.radius * (1.0 + self.value))
        return with_castor(robot, self.castor, wheels=tuple(wheels))


Effect = Annotated[PivotBias | WheelRadius, Field(discriminator="name")]


def castor_of(robot: "RobotDescription", number: int, effect: str) -> "Castor":
    """Return castor `number` (from 1); raises InputError where the robot has no such castor."""
    if number > len(robot.castors):
        raise InputError(f"effect {effect}: robot {robot.name!r} has no castor {number}")
    return robot.castors[number - 1]


def with_castor(robot: "RobotDescription", number: int, **changes: object) -> "RobotDescription":
    """Return the robot with some fields of castor `number` (from 1) replaced."""
    castors = list(robot.castors)
    castors[number - 1] = dataclasses.replace(castors[number - 1], **changes)
    return dataclasses.replace(robot, castors=tuple(castors))


def apply_effects(robot: "RobotDescription", effects: tuple[PivotBias | WheelRadius, ...]) -> "RobotDescription":
    """Apply effects in order."""
    for effect in effects:
        robot = effect.apply(robot)
    return robot
