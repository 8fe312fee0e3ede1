"""Calibration methods judged: by the parameters that they find, and by the odometry with these afterwards.

A method gets a robot file with wrong numbers and recordings; an estimator that is the same for all methods follows test
runs with the robot that the method returns.

What is drawn for case k comes from ``default_rng([k, part])``: part 0 the parameters' errors, 1 the encoders' phases in
the test runs, 2 those (and the slip) in the recordings, 3 the test path of `SquaresCalibration`. Seeds from 0 on are
official: tuning a method on them would be tuning on the test set.

For bases on castors the file is the preset and the errors are in the robot that drives: the rounding of a steady pivot
angle depends on the true parameters alone, and would be the same in all cases if the preset drove. For differential
robots the preset drives and the file has the errors, as in the other tasks.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Literal

import gymnasium as gym
import numpy as np

from benchmarks.tasks.kinematic import ROBOT, UNCALIBRATED_BETA
from benchmarks.tasks.measured import MeasuredCalibration
from benchmarks.tasks.other_robots import OtherRobot, cannot_roll_as_described
from benchmarks.tasks.physics import drive
from benchmarks.tasks.task import Calibration, Case, Episode, Run, Task
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.logs.recorder import RecordLog
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import Rolled, roll
from castor_envs.motion.trajectories import Direction, Trajectory, figure_eight, pivoting, umbmark, wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.axle import driven_axle, with_axle
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Castor, RobotDescription
from estimators.calibration.protocol import Recording

WHEEL_BASE, DIAMETER = 0.02, 0.01
"""Half-widths of the uniform relative errors of a differential robot's wheel base, and of each wheel's diameter."""

SLIP = 0.3e-3
"""m per square root of m: standard deviation of the distance that a wheel's encoder misses by slip while the wheel
rolls 1 m.

Single squares of a robot as small as OptiOdom's (0.75 m sides, wheel base 0.2 m) then end 2 mm apart, one standard
deviation in x, as its measured ones do (1.6 to 2.1 mm)."""

WAYS: tuple[Direction, ...] = ("cw", "ccw")


@dataclass(frozen=True)
class TurnsCalibration:
    """Doebbler's prototype turns about each castor in turn, held, both ways; perfect rolling; no reference poses.

    The robot that drives is off its file, the preset, by Table I's errors before calibration. Recordings, two for each
    castor: starting with all castors as after driving straight ahead, the base turns 1 1/4 times about the held
    castor's pivot at 30 deg/s, clockwise in one and counter-clockwise in the other; the free castors swing in during
    the first quarter. (From the angles at which the other turn ended, castors would stand in unstable equilibrium, and
    perfect rolling would never swing them round.) Encoders keep their remainder, with a random phase in every
    recording. Test runs: the kinematic tasks' 1.5 m square, two each way, followed by CAST-0. robot: the robot file.
    """

    name: str = "calibration-pivoting"
    title: str = "Calibration by turns about held castors, perfect rolling"
    description: str = (
        "Doebbler's Table I before calibration; a turn both ways about each castor, without reference; then squares."
    )
    version: int = 1
    metric: str = "E_max_syst"
    group: str = "calibration"
    standard: bool = True
    followed_by: str = "cast-0"
    missing: str | None = None
    robot: RobotDescription = field(default_factory=lambda: preset(ROBOT))

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the seeds of the first n robots."""
        return range(12 if n is None else n)

    def record(self, case: Case) -> Episode:
        """Return six recordings and four test runs."""
        true = built(self.robot, case)
        phases, recorded = _random(case, 1), _random(case, 2)
        recordings = [
            Recording(_encoded(true, rolled_turn(true, held, way), recorded), held=held)
            for held in range(1, len(true.castors) + 1)
            for way in WAYS
        ]
        runs = []
        for way in WAYS:
            rolled = roll(true, umbmark(way))
            runs += [Run(_encoded(true, rolled, phases, rolled.pose), way) for _ in range(2)]
        return Episode(self.robot, tuple(runs), Calibration.by(self.followed_by, recordings, true))


