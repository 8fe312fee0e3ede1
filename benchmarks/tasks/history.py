"""Vogt and Minor's static tests with history: a train drives, then slips into the configuration of one of them.

From a snapshot of a static test (`benchmarks.tasks.static_tests`) nobody can tell for certain which axle odometry has
right. Here the train comes from a drive of 3 m with sound odometry. It ends where odometry has the train in that test,
all axles in line, and stands. Then the axles that odometry has wrong slip one after the other, from the front, within
`SLIPPING`: in tests 1 to 3 an axle is pushed to where it truly is while its wheels stand; in test 4 its wheels turn it,
drive it back and turn it, as counted, while it stands. Axles that slip in the same moment would be a snapshot again: in
test 3 one cannot tell, then, whether axles 1 and 3 slipped, or 2 and 3.

Assumptions, as in no paper: axles roll along one path, with slip as on clean floors (`SLIP`); frames are bent as beams;
sensors have their noise and constant offsets, the train file the errors that calibration leaves, as in
`benchmarks.tasks.trains`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.tasks.kinematic import CALIBRATED
from benchmarks.tasks.static_tests import ALIGNED, STATIC_TESTS, StaticTest
from benchmarks.tasks.task import Case, Episode, Run, Task
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, inverse, relative_pose
from castor_envs.logs.log import Log
from castor_envs.motion.paths import TrainPath, axles_behind
from castor_envs.sensors.posture import sensed
from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.train import TrainDescription
from estimators.likelihood.trains import bending

CASES = 20
SLIPPING, BETWEEN, AFTER = 0.25, 2.0, 6.0
"""s: how long an axle takes to slip, or for each of the three motions of its wheels; how long the train stands before
and after each axle; and at the end, longer than any estimator waits between corrections."""

SLIP = (1e-3, 1e-3)
"""Slip of axles that roll, along m and turn rad, after 1 m; it grows with the square root of the way."""


@dataclass(frozen=True)
class StaticTestsWithHistory:
    """The four static tests after a drive; case k is test 1 + k mod 4, with a path and noise of its own."""

    name: str = "configuration-history"
    title: str = "Configuration of a train, the paper's static tests after a drive"
    description: str = (
        "Vogt and Minor's tests 1 to 4, five times each: a train of three axles drives 3 m and stands; then the axles "
        "that odometry has wrong in the test slip one after the other. Scored 6 s later."
    )
    metric: str = "final_axle_position"
    version: int = 1
    group: str = "snapshots"
    standard: bool = True
    missing: None = None

    @property
    def robot(self) -> TrainDescription:
        """The train."""
        return cfmmr(3)

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the first n seeds."""
        return range(CASES if n is None else n)

    def record(self, case: Case) -> Episode:
        """Return the run of a case."""
        random, train = np.random.default_rng([int(case), 4]), self.robot
        described = replace(train, modules=tuple(CALIBRATED.applied(module, random) for module in train.modules))
        test = STATIC_TESTS[int(case) % len(STATIC_TESTS)]
        truth, rolled = _driven(train, random)
        for then, counted in _slipped(test, train.sample_period):
            truth, rolled = np.concatenate([truth, then]), np.concatenate([rolled, counted])
        return Episode(described, (Run(_log(train, truth, rolled, random)),))


def _driven(train: TrainDescription, random: np.random.Generator) -> tuple[Array, Array]:
    """Return a drive that ends in line: true poses (K, N, 3), and how odometry moved in each sample, (K, N, 2): along,
    m, and turn, rad."""
    curvature = random.choice([-1.0, 1.0]) * random.uniform(0.4, 1.2)
    path = TrainPath("to the test", ((0.4, 0.0), (0.8, curvature), (0.8, -curvature), (1.0, 0.0)))
    behind = axles_behind([frame.length for frame in train.frames])
    times = np.arange(0.0, path.duration + train.sample_period, train.sample_period)
    poses, _ = path.at(path.progress(times)[0][:, None] - behind)
    end, _ = path.at(np.array(path.length))
    truth = compose(compose(np.array(ALIGNED[0]), inverse(end)), poses)
    step = relative_pose(truth[:-1], truth[1:])
    turn = step[..., 2]
    way = step[..., 0] / np.sinc(turn / (2 * np.pi)) / np.cos(turn / 2)
    rolled = np.stack([way, turn], axis=-1)
    rolled += random.standard_normal(rolled.shape) * np.array(SLIP) * np.sqrt(np.abs(way))[..., None]
    return truth, np.concatenate([np.zeros((1, *rolled.shape[1:])), rolled])


