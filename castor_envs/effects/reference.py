"""Effects on what else tells of the body: which point a reference tracks, how its axes stand, and the gyro's scale."""

import math
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from castor_envs.description import CONFIG
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription

Metres = Annotated[float, Field(ge=-10.0, le=10.0)]


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ReferenceYaw(Effect[RobotDescription]):
    """The reference's axes are turned against the body: its heading is larger by `value` (rad).

    It looks like a bias of every pivot encoder together with all pivots turned about the body's origin.
    """

    name: Literal["reference_yaw"] = "reference_yaw"
    value: Annotated[float, Field(ge=-math.pi, le=math.pi)]
    title = "reference's axes turned against the body"
    unit = "rad"
    step = 1e-3
    tolerance = 3e-4  # rad: a straight edge of 0.3 m, 0.1 mm off
    check = "Push the robot straight along a ruler and compare the reference's heading with its path."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["ReferenceYaw", ...]:
        """Return a single instance."""
        return (cls(value=cls.step),)

    def reference_pose(self, pose: Array) -> Array:
        """Return the poses with headings larger by `value`."""
        return pose + np.array([0.0, 0.0, self.value])


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ReferenceLeverX(Effect[RobotDescription]):
    """The point that the reference tracks stands `value` (m) further forward than the body's origin.

    It looks as if all pivots stood further back.
    """

    name: Literal["reference_lever_x"] = "reference_lever_x"
    value: Metres
    title = "lever arm of the reference, forward"
    unit = "m"
    step = 1e-3
    tolerance = 1e-4  # m: as good as parts are measured
    check = "Measure from the robot's origin to the tracked point; turn on the spot and fit a circle to the reference."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["ReferenceLeverX", ...]:
        """Return a single instance."""
        return (cls(value=cls.step),)

    def reference_pose(self, pose: Array) -> Array:
        """Return the poses of a point `value` ahead."""
        return _moved(pose, self.value, 0.0)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class ReferenceLeverY(Effect[RobotDescription]):
    """The point that the reference tracks stands `value` (m) further to the left than the body's origin.

    It looks as if all pivots stood further to the right.
    """

    name: Literal["reference_lever_y"] = "reference_lever_y"
    value: Metres
    title = "lever arm of the reference, to the left"
    unit = "m"
    step = 1e-3
    tolerance = 1e-4  # m: as good as parts are measured
    check = "Measure from the robot's origin to the tracked point; turn on the spot and fit a circle to the reference."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["ReferenceLeverY", ...]:
        """Return a single instance."""
        return (cls(value=cls.step),)

    def reference_pose(self, pose: Array) -> Array:
        """Return the poses of a point `value` to the left."""
        return _moved(pose, 0.0, self.value)


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class GyroScale(Effect[RobotDescription]):
    """The gyro says that the body turns too far by this part of the turn.

    Without a reference it looks like wheels that are all larger, or a track that is narrower.
    """

    name: Literal["gyro_scale"] = "gyro_scale"
    value: Annotated[float, Field(ge=-0.5, le=0.5)]
    title = "scale of the gyro"
    unit = "relative"
    step = 1e-3
    tolerance = 3e-3  # data sheets of MEMS gyros state 0.5 to 1 % at most, after calibration in the factory
    check = "Turn the robot ten times on the spot, against a mark on the floor, and add up what the gyro reads."

    @classmethod
    def variants(cls, robot: RobotDescription) -> tuple["GyroScale", ...]:
        """Return a single instance, for robots with a gyro."""
        return () if robot.gyro is None else (cls(value=cls.step),)

    def gyro_gain(self) -> float:
        """Return 1 + `value`."""
        return 1.0 + self.value


def _moved(pose: Array, x: float, y: float) -> Array:
    return np.column_stack([pose[:, :2] + rotate(np.array([x, y]), pose[:, 2]), pose[:, 2]])
