"""Drives that a paper would report: long runs, manoeuvres, soft floors, slipping wheels, failing encoders, a gyro,
external fixes.

Each is driven by seven robots in physics. For every case a true robot is drawn within the tolerances that the robot
file states, pivots' places too, so that no estimator gains by knowing a preset's numbers. No drive ends where it
starts.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.tasks.driving.disturbances import faults_of, faulty, slip_bursts, soft_floor
from benchmarks.tasks.driving.drive import Drive, drive, joined, recorded
from benchmarks.tasks.driving.fixes import SENSOR, with_fixes
from benchmarks.tasks.driving.manoeuvres import laps, manoeuvres
from benchmarks.tasks.driving.oracle import followed
from benchmarks.tasks.task import Case, Episode, Run, Task
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.load import load_robot
from castor_envs.vehicles.robot import Fixes, Gyro, RobotDescription
from castor_envs.vehicles.tolerances import Tolerances

ROBOTS = {
    "prototype": "asoc-prototype",
    "full-scale": "asoc-full-scale",
    "powered-caster": "powered-caster",
    "swerve": "swerve",
    "tricycle": "tricycle",
    "omni": "omni3",
    "differential": "differential",
}
"""The robots by what tasks call them, and their presets."""

CALIBRATED = Tolerances(radius=4.6e-4, lateral=4.6e-4, offset=1e-3, pivot_zero=2e-4, pivot=3e-4)
DRAWINGS = Tolerances(radius=2.4e-2, lateral=1e-2, offset=2.5e-3, pivot_zero=2e-3, pivot=5e-4)
"""After and before calibration: Doebbler's Table I, whose mean absolute errors are taken as those of uniform
distributions; pivots as a chassis is welded and measured; zeros, which Table I has at 8 degrees before calibration, as
a jig sets them."""

GYRO_NOISE = 3.9e-4
"""rad/s a sample at 20 Hz: 0.007 deg/s/sqrt(Hz), the BMI160's data sheet."""
GYRO_BIAS, GYRO_DRIFT = 8.7e-3, 1e-4
"""rad/s, and rad/s in a root second: a bias of 0.5 deg/s, which no file tells, and its random walk, 0.04 deg/s in a
minute, as of a chip that warms up."""

MINUTE = 60.0
"""s, that drives take."""
WAY = 1000.0
"""m of a long run."""
PAYLOAD, PAYLOAD_SHRINKS = 0.5, (0.001, 0.004)
"""Of the robot's mass, that is loaded half-way of a long run; and the part by which wheels roll smaller under it."""
CARPETS, CARPET_SHRINKS = 8, (0.002, 0.01)
"""Carpets, and the part by which wheels roll smaller on them: 0.1 to 0.5 mm of a wheel of 50 mm."""
SILLS = 6
ARENA = 2.5
"""m, from the start, in which carpets and sills lie."""
RATES = (0.05, 0.02, 0.004)
"""s: sample periods of 20, 50 and 250 Hz, in turn from case to case."""
JITTER, LOST = 0.1, 0.02
"""Standard deviation of sampling, in sample periods, and the part of samples that are lost."""


@dataclass(frozen=True)
class Driven:
    """The true robot, the drive as it truly was, and as encoders read it, and the floor."""

    robot: RobotDescription
    true: Drive
    read: Drive
    floor: Floor = field(default_factory=Floor)


Recipe = Callable[[RobotDescription, np.random.Generator, int], Driven]
"""From a described robot, random numbers and the case."""


def _plain(robot: RobotDescription, random: np.random.Generator, case: int) -> Driven:
    built = robot.drawn(random)
    true = drive(built, robot, manoeuvres(robot, random, MINUTE), MINUTE, random)
    return Driven(built, true, true)


