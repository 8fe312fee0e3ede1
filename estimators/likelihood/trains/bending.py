"""Bending of a frame between two axles, the readings of its sensor, and the creep of axles under its forces.

A frame that is loaded at its ends alone, without tension, bends with a curvature that is linear along it, kappa = a + b
s / length: the pose of one end relative to the other determines a and b, and how much shorter the bent frame is.
Tension along it, from wheels that are held at speeds that disagree, bows it in addition.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.sensors.posture import gauges_of, posture, sensed
from castor_envs.vehicles.train import Frame, TrainDescription
from castor_envs.vehicles.weight import wheel_loads

GRAVITY = 9.81
NEWTON = 3
BUCKLING = -30.0
"""Lower bound of tension, in E I / length^2; at -4 pi^2 a clamped frame buckles."""

UNIT_SLIP = 1e-3
"""Slip that defines the unit of the tension of frames."""

SMALL, MOST = 1e-3, 60.0
"""1/m: step for numerical derivatives, and a bound on the difference of curvature between a frame's ends."""


def ends(frame: Frame, relative: Array) -> Array:
    """Return the curvature (..., 2) at the rear and the front end, 1/m, of a frame bent to y and phi of `relative`.

    relative (..., 3): the front axle's pose in the rear axle's frame, m and rad, of which x is not used.
    """
    y, mean = relative[..., 1], np.clip(relative[..., 2], -3.0, 3.0) / frame.length
    slope = np.clip(12 * (mean / 2 - y / frame.length**2), -MOST, MOST)  # front less rear, exact for small bends
    for _ in range(NEWTON):
        below, above = (posture_of(frame, _about(mean, slope + small))[..., 1] for small in (-SMALL, SMALL))
        by_slope = np.minimum((above - below) / (2 * SMALL), -(frame.length**2) / 100)
        slope = np.clip(slope - ((below + above) / 2 - y) / by_slope, -MOST, MOST)
    return _about(mean, slope)


def _about(mean: Array, slope: Array) -> Array:
    return np.stack([mean - slope / 2, mean + slope / 2], axis=-1)


def posture_of(frame: Frame, at_ends: Array, bowed: Array | float = 0.0) -> Array:
    """Return the front end's pose (..., 3) in the rear one's frame for the curvature (..., 2) at the ends, 1/m.

    bowed (...,): the first part of `bow`, 1/m. By its first terms it changes x alone.
    """
    curved = np.stack([at_ends[..., 0], np.mean(at_ends, axis=-1), at_ends[..., 1]], axis=-1)
    curved = curved + np.asarray(bowed)[..., None] * shape_of_bow(np.array([0.0, 0.5, 1.0]))
    return posture(Frame(length=frame.length, gauges=(0.0, frame.length / 2, frame.length)), curved)


def ends_by_posture(frame: Frame, at_ends: Array) -> Array:
    """Return the derivatives (K, 2, 2) of `ends` by y and phi, at curvatures (K, 2)."""
    change = [
        (posture_of(frame, at_ends + small) - posture_of(frame, at_ends - small)) / (2 * SMALL)
        for small in SMALL * np.eye(2)
    ]
    return np.linalg.inv(np.stack(change, axis=-1)[:, 1:]).astype(float)


def bow(frame: Frame, at_ends: Array, tension: Array) -> Array:
    """Return the change (..., 2), 1/m, of the curvature of a frame's ends by its tension: the symmetric and the
    antisymmetric part.

    kappa'' = tension kappa / E I, the pose of the ends the same, by the first terms in tension (...,), N: at a fraction
    u of the frame the curvature changes by (6 u^2 - 6 u + 1) of the first, at the ends by -1 and 1 times the second.
    """
    pulled = np.maximum(tension * frame.length**2 / frame.bending_stiffness, BUCKLING)
    alike = np.mean(at_ends, axis=-1) * pulled / (12 + pulled / 5)
    return np.stack([alike, (at_ends[..., 1] - at_ends[..., 0]) * pulled / 120], axis=-1)


def shape_of_bow(share: Array) -> Array:
    """Return the change of curvature at these parts of a frame's length (...,), in units of the first part of `bow`."""
    return 6 * share**2 - 6 * share + 1


def reading(
    frame: Frame, at_ends: Array, offsets: Array, t: Array, bowed: Array | float = 0.0, raised: float = 0.0
) -> Array:
    """Return the readings (K, 3) of the sensor of a frame as it is built, for the curvature (K, 2) at its ends, 1/m.

    They are means over the sensor's noise, which bends and so shortens the frame that is read. offsets (gauges,): 1/m.
    t (K,): s. bowed (K,): the first part of `bow`; raised: part of it by which gauges read too much, wherever they are.
    """
    share = np.array(frame.gauge_positions) / frame.length
    curved = at_ends[..., :1] * (1 - share) + at_ends[..., 1:] * share
    curved = curved + np.asarray(bowed)[..., None] * (shape_of_bow(share) + raised)
    read = sensed(frame, curved, offsets, t)
    read[..., 0] -= shortened_by_noise(frame)[0]
    return read


