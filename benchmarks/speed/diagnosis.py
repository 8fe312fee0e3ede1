"""What a diagnosis costs for a second of log, by the log's length."""

import tempfile
from collections.abc import Iterator
from pathlib import Path

import gymnasium as gym

import castor_envs  # noqa: F401  (registers the environments)
from benchmarks.speed.figures import Effort, Figure, Group, process_cpu
from castor_envs.logs.recorder import RecordLog

ROBOT = "asoc-prototype"


def figures(effort: Effort) -> Iterator[Figure]:
    """Yield the CPU time of `castor-diagnose` on a drive of each length, divided by the length."""
    for side in effort.sides:
        with tempfile.TemporaryDirectory() as folder:
            length = _recorded(Path(folder), side)
            spent = process_cpu(["-m", "discrepancy", "find", folder], 1)
        yield Figure(f"diagnosis of {ROBOT}, a second of a log of {length:.0f} s", spent / length, "s")


def _recorded(folder: Path, side: float) -> float:
    """Write the log of a square; return how long it took, s."""
    env = RecordLog(gym.make("castor/UMBmark-v0", robot=ROBOT, side=side), folder)
    observation, info = env.reset(seed=0)
    done = False
    while not done:
        observation, _, done, _, info = env.step(info["pose"])
    env.close()
    return float(observation["time"][0])


GROUP = Group("Diagnosis", figures)
