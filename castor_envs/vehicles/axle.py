"""The driven axle of a differential robot: find it, and correct its wheel base and wheel diameters."""

import dataclasses
from dataclasses import dataclass

from castor_envs.errors import Declined
from castor_envs.vehicles.robot import Castor, RobotDescription


def driven_axle(robot: RobotDescription) -> int:
    """Return the index (from 0) of the fixed castor that carries a differential robot's two driven wheels.

    Raises Declined for other robots. Idle castors beside the axle do no harm.
    """
    castors = sorted({robot.wheel_castors[k] for k in robot.driven_wheels})
    wheels = [robot.wheels[k] for k in robot.driven_wheels]
    axle = robot.castors[castors[0]] if len(castors) == 1 else None
    if (
        axle is None
        or axle.steering != "fixed"
        or robot.driven_castors
        or len(wheels) != 2
        or any(wheel.grip != "standard" for wheel in wheels)
    ):
        raise Declined(
            f"{robot.name!r} is not a differential robot; give one with exactly two driven standard wheels, both on "
            "one fixed castor"
        )
    return castors[0]


def with_axle(robot: RobotDescription, base: float, right: float, left: float) -> RobotDescription:
    """Return a differential robot with a wheel base and wheel diameters, m; the middle of the axle stays."""
    at = driven_axle(robot)
    axle = robot.castors[at]
    drive = [k for k, wheel in enumerate(axle.wheels) if wheel.driven]
    middle = sum(axle.wheels[k].lateral for k in drive) / 2
    wheels = list(axle.wheels)
    for k, side, diameter in zip(drive, (1, -1), (left, right), strict=True):
        wheels[k] = dataclasses.replace(wheels[k], radius=diameter / 2, lateral=middle + side * base / 2)
    castors: list[Castor] = list(robot.castors)
    castors[at] = dataclasses.replace(axle, wheels=tuple(wheels))
    return dataclasses.replace(robot, castors=tuple(castors))


@dataclass(frozen=True)
class AxleCorrection:
    """What an UMBmark calibration found for a differential robot (Borenstein and Feng 1996).

    wheel_base_factor: E_b, true over nominal wheel base. diameter_ratio: right over left wheel diameter, whose mean
    stays as it was. nominal_wheel_base and nominal_diameter: before, of both wheels on average, m.
    """

    nominal_wheel_base: float
    nominal_diameter: float
    wheel_base_factor: float
    diameter_ratio: float

    @property
    def wheel_base(self) -> float:
        """The corrected wheel base, m."""
        return self.wheel_base_factor * self.nominal_wheel_base

    @property
    def diameters(self) -> tuple[float, float]:
        """The corrected diameters of the right and of the left wheel, m."""
        ratio = self.diameter_ratio
        return 2 * self.nominal_diameter / (1 + 1 / ratio), 2 * self.nominal_diameter / (1 + ratio)

    def apply(self, robot: RobotDescription) -> RobotDescription:
        """Return a differential robot with the corrected wheel base and diameters."""
        return with_axle(robot, self.wheel_base, *self.diameters)
