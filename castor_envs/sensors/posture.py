"""The relative posture sensor (RPS): from strain along a frame to the front axle's pose in the rear axle's frame.

Strain gauges measure the frame's curvature where they are glued. A polynomial is fitted to the readings and integrated
twice along the frame (Merrell and Minor 2003, Vogt and Minor's reference 3):

    phi(s) = int_0^s kappa        x = int_0^L cos phi        y = int_0^L sin phi
"""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.geometry.arrays import Array, vectors
from castor_envs.vehicles.train import Frame, TrainDescription

DEGREE = 2  # of the fitted polynomial: a shear force makes curvature linear, large bends add a little more
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


def posture(frame: Frame, curvature: ArrayLike) -> Array:
    """Return the front axle's pose (..., 3) in the rear axle's frame from curvature (..., gauges) at the gauges, 1/m.

    The fit is by least squares, of degree 2 or what the number of gauges allows.
    """
    return gauges_of((frame,)).posture(np.asarray(curvature, dtype=float)[..., None, :])[..., 0, :]


def curvature_at_gauges(frame: Frame, joint_angles: ArrayLike) -> Array:
    """Return the true curvature (..., gauges), 1/m, where the gauges are, from the joints' angles (..., links).

    A joint's angle is the bend of its piece of the frame; between the middles of the pieces, and beyond the outer
    ones, curvature runs linearly, as in a beam that is loaded at its ends alone.
    """
    return gauges_of((frame,)).curvature(np.asarray(joint_angles, dtype=float)[..., None, :])[..., 0, :]


def sensed(frame: Frame, curvature: ArrayLike, errors: ArrayLike, time: ArrayLike) -> Array:
    """Return the pose (..., 3), as of `posture`, that a frame's sensor computes from true curvature (..., gauges), 1/m.

    frame: as it is built; its gauges' gains, drift and deaths count, and the share of foreshortening that its program
    leaves out. errors (..., gauges): offsets and noise, 1/m. time (...): s.
    """
    true, off = (np.asarray(values, dtype=float)[..., None, :] for values in (curvature, errors))
    return gauges_of((frame,)).sensed(true, off, np.asarray(time, dtype=float))[..., 0, :]


class Gauges:
    """The gauges of frames, (..., F, G): of one train, or with a leading axis of several.

    Frames with fewer gauges or links than others have zeros there. there (F, G): whether there is a gauge.
    """

    def __init__(self, frames: Sequence[Frame]) -> None:
        counts = [len(frame.gauge_positions) for frame in frames]
        shape = len(frames), max(counts)
        self.there = np.arange(shape[1]) < np.array(counts)[:, None]
        self.before, self.alive = np.zeros(shape, dtype=np.intp), self.there.copy()
        self.share, self.gain = np.zeros(shape), np.ones(shape)
        self.heading = np.zeros((*shape, len(_NODES) + 1))  # at nodes and end, rad for a reading of 1/m
        for f, frame in enumerate(frames):
            n = counts[f]
            place = np.array(frame.gauge_positions) * frame.links / frame.length - 0.5
            self.before[f, :n] = np.clip(np.floor(place), 0, frame.links - 2)
            self.share[f, :n] = place - self.before[f, :n]
            self.gain[f, :n] = frame.gauge_gains or 1.0
            self.alive[f, [number - 1 for number in frame.dead_gauges]] = False
            self.heading[f, :n] = _headings(frame.gauge_positions, frame.computed_length)
        lengths = np.array([frame.length for frame in frames])
        self.piece, self.length = lengths / [frame.links for frame in frames], lengths
        self.computed_length = np.array([frame.computed_length for frame in frames])
        self.weights = 0.5 * self.computed_length[:, None] * _WEIGHTS
        self.noise, self.offset, self.drift, self.left_out = (
            np.array([getattr(frame, name) for frame in frames])
            for name in ("gauge_noise", "gauge_offset", "gauge_drift", "foreshortening_left_out")
        )
        self.stops = np.array([np.inf if frame.rps_stops is None else frame.rps_stops for frame in frames])

    @classmethod
    def stacked(cls, trains: Sequence[TrainDescription]) -> "Gauges":
        """Return the gauges of several trains with as many frames each, along a new leading axis."""
        joined = cls([frame for train in trains for frame in train.frames])
        for name, values in vars(joined).items():
            setattr(joined, name, values.reshape(len(trains), -1, *values.shape[1:]))
        return joined

    def curvature(self, joint_angles: Array) -> Array:
        """Return what `curvature_at_gauges` does for each frame: (..., F, G) from (..., F, links)."""
        bent = joint_angles / self.piece[..., None]
        before = np.broadcast_to(self.before, (*bent.shape[:-1], self.before.shape[-1]))
        first, second = (np.take_along_axis(bent, before + k, axis=-1) for k in (0, 1))
        return (1.0 - self.share) * first + self.share * second

    def posture(self, reading: Array) -> Array:
        """Return what `posture` does for each frame: (..., F, 3) from (..., F, G)."""
        heading = (reading[..., None] * self.heading).sum(axis=-2)
        within = heading[..., :-1]
        x, y = ((of(within) * self.weights).sum(axis=-1) for of in (np.cos, np.sin))
        return vectors(x, y, heading[..., -1])

    def sensed(self, curvature: Array, errors: Array, time: Array) -> Array:
        """Return what `sensed` does for each frame: (..., F, 3) from (..., F, G) twice, and time (...)."""
        drifted = (self.drift * time[..., None])[..., None]
        pose = self.posture(np.where(self.alive, self.gain * curvature + errors + drifted, 0.0))
        pose[..., 0] += self.left_out * (self.computed_length - pose[..., 0])
        return pose