def _soft(robot: RobotDescription, random: np.random.Generator, case: int) -> Driven:
    built = robot.drawn(random)
    carpets = [
        Patch(
            center=(random.uniform(-ARENA, ARENA), random.uniform(-ARENA, ARENA)),
            size=(random.uniform(0.8, 2.0), random.uniform(0.8, 2.0)),
            friction=0.5,
            angle=random.uniform(0.0, np.pi),
        )
        for _ in range(CARPETS)
    ]
    sills = tuple(
        Cable(
            center=(random.uniform(-ARENA, ARENA), random.uniform(-ARENA, ARENA)),
            direction=random.uniform(0.0, np.pi),
            length=1.2,
            diameter=0.01,
        )
        for _ in range(SILLS)
    )
    floor = Floor(patches=tuple(carpets), cables=sills)
    true = drive(built, robot, manoeuvres(robot, random, MINUTE), MINUTE, random, floor=floor)
    read = soft_floor(built, true, carpets, list(random.uniform(*CARPET_SHRINKS, CARPETS)))
    return Driven(built, true, read, floor)


def _bursts(robot: RobotDescription, random: np.random.Generator, case: int) -> Driven:
    plain = _plain(robot, random, case)
    return dataclasses.replace(plain, read=slip_bursts(plain.robot, plain.true, random))


def _faults(robot: RobotDescription, random: np.random.Generator, case: int) -> Driven:
    plain, faults = _plain(robot, random, case), faults_of(robot)
    return dataclasses.replace(plain, read=faulty(plain.robot, plain.true, faults[case % len(faults)], random))


def _gyro(robot: RobotDescription, random: np.random.Generator, case: int) -> Driven:
    slipping = _bursts(robot, random, case)
    t = slipping.true.t
    walk = np.cumsum(GYRO_DRIFT * np.sqrt(np.diff(t, prepend=t[:1])) * random.standard_normal(len(t)))
    # Of the true robot alone: the file that estimators get (`Kind.gyro`) says nothing of the bias.
    bias = Gyro(noise=GYRO_NOISE, bias=float(np.clip(random.normal(0.0, GYRO_BIAS), -1.0, 1.0)))
    read = dataclasses.replace(slipping.read, yaw_rate=slipping.read.yaw_rate + walk)
    return dataclasses.replace(slipping, robot=dataclasses.replace(slipping.robot, gyro=bias), read=read)


def _sampled(robot: RobotDescription, random: np.random.Generator, case: int) -> Driven:
    period = RATES[case % len(RATES)]
    plain = _plain(dataclasses.replace(robot, sample_period=period), random, case)
    read = plain.true.at(sampled_times(plain.true.t, period, random))
    return Driven(plain.robot, read, read)


def sampled_times(t: Array, period: float, random: np.random.Generator) -> Array:
    """Return the times, s, at which samples are really taken that are due at t (K,): some are lost, others jitter."""
    kept = np.sort(random.permutation(len(t) - 1)[: round((1 - LOST) * (len(t) - 1))] + 1)
    early = np.clip(random.normal(0.0, JITTER, len(kept)), -0.4, 0.4) * period
    return np.concatenate([[0.0], np.minimum(t[kept] + early, t[-1])])


def _long(robot: RobotDescription, random: np.random.Generator, case: int) -> Driven:
    built = robot.drawn(random)
    shrinks = random.uniform(*PAYLOAD_SHRINKS)
    first = laps(random, WAY / 2)
    empty = drive(built, robot, first, first.duration, random)
    second = laps(random, WAY / 2)
    payload = dataclasses.replace(built, mass=built.mass * (1 + PAYLOAD), inertia=built.inertia * (1 + PAYLOAD))
    loaded = drive(payload, robot, second, second.duration, random, castor_angle=empty.castor[-1])
    true = joined([empty, loaded])
    turned = np.concatenate([empty.wheel, empty.wheel[-1] + loaded.wheel[1:] / (1.0 - shrinks)])
    return Driven(built, true, dataclasses.replace(true, wheel=turned))


@dataclass(frozen=True)
class Kind:
    """One kind of drive. tolerances, gyro and fixes: those that the robot file states. cases: how many are official."""

    name: str
    title: str
    description: str
    recipe: Recipe
    cases: int
    tolerances: Tolerances = CALIBRATED
    gyro: Gyro | None = None
    fixes: Fixes | None = None
    metric: str = "ate"


