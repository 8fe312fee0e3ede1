"""Reading a train's relative posture sensors (RPS): which readings can be used, and warnings about the others."""

import warnings

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.train import TrainDescription
from estimators.protocol import Observation

MAX_AGE = 0.5
"""s: an older reading is not used. A train at 0.5 m/s bends over a quarter of a metre in that time."""


FARTHEST = 10.0
"""Frame lengths: a reading that puts the front axle farther away than this is impossible, and not used."""


class RelativePoseWarning(UserWarning):
    """A frame gives no usable relative pose; the estimator goes on by odometry."""


class RelativePoses:
    """The relative poses of a train's frames, sample by sample.

    status: which frame's reading cannot be used now, and why; None while all can. usable (F,): which frames' can.
    """

    def __init__(self, train: TrainDescription) -> None:
        self.status: str | None = None
        self._names = train.frame_names
        self.usable = np.zeros(len(self._names), dtype=bool)
        self._lengths = np.array([frame.length for frame in train.frames])
        self._said: set[tuple[int, str]] = set()

    def read(self, observation: Observation) -> Array | None:
        """Return the relative poses (F, 3), front axle in the rear axle's frame; None if any cannot be used.

        A reading is usable if it is finite, possible (`FARTHEST`) and at most `MAX_AGE` old. Warns once for each frame
        and cause. Raises InputError where `rps` or `rps_age` is missing or of the wrong size, or an age is below 0.
        """
        n = len(self._names)
        relative = entry(observation, "rps", 3 * n, f"3 for each of {n} frames").reshape(n, 3)
        age = entry(observation, "rps_age", n, "one for each frame")
        if np.any(age < 0):
            raise InputError(f"the observation's 'rps_age' is {age}; a reading is of now or earlier, never below 0 s")
        finite = np.isfinite(relative).all(axis=-1)
        x, y = np.where(finite, relative.T[:2], 0.0)
        far = np.asarray(np.hypot(x, y) > FARTHEST * self._lengths)
        bad = far | ~finite
        old = np.logical_not(age <= MAX_AGE)
        self.status, self.usable = None, ~(bad | old)
        for frame in np.flatnonzero(bad | old).tolist():
            cause = "an impossible reading" if far[frame] else "no reading" if bad[frame] else "an old reading"
            how_old = "" if bad[frame] else f", of {age[frame]:.6g} s ago (at most {MAX_AGE:g} s are used)"
            text = f"frame {self._names[frame]} has {cause}{how_old}"
            self.status = self.status or f"{text}; odometry alone until it is back"
            if (frame, cause) not in self._said:
                self._said.add((frame, cause))
                warnings.warn(f"{text}; odometry alone until it is back", RelativePoseWarning, stacklevel=4)
        return relative if self.status is None else None


def entry(observation: Observation, key: str, size: int, layout: str) -> Array:
    """Return an array of the observation; raises InputError where it is missing or not of this size."""
    if key not in observation:
        raise InputError(f"the observation has no {key!r}, which an estimator of this train needs: {size} ({layout})")
    values = np.asarray(observation[key], dtype=float)
    if values.shape != (size,):
        raise InputError(f"the observation's {key!r} has shape {values.shape}; this train needs ({size},), {layout}")
    return values
