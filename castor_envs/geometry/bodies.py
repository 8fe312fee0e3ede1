"""Rigid bodies and the frames of robots on them: a body stands at its centre of mass, a frame at its own origin."""

import math

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate_single


def motion_of(at: Array, angle: float, twist: Array, center: Array) -> Array:
    """Return the motion (6,) of a body with frame origin `at` and `twist` in its frame, its centre of mass at `center`.

    That is x, y, angle, v_x, v_y, angular velocity, of the centre of mass in N.
    """
    velocity = rotate_single(np.array([twist[0] - twist[2] * center[1], twist[1] + twist[2] * center[0]]), angle)
    position = at + rotate_single(center, angle)
    return np.array([position[0], position[1], angle, velocity[0], velocity[1], twist[2]])


def pose_of(motion: Array, center: Array) -> Array:
    """Return the pose (3,) in N of a body's frame from its motion (6,); `center` is its centre of mass in the frame."""
    (x, y, psi), (right, up) = motion[:3].tolist(), center.tolist()
    c, s = math.cos(psi), math.sin(psi)
    return np.array([x - (c * right - s * up), y - (s * right + c * up), psi])


def twist_of(motion: Array, center: Array) -> Array:
    """Return the twist (3,) in its own frame of a body's frame from its motion (6,)."""
    (psi, x, y, omega), (right, up) = motion[2:].tolist(), center.tolist()
    c, s = math.cos(-psi), math.sin(-psi)
    return np.array([c * x - s * y + omega * up, s * x + c * y - omega * right, omega])