KINDS = (
    Kind(
        "manoeuvres",
        "Manoeuvres",
        "A minute of pivoting, driving sideways, figures of eight, random driving and hard accelerations, in random "
        "order; dimensions as after calibration.",
        _plain,
        cases=40,
    ),
    Kind(
        "drawings",
        "Manoeuvres, uncalibrated",
        "The same, with dimensions as on drawings: wheels are off by 2.4 %.",
        _plain,
        cases=40,
        tolerances=DRAWINGS,
    ),
    Kind(
        "floors",
        "Carpets and sills",
        "Manoeuvres over eight carpets, on which wheels roll smaller by 0.2 to 1 %, and over sills of 10 mm.",
        _soft,
        cases=40,
    ),
    Kind(
        "bursts",
        "Slip bursts",
        "Manoeuvres in which wheels drawn at random slip: six bursts of 3 to 50 % a minute, and one wheel by 5 % for "
        "8 s.",
        _bursts,
        cases=100,
    ),
    Kind(
        "faults",
        "Encoder faults",
        "Manoeuvres in which one encoder fails while driving: dead, frozen, noisy or late.",
        _faults,
        cases=100,
    ),
    Kind(
        "gyro",
        "Slip bursts, with a gyro",
        "Slip bursts, and a gyro with the noise of a data sheet and a bias that nobody tells and that drifts.",
        _gyro,
        cases=100,
        gyro=Gyro(noise=GYRO_NOISE),
    ),
    Kind(
        "fixes",
        "Slip bursts, with external fixes",
        "Slip bursts, and fixes of the pose as of markers: every 5 s, to 10 mm and 10 mrad, 0.1 to 0.5 s late; one of "
        "twenty is wrong.",
        _bursts,
        cases=100,
        fixes=SENSOR,
    ),
    Kind(
        "sampling",
        "Sampling",
        "Manoeuvres sampled at 20, 50 and 250 Hz, from case to case, with jitter that time stamps tell; one sample of "
        "fifty is lost.",
        _sampled,
        cases=42,
    ),
    Kind(
        "long",
        "Long runs",
        "1 km of laps in a warehouse; half-way, half of the robot's mass is loaded, and wheels roll smaller by 0.1 to "
        "0.4 %.",
        _long,
        cases=20,
        metric="drift",
    ),
)


@dataclass(frozen=True)
class DrivenRobot:
    """One robot in one kind of drive; every case is one true robot and one way. label: of `ROBOTS`."""

    kind: Kind
    label: str
    version: int = 1
    missing: None = None
    standard: bool = False  # all drives of all robots take hours

    @property
    def name(self) -> str:
        """The kind and the robot."""
        return f"{self.kind.name}-{self.label}"

    @property
    def title(self) -> str:
        """The kind's title and the robot."""
        return f"{self.kind.title}: {self.label}"

    @property
    def description(self) -> str:
        """That of the kind."""
        return self.kind.description

    @property
    def metric(self) -> str:
        """That of the kind."""
        return self.kind.metric

    @property
    def group(self) -> str:
        """The kind of drive."""
        return self.kind.name

    @property
    def robot(self) -> RobotDescription:
        """The robot as estimators get it."""
        kind = self.kind
        return dataclasses.replace(
            load_robot(ROBOTS[self.label]), tolerances=kind.tolerances, gyro=kind.gyro, fixes=kind.fixes
        )

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the first n seeds."""
        return range(self.kind.cases if n is None else n)

    def record(self, case: Case) -> Episode:
        """Return the run of a case."""
        random = np.random.default_rng([int(case), *self.name.encode()])
        driven = self.kind.recipe(self.robot, random, int(case))
        log = recorded(driven.robot, driven.read, random)
        undisturbed = recorded(driven.robot, driven.true, random)
        if self.kind.fixes is not None:
            log, right = with_fixes(log, random)
            undisturbed = dataclasses.replace(undisturbed, fix=right.fix, fix_age=right.fix_age)
        robot = dataclasses.replace(self.robot, sample_period=driven.robot.sample_period)
        run = Run(log, floor=driven.floor)
        ceiling = followed(driven.robot, undisturbed, run.start, run.samples)
        return Episode(robot, (dataclasses.replace(run, oracle=ceiling),))


def tasks(measured: Path | None) -> tuple[Task, ...]:
    """Return all kinds of drives by all robots; they need no measured data."""
    return tuple(DrivenRobot(kind, label) for kind in KINDS for label in ROBOTS)
