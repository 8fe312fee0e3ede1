"""All metrics (those that a module of this folder offers as ``METRICS``), and the scores that they give."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.scoring.metric import Judged, Metric
from benchmarks.tasks.task import Episode
from castor_envs.discovery import offers
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription


def _found() -> list[Metric]:
    """Return all metrics by their place; raises ValueError for two metrics with the same name or key."""
    found = sorted((m for metrics in offers("benchmarks.scoring", "METRICS") for m in metrics), key=lambda m: m.place)
    for names in ([metric.name for metric in found], [metric.key for metric in found]):
        if len(set(names)) < len(names):
            raise ValueError(f"two metrics share a name or key: {', '.join(sorted(names))}")
    return found


_ALL = _found()

BOARD_METRICS: dict[str, Metric] = {metric.name: metric for metric in _ALL if metric.on_boards}
"""The metrics that boards show, by name."""


def score(
    episode: Episode,
    estimates: Sequence[Array],
    calibrated: RobotDescription | None = None,
    covariances: Sequence[Array | None] = (),
    stated: Sequence[NDArray[np.bool_] | None] = (),
) -> dict[str, float]:
    """Return the scores of an estimator in an episode, in SI, by the names of metrics; what does not apply is left out.

    estimates: for each run, the estimated poses (M, 3) at `Run.samples`, of a train (N, M, 3). calibrated: the robot as
    a calibration method returned it, which is scored too where the true one is known. covariances and stated: for each
    run, what the estimator said beside (see `Judged`); () where it is not known. Raises ValueError for estimates of
    another shape than the truth.
    """
    judged = Judged(episode, estimates, calibrated, covariances, stated)
    values = ((metric.name, metric.value(judged)) for metric in _ALL)
    return {name: value for name, value in values if value is not None}
