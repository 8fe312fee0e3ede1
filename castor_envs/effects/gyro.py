"""Effects on the gyro."""

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from castor_envs.description import CONFIG
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription


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
