"""The state of a train in one log, and the sizes of noise."""

from dataclasses import dataclass, replace

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose
from castor_envs.vehicles.train import TrainDescription

LEAST_NOISE = 1e-3
"""1/m: least noise of gauges."""


@dataclass(frozen=True, eq=False)
class Motion:
    """The motion of a train at K samples, with the nuisances of the log.

    pose (K, N, 3). roll (K, 2N), rad. tension (K, F): of each frame in the step that begins, in `bending.newtons`.
    offsets: of every frame's gauges (gauges,), 1/m. mount (N, 3): the tracked points in the axles' frames, m and rad.
    clock: s, by which the reference is ahead. creep (N,): relative excess of the creep of axles under bent frames over
    the prediction. raised (F,): part of a frame's bow by which its gauges read too much. pull (F,): mean tension of a
    frame, about which its tension changes, in the same unit.
    """

    pose: Array
    roll: Array
    tension: Array
    offsets: Array
    mount: Array
    clock: float
    creep: Array
    raised: Array
    pull: Array

    @property
    def relative(self) -> Array:
        """For every frame the front axle's pose in the rear axle's frame, (K, F, 3)."""
        return relative_pose(self.pose[:, 1:], self.pose[:, :-1])

    def moved(self, by_sample: Array, by_number: Array) -> "Motion":
        """Return the motion with these changes of the unknowns of every sample (K, B) and of the nuisances (n,)."""
        n = self.pose.shape[1]
        pose, roll, tension = np.split(by_sample, [3 * n, 5 * n], axis=1)
        n_offsets = len(self.offsets)
        ends = np.cumsum([n_offsets, 3 * n, 1, n, len(self.raised)])
        offsets, mount, clock, creep, raised, pull = np.split(by_number, ends)
        return Motion(
            self.pose + pose.reshape(-1, n, 3),
            self.roll + roll,
            self.tension + tension,
            self.offsets + offsets,
            self.mount + mount.reshape(n, 3),
            self.clock + float(clock[0]),
            self.creep + creep,
            self.raised + raised,
            self.pull + pull,
        )


@dataclass(frozen=True)
class Sizes:
    """Standard deviations. rolling, side: slip of a wheel, and of an axle to its side, m after 1 m; tension: of a
    frame, in `bending.newtons`; shape: of a frame's length along the bend, m; position, heading: of the reference, m
    and rad. gauges (F,): of the readings of each frame's gauges, relative to the described noise.
    """

    rolling: float = 1e-3
    side: float = 1e-3
    tension: float = 1.0
    shape: float = 3e-4
    position: float = 1e-3
    heading: float = 1e-3
    gauges: tuple[float, ...] = ()

    def of(self, kind: str) -> float:
        """Return the size of a kind of equations; 1 for those whose size is known, and for gauges, whose noise is that
        of a train `with_noise`."""
        return 1.0 if kind.startswith("gauges") else float(getattr(self, kind, 1.0))

    def with_noise(self, train: TrainDescription) -> TrainDescription:
        """Return a train whose gauges are as noisy as these sizes say."""
        frames = [
            replace(frame, gauge_noise=max(size * frame.gauge_noise, LEAST_NOISE))
            for frame, size in zip(train.frames, self.gauges, strict=True)
        ]
        return replace(train, frames=tuple(frames))

    def changed(self, kind: str, factor: float) -> "Sizes":
        """Return the sizes with that of one kind multiplied, within its bounds; those that are known stay."""
        if kind.startswith("gauges"):
            f = int(kind.removeprefix("gauges"))
            size = float(np.clip(self.gauges[f] * factor, *GAUGES))
            return replace(self, gauges=(*self.gauges[:f], size, *self.gauges[f + 1 :]))
        if kind not in FITTED:
            return self
        least, most = LEAST_SIZE[kind], MOST_SIZE.get(kind, np.inf)
        return replace(self, **{kind: float(np.clip(self.of(kind) * factor, least, most))})

    def at_most(self, bound: "Sizes") -> "Sizes":
        """Return the smaller of the sizes of each kind."""
        gauges = tuple(min(pair) for pair in zip(self.gauges, bound.gauges, strict=True))
        return Sizes(**{kind: min(self.of(kind), bound.of(kind)) for kind in FITTED}, gauges=gauges)


LEAST_SIZE = {"rolling": 2e-4, "side": 3e-4, "tension": 0.1, "shape": 1e-4, "position": 1e-4, "heading": 1e-4}
MOST_SIZE = {"tension": 10.0}
FITTED = tuple(LEAST_SIZE)
GAUGES = 0.3, 5.0
"""Bounds of the noise of gauges, relative to the described noise; what looks noisier has another cause."""
