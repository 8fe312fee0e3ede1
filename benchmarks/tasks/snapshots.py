"""Snapshots of trains: from axle poses that odometry got partly wrong and relative poses, find the configuration.

Vogt and Minor's static tests (section IV), and random ones around them. A snapshot is a log of two rows: nothing moves,
the relative posture sensors say the same in both. Estimators start at the belief, see the first row, may correct at the
second, 10 s later (longer than any of their correction intervals), and are scored there. Numbers that the paper does
not give are assumptions: how far odometry and sensors are off (it says 1 to 3 cm for the sensors), how far a deviant
axle is.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.tasks.ceilings.trains import best_configuration
from benchmarks.tasks.static_tests import STATIC_TESTS
from benchmarks.tasks.task import Case, Episode, Run, Task
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, inverse
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import FRAME_LENGTH, cfmmr
from castor_envs.vehicles.train import TrainDescription

CASES = 20
RUNS = 25
TIMES = (0.0, 10.0)  # s

AGREES = (0.02, np.radians(2.0))
"""m, rad: in the static tests an axle is sound if odometry puts it no farther than this from the truth."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of white noise on poses: along each of x and y, m, and of the heading, rad."""

    position: float
    heading: float

    def draw(self, random: np.random.Generator, *shape: int) -> Array:
        """Return errors of poses, (*shape, 3)."""
        return random.standard_normal((*shape, 3)) * [self.position, self.position, self.heading]

    def covariance(self, axles: int) -> Array:
        """Return the covariance (N, 3, 3) of the poses of so many axles."""
        return np.tile(np.diag([self.position, self.position, self.heading]) ** 2, (axles, 1, 1))


ODOMETRY = Noise(0.01, np.radians(1.0))
"""Of odometry, as belief_covariance tells estimators: that of axles that have not slipped, which nobody knows."""


@dataclass(frozen=True)
class StaticTests:
    """The four static tests of the paper; every case is one, and its single run is the snapshot."""

    name: str = "configuration-static"
    title: str = "Configuration of a train, the paper's static tests"
    description: str = (
        "Vogt and Minor's tests 1 to 4 on three axles: odometry and relative poses contradict each other, and one axle "
        "or more is where odometry says. The truth is the relative poses attached to the true axle, as in the paper. "
        "Sound is every axle that odometry has within 2 cm and 2 deg of the truth."
    )
    metric: str = "mean_axle_position"
    group: str = "snapshots"
    standard: bool = True
    version: int = 1
    missing: None = None

    @property
    def robot(self) -> TrainDescription:
        """The train."""
        return cfmmr(3)

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the names of the first n tests."""
        return [f"test-{test.number}" for test in STATIC_TESTS][:n]

    def record(self, case: Case) -> Episode:
        """Return a test's snapshot."""
        (test,) = (test for test in STATIC_TESTS if case == f"test-{test.number}")
        truth = configuration(test.relative, test.odometry[test.true_axle - 1], test.true_axle)
        off = np.abs(test.odometry - truth)
        agrees = (np.hypot(off[:, 0], off[:, 1]) <= AGREES[0]) & (off[:, 2] <= AGREES[1])
        sound = tuple(int(axle) + 1 for axle in np.flatnonzero(agrees))
        return Episode(self.robot, (snapshot(truth, test.odometry, test.relative, sound, ODOMETRY),))


