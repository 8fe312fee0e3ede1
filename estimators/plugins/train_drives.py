"""Drives to check estimators of trains on: smooth, noise-free; all axles on one path, the frames bent along it.

The axles follow each other along the path, each a frame's length behind: all at one speed v, axle i turning at v
k(s_i), with k(s_i) the path's curvature where axle i is. So wheels roll without slip, and a frame is an arc where k is
constant.
"""

from collections.abc import Callable

import numpy as np

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.train import TrainDescription
from estimators.plugins.drives import Drive, Observations

SPEED = 0.25
"""m/s, along the path."""


def straight(train: TrainDescription) -> Drive:
    """Return 10 s straight on, 2.5 m."""
    return _drive(train, lambda s: 0.0 * s, 10.0)


def turning(train: TrainDescription) -> Drive:
    """Return three full circles and a half to the left, of a radius of 0.8 m."""
    return _drive(train, lambda s: 1.25 * s, 7 * np.pi / (1.25 * SPEED))


def winding(train: TrainDescription) -> Drive:
    """Return 12 s of bends to both sides."""
    return _drive(train, lambda s: 0.5 * np.sin(2.5 * s) + 0.3 * s, 12.0)


def with_silent_sensors(observations: Observations, samples: slice) -> Observations:
    """Return the same observations, but without any relative pose in these samples."""
    silent = list(observations)
    silent[samples] = [
        {**seen, "rps": np.full_like(seen["rps"], np.nan), "rps_age": np.full_like(seen["rps_age"], np.inf)}
        for seen in observations[samples]
    ]
    return silent


def _drive(train: TrainDescription, heading: Callable[[Array], Array], seconds: float) -> Drive:
    """Return the drive along a path of this heading (rad) at arc length s (m); axle 1 starts at s = 0."""
    from scipy.integrate import solve_ivp  # slow to import, and only checks need it

    t = train.sample_period * np.arange(round(seconds / train.sample_period) + 1)
    behind = np.cumsum([0.0, *(frame.length for frame in train.frames)])
    at: Array = (SPEED * t[:, None] - behind).astype(float)

    def direction(s: float, _: Array) -> list[float]:
        psi = float(heading(np.array(s)))
        return [np.cos(psi), np.sin(psi)]

    span = (-behind[-1], at[-1, 0])
    path = solve_ivp(direction, span, [0.0, 0.0], "DOP853", dense_output=True, rtol=1e-10, atol=1e-11).sol
    x, y = path(at.ravel()).reshape(2, *at.shape)
    pose = np.stack([x, y, heading(at)], axis=-1)
    pose = se2.relative_pose(pose[0, 0], pose)  # axle 1 starts at the origin, forward

    rolled, turned = np.diff(at, axis=0, prepend=at[:1]), np.diff(pose[..., 2], axis=0, prepend=pose[:1, :, 2])
    counts = []
    for i, module in enumerate(train.modules):
        for wheel in module.castors[0].wheels:
            per_metre = (wheel.counts_per_rev or 0.0) / (2 * np.pi * wheel.radius)
            counts.append((rolled[:, i] - wheel.lateral * turned[:, i]) * per_metre)
    relative = se2.relative_pose(pose[:, 1:], pose[:, :-1])
    observations = [
        {
            "wheel": np.array([count[k] for count in counts]),
            "time": t[k : k + 1],
            "rps": relative[k].ravel(),
            "rps_age": np.zeros(len(train.frames)),
        }
        for k in range(len(t))
    ]
    return Drive(pose, observations)