@lru_cache(maxsize=256)
def shortened_by_noise(frame: Frame) -> tuple[float, float]:
    """Return by how much the noise of its gauges shortens a straight frame that is read, mean and standard deviation,
    m: half of the squared heading along it, whose mean and variance follow from those of products of normal numbers."""
    gauges = gauges_of((frame,))
    heading = gauges.heading[0, :, :-1] * live(frame)[:, None]
    products = frame.gauge_noise**2 * (heading * gauges.weights[0]) @ heading.T
    counts = 1.0 - frame.foreshortening_left_out
    return counts * float(np.trace(products)) / 2, counts * float(np.sum(products**2) / 2) ** 0.5


def live(frame: Frame) -> Array:
    """Return 1 for each gauge of a frame that works, 0 for a dead one (gauges,)."""
    return gauges_of((frame,)).alive[0].astype(float)


@lru_cache(maxsize=64)
def compliance(train: TrainDescription) -> tuple[Array, Array]:
    """Return the slip of the contacts of each axle per newton, along and across, (N,) each, 1/N."""
    stiffness = ([getattr(m.contact, f"slip_stiffness_{way}") for m in train.modules] for way in ("long", "lat"))
    along, across = (1.0 / (np.array(values) * carried(train)) for values in stiffness)
    return along, across


def newtons(train: TrainDescription) -> Array:
    """Return the unit of the tension of each frame (F,), N.

    It is the tension that drives the axles beside it to a mean slip of `UNIT_SLIP`, so that the observable, their slip
    against each other, is the same on any floor; or the tension that would bow a bent frame as much as it is bent, if
    that is less.
    """
    along, _ = compliance(train)
    limp = np.array([frame.bending_stiffness / frame.length**2 for frame in train.frames])
    return np.minimum(limp, 2 * UNIT_SLIP / (along[1:] + along[:-1]))


def sliding_force(train: TrainDescription) -> Array:
    """Return the force at which the wheels of each axle slide, (N,), N."""
    return np.array([module.contact.friction for module in train.modules]) * carried(train)


def carried(train: TrainDescription) -> Array:
    """Return the load of the wheels of each axle, (N,), N: their module, and half of each frame on it."""
    half = [0.5 * frame.linear_density * frame.length for frame in train.frames]
    masses = zip(train.modules, [0.0, *half], [*half, 0.0], strict=True)
    return np.array([np.sum(wheel_loads(replace(m, mass=m.mass + a + b), GRAVITY)) for m, a, b in masses])


def half_track(train: TrainDescription) -> Array:
    """Return half the distance between the wheels of each axle (N,), m."""
    return np.array([(m.castors[0].wheels[0].lateral - m.castors[0].wheels[1].lateral) / 2 for m in train.modules])


def loads(train: TrainDescription, relative: Array, at_ends: Array, tension: Array) -> Array:
    """Return the loads of bent frames on the axles (K, N, 3): force along and across each axle's way, N, and moment, N
    m.

    train: as it is built. relative (K, F, 3): the front axle's pose in the rear axle's frame. at_ends (K, F, 2): the
    curvatures that go with it, 1/m. tension (K, F): force along the line between the two axles, N.
    """
    found = np.zeros((len(relative), train.n_axles, 3))
    for f, frame in enumerate(train.frames):
        away = np.arctan2(relative[:, f, 1], relative[:, f, 0])  # from the rear axle to the front one
        alike, apart = bow(frame, at_ends[:, f], tension[:, f]).T
        moment = frame.bending_stiffness * (at_ends[:, f] + np.stack([alike - apart, alike + apart], axis=-1))
        shear = (moment[:, 1] - moment[:, 0]) / np.hypot(relative[:, f, 0], relative[:, f, 1])
        for axle, sign, angle in ((f, 1.0, away - relative[:, f, 2]), (f + 1, -1.0, away)):
            c, s, pulled = np.cos(angle), np.sin(angle), -tension[:, f]
            found[:, axle, 0] += sign * (pulled * c - shear * s)
            found[:, axle, 1] += sign * (pulled * s + shear * c)
            found[:, axle, 2] -= sign * moment[:, 1 if axle == f else 0]
    return found


def creep(train: TrainDescription, load: Array) -> Array:
    """Return the slip (K, N, 3) of axles under `load` (K, N, 3): of the left wheel, of the right wheel, and across.

    Metres beyond the distance rolled, per metre that each wheel rolls, in steady state. train: as it is built.
    """
    along, across = compliance(train)
    turning = load[..., 2] / half_track(train)
    slip = [(load[..., 0] - turning) * along, (load[..., 0] + turning) * along, load[..., 1] * across]
    return np.stack(slip, axis=-1)