@dataclass(frozen=True)
class DeviantAxles:
    """Bent at random, with some axles that odometry has far off; every case is RUNS such snapshots.

    The train stands anywhere; each frame is bent evenly by up to 60 deg. Odometry has noise on every axle, and on the
    deviant axles, drawn anew for every run, larger errors: a distance in any direction and a turn, both uniform.
    distance: from, to, m. turn: up to, rad, either way.
    """

    name: str
    title: str
    description: str
    axles: int
    deviant: int
    distance: tuple[float, float]
    turn: float
    stream: int
    odometry: Noise = ODOMETRY
    sensors: Noise = Noise(0.02, np.radians(2.0))
    metric: str = "mean_axle_position"
    group: str = "snapshots"
    standard: bool = True
    version: int = 1
    missing: None = None

    @property
    def robot(self) -> TrainDescription:
        """The train."""
        return cfmmr(self.axles)

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the first n seeds."""
        return range(CASES if n is None else n)

    def record(self, case: Case) -> Episode:
        """Return the snapshots of a case."""
        random = np.random.default_rng([int(case), self.stream])
        return Episode(self.robot, tuple(self._run(random) for _ in range(RUNS)))

    def _run(self, random: np.random.Generator) -> Run:
        relative = bent_evenly(random.uniform(-np.pi / 3, np.pi / 3, self.axles - 1))
        rear = random.uniform([-2.0, -2.0, -np.pi], [2.0, 2.0, np.pi])
        truth = configuration(relative, rear, self.axles)
        belief = truth + self.odometry.draw(random, self.axles)
        deviant = random.choice(self.axles, self.deviant, replace=False)
        distance, direction = random.uniform(*self.distance, self.deviant), random.uniform(-np.pi, np.pi, self.deviant)
        turn = random.uniform(-self.turn, self.turn, self.deviant)
        belief[deviant] += np.stack([distance * np.cos(direction), distance * np.sin(direction), turn], axis=-1)
        sound = tuple(axle for axle in range(1, self.axles + 1) if axle - 1 not in deviant)
        return snapshot(truth, belief, relative + self.sensors.draw(random, self.axles - 1), sound, self.odometry)


@dataclass(frozen=True)
class OppositeBends:
    """The paper's static test 3 with the front frame bent less or more than there; every case is another ratio.

    Odometry has the three axles in a straight line. Truly frame B is bent by 60.8 deg to one side and frame A by a
    part of that, the ratio, to the other; axle 2 is where odometry says. Every run draws new, small noise.
    """

    name: str
    title: str
    description: str
    ratios: tuple[float, float] = (0.40, 0.95)
    stream: int = 3
    odometry: Noise = Noise(0.002, np.radians(0.2))
    sensors: Noise = Noise(0.005, np.radians(0.5))
    metric: str = "mean_axle_position"
    group: str = "snapshots"
    standard: bool = True
    version: int = 1
    missing: None = None

    @property
    def robot(self) -> TrainDescription:
        """The train."""
        return cfmmr(3)

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the first n cases; the ratios are swept over the official number, then anew with other noise."""
        return range(CASES if n is None else n)

    def ratio(self, case: Case) -> float:
        """Return frame A's bend as a part of frame B's."""
        return float(np.linspace(*self.ratios, CASES)[int(case) % CASES])

    def record(self, case: Case) -> Episode:
        """Return the snapshots of a case."""
        random = np.random.default_rng([int(case), self.stream])
        relative = bent_evenly(np.radians(60.8) * np.array([self.ratio(case), -1.0]))
        aligned = configuration(bent_evenly([0.0, 0.0]), np.zeros(3), 3)
        truth = configuration(relative, aligned[1], 2)
        return Episode(
            self.robot,
            tuple(
                snapshot(
                    truth,
                    aligned + self.odometry.draw(random, 3),
                    relative + self.sensors.draw(random, 2),
                    sound=(2,),
                    odometry=self.odometry,
                )
                for _ in range(RUNS)
            ),
        )


def bent_evenly(angles: ArrayLike) -> Array:
    """Return the relative poses (F, 3) of frames bent to arcs of constant curvature by angles (F,), rad."""
    angle = np.asarray(angles, dtype=float)
    half = angle / 2
    chord = FRAME_LENGTH * np.sinc(half / np.pi)
    return np.stack([chord * np.cos(half), chord * np.sin(half), angle], axis=-1)


def configuration(relative: Array, pose: Array, axle: int) -> Array:
    """Return the poses (N, 3) of all axles: those of relative poses (N - 1, 3), with axle number `axle` at `pose`."""
    poses = [pose]
    for seen in relative[: axle - 1][::-1]:
        poses.insert(0, compose(poses[0], seen))
    for seen in relative[axle - 1 :]:
        poses.append(compose(poses[-1], inverse(seen)))
    return np.array(poses)


def snapshot(truth: Array, belief: Array, relative: Array, sound: tuple[int, ...], odometry: Noise) -> Run:
    """Return a run of two rows in which nothing moves; truth, belief (N, 3) in N, relative (N - 1, 3).

    odometry: how exact the belief of sound axles is.
    """
    rows = len(TIMES)
    log = Log(
        t=np.array(TIMES),
        wheel=np.zeros((rows, 2 * len(truth))),
        pivot=np.empty((rows, 0)),
        reference=np.tile(truth.ravel(), (rows, 1)),
        rps=np.tile(relative.ravel(), (rows, 1)),
    )
    ceiling = best_configuration(belief, relative, sound)
    covariance = odometry.covariance(len(truth))
    return Run(log, belief=belief, belief_covariance=covariance, sound=sound, oracle=ceiling[:, None])


def tasks(measured: Path | None) -> tuple[Task, ...]:
    """Return the snapshots; they need no measured data."""
    return (
        StaticTests(),
        DeviantAxles(
            name="configuration-one-of-three",
            title="Configuration of a train, one of three axles deviant",
            description="Odometry has an axle of three 10 to 40 cm off and turned by up to 60 deg; noise on all.",
            axles=3,
            deviant=1,
            distance=(0.10, 0.40),
            turn=np.radians(60.0),
            stream=0,
        ),
        DeviantAxles(
            name="configuration-two-of-five",
            title="Configuration of a train, two of five axles deviant",
            description="The same with two deviant axles of five: the sound ones are still more.",
            axles=5,
            deviant=2,
            distance=(0.10, 0.40),
            turn=np.radians(60.0),
            stream=1,
        ),
        DeviantAxles(
            name="configuration-small",
            title="Configuration of a train, small deviations",
            description="One axle of three is 3 to 8 cm off and turned by up to 10 deg: hardly more than the noise.",
            axles=3,
            deviant=1,
            distance=(0.03, 0.08),
            turn=np.radians(10.0),
            stream=2,
        ),
        OppositeBends(
            name="configuration-opposite-bends",
            title="Configuration of a train, bent to opposite sides",
            description=(
                "The paper's test 3, the bend of frame A swept from 0.40 to 0.95 of frame B's: axle 2 alone is sound, "
                "and theta_xy ties between axles 1 and 2 at two thirds."
            ),
        ),
    )
