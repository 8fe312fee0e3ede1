"""Make docs/train-filter.png: estimate and truth before, while and after an axle of a train slips.

Run from the repository: ``python scripts/pictures/make_train_picture.py``.
"""

import warnings
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse
from scipy.stats import chi2

from benchmarks.tasks.trains import tasks
from estimators import RelativePoseWarning, TrainFilter, TrainOdometry

SEED = 900_008
MOMENTS = (4.0, 9.0, 14.0)  # s
HALF_WIDTH, SHOWN, NEAR = 0.11, 0.6, 0.025  # m: of an axle as drawn; of what is shown of a train, and of an axle
COLOURS = {"truth": "#222222", "train-filter": "#0072b2", "train-odometry": "#e69f00"}
PIXELS = 80


def followed():
    """Return the times (K,), and the poses (K, N, 3) by each name, and the filter's covariances (K, N, 3, 3)."""
    (task,) = (task for task in tasks(None) if task.name == "train-3-patch")
    episode = task.record(SEED)
    (run,) = episode.runs
    log = run.log
    assert log.reference is not None
    truth = log.reference.reshape(len(log), -1, 3)
    train: Any = episode.robot
    estimator, odometry = TrainFilter(), TrainOdometry()
    found = {"train-filter": [], "train-odometry": []}
    covariance = []
    for each in (estimator, odometry):
        each.reset(train, truth[0])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RelativePoseWarning)
        for seen in log.observations():
            found["train-filter"].append(estimator.update(seen))
            found["train-odometry"].append(odometry.update(seen))
            covariance.append(estimator.covariance)
    poses = {"truth": truth} | {name: np.array(rows) for name, rows in found.items()}
    return log.t, poses, np.array(covariance)


def draw(axes, poses, k):
    """Draw all axles of sample k as lines between their wheels."""
    for name, of in poses.items():
        x, y, psi = of[k].T
        across = HALF_WIDTH * np.array([-np.sin(psi), np.cos(psi)])
        style = {"color": COLOURS[name], "linewidth": 3.5 if name == "truth" else 1.6}
        for i in range(len(x)):
            ends = np.array([x[i], y[i]])[:, None] + across[:, i, None] * [-1.0, 1.0]
            axes.plot(*ends, **style, label=name if i == 0 else None)
        axes.plot(x, y, color=COLOURS[name], linewidth=0.8)
    show(axes, poses["truth"][k].mean(axis=0), SHOWN)


def draw_near(axes, poses, k, covariance, axle):
    """Draw where an axle is in sample k, in truth and as estimated, and the 95 % ellipse of the estimate."""
    for name in ("truth", "train-filter"):
        axes.plot(*poses[name][k, axle, :2], "o" if name == "truth" else "+", color=COLOURS[name], markersize=9)
    size, ways = np.linalg.eigh(covariance[k, axle, :2, :2])
    width, height = 2 * np.sqrt(size * chi2.ppf(0.95, 2))
    angle = np.degrees(np.arctan2(ways[1, 0], ways[0, 0]))
    place = poses["train-filter"][k, axle, :2]
    axes.add_patch(Ellipse(place, width, height, angle=angle, color=COLOURS["train-filter"], alpha=0.3))
    show(axes, poses["truth"][k, axle], NEAR)
    axes.ticklabel_format(useOffset=False)
    axes.locator_params(nbins=4)


def show(axes, around, far):
    """Show a square around a pose."""
    x, y, _ = around
    axes.set_aspect("equal")
    axes.set_xlim(x - far, x + far)
    axes.set_ylim(y - far, y + far)


def main():
    """Draw and save."""
    t, poses, covariance = followed()
    figure, panels = plt.subplots(2, len(MOMENTS), figsize=(9, 6.4), dpi=PIXELS, layout="constrained")
    off = poses["train-odometry"] - poses["truth"]
    slipped = int(np.argmax(np.hypot(off[-1, :, 0], off[-1, :, 1])))
    for (whole, near), moment in zip(panels.T, MOMENTS, strict=True):
        k = int(np.argmin(np.abs(t - moment)))
        draw(whole, poses, k)
        draw_near(near, poses, k, covariance, slipped)
        whole.set_title(f"after {moment:g} s")
        near.set_title(f"axle {slipped + 1}")
        near.set_xlabel("x, m")
    for axes in panels[:, 0]:
        axes.set_ylabel("y, m")
    panels[0, 0].legend(loc="best", fontsize="small")
    figure.savefig(Path(__file__).parents[2] / "docs" / "train-filter.png", metadata={"Software": None})


if __name__ == "__main__":
    main()