@dataclass(frozen=True)
class PhysicsCalibration:
    """The same robots and turns in physics: `castor/ASOC-v1` with a castor held and all other wheels at a voltage.

    Recordings as in `TurnsCalibration`, but the castors start as trailing in the turn, nobody controls the angle, and
    the wheels slip: at 0.2 of the full voltage, over 18 s, the base turns about once. The recordings have no reference
    poses. Test runs: `castor/UMBmark-v0`'s square on a clean floor, one each way, followed by CAST-0.
    """

    name: str = "calibration-physics"
    title: str = "Calibration by turns about held castors, in physics"
    description: str = (
        "The same robots; turns and squares driven in physics, where the wheels of a castor at one voltage slip."
    )
    version: int = 1
    metric: str = "E_max_syst"
    group: str = "calibration"
    standard: bool = True
    followed_by: str = "cast-0"
    missing: None = None

    @property
    def robot(self) -> RobotDescription:
        """The robot file."""
        return preset(ROBOT)

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the seeds of the first n robots."""
        return range(8 if n is None else n)

    def record(self, case: Case) -> Episode:
        """Return six recordings and two test runs."""
        true = built(self.robot, case)
        test, recorded = _seeds(case, 1), _seeds(case, 2)
        recordings = [
            Recording(driven_turn(true, held, way, next(recorded)), held=held)
            for held in range(1, len(true.castors) + 1)
            for way in WAYS
        ]
        runs = tuple(Run(drive(true, way, Floor(), next(test)), way) for way in WAYS)
        return Episode(self.robot, runs, Calibration.by(self.followed_by, recordings, true))


@dataclass(frozen=True)
class SquaresCalibration:
    """A differential robot drives UMBmark squares both ways; rolling, with a little slip; true poses at both ends.

    Robot files: the wheel base is off by up to 2 %, each diameter by up to 1 % (uniform). Recordings: squares of 2 m,
    five each way, with the true pose in the first and the last row only. In every sample each wheel's encoder misses a
    random distance (`SLIP`): without it, one square would tell as much as five. Test runs, without slip, so that they
    show the parameters' errors alone: squares of 1.5 m, two each way, a figure eight, and a random path of 30 s that
    does not close (and so shows a common scale, which squares do not). Dead reckoning follows them. robot: the one that
    drives, described without errors.
    """

    name: str = "calibration-umbmark"
    title: str = "Calibration by UMBmark squares, differential robot"
    description: str = (
        "Wheel base off by up to 2 %, diameters by up to 1 %; five squares each way with the true ends and a little "
        "slip; then other squares, a figure eight and a random path."
    )
    side: float = 2.0
    version: int = 1
    metric: str = "E_max_syst"
    group: str = "calibration"
    standard: bool = True
    followed_by: str = "dead-reckoning-1"
    missing: str | None = None
    robot: RobotDescription = field(default_factory=lambda: preset("differential"))

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the seeds of the first n robot files."""
        return range(20 if n is None else n)

    def described(self, case: Case) -> RobotDescription:
        """Return the robot file of a case."""
        random, axle = _random(case, 0), driven_axle(self.robot)
        left, right = (wheel for wheel in self.robot.castors[axle].wheels if wheel.driven)
        base = (left.lateral - right.lateral) * (1 + WHEEL_BASE * random.uniform(-1, 1))
        diameters = [2 * wheel.radius * (1 + DIAMETER * random.uniform(-1, 1)) for wheel in (right, left)]
        return with_axle(self.robot, base, *diameters)

    def record(self, case: Case) -> Episode:
        """Return ten recordings and six test runs."""
        robot, phases, recorded = self.robot, _random(case, 1), _random(case, 2)
        recordings = []
        for way in WAYS:
            rolled = rolled_differential(robot, way, self.side)
            ends = np.full((len(rolled.t), 3), np.nan)
            ends[[0, -1]] = rolled.pose[[0, -1]]
            for _ in range(5):
                slipped = rolled._replace(wheel_angle=_slipped(robot, rolled.wheel_angle, recorded))
                recordings.append(Recording(_encoded(robot, slipped, recorded, ends), side=self.side))
        path = roll(robot, wander(_random(case, 3), duration=30.0, holonomic=False))
        tests: list[tuple[Rolled, Direction | None]] = [(rolled_differential(robot, way, 1.5), way) for way in WAYS]
        tests = [*tests, *tests, (rolled_differential(robot, "eight"), None), (path, None)]
        runs = tuple(Run(_encoded(robot, rolled, phases, rolled.pose), way) for rolled, way in tests)
        return Episode(self.described(case), runs, Calibration.by(self.followed_by, recordings, robot))


