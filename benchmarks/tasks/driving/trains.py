"""Drives of trains of 3, 5 and 10 axles: winding ways, slipping wheels, failing sensors, sampling, long runs.

For every case a true train is drawn within the tolerances that the train file states, and its gauges' offsets, which no
file tells. A driver takes it along random arcs that end far from their start.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.tasks.ceilings.trains import followed_ideally
from benchmarks.tasks.driving.disturbances import FAULT_LATENCY, failing, fails_when, slipping
from benchmarks.tasks.driving.task import CALIBRATED, RATES, sampled_times
from benchmarks.tasks.driving.train_drive import TrainDrive, drive_train, recorded_train
from benchmarks.tasks.task import Case, Episode, Run, Task
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.paths import TrainPath, random_path
from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.tolerances import Tolerances
from castor_envs.vehicles.train import TrainDescription

AXLES = (3, 5, 10)
TOLERANCES = Tolerances(radius=CALIBRATED.radius, lateral=CALIBRATED.lateral)
"""Of the axles, as of robots after calibration; an axle is the origin of its pose, so that it has no others."""

WAY, LONG_WAY = 15.0, 50.0
"""m: of a drive, a minute or two, and of a long run, three to six; train-filter takes 17 ms a sample for ten axles."""
SPEEDS = (0.15, 0.35)
"""m/s; CFMMR's papers drive at 0.25."""
STOPS = (1.0, 4.0)
"""m between two stops."""
AWAY = 2.0
"""m: no drive ends nearer to its start."""

TrainFault = Literal["dead wheel", "noisy wheel", "late wheel", "frozen posture", "dead posture", "late posture"]
FAULTS: tuple[TrainFault, ...] = (
    "dead wheel",
    "noisy wheel",
    "late wheel",
    "frozen posture",
    "dead posture",
    "late posture",
)


@dataclass(frozen=True)
class DrivenTrue:
    """The true train, the drive as it truly was, and the log that estimators get."""

    train: TrainDescription
    true: TrainDrive
    log: Log


Recipe = Callable[[TrainDescription, np.random.Generator, int], DrivenTrue]
"""From a described train, random numbers and the case."""


def winding(random: np.random.Generator, way: float) -> TrainPath:
    """Return random arcs of about `way` m, with stops, at a random speed; they end `AWAY` from the start or farther."""
    while True:
        path = random_path(random, longest=way)
        if np.hypot(*path.at(path.length)[0][:2]) > AWAY:
            break
    stops = np.cumsum(random.uniform(*STOPS, int(path.length / STOPS[0])))
    stops = tuple(stops[stops < path.length - STOPS[0]].tolist())
    return dataclasses.replace(path, speed=float(random.uniform(*SPEEDS)), stops=stops)


def drawn(train: TrainDescription, random: np.random.Generator) -> TrainDescription:
    """Return a train as it may truly be, made within the tolerances of its modules."""
    return dataclasses.replace(train, modules=tuple(module.drawn(random) for module in train.modules))


def sampled_every(train: TrainDescription, period: float) -> TrainDescription:
    """Return a train whose sensors are read, and wheels are commanded, every `period` s."""
    modules = tuple(dataclasses.replace(module, sample_period=period) for module in train.modules)
    return dataclasses.replace(train, modules=modules)


def _driven(train: TrainDescription, random: np.random.Generator, way: float) -> tuple[TrainDescription, TrainDrive]:
    built = drawn(train, random)
    return built, drive_train(built, train, winding(random, way), random)


def _plain(train: TrainDescription, random: np.random.Generator, case: int) -> DrivenTrue:
    built, true = _driven(train, random, WAY)
    return DrivenTrue(built, true, recorded_train(built, true, random))


def _long(train: TrainDescription, random: np.random.Generator, case: int) -> DrivenTrue:
    built, true = _driven(train, random, LONG_WAY)
    return DrivenTrue(built, true, recorded_train(built, true, random))


def _bursts(train: TrainDescription, random: np.random.Generator, case: int) -> DrivenTrue:
    built, true = _driven(train, random, WAY)
    wheel = slipping(true.t, true.wheel, range(2 * train.n_axles), random)
    return DrivenTrue(built, true, recorded_train(built, dataclasses.replace(true, wheel=wheel), random))


