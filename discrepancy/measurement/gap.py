"""The gap between odometry and reference, given the most likely states of logs."""

from collections.abc import Sequence

import numpy as np

from castor_envs.motion.kinematics import Geometry
from estimators.calibration.maximum_likelihood import State
from estimators.likelihood.log_likelihood import LogLikelihood


def gap_of(models: Sequence[LogLikelihood], geometry: Geometry, at: State) -> tuple[float, float] | None:
    """Return the rms difference between odometry and reference, m and rad; None without a reference."""
    tracked = [log_fit for log_fit in zip(models, at.states, at.clocks, strict=True) if log_fit[0].poses]
    if not tracked:
        return None
    off = np.concatenate([model.errors(geometry, state, clock, at.mount) for model, state, clock in tracked])
    return float(np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1)))), float(np.sqrt(np.mean(off[:, 2] ** 2)))
