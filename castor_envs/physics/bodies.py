"""Rigid bodies and the frames of robots on them: a body stands at its centre of mass, a frame at its own origin."""

import numpy as np
import pymunk

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate_single


def place(body: pymunk.Body, at: Array, angle: float, twist: Array, center: Array) -> None:
    """Put a body with frame origin `at` and `twist` in its frame; `center` is its centre of mass in that frame."""
    velocity = rotate_single(np.array([twist[0] - twist[2] * center[1], twist[1] + twist[2] * center[0]]), angle)
    position = at + rotate_single(center, angle)
    body.angle = float(angle)
    body.position = (float(position[0]), float(position[1]))
    body.velocity = (float(velocity[0]), float(velocity[1]))
    body.angular_velocity = float(twist[2])


def pose_of(motion: Array, center: Array) -> Array:
    """Return the pose (3,) in N of a body's frame from its motion (6,); `center` is its centre of mass in the frame."""
    x, y, psi = motion[:3]
    return np.array([*((x, y) - rotate_single(center, psi)), psi])


def twist_of(motion: Array, center: Array) -> Array:
    """Return the twist (3,) in its own frame of a body's frame from its motion (6,)."""
    _, _, psi, *velocity, omega = motion
    v = rotate_single(np.array(velocity), -psi)
    return np.array([v[0] + omega * center[1], v[1] - omega * center[0], omega])
