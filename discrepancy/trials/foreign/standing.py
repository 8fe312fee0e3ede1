"""Statics of a robot in 3-D: contacts of its wheels, skids where wheels do not hold it upright, and loads."""

import math

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import Castor, RobotDescription

SKID_SHARE = 0.1
"""Load of a skid over that of a wheel."""

LIGHTEST = 0.2
"""Least part of a castor's mass and inertia that its fork keeps beside the wheels."""

ACROSS = 0.55
"""Inertia of a wheel about its diameter over that about its axle: a disc's, and a little for its width."""

TILTING = 0.6
"""Inertia of chassis and forks about level axes over that about the vertical: they are flat."""

DROOP, STEERING_DROOP = 0.1, 0.01
"""How far wheels and steering fall behind their commands at full torque, in parts of their highest rate."""

DAMPING, GRAVITY = 0.7, 9.81
"""Damping of springs and of contacts across the floor, in parts of the critical damping under static load; and the
gravity for which it is chosen, m/s2."""


def damping_of(sinking: float) -> float:
    """Return the damping over the stiffness, s, of a spring that gives by `sinking` (m) under its load."""
    return 2 * DAMPING * math.sqrt(sinking / GRAVITY)


def supports(geometry: Geometry) -> Array:
    """Return where wheels stand (w, 2), in B: those of castors that turn, below the pivot."""
    castor, fixed = geometry.wheel_castor, geometry.fixed[geometry.wheel_castor]
    from_pivot = np.column_stack([-geometry.offset[castor], geometry.lateral]) * fixed[:, None]
    return geometry.pivot[castor] + rotate(from_pivot, geometry.angle[castor])


def skids_of(robot: RobotDescription, geometry: Geometry) -> Array:
    """Return the places of skids (4, 2), or none (0, 2) where wheels hold the robot upright whichever way they turn."""
    wheels, center = supports(geometry), np.array(robot.center_of_mass)
    reach = float(np.max(geometry.offset + 1e-3))
    around = np.linspace(0, 2 * math.pi, 72, endpoint=False)
    out = (wheels - center) @ np.array([np.cos(around), np.sin(around)])
    if np.all(out.max(axis=0) > reach):
        return np.empty((0, 2))
    half = max(0.25, float(np.abs(wheels - center).max()))
    return center + half * np.array([(1, 1), (1, -1), (-1, 1), (-1, -1)])


def static_loads(robot: RobotDescription, geometry: Geometry, gravity: float, skids: Array) -> Array:
    """Return the loads of wheels and skids, N: in equilibrium on level ground, as even as that allows."""
    places = np.vstack([supports(geometry), skids])
    share = np.concatenate([np.ones(len(geometry.radius)), np.full(len(skids), SKID_SHARE)])
    masses = np.array([robot.mass, *(castor.mass for castor in robot.castors)])
    centers = np.vstack([np.array(robot.center_of_mass), geometry.pivot])
    weight = gravity * np.array([masses.sum(), *(masses @ centers)])
    rows = np.vstack([np.ones(len(places)), places.T])
    load = share * (rows.T @ np.linalg.lstsq(rows @ (share[:, None] * rows.T), weight, rcond=None)[0])
    if load.min() < 0.02 * load.max():
        raise InputError(f"robot {robot.name!r} does not stand on its wheels: its centre of mass is too far out")
    return load


def wheel_mass(inertia: float, radius: float) -> float:
    """Return the mass of a solid disc of some spin inertia, kg."""
    return 2 * inertia / radius**2


def fork(castor: Castor) -> tuple[float, float]:
    """Return mass and inertia of a castor without its wheels, kg and kg m2."""
    wheels = [(wheel_mass(wheel.inertia, wheel.radius), wheel.inertia, wheel.lateral) for wheel in castor.wheels]
    mass = castor.mass - sum(m for m, _, _ in wheels)
    inertia = castor.inertia - sum(m * y**2 + ACROSS * spin for m, spin, y in wheels)
    return max(mass, LIGHTEST * castor.mass), max(inertia, LIGHTEST * castor.inertia)
