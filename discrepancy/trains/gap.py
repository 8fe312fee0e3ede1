"""The gap between a train's localisation and the reference."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, inverse
from castor_envs.vehicles.train import TrainDescription
from discrepancy.trains.evidence import FittedStates, fit_states
from discrepancy.trains.motion import Motion
from discrepancy.trains.rows import TrainLog

HORIZON = 5.0
"""s of localisation by wheel counts alone before the train is reset to its fitted pose."""


def localised_off(train: TrainDescription, logs: Sequence[TrainLog], state: FittedStates) -> tuple[float, float] | None:
    """Return the error of the train's localisation by counts and relative poses within `HORIZON` against the reference,
    m and rad (rms); None without a reference, or where there is no solution.

    state: the fitted motions of the train with its effects.
    """
    built, poses = train.as_built(), [np.zeros((0, 3))]
    try:
        blind = fit_states(train, [log.without_reference() for log in logs], state, state.sizes)
    except InputError:
        return None
    for log, motion, localised in zip(logs, state.motions, blind.motions, strict=True):
        if len(log.at):
            moved = replace(motion, pose=_carried(localised.pose, motion, log.t))
            left = log.residuals(built, moved)
            poses.append(np.concatenate([left["position"], left["heading"][..., None]], axis=-1).reshape(-1, 3))
    pose = np.concatenate(poses)
    return (_rms(pose[:, :2]), _rms(pose[:, 2:])) if len(pose) else None


def _carried(odometry: Array, motion: Motion, t: Array) -> Array:
    """Return poses (K, N, 3) by odometry (K, N, 3) alone, reset to the motion every `HORIZON`."""
    start = np.searchsorted(t, np.floor(t / HORIZON) * HORIZON - 1e-9)
    return compose(compose(motion.pose[start], inverse(odometry[start])), odometry)


def _rms(values: Array) -> float:
    """Return the rms of the lengths of rows (n, d); 0 without rows."""
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1)))) if len(values) else 0.0
