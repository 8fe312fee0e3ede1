"""Make docs/umbmark.png: a square driven over a slippery patch, and return errors of four estimators.

Run from the repository: ``.venv/bin/python scripts/pictures/make_picture.py``.
"""

from pathlib import Path

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np

from benchmarks.scoring.square_metrics import return_errors
from benchmarks.tasks import official_tasks, select_tasks
from castor_envs.floor import Cable, Floor, Patch
from estimators.robots.cast import CAST
from estimators.robots.dead_reckoning import DeadReckoning
from estimators.robots.ipec import IPEC

ESTIMATORS = {
    "one castor": (lambda: DeadReckoning(1), "#999999"),
    "IPEC-1": (lambda: IPEC(1), "#e69f00"),
    "CAST-1": (lambda: CAST(1), "#0072b2"),
    "CAST-0": (lambda: CAST(0), "#d55e00"),
}
SETS = 40


def drive():
    """Return a picture of the base after three sides, with its true and its estimated path."""
    cables = tuple(
        Cable(center=(0.5 + 0.12 * i, 0.266), direction=np.pi / 2, length=0.08, diameter=0.01) for i in range(4)
    )
    floor = Floor(patches=(Patch(center=(1.5, 0.3), size=(0.6, 0.6), friction=0.025),), cables=cables)
    env = gym.make("castor_envs:castor/UMBmark-v0", floor=floor, render_mode="rgb_array")
    observation, info = env.reset(seed=0)
    estimator = CAST()
    estimator.reset(env.unwrapped.robot, info["pose"])
    for _ in range(500):
        observation, _, _, _, info = env.step(estimator.update(observation))
    return env.render()


def errors(make, task):
    """Return the return errors (SETS, 2, 3), cw and ccw, of an estimator on calibrated robot files."""
    found = []
    for case in task.cases(SETS):
        episode = task.record(case)
        for run in (episode.runs[0], episode.runs[-1]):
            estimator = make()
            estimator.reset(episode.robot, run.log.reference[0])
            for observation in run.log.observations():
                pose = estimator.update(observation)
            found.append(return_errors(run.log.reference[0], run.log.reference[-1], pose))
    return np.reshape(found, (SETS, 2, 3))


def main():
    """Draw and save."""
    (task,) = select_tasks(official_tasks(), ["umbmark-kinematic-calibrated"])
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 6), dpi=100, layout="constrained")
    figure.get_layout_engine().set(h_pad=0.12)  # pyright: ignore
    left.imshow(drive())
    left.axis("off")
    left.set_title("castor/UMBmark-v0: cables, a slippery patch, CAST-0's estimate", fontsize=11)
    for name, (make, color) in ESTIMATORS.items():
        off = 1e3 * errors(make, task)
        for way, marker in ((0, "o"), (1, "^")):
            label = f"{name}, {'cw' if way == 0 else 'ccw'}"
            right.scatter(*off[:, way, :2].T, c=color, marker=marker, s=22, alpha=0.75, label=label, linewidths=0)
    right.axhline(0, color="#cccccc", zorder=0)
    right.axvline(0, color="#cccccc", zorder=0)
    right.set_xlim(-75, 75)
    right.set_ylim(-75, 105)
    right.set_aspect("equal")
    right.set_xlabel("return error x, mm")
    right.set_ylabel("return error y, mm")
    right.set_title(f"UMBmark, calibrated robot files, {SETS} parameter sets", fontsize=11)
    right.legend(fontsize=7, ncols=4, loc="upper center", columnspacing=0.8, handletextpad=0.1)
    figure.savefig(Path(__file__).parents[2] / "docs" / "umbmark.png")


if __name__ == "__main__":
    main()
