"""UMBmark in physics: squares in `castor/UMBmark-v0`, with slip, on a clean floor, over cables, on a slippery patch.

The robot files carry the errors that Doebbler's Table I says are left after calibration, one set a case.
Physics repeats itself but for the encoders' phases, so a case is one run each way (and, where the floor has
something on it, one more each way on the clean floor, from which the extended UMBmark takes the systematic
part).
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import gymnasium as gym
import numpy as np

from benchmarks.tasks.ceilings.robots import with_ceiling
from benchmarks.tasks.kinematic import CALIBRATED
from benchmarks.tasks.other_robots import OtherRobot, cannot_roll_square
from benchmarks.tasks.task import Case, Episode, Run, Task
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.logs.log import Log
from castor_envs.logs.recorder import RecordLog
from castor_envs.motion.controllers import trailing_angles
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.trajectories import Direction
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Gyro, RobotDescription

ROBOT = "asoc-prototype"
CASES = 20

FloorOf = Callable[[RobotDescription, Direction, np.random.Generator], Floor]


def clean_floor(robot: RobotDescription, direction: Direction, random: np.random.Generator) -> Floor:
    """Return an even floor."""
    return Floor()


def ten_cables(robot: RobotDescription, direction: Direction, random: np.random.Generator) -> Floor:
    """Return ten cables of 10 mm across the first side, under the inner wheels only, as in the extended UMBmark.

    Borenstein and Feng (1995) lay ten bumps of 9-10 mm along the first side, under the wheel that faces the inside of
    the square. Bases on castors have no such single wheel: the cables lie under the innermost wheel, every 0.12 m, each
    shifted at random by up to 2 cm.
    """
    inside = 1.0 if direction == "ccw" else -1.0
    reach = innermost_wheel(robot, inside)
    cables = tuple(
        Cable(
            center=(0.2 + 0.12 * i + random.uniform(-0.02, 0.02), inside * reach),
            direction=np.pi / 2,
            length=0.08,
            diameter=0.01,
        )
        for i in range(10)
    )
    return Floor(cables=cables)


def innermost_wheel(robot: RobotDescription, inside: float) -> float:
    """Return how far to one side (1: left, -1: right) of a robot's path a wheel runs, m, to 1 mm; castors trail."""
    angles = trailing_angles(Geometry.of(robot), (1.0, 0.0, 0.0))
    sides = [
        castor.pivot[1] - castor.offset * np.sin(angle) + wheel.lateral * np.cos(angle)
        for castor, angle in zip(robot.castors, angles, strict=True)
        for wheel in castor.wheels
    ]
    return round(float(max(inside * side for side in sides)), 3)


def slippery_patch(robot: RobotDescription, direction: Direction, random: np.random.Generator) -> Floor:
    """Return a square of 0.6 m, friction 0.02 to 0.05 (wet soap), about the first corner.

    The base brakes, turns and starts there: at 0.5 m/s2 its wheels need about 0.05 if all share the work. Under one
    castor alone a patch shows little: the others hold the base, and the servo keeps the wheel's speed.
    """
    inside = 1.0 if direction == "ccw" else -1.0
    center = (1.5 + random.uniform(-0.2, 0.2), inside * (0.3 + random.uniform(-0.2, 0.2)))
    return Floor(patches=(Patch(center=center, size=(0.6, 0.6), friction=random.uniform(0.02, 0.05)),))


@dataclass(frozen=True)
class PhysicsUMBmark:
    """The square, driven in `castor/UMBmark-v0`; every case is one robot file and one floor.

    robot: the one that drives; effects in its file disturb it, and estimators do not know of them.
    """

    name: str
    title: str
    description: str
    floor: FloorOf
    metric: str
    baseline: bool
    version: int = 1
    group: str = "umbmark-physics"
    standard: bool = True
    missing: str | None = None
    robot: RobotDescription = field(default_factory=lambda: preset(ROBOT))

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the first n seeds."""
        return range(CASES if n is None else n)

    def record(self, case: Case) -> Episode:
        """Return one run each way, and one each way on the clean floor where there is anything on it."""
        described = CALIBRATED.applied(self.robot.as_described(), np.random.default_rng([int(case), 0]))
        if described.gyro is not None:
            told = bias_as_told(described.gyro, np.random.default_rng([int(case), 3]))
            described = dataclasses.replace(described, gyro=told)
        runs = []
        for side, direction in enumerate(("cw", "ccw")):
            floors = [self.floor(self.robot, direction, np.random.default_rng([int(case), 1, side]))]
            floors += [Floor()] * self.baseline
            for baseline, floor in enumerate(floors):
                seed = int(np.random.SeedSequence([int(case), 2, side, baseline]).generate_state(1)[0])
                log = drive(self.robot, direction, floor, seed)
                runs.append(Run(log, direction, baseline=bool(baseline), floor=floor))
        return Episode(described, with_ceiling(self.robot.as_built(), runs))


def bias_as_told(gyro: Gyro, random: np.random.Generator) -> Gyro:
    """Return a gyro as estimators get it: its bias off within `bias_tolerance`; nobody tells one that has none."""
    told = 0.0 if gyro.bias_tolerance is None else gyro.bias + gyro.bias_tolerance * random.standard_normal()
    return dataclasses.replace(gyro, bias=float(np.clip(told, -10.0, 10.0)))


def drive(robot: RobotDescription, direction: Direction, floor: Floor, seed: int) -> Log:
    """Return the log of one square in `castor/UMBmark-v0`; the estimates it is given change nothing."""
    env = gym.make("castor_envs:castor/UMBmark-v0", robot=robot, direction=direction, floor=floor)
    recorder = RecordLog(env)
    recorder.reset(seed=seed)
    finished = False
    while not finished:
        *_, terminated, truncated, _ = recorder.step(np.zeros(3))
        finished = terminated or truncated
    recorder.close()
    return recorder.log()


def tasks(measured: Path | None) -> tuple[Task, ...]:
    """Return the physics tasks; they need no measured data."""
    return (
        PhysicsUMBmark(
            name="umbmark-physics-clean",
            title="UMBmark in physics, clean floor",
            description="Slip in proportion to force, and the parameter errors left after calibration.",
            floor=clean_floor,
            metric="E_max_syst",
            baseline=False,
        ),
        PhysicsUMBmark(
            name="umbmark-physics-cables",
            title="UMBmark in physics, ten cables under the inner wheel",
            description="The extended UMBmark: what ten 10 mm bumps add to the orientation error.",
            floor=ten_cables,
            metric="nonsystematic_orientation_error",
            baseline=True,
        ),
        PhysicsUMBmark(
            name="umbmark-physics-slippery",
            title="UMBmark in physics, slippery patch",
            description="Braking, turning and starting on a patch of friction 0.02 to 0.05.",
            floor=slippery_patch,
            metric="end_point_position",
            baseline=True,
        ),
    )


def on_robot(user_robot: OtherRobot) -> tuple[Task, ...]:
    """Return the physics tasks on another robot."""
    return tuple(user_robot.of(task, missing=cannot_roll_square(user_robot.robot.as_built())) for task in tasks(None))