@lru_cache
def gauges_of(frames: tuple[Frame, ...]) -> Gauges:
    """Return the gauges of a train's frames, not to be changed."""
    return Gauges(frames)


@lru_cache
def _headings(gauge_positions: tuple[float, ...], length: float) -> Array:
    """Return what headings (gauges, nodes + 1), at nodes and end, a reading of 1/m of each gauge makes, rad."""
    s = np.array(gauge_positions) / length
    powers = np.arange(min(DEGREE, len(s) - 1) + 1)
    along = 0.5 * (1.0 + _NODES)
    integrals = length * np.append(along, 1.0)[:, None] ** (powers + 1) / (powers + 1)
    return np.linalg.pinv(s[:, None] ** powers).T.astype(float, copy=False) @ integrals.T


class PostureSensors:
    """The relative posture sensors of a train, one a frame; read once every sample period.

    train: as it is built; its gauges' gains, offsets, drift and deaths are those of `castor_envs.vehicles.train.Frame`.
    A sensor computes poses from its readings as `posture` does. random: draws offsets now, noise later.
    """

    def __init__(self, train: TrainDescription, random: np.random.Generator) -> None:
        self.gauges, self._randoms = gauges_of(train.frames), [random]
        self._offsets = self.gauges.offset[:, None] * self._drawn()
        self._last = np.full((len(train.frames), 3), np.nan)
        self._taken = np.zeros(len(train.frames))

    @classmethod
    def stacked(cls, trains: Sequence[TrainDescription]) -> "PostureSensors":
        """Return the sensors of several trains of one layout, along a new leading axis; `take` brings their states."""
        joined = cls.__new__(cls)
        joined.gauges, joined._randoms = Gauges.stacked(trains), [np.random.default_rng(0)] * len(trains)
        joined._offsets, joined._taken = np.zeros(joined.gauges.there.shape), np.zeros(joined.gauges.length.shape)
        joined._last = np.full((*joined._taken.shape, 3), np.nan)
        return joined

    def take(self, row: int, member: "PostureSensors") -> None:
        """Let a row of stacked sensors stand as those of a single train."""
        self._randoms[row] = member._randoms[0]
        self._offsets[row, :, : member._offsets.shape[-1]] = member._offsets
        self._last[row], self._taken[row] = member._last, member._taken

    def give_back(self, row: int, member: "PostureSensors") -> None:
        """Let a single train's sensors stand as a row of stacked ones."""
        member._last, member._taken = self._last[row].copy(), self._taken[row].copy()

    def read(
        self, joint_angles: Sequence[Array], time: ArrayLike, going: NDArray[np.bool_] | None = None
    ) -> tuple[Array, Array]:
        """Return relative poses (..., F, 3) and their ages (..., F), s, at a time (...).

        joint_angles: (..., links) of each frame. A sensor that has stopped repeats its last reading; the first reading
        is always taken. going (B,): which rows of stacked sensors are read at all; others keep their last reading.
        """
        time = np.asarray(time, dtype=float)
        errors = self._offsets + self.gauges.noise[..., None] * self._drawn(going)
        bent = np.zeros((*self._taken.shape, max(angles.shape[-1] for angles in joint_angles)))
        for f, angles in enumerate(joint_angles):
            bent[..., f, : angles.shape[-1]] = angles
        read = (time[..., None] <= self.gauges.stops) | np.isnan(self._last[..., 0])
        if going is not None:
            read &= going[:, None]
        pose = self.gauges.sensed(self.gauges.curvature(bent), errors, time)
        self._last = np.where(read[..., None], pose, self._last)
        self._taken = np.where(read, time[..., None], self._taken)
        return self._last.copy(), time[..., None] - self._taken

    def _drawn(self, going: NDArray[np.bool_] | None = None) -> Array:
        """Draw a standard normal number for each gauge, zero where none is or where a row is not read: (..., F, G)."""
        there = self.gauges.there
        drawn = np.zeros(there.shape)
        if going is None:
            drawn[there] = self._randoms[0].standard_normal(np.count_nonzero(there))
        else:
            for row in np.flatnonzero(going).tolist():
                drawn[row][there[row]] = self._randoms[row].standard_normal(np.count_nonzero(there[row]))
        return drawn
