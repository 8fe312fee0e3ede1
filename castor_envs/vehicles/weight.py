"""What a robot weighs, where, and how its weight stands on its wheels at rest."""

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate_single
from castor_envs.vehicles.robot import RobotDescription


def castor_center(robot: RobotDescription, i: int) -> Array:
    """Return the centre of mass of castor i in the frame of its pivot turned by its own angle: behind the pivot."""
    return np.array([-robot.castors[i].offset, 0.0])


def chassis(robot: RobotDescription) -> tuple[float, float, Array]:
    """Return mass, inertia and centre of mass (2,) in B of the chassis with the castors fixed to it."""
    parts = [(robot.mass, robot.inertia, np.array(robot.center_of_mass))]
    for i, castor in enumerate(robot.castors):
        if castor.steering == "fixed":
            center = np.array(castor.pivot) + rotate_single(castor_center(robot, i), castor.angle)
            parts.append((castor.mass, castor.inertia, center))
    return combined(parts)


def combined(parts: list[tuple[float, float, Array]]) -> tuple[float, float, Array]:
    """Return mass, inertia and centre of mass (2,) of parts fixed to each other, each given by the same three."""
    mass = sum(part[0] for part in parts)
    center = sum((part[0] * part[2] for part in parts), np.zeros(2)) / mass
    inertia = sum(part[1] + part[0] * float(np.sum((part[2] - center) ** 2)) for part in parts)
    return mass, inertia, center


def wheel_loads(robot: RobotDescription, gravity: float) -> Array:
    """Return the load on each wheel (w,), N, as it is on average over all directions in which castors may trail.

    The chassis stands on its pivots, and on the axles of castors that are fixed to it: the smallest loads (in the sum
    of squares) that balance its weight and moments, which is exact for three; a pivot bearing takes moments, so a
    castor's own weight and load stand on its wheels by the lever rule about the pivot's line. Moments that no
    arrangement of these places can balance are left to support castors without load.
    """
    places = [np.array(castor.pivot) for castor in robot.castors]
    for i, castor in enumerate(robot.castors):
        if castor.steering == "fixed":
            places[i] += rotate_single(castor_center(robot, i), castor.angle)
    on_castor = _castor_loads(robot, gravity, np.array(places))
    for castor, load in zip(robot.castors, on_castor.tolist(), strict=True):
        if load <= castor.mass * gravity:
            raise InputError(
                f"robot {robot.name!r}: center_of_mass {robot.center_of_mass} lies outside its pivots, and the castor "
                f"at {castor.pivot} would lift; move one of them"
            )
    return on_castor[list(robot.wheel_castors)] * _shares(robot)


def swung_loads(robot: RobotDescription, gravity: float, castor_angle: Array) -> Array:
    """Return the loads on wheels (K, w), N, of a robot at rest with its castors at angles (K, n), rad.

    As `wheel_loads`, but the chassis stands where the castors' axles are, which trail behind the pivots; a castor that
    would lift carries its own weight.
    """
    pivot, offset = (np.array([getattr(castor, name) for castor in robot.castors]) for name in ("pivot", "offset"))
    behind = np.stack([np.cos(castor_angle), np.sin(castor_angle)], axis=-1) * offset[:, None]
    on_castor = _castor_loads(robot, gravity, pivot - behind)
    castor_weight = np.array([castor.mass * gravity for castor in robot.castors])
    return np.maximum(on_castor, castor_weight)[:, list(robot.wheel_castors)] * _shares(robot)


def _castor_loads(robot: RobotDescription, gravity: float, places: Array) -> Array:
    """Return what castors (..., n) carry, N, their own weight too, where the chassis stands at places (..., n, 2)."""
    balance = np.concatenate([np.ones_like(places[..., :1]), places], axis=-1)
    weight = robot.mass * gravity * np.array([1.0, *robot.center_of_mass])
    load = (np.linalg.pinv(np.swapaxes(balance, -1, -2), rcond=1e-9) @ weight[:, None])[..., 0]
    load *= robot.mass * gravity / np.sum(load, axis=-1, keepdims=True)
    return load + gravity * np.array([castor.mass for castor in robot.castors])


def _shares(robot: RobotDescription) -> Array:
    """Return the part of its castor's load that each wheel (w,) carries."""
    shares = []
    for castor in robot.castors:
        lateral = np.array([wheel.lateral for wheel in castor.wheels])
        if len(lateral) == 1:
            share = np.ones(1)
        else:
            share = np.linalg.pinv(np.vstack([np.ones(len(lateral)), lateral])) @ np.array([1.0, 0.0])
        if np.any(share <= 0):
            raise InputError(
                f"robot {robot.name!r}: the wheels of the castor at {castor.pivot} all stand to one side of its pivot, "
                "and it would tip; set their lateral positions to both sides"
            )
        shares.append(share)
    return np.concatenate(shares)