def driven_turn(robot: RobotDescription, held: int, direction: Direction, seed: int) -> Log:
    """Return the log, without reference, of a turn in `castor/ASOC-v1`: castor `held` blocked, 0.2 of the voltage."""
    trajectory = pivoting(robot.castors[held - 1].pivot, direction, angle=2.6 * np.pi, speed=0.5, acceleration=0.3)
    env = RecordLog(
        gym.make("castor_envs:castor/ASOC-v1", robot=robot, trajectory=trajectory, control="voltage", held=held)
    )
    env.reset(seed=seed)
    action, finished = np.full(len(robot.driven_wheels), 0.2, dtype=np.float32), False
    while not finished:
        *_, terminated, truncated, _ = env.step(action)
        finished = terminated or truncated
    env.close()
    return dataclasses.replace(env.log(), reference=None)


def built(robot: RobotDescription, case: Case) -> RobotDescription:
    """Return the robot that drives in a case: off its description by Table I's errors."""
    return UNCALIBRATED_BETA.applied(robot, _random(case, 0))


def rolled_turn(robot: RobotDescription, held: int, direction: Direction) -> Rolled:
    """Return the motion of a robot's joints while it turns about castor `held`."""
    trajectory = pivoting(robot.castors[held - 1].pivot, direction, angle=2.5 * np.pi)
    return roll(robot, trajectory, np.zeros(len(robot.castors)))


@cache
def rolled_differential(robot: RobotDescription, path: Literal["cw", "ccw", "eight"], side: float = 0.0) -> Rolled:
    """Return the motion of a differential robot's wheels on a square (side in m) or a figure eight."""
    trajectory: Trajectory = figure_eight() if path == "eight" else umbmark(path, side=side)
    return roll(robot, trajectory)


def _encoded(
    robot: RobotDescription, rolled: Rolled, random: np.random.Generator, reference: Array | None = None
) -> Log:
    """Return the log of encoders that carry their remainders, with random phases."""
    geometry = Geometry.of(robot)
    encoders = Encoders(geometry, Encoders.random_phase(geometry, random))
    return Log(rolled.t, encoders.wheel(rolled.wheel_angle), encoders.pivot(rolled.castor_angle), reference=reference)


def _slipped(robot: RobotDescription, wheel_angle: Array, random: np.random.Generator) -> Array:
    """Return wheel angles (N, w) with slip added sample by sample: normal, its variance in proportion to distance."""
    radius = np.array([wheel.radius for wheel in robot.wheels])
    rolled = np.abs(np.diff(wheel_angle, axis=0, prepend=wheel_angle[:1])) * radius
    return wheel_angle + np.cumsum(SLIP * np.sqrt(rolled) * random.normal(size=rolled.shape), axis=0) / radius


def _random(case: Case, part: int) -> np.random.Generator:
    return np.random.default_rng([int(case), part])


def _seeds(case: Case, part: int) -> Iterator[int]:
    """Yield seeds for environments."""
    random = _random(case, part)
    while True:
        yield int(random.integers(2**31))


def tasks(measured: Path | None) -> tuple[Task, ...]:
    """Return the calibration tasks; one needs measured data."""
    return (TurnsCalibration(), SquaresCalibration(), PhysicsCalibration(), MeasuredCalibration(measured))


def on_robot(user_robot: OtherRobot) -> tuple[Task, ...]:
    """Return the calibration tasks on another robot, without those of physics, whose voltage suits their robot alone.

    The tasks of turns take bases on two free castors or more, with two driven wheels and a pivot encoder each; those of
    squares take differential robots.
    """
    robot, slips = user_robot.robot, cannot_roll_as_described(user_robot.robot)
    no_turns = None
    if len(robot.castors) < 2 or not all(_split(castor) for castor in robot.castors):
        no_turns = f"robot {robot.name!r} is no base on free castors with two driven wheels and a pivot encoder each"
    no_squares, axle = None, 0
    try:
        axle = driven_axle(robot)
    except InputError as error:
        no_squares = str(error)
    squares = SquaresCalibration()
    return (
        user_robot.of(TurnsCalibration(), missing=slips or no_turns),
        user_robot.of(squares, missing=slips or no_squares, followed_by=f"dead-reckoning-{axle + 1}"),
    )


def _split(castor: Castor) -> bool:
    wheels = castor.wheels
    return (
        castor.steering == "free"
        and castor.offset > 0
        and castor.pivot_counts_per_rev is not None
        and len(wheels) == 2
        and all(wheel.driven and wheel.grip == "standard" for wheel in wheels)
    )
