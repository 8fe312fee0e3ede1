"""The nonholonomic driver of a train: every module follows the path, the rear ones with an eye on the axle ahead."""

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.kinematics import Geometry
from castor_envs.geometry.kinematics import inverse as wheel_motion
from castor_envs.geometry.se2 import compose, inverse, relative_pose
from castor_envs.motion.paths import TrainPath, axles_behind
from castor_envs.vehicles.train import TrainDescription

# Gains on the errors along (1/s), across (1/m2) and in heading (1/m): critically damped, within a third of a metre.
ALONG, ACROSS, TURN = 1.0, 9.0, 6.0


class TrainDriver:
    """Commands wheel rates that take a train along a path. It knows time and the relative posture sensors alone.

    The front axle is driven by the path (open loop in the pose, as `KinematicController`). Every other axle is driven
    by the path as well, and corrects its place behind the axle ahead by the sensor between them: the posture tracking
    law of Kanayama et al. (1990), whose reference is where the axle should stand as seen from where it is. The train
    starts on its path, so what a sensor reads first tells its zero: an offset of 4 degrees, followed, would set the
    axles against each other. A reading that is missing or older than a sample period is not followed.
    """

    def __init__(self, train: TrainDescription, path: TrainPath) -> None:
        self._train, self._path = train, path
        self._behind = axles_behind([frame.length for frame in train.frames])
        self._geometry = [Geometry.of(module) for module in train.modules]
        self._zero = np.full((len(train.frames), 3), np.nan)

    def twists(self, time: float, rps: ArrayLike, age: ArrayLike) -> Array:
        """Return the axles' twists (N, 3) wanted in the sample period that begins at `time` (s).

        rps (F, 3) or (3F,): relative poses as measured now; age (F,): s.
        """
        period, run, path = self._train.sample_period, self._path.run, self._path
        covered, _ = run.progress(np.array([time, time + period]))
        place, after = (path.at(length - self._behind)[0] for length in covered)
        v = np.full(len(place), (covered[1] - covered[0]) / period)
        turning = (after[:, 2] - place[:, 2]) / period
        wanted = relative_pose(place[1:], place[:-1])
        measured = np.reshape(np.asarray(rps, dtype=float), (-1, 3))
        sound = np.isfinite(measured).all(axis=-1) & (np.asarray(age) <= 1.5 * period)
        first = sound & np.isnan(self._zero[:, 0])
        self._zero[first] = (measured - wanted)[first]
        seen = np.where(sound[:, None], measured - self._zero, wanted)
        error = np.where(sound[:, None], compose(seen, inverse(wanted)), 0.0)
        speed = v[1:].copy()
        v[1:] += ALONG * error[:, 0] * (speed > 0)
        turning[1:] += speed * (ACROSS * error[:, 1] + TURN * np.sin(error[:, 2]))
        return np.stack([v, np.zeros_like(v), turning], axis=-1)

    def commands(self, time: float, rps: ArrayLike, age: ArrayLike) -> Array:
        """Return wheel rates (2N,), rad/s, for the sample period that begins at `time`; arguments as for `twists`."""
        twists = self.twists(time, rps, age)
        rates = [
            wheel_motion(geometry, geometry.angle, np.zeros(1), twist).rate
            for geometry, twist in zip(self._geometry, twists, strict=True)
        ]
        return np.concatenate(rates)