def _faults(train: TrainDescription, random: np.random.Generator, case: int) -> DrivenTrue:
    built, true = _driven(train, random, WAY)
    fault, failed = FAULTS[case % len(FAULTS)], fails_when(true.t, random)
    if fault.endswith("posture"):
        sound = DrivenTrue(built, true, recorded_train(built, true, random))
        return dataclasses.replace(sound, log=failing_posture(sound.log, fault, failed, random))
    number, wheel = int(random.integers(2 * train.n_axles)), true.wheel.copy()
    counts = built.modules[number // 2].wheels[number % 2].counts_per_rev
    wheel[:, number] = failing(fault.split()[0], true.t, wheel[:, number], failed, counts, random)
    return DrivenTrue(built, true, recorded_train(built, dataclasses.replace(true, wheel=wheel), random))


def failing_posture(log: Log, fault: TrainFault, failed: NDArray[np.bool_], random: np.random.Generator) -> Log:
    """Return a log in which one relative posture sensor has failed in rows (K,).

    A frozen one gives its last reading on as if it were new, a dead one none, a late one readings as old as
    `FAULT_LATENCY`, which their age does not tell.
    """
    assert log.rps is not None
    rps = log.rps.reshape(len(log), -1, 3).copy()
    of: Array = rps[:, random.integers(rps.shape[1])]  # a view
    match fault:
        case "frozen posture":
            of[failed] = of[~failed][-1]
        case "dead posture":
            of[failed] = np.nan
        case _:
            then = np.searchsorted(log.t, log.t - random.uniform(*FAULT_LATENCY))
            of[failed] = of[then][failed]
    return dataclasses.replace(log, rps=rps.reshape(len(log), -1))


def _sampled(train: TrainDescription, random: np.random.Generator, case: int) -> DrivenTrue:
    period = RATES[case % len(RATES)]
    built, true = _driven(sampled_every(train, period), random, WAY)
    read = true.at(sampled_times(true.t, period, random))
    return DrivenTrue(built, read, recorded_train(built, read, random))


@dataclass(frozen=True)
class TrainKind:
    """One kind of drive. name: also of the group, that of the same kind of robots' drives. cases: the official ones."""

    name: str
    title: str
    description: str
    recipe: Recipe
    cases: int


KINDS = (
    TrainKind(
        "manoeuvres",
        "Winding ways",
        "15 m of random arcs at 0.15 to 0.35 m/s, with a stop every 1 to 4 m; dimensions as after calibration.",
        _plain,
        cases=40,
    ),
    TrainKind(
        "bursts",
        "Slip bursts",
        "The same, and wheels drawn at random slip: six bursts of 3 to 50 % a minute, and one wheel by 5 % for 8 s.",
        _bursts,
        cases=100,
    ),
    TrainKind(
        "faults",
        "Sensor faults",
        "The same, and one sensor fails while driving: a wheel's encoder is dead, noisy or late, or a relative posture "
        "sensor is frozen, dead or late.",
        _faults,
        cases=100,
    ),
    TrainKind(
        "sampling",
        "Sampling",
        "The same, sampled at 20, 50 and 250 Hz, from case to case, with jitter that time stamps tell; one sample of "
        "fifty is lost.",
        _sampled,
        cases=42,
    ),
    TrainKind("long", "Long runs", "50 m of random arcs with a stop every 1 to 4 m.", _long, cases=20),
)


@dataclass(frozen=True)
class DrivenTrain:
    """A train of some axles in one kind of drive; every case is one true train and one way."""

    kind: TrainKind
    axles: int
    version: int = 2  # in 1 the oracle was train-filter, told the true train
    missing: None = None
    metric: str = "mean_axle_position"
    standard: bool = False  # as the drives of robots: all together take hours

    @property
    def name(self) -> str:
        """The kind and the train."""
        return f"{self.kind.name}-train-{self.axles}"

    @property
    def title(self) -> str:
        """The kind's title and the train."""
        return f"{self.kind.title}: a train of {self.axles} axles"

    @property
    def description(self) -> str:
        """That of the kind."""
        return self.kind.description

    @property
    def group(self) -> str:
        """The kind of drive."""
        return self.kind.name

    @property
    def robot(self) -> TrainDescription:
        """The train as estimators get it."""
        train = cfmmr(self.axles)
        modules = tuple(dataclasses.replace(module, tolerances=TOLERANCES) for module in train.modules)
        return dataclasses.replace(train, modules=modules)

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the first n seeds."""
        return range(self.kind.cases if n is None else n)

    def record(self, case: Case) -> Episode:
        """Return the run of a case."""
        random = np.random.default_rng([int(case), *self.name.encode()])
        driven = self.kind.recipe(self.robot, random, int(case))
        run = Run(driven.log)
        ceiling = followed_ideally(driven.train, driven.true.pose, run.samples)
        train = sampled_every(self.robot, driven.train.sample_period)
        return Episode(train, (dataclasses.replace(run, oracle=ceiling),))


def tasks(measured: Path | None) -> tuple[Task, ...]:
    """Return all kinds of drives by all trains; they need no measured data."""
    return tuple(DrivenTrain(kind, axles) for kind in KINDS for axles in AXLES)