def _slipped(test: StaticTest, period: float) -> list[tuple[Array, Array]]:
    """Return what follows the drive, as `_driven` returns it: the axles slip one by one, and the train stands."""
    samples, stands = round(SLIPPING / period), [round(BETWEEN / period), round(AFTER / period)]
    pose, parts = np.array(ALIGNED), [_standing(np.array(ALIGNED), stands[0])]
    for axle in range(len(pose)):
        to, motions = pose.copy(), _motions(np.array(ALIGNED)[axle], test.odometry[axle])
        to[axle] = test.truth[axle]
        if np.abs(to - pose).max() == 0.0 and not motions.any():
            continue
        share = np.linspace(0.0, 1.0, len(motions) * samples + 1)[1:, None, None]
        counted = np.zeros((len(share), len(pose), 2))
        counted[:, axle] = np.repeat(motions / samples, samples, axis=0)
        parts += [(pose + share * (to - pose), counted), _standing(to, stands[0])]
        pose = to
    return [*parts, _standing(pose, stands[1] - stands[0])]


def _standing(pose: Array, samples: int) -> tuple[Array, Array]:
    return np.tile(pose, (samples, 1, 1)), np.zeros((samples, len(pose), 2))


def _motions(start: Array, end: Array) -> Array:
    """Return how wheels take an axle from one pose (3,) to another: (M, 2), along and turn of each motion."""
    dx, dy, turn = end - start
    if not np.hypot(dx, dy) + abs(turn) > 0.0:
        return np.zeros((1, 2))
    towards = np.arctan(dy / dx) - start[2]
    along = np.copysign(np.hypot(dx, dy), dx)
    return np.array([[0.0, towards], [along, 0.0], [0.0, turn - towards]])


def _log(train: TrainDescription, truth: Array, rolled: Array, random: np.random.Generator) -> Log:
    """Return the log of true poses (K, N, 3) and what odometry did, (K, N, 2); its encoders and sensors are ideal but
    for rounding, noise and offsets."""
    t = train.sample_period * np.arange(len(truth))
    wheels = [module.castors[0].wheels for module in train.modules]
    radius, lateral = (
        np.array([[getattr(w, name) for w in pair] for pair in wheels]) for name in ("radius", "lateral")
    )
    counts_per_rev = np.array([[w.counts_per_rev or np.inf for w in pair] for pair in wheels])
    way = np.cumsum(rolled[..., :1] - lateral * rolled[..., 1:], axis=0)
    counts = way / radius * counts_per_rev / (2 * np.pi) + random.uniform(-0.5, 0.5, radius.shape)
    relative = relative_pose(truth[:, 1:], truth[:, :-1])
    readings = []
    for f, frame in enumerate(train.frames):
        share = np.array(frame.gauge_positions) / frame.length
        ends = bending.ends(frame, relative[:, f])
        curvature = ends[:, :1] * (1 - share) + ends[:, 1:] * share
        offsets = frame.gauge_offset * random.standard_normal(len(share))
        noise = frame.gauge_noise * random.standard_normal(curvature.shape)
        readings.append(sensed(frame, curvature, offsets + noise, t))
    return Log(
        t=t,
        wheel=np.round(counts).reshape(len(t), -1),
        pivot=np.empty((len(t), 0)),
        reference=truth.reshape(len(t), -1),
        rps=np.concatenate(readings, axis=-1),
    )


def tasks(measured: Path | None) -> tuple[Task, ...]:
    """Return the task; it needs no measured data."""
    return (StaticTestsWithHistory(),)
