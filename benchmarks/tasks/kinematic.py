"""UMBmark without physics: perfect rolling and honest encoders, but a robot file with wrong numbers (Doebbler IV.B).

Doebbler's Table II: a 1.5 m square driven five times each way at 20 Hz by a robot of the prototype's dimensions, its
parameters known with random errors, all encoders quantised; the score is E_max, averaged over the sets. The paper does
not specify, and we assume: 0.25 m/s and 0.5 m/s2 along the sides; turns of 90 deg on the spot at the corners, at 45
deg/s and 90 deg/s2; a random phase of every wheel encoder in every run; uniform errors ("up to 4 %" fits no normal
distribution), drawn separately for every castor and wheel.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

from benchmarks.tasks.ceilings.robots import with_ceiling
from benchmarks.tasks.other_robots import OtherRobot, cannot_roll_as_described
from benchmarks.tasks.task import Case, Episode, Run, Task
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import Rolled, roll
from castor_envs.motion.trajectories import Direction, umbmark
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel

ROBOT = "asoc-prototype"
SETS = 100
RUNS = 5  # each way

Corners = Literal["turn", "fixed"]
Distribution = Literal["uniform", "normal"]

#: Standard deviation of a normal number whose mean size is 1/2, that of a uniform one in [-1, 1).
NORMAL = 0.5 * np.sqrt(np.pi / 2)


@dataclass(frozen=True)
class ParameterErrors:
    """How wrong a robot file may be: half-widths of uniform errors, relative except that of beta (rad)."""

    offset: float
    radius: float
    lateral: float
    pivot_zero: float

    @classmethod
    def of_mean(cls, offset: float, radius: float, lateral: float, pivot_zero: float) -> "ParameterErrors":
        """Return the errors with these mean absolute values: a uniform error's half-width is twice its mean size."""
        return cls(2 * offset, 2 * radius, 2 * lateral, 2 * pivot_zero)

    def applied(
        self, robot: RobotDescription, random: np.random.Generator, distribution: Distribution = "uniform"
    ) -> RobotDescription:
        """Return the robot as a user with such errors would describe it.

        Drawn castor by castor: r_c, beta, then for each wheel (left, right) r_w and d, each one uniform
        number in [-1, 1), or a normal one of the same mean size.
        """

        def off(half_width: float) -> float:
            if distribution == "normal":
                return half_width * random.normal(0.0, NORMAL)
            return half_width * random.uniform(-1.0, 1.0)

        def wheel(w: Wheel) -> Wheel:
            radius = w.radius * (1 + off(self.radius))
            return dataclasses.replace(w, radius=radius, lateral=w.lateral * (1 + off(self.lateral)))

        def castor(c: Castor) -> Castor:
            offset, zero = c.offset * (1 + off(self.offset)), c.pivot_zero + off(self.pivot_zero)
            return dataclasses.replace(c, offset=offset, pivot_zero=zero, wheels=tuple(wheel(w) for w in c.wheels))

        return dataclasses.replace(robot, castors=tuple(castor(c) for c in robot.castors))


#: Doebbler, Table I: mean absolute errors before and after calibration; before it, Table II leaves beta out.
UNCALIBRATED = ParameterErrors.of_mean(offset=0.0021, radius=0.0207, lateral=0.0089, pivot_zero=0.0)
UNCALIBRATED_BETA = dataclasses.replace(UNCALIBRATED, pivot_zero=2 * np.radians(7.98))
CALIBRATED = ParameterErrors.of_mean(offset=0.0009, radius=0.0004, lateral=0.0004, pivot_zero=np.radians(0.01))


def true_robot() -> RobotDescription:
    """Return the robot that drives, described without errors."""
    return preset(ROBOT)


@dataclass(frozen=True)
class KinematicUMBmark:
    """The square, rolled perfectly; every case is one set of parameter errors, five runs each way.

    robot: the one that drives, described without errors.
    """

    name: str
    title: str
    description: str
    errors: ParameterErrors
    corners: Corners = "turn"
    version: int = 1
    metric: str = "E_max_syst"
    group: str = "umbmark-kinematic"
    standard: bool = True
    missing: str | None = None
    robot: RobotDescription = field(default_factory=true_robot)

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the seeds of the first n parameter sets."""
        return range(SETS if n is None else n)

    def described(self, case: Case) -> RobotDescription:
        """Return the robot file that the estimators get in a case: parameter set number `case`."""
        return self.errors.applied(self.robot, np.random.default_rng([int(case), 0]))

    def record(self, case: Case) -> Episode:
        """Return five runs each way, which differ in their encoders' phases alone."""
        random, geometry = phase_source(int(case)), Geometry.of(self.robot)
        runs = []
        for direction in ("cw", "ccw"):
            rolled = rolled_square(self.robot, direction, self.corners)
            for _ in range(RUNS):
                encoders = Encoders(geometry, Encoders.random_phase(geometry, random))
                wheel, pivot = encoders.wheel(rolled.wheel_angle), encoders.pivot(rolled.castor_angle)
                log = Log(t=rolled.t, wheel=wheel, pivot=pivot, reference=rolled.pose)
                runs.append(Run(log, direction))
        return Episode(self.described(case), with_ceiling(self.robot, runs, slips=False))


def phase_source(case: int) -> np.random.Generator:
    """Return the generator of a case's wheel encoder phases, drawn run by run, clockwise runs first."""
    return np.random.default_rng([case, 1])


@cache
def rolled_square(robot: RobotDescription, direction: Direction, corners: Corners) -> Rolled:
    """Return the motion of a robot's joints on the square, computed once for all cases."""
    return roll(robot, umbmark(direction, corners))


def tasks(measured: Path | None) -> tuple[Task, ...]:
    """Return the kinematic tasks; they need no measured data."""
    return (
        KinematicUMBmark(
            name="umbmark-kinematic-uncalibrated",
            title="UMBmark, perfect rolling, uncalibrated robot files",
            description="Doebbler's Table II before calibration: Table I's parameter errors, beta = 0.",
            errors=UNCALIBRATED,
        ),
        KinematicUMBmark(
            name="umbmark-kinematic-calibrated",
            title="UMBmark, perfect rolling, calibrated robot files",
            description="The same with the parameter errors that Table I says are left after calibration.",
            errors=CALIBRATED,
        ),
    )


def on_robot(user_robot: OtherRobot) -> tuple[Task, ...]:
    """Return the kinematic tasks on another robot."""
    return tuple(user_robot.of(task, missing=cannot_roll_as_described(user_robot.robot)) for task in tasks(None))
