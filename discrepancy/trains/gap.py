"""How far a train's model is off what was measured: relative poses, and the axles' poses if there is a reference."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, inverse, relative_pose
from castor_envs.vehicles.train import TrainDescription
from discrepancy.trains.evidence import Settled, settled
from discrepancy.trains.motion import Motion
from discrepancy.trains.rows import TrainLog

HORIZON = 5.0
"""s for which wheel counts alone carry the train on, before it is put again where it was."""

MEAN = 1.0
"""s over which the difference of relative poses is averaged, as their readings are noisy."""


@dataclass(frozen=True)
class Gap:
    """What wheel counts, with the creep that a train's contacts say, get wrong within `HORIZON` (rms).

    posture_position, posture_heading: of the relative poses as sensors should read them, m and rad, averaged over
    `MEAN`. position, heading: of the axles against the reference; None without one.
    """

    posture_position: float
    posture_heading: float
    position: float | None
    heading: float | None


def gap_of(train: TrainDescription, logs: Sequence[TrainLog], state: Settled) -> Gap:
    """Return the gap of a train with its effects on logs, from the motions that go with them."""
    built = train.as_built()
    sensors, poses = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for log, motion in zip(logs, state.motions, strict=True):
        slip = log.creep(built, motion, log.ends(built, motion.relative), np.zeros_like(motion.pull))
        carried = _carried(log.start(built, slip).pose, motion, log.t)
        relative = relative_pose(carried[:, 1:], carried[:, :-1])
        moved = replace(motion, pose=carried)
        left = log.residuals(built, moved, log.ends(built, relative))
        block = np.floor(log.t / MEAN).astype(int)
        for f in range(log.f):
            own = log.read[:, f]
            counts = np.bincount(block[own])
            sums = [np.bincount(block[own], left[f"gauges{f}"][own, j]) for j in range(3)]
            sensors.append(np.stack(sums, axis=1)[counts > 0] / counts[counts > 0, None])
        if len(log.at):
            both = np.concatenate([left["position"], left["heading"][..., None]], axis=-1)
            poses.append(both.reshape(-1, 3))
    posture, pose = np.concatenate(sensors), np.concatenate(poses)
    none = len(pose) == 0
    return Gap(
        _rms(posture[:, :2]),
        _rms(posture[:, 2:]),
        None if none else _rms(pose[:, :2]),
        None if none else _rms(pose[:, 2:]),
    )


def localised_off(train: TrainDescription, logs: Sequence[TrainLog], state: Settled) -> tuple[float, float] | None:
    """Return what the train's localisation by counts and relative poses gets wrong within `HORIZON` against the
    reference, m and rad (rms); None without one, or where there is no solution.

    state: the motions that go with the train and its effects.
    """
    built, poses = train.as_built(), [np.zeros((0, 3))]
    try:
        blind = settled(train, [log.without_reference() for log in logs], state, state.sizes)
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
    """Return poses (K, N, 3) by odometry (K, N, 3) alone, put back where the motion was every `HORIZON`."""
    start = np.searchsorted(t, np.floor(t / HORIZON) * HORIZON - 1e-9)
    return compose(compose(motion.pose[start], inverse(odometry[start])), odometry)


def _rms(values: Array) -> float:
    """Return the rms of the lengths of rows (n, d); 0 of nothing."""
    return float(np.sqrt(np.mean(np.sum(values**2, axis=1)))) if len(values) else 0.0
