"""How a frame between two axles bends, what its sensor then reads, and how far axles creep under its forces.

A frame that is loaded at its ends alone bends with a curvature that is linear along it, kappa = a + b s / length:
the pose of one end as seen from the other tells a and b, and how much shorter the bent frame is.
"""

import numpy as np

from castor_envs.kinematics import Array
from castor_envs.physics.statics import wheel_loads
from castor_envs.posture_sensor import posture, sensed
from castor_envs.train import Frame, TrainDescription

GRAVITY = 9.81
NEWTON = 3
SMALL, MOST = 1e-3, 60.0
"""1/m: to take a derivative with, and more than any difference of curvature between a frame's ends."""


def ends(frame: Frame, relative: Array) -> Array:
    """Return the curvature (..., 2) at the rear and the front end, 1/m, of a frame bent to y and phi of `relative`.

    relative (..., 3): the front axle's pose in the rear axle's frame, m and rad, of which x is not used.
    """
    y, mean = relative[..., 1], np.clip(relative[..., 2], -3.0, 3.0) / frame.length
    slope = np.clip(12 * (mean / 2 - y / frame.length**2), -MOST, MOST)  # front less rear, exact for small bends
    for _ in range(NEWTON):
        less, more = (posture_of(frame, _about(mean, slope + small))[..., 1] for small in (-SMALL, SMALL))
        by_slope = np.minimum((more - less) / (2 * SMALL), -(frame.length**2) / 100)
        slope = np.clip(slope - ((less + more) / 2 - y) / by_slope, -MOST, MOST)
    return _about(mean, slope)


def _about(mean: Array, slope: Array) -> Array:
    return np.stack([mean - slope / 2, mean + slope / 2], axis=-1)


def posture_of(frame: Frame, at_ends: Array) -> Array:
    """Return the front end's pose (..., 3) in the rear one's frame for the curvature (..., 2) at the ends, 1/m."""
    return posture(Frame(length=frame.length, gauges=(0.0, frame.length)), at_ends)


def ends_by_posture(frame: Frame, at_ends: Array) -> tuple[Array, Array]:
    """Return the derivatives (K, 2, 2) of `ends` by y and phi, and (K, 2) of x by the ends, at curvatures (K, 2)."""
    change = [
        (posture_of(frame, at_ends + small) - posture_of(frame, at_ends - small)) / (2 * SMALL)
        for small in SMALL * np.eye(2)
    ]
    by_ends = np.stack(change, axis=-1)
    return np.linalg.inv(by_ends[:, 1:]).astype(float), by_ends[:, 0]


def reading(frame: Frame, at_ends: Array, offsets: Array, t: Array) -> Array:
    """Return what the sensor of a frame as it is built reads, (K, 3), when the curvature at its ends is (K, 2), 1/m.

    In the mean over its noise, which bends and so shortens what is read. offsets (gauges,): 1/m. t (K,): s.
    """
    share = np.array(frame.gauge_positions) / frame.length
    read = sensed(frame, at_ends[..., :1] * (1 - share) + at_ends[..., 1:] * share, offsets, t)
    live = np.ones(len(share))
    live[[number - 1 for number in frame.dead_gauges]] = 0.0
    shorter = np.sum(frame.length - posture(frame, frame.gauge_noise * np.diag(live))[:, 0])
    read[..., 0] -= (1.0 - frame.foreshortening_left_out) * shorter
    return read


def yielding(train: TrainDescription) -> tuple[Array, Array]:
    """Return how much the contacts of each axle slip for a force of 1 N, along and across, (N,) each, 1/N."""
    along, across = [], []
    for module in train.modules:
        load = float(np.sum(wheel_loads(module, GRAVITY)))
        along.append(1.0 / (module.contact.slip_stiffness_long * load))
        across.append(1.0 / (module.contact.slip_stiffness_lat * load))
    return np.array(along), np.array(across)


def half_track(train: TrainDescription) -> Array:
    """Return half the distance between the wheels of each axle (N,), m."""
    return np.array([(m.castors[0].wheels[0].lateral - m.castors[0].wheels[1].lateral) / 2 for m in train.modules])


def creep(train: TrainDescription, at_ends: Array) -> Array:
    """Return the slip (K, N, 3) that bent frames drive the axles to: of the left wheel, of the right one, and across.

    Metres beyond what is rolled, a metre of travel, from the frames' moments and shear forces in steady rolling; what
    pulls along the frames their bends do not tell. train: as it is built. at_ends (K, F, 2): curvatures, 1/m.
    """
    k, n = len(at_ends), train.n_axles
    moment, force = np.zeros((k, n)), np.zeros((k, n))
    for f, frame in enumerate(train.frames):
        rear, front = at_ends[:, f].T * frame.bending_stiffness
        moment[:, f] -= front
        moment[:, f + 1] += rear
        force[:, f] += (front - rear) / frame.length
        force[:, f + 1] -= (front - rear) / frame.length
    along, across = yielding(train)
    turning = moment / half_track(train) * along
    return np.stack([-turning, turning, force * across], axis=-1)
