"""What a diagnosis costs, by the length of the log, the robot's castors and the number of logs."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.speed.figures import Effort
from benchmarks.speed.growth.curve import Cost, Curve, cost_of
from benchmarks.tasks.driving.drive import drive, recorded
from castor_envs.logs.csv import write_log
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset

ROBOT = "asoc-prototype"
LENGTHS = (30, 60, 120, 300, 900, 3600)
"""s of one log at 20 Hz."""
CASTORS = {1: "1-castor", 3: ROBOT, 6: "6-castor"}
LOGS, LENGTH = (1, 2, 4, 8), 60
"""Numbers of logs of so many s each; of other robots one log of that length."""


def curves(effort: Effort) -> Iterator[Curve]:
    """Yield the CPU time and the memory of `castor-diagnose`."""
    yield from _curves("length of the log, s", {length: diagnosed(ROBOT, length, 1) for length in LENGTHS})
    yield from _curves("castors", {n: diagnosed(robot, LENGTH, 1) for n, robot in CASTORS.items()})
    yield from _curves(f"logs of {LENGTH} s", {n: diagnosed(ROBOT, LENGTH, n) for n in LOGS})


def diagnosed(robot: str, length: float, logs: int) -> Cost:
    """Return what it takes to diagnose logs of random drives of a preset, each of a length, s."""
    described, random = preset(robot), np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        described.save(Path(folder) / "robot.json")
        for k in range(logs):
            driven = drive(described, described, wander(random, duration=length), length, random)
            write_log(Path(folder) / f"drive-{k:02d}.csv", recorded(described, driven, random), described)
        return cost_of(["-m", "discrepancy", "find", folder])


def _curves(over: str, costs: dict[int, Cost]) -> Iterator[Curve]:
    sizes = list(map(float, costs))
    yield Curve("diagnosis", over, "s", sizes, [cost.cpu for cost in costs.values()])
    yield Curve("diagnosis", over, "MB", sizes, [cost.memory for cost in costs.values()])
