"""Trains that drive: random paths in `castor/Configuration-v0`, on which one or two axles slip or roll over cables.

All axles follow one path, so what lies on it disturbs them all. The axles that are to be disturbed alone have a wider
track: patches and cables lie beside the lane of the others, under their wheels. Which axles are wider is drawn anew for
every case. The train files carry the errors that Doebbler's Table I says are left after calibration, as for the other
robots; the relative posture sensors those of `castor_envs.vehicles.presets`.
"""

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import numpy as np
from numpy.typing import ArrayLike

from benchmarks.tasks.ceilings.trains import followed_ideally
from benchmarks.tasks.kinematic import CALIBRATED
from benchmarks.tasks.task import Case, Episode, Run, Task
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.geometry.se2 import compose
from castor_envs.logs.log import Log
from castor_envs.logs.recorder import RecordLog
from castor_envs.motion.paths import TrainPath, random_path
from castor_envs.vehicles.presets import axle_module, cfmmr
from castor_envs.vehicles.train import TrainDescription

CASES = 20
WIDE = 0.22  # m, half track of the axles that are disturbed; the others have 0.16
LANE = 0.19  # m: distance from the path at which things on the floor begin
STRETCH = (0.5, 1.7)  # m along the path: where it lies

FloorOf = Callable[[TrainPath, np.random.Generator], Floor]


def slippery(path: TrainPath, random: np.random.Generator) -> Floor:
    """Return strips of friction 0.02 to 0.05 on both sides of the path, of squares small enough for its bends."""
    friction = random.uniform(0.02, 0.05)
    places = np.arange(STRETCH[0], STRETCH[1], 0.05)
    patches = [
        Patch(center=beside(pose, side * (LANE + 0.06)), size=(0.06, 0.12), friction=friction, angle=float(pose[2]))
        for pose in path.at(places)[0]
        for side in (1.0, -1.0)
    ]
    return Floor(patches=tuple(patches))


def cables(path: TrainPath, random: np.random.Generator) -> Floor:
    """Return twelve 10 mm cables under the wheels of one side, every 0.1 m, each shifted at random by up to 1 cm."""
    side = random.choice([-1.0, 1.0])
    places = np.linspace(*STRETCH, 12) + random.uniform(-0.01, 0.01, 12)
    laid = [
        Cable(
            center=beside(pose, side * (LANE + 0.06)), direction=float(pose[2] + np.pi / 2), length=0.12, diameter=0.01
        )
        for pose in path.at(places)[0]
    ]
    return Floor(cables=tuple(laid))


def beside(pose: ArrayLike, left: float) -> tuple[float, float]:
    """Return the point at a distance to the left of a pose (3,)."""
    x, y, _ = compose(pose, (0.0, left, 0.0))
    return float(x), float(y)


@dataclass(frozen=True)
class DrivenTrain:
    """A train on random paths; every case is one path, one floor and one train file."""

    name: str
    title: str
    description: str
    axles: int
    disturbed: int
    floor: FloorOf
    metric: str = "mean_axle_position"
    group: str = "trains"
    standard: bool = True
    version: int = 1
    missing: None = None

    @property
    def robot(self) -> TrainDescription:
        """The train that drives, described without errors."""
        return cfmmr(self.axles)

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the first n seeds."""
        return range(CASES if n is None else n)

    def record(self, case: Case) -> Episode:
        """Return the run of a case."""
        random = np.random.default_rng([int(case), 3, self.axles])
        wide = random.choice(self.axles, self.disturbed, replace=False)
        modules = [axle_module(WIDE) if i in wide else axle_module() for i in range(self.axles)]
        train = dataclasses.replace(self.robot, modules=tuple(modules))
        described = dataclasses.replace(train, modules=tuple(CALIBRATED.applied(module, random) for module in modules))
        path = random_path(random)
        floor = self.floor(path, random)
        log = drive(train, path, floor, seed=int(random.integers(2**31)))
        run = Run(log, floor=floor)
        assert log.reference is not None
        ceiling = followed_ideally(train, log.reference, run.samples)
        return Episode(described, (dataclasses.replace(run, oracle=ceiling),))


def drive(train: TrainDescription, path: TrainPath, floor: Floor, seed: int) -> Log:
    """Return the log of one drive in `castor/Configuration-v0`; the estimates it is given change nothing."""
    env = gym.make("castor_envs:castor/Configuration-v0", train=train, path=path, floor=floor)
    recorder = RecordLog(env)
    recorder.reset(seed=seed)
    finished = False
    while not finished:
        *_, finished, _, _ = recorder.step(np.zeros(3 * train.n_axles))
    recorder.close()
    return recorder.log()


def tasks(measured: Path | None) -> tuple[Task, ...]:
    """Return the tasks of driven trains; they need no measured data."""
    return tuple(
        DrivenTrain(
            name=f"train-{axles}-{kind}",
            title=f"A train of {axles} axles on random paths, {disturbed} of them {disturbance}",
            description=f"{disturbed} of {axles} axles, drawn anew for every case, {disturbance} for 1.2 m of a path "
            "of 5 to 6 m; train files as calibrated, relative posture sensors with their noise and offsets.",
            axles=axles,
            disturbed=disturbed,
            floor=floor,
        )
        for axles, disturbed in ((2, 1), (3, 1), (5, 2))
        for kind, floor, disturbance in (("patch", slippery, "on slippery strips"), ("cables", cables, "over cables"))
    )
