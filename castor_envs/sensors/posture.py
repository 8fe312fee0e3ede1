"""The relative posture sensor (RPS): from strain along a frame to the front axle's pose in the rear axle's frame.

Strain gauges measure the frame's curvature where they are glued. A polynomial is fitted to the readings and integrated
twice along the frame (Merrell and Minor 2003, Vogt and Minor's reference 3):

    phi(s) = int_0^s kappa        x = int_0^L cos phi        y = int_0^L sin phi
"""

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry.arrays import Array, vectors
from castor_envs.vehicles.train import Frame, TrainDescription

DEGREE = 2  # of the fitted polynomial: a shear force makes curvature linear, large bends add a little more
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


def posture(frame: Frame, curvature: ArrayLike) -> Array:
    """Return the front axle's pose (..., 3) in the rear axle's frame from curvature (..., gauges) at the gauges, 1/m.

    The fit is by least squares, of degree 2 or what the number of gauges allows.
    """
    fit, integrals, weights = _fit(frame.gauge_positions, frame.length)
    heading = np.asarray(curvature, dtype=float) @ fit @ integrals
    x, y = np.cos(heading[..., :-1]) @ weights, np.sin(heading[..., :-1]) @ weights
    return vectors(x, y, heading[..., -1])


@lru_cache
def _fit(gauge_positions: tuple[float, ...], length: float) -> tuple[Array, Array, Array]:
    """Return matrices from readings to coefficients, from these to headings at nodes and end; the nodes' weights, m."""
    s = np.array(gauge_positions) / length
    powers = np.arange(min(DEGREE, len(s) - 1) + 1)
    along = 0.5 * (1.0 + _NODES)
    integrals = length * np.append(along, 1.0)[:, None] ** (powers + 1) / (powers + 1)
    fit = np.linalg.pinv(s[:, None] ** powers).T.astype(float, copy=False)
    return fit, integrals.T, 0.5 * length * _WEIGHTS


def curvature_at_gauges(frame: Frame, joint_angles: ArrayLike) -> Array:
    """Return the true curvature (..., gauges), 1/m, where the gauges are, from the joints' angles (..., links).

    A joint's angle is the bend of its piece of the frame; between the middles of the pieces, and beyond the outer
    ones, curvature runs linearly, as in a beam that is loaded at its ends alone.
    """
    h = frame.length / frame.links
    curvature = np.asarray(joint_angles, dtype=float) / h
    place = np.array(frame.gauge_positions) / h - 0.5
    before = np.clip(np.floor(place).astype(int), 0, frame.links - 2)
    share = place - before
    return (1.0 - share) * curvature[..., before] + share * curvature[..., before + 1]


def sensed(frame: Frame, curvature: ArrayLike, errors: ArrayLike, time: ArrayLike) -> Array:
    """Return the pose (..., 3), as of `posture`, that a frame's sensor computes from true curvature (..., gauges), 1/m.

    frame: as it is built; its gauges' gains, drift and deaths count, and the share of foreshortening that its program
    leaves out. errors (..., gauges): offsets and noise, 1/m. time (...): s.
    """
    gains = np.array(frame.gauge_gains or (1.0,))
    drift = frame.gauge_drift * np.asarray(time, dtype=float)[..., None]
    reading = gains * np.asarray(curvature, dtype=float) + np.asarray(errors, dtype=float) + drift
    reading[..., [number - 1 for number in frame.dead_gauges]] = 0.0
    pose = posture(frame, reading)
    pose[..., 0] += frame.foreshortening_left_out * (frame.length - pose[..., 0])
    return pose


class PostureSensors:
    """The relative posture sensors of a train, one a frame; read once every sample period.

    train: as it is built; its gauges' gains, offsets, drift and deaths are those of `castor_envs.vehicles.train.Frame`.
    A sensor computes poses from its readings as `posture` does. random: draws offsets now, noise later.
    """

    def __init__(self, train: TrainDescription, random: np.random.Generator) -> None:
        self._frames, self._random = train.frames, random
        self._offsets = [
            frame.gauge_offset * random.standard_normal(len(frame.gauge_positions)) for frame in train.frames
        ]
        self._last = np.full((len(train.frames), 3), np.nan)
        self._taken = np.zeros(len(train.frames))

    def read(self, joint_angles: list[Array], time: float) -> tuple[Array, Array]:
        """Return relative poses (F, 3) and their ages (F,), s, for the angles (links,) of each frame's joints.

        A sensor that has stopped repeats its last reading; the first reading is always taken.
        """
        for f, (frame, angles) in enumerate(zip(self._frames, joint_angles, strict=True)):
            noise = frame.gauge_noise * self._random.standard_normal(len(frame.gauge_positions))
            stopped = frame.rps_stops is not None and time > frame.rps_stops and np.isfinite(self._last[f, 0])
            if not stopped:
                curvature = curvature_at_gauges(frame, angles)
                self._last[f], self._taken[f] = sensed(frame, curvature, self._offsets[f] + noise, time), time
        return self._last.copy(), time - self._taken
