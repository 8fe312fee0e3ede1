"""A compliant frame as a chain of rigid links: pivots hold the links together, rotary springs straighten them.

A beam of length L is cut into n equal pieces of length h = L / n, and all of its bending and all of its mass is put
into the n middles of the pieces: springs of stiffness E I / h, dampers likewise, and point masses. So the chain is
n - 1 links of length h with their mass at both ends, and half a link, rigid, on either axle. The middles make it a
midpoint rule: a clamped chain's tip deflects P L^3 / 3 E I times 1 - 1 / 4 n^2, and everything converges to the
Euler-Bernoulli beam with n^2 (shear-free: a link does not shear).
"""

import math
from typing import NamedTuple

import numpy as np
import pymunk
from numpy.typing import ArrayLike
from pymunk.constraints import Constraint, DampedRotarySpring, PivotJoint

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose
from castor_envs.vehicles.train import Frame


class Clamp(NamedTuple):
    """Where a frame is clamped: a body, and the clamped end in the body's own coordinates (from its centre of mass)."""

    body: pymunk.Body
    end: Array


class Chain(NamedTuple):
    """The links of a frame, from the rear, and the joints and springs that hold them, clamps included."""

    links: list[pymunk.Body]
    joints: list[Constraint]


def chain(frame: Frame, rear: Clamp, front: Clamp, dt: float, bend: float = 0.0) -> Chain:
    """Return the chain between two clamps that stand where `bent_pose` puts them, for substeps of dt (s).

    bend: angle (rad) by which all joints together are bent at the start, evenly.
    """
    n, h = frame.links, frame.length / frame.links
    mass, inertia = link_inertia(frame)
    x, y = rear.body.local_to_world(tuple(rear.end))
    tip = compose((x, y, rear.body.angle), (0.5 * h, 0.0, 0.0))
    links, joints = [], []
    before, anchor = rear.body, rear.end + np.array([0.5 * h, 0.0])
    for k in range(n):
        tip = tip + np.array([0.0, 0.0, bend / n])
        if k < n - 1:
            body = pymunk.Body(mass, inertia)
            middle = compose(tip, (0.5 * h, 0.0, 0.0))
            body.position, body.angle = (float(middle[0]), float(middle[1])), float(middle[2])
            rear_end = np.array([-0.5 * h, 0.0])
            links.append(body)
        else:
            body, rear_end = front.body, front.end - np.array([0.5 * h, 0.0])
        pivot = PivotJoint(before, body, tuple(anchor), tuple(rear_end))
        # Joints keep Chipmunk's slow drift correction (6 a second): its solver leaves errors in a chain of light links
        # between heavy axles, and correcting these at once would feed energy into the links.
        stiffness = frame.bending_stiffness / h
        joints += [pivot, DampedRotarySpring(before, body, 0.0, stiffness, _chipmunk_damping(frame, before, body, dt))]
        before, anchor = body, np.array([0.5 * h, 0.0])
        tip = compose(tip, (h, 0.0, 0.0))
    return Chain(links, joints)


def _chipmunk_damping(frame: Frame, a: pymunk.Body, b: pymunk.Body, dt: float) -> float:
    """Return the coefficient with which Chipmunk's damper gives the impulse c * rate * dt, rate after the substep.

    Chipmunk damps a relative rate by the share a = 1 - exp(-coefficient * dt * (1 / I_a + 1 / I_b)), as if both bodies
    were free, and again in every iteration the rate that the other joints have restored since the last one. So its
    impulses add up to a / (1 - a) / (1 / I_a + 1 / I_b) times the rate that remains.
    """
    mobility = dt * (1.0 / a.moment + 1.0 / b.moment)
    return math.log1p(frame.damping / (frame.length / frame.links) * mobility) / mobility


def link_inertia(frame: Frame) -> tuple[float, float]:
    """Return mass (kg) and inertia about its middle (kg m2) of a link: half of its mass at either end."""
    h = frame.length / frame.links
    mass = frame.linear_density * h
    return mass, mass * h**2 / 4


def half_link(frame: Frame, side: float) -> tuple[float, float, Array]:
    """Return mass, inertia and place (2,) of the half link on an axle, in its frame; side: 1 ahead, -1 behind."""
    mass, _ = link_inertia(frame)
    return 0.5 * mass, 0.0, np.array([side * 0.5 * frame.length / frame.links, 0.0])


def bent_pose(frame: Frame, bend: ArrayLike) -> Array:
    """Return the front clamp's pose (..., 3) in the rear one's frame when all joints together are bent evenly."""
    bend = np.asarray(bend, dtype=float)
    return chain_pose(frame, np.repeat(bend[..., None] / frame.links, frame.links, axis=-1))


def chain_pose(frame: Frame, joint_angles: ArrayLike) -> Array:
    """Return the front clamp's pose (..., 3) in the rear one's frame for the angles (..., n) of the joints, rad."""
    return chain_points(frame, joint_angles)[..., -1, :]


def chain_points(frame: Frame, joint_angles: ArrayLike) -> Array:
    """Return the poses (..., n + 2, 3) along a frame, in the rear clamp's frame: rear clamp, joints, front clamp."""
    angles = np.asarray(joint_angles, dtype=float)
    h = frame.length / frame.links
    zero = np.zeros((*angles.shape[:-1], 1))
    heading = np.concatenate([zero, np.cumsum(angles, axis=-1)], axis=-1)
    length = np.full(frame.links + 1, h)
    length[[0, -1]] = 0.5 * h
    steps = np.stack([length * np.cos(heading), length * np.sin(heading)], axis=-1)
    places = np.concatenate([np.zeros((*angles.shape[:-1], 1, 2)), np.cumsum(steps, axis=-2)], axis=-2)
    return np.concatenate([places, np.concatenate([heading, heading[..., -1:]], axis=-1)[..., None]], axis=-1)


def frame_substeps(frame: Frame, sample_period: float) -> int:
    """Return the substeps a sample period that keep a chain's fastest wave and its dampers well resolved.

    Its links swing against each other with a frequency of up to 4 sqrt(E I / linear density) / h^2.
    """
    h = frame.length / frame.links
    fastest = 4 * math.sqrt(frame.bending_stiffness / frame.linear_density) / h**2
    _, inertia = link_inertia(frame)
    damped = 2 * frame.damping / (h * inertia)
    return math.ceil(sample_period * max(fastest / 0.5, damped / 0.9))
