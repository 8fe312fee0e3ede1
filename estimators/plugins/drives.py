"""Drives to check estimators on: smooth, noise-free, for any robot; encoder readings of perfect rolling."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import unwrapped
from castor_envs.motion.controllers import trailing_angles
from castor_envs.motion.kinematics import Geometry, castor_rates, constraint_matrix, inverse, pivot_velocity
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.robot import RobotDescription

Observations = list[dict[str, Array]]

FIXED_EVERY = 20
"""Samples from one external fix to the next, of robots that have them: most samples have none."""


@dataclass(frozen=True, eq=False)
class Drive:
    """K samples: true poses, psi unwrapped, and what an estimator sees.

    pose: (K, 3) of a robot, (K, N, 3) of the axles of a train. The robot, or axle 1, starts at (0, 0, 0).
    """

    pose: Array
    observations: Observations


def straight(robot: RobotDescription) -> Drive:
    """Return 10 s straight on, along x or as near to it as fixed castors allow, 2.5 m."""
    return _drive(robot, lambda t: np.array([0.25, 0.0, 0.0]), 10.0, turns=False)


def turning(robot: RobotDescription) -> Drive:
    """Return three full circles and a half to the left."""
    return _drive(robot, lambda t: np.array([0.25, 0.0, 1.0]), 7 * np.pi)


def winding(robot: RobotDescription) -> Drive:
    """Return 12 s of bends in which castors turn all the way round where the robot can move sideways."""

    def twist(t: float) -> Array:
        return np.array([0.25 * np.cos(0.6 * t), 0.25 * np.sin(0.6 * t), 0.5 * np.sin(0.9 * t) + 0.1])

    def forward(t: float) -> Array:
        return np.array([0.25, 0.0, 0.8 * np.sin(0.9 * t) + 0.1])

    return _drive(robot, forward if Geometry.of(robot).fixed.any() else twist, 12.0)


def with_pivot_counts_unwrapped(robot: RobotDescription, observations: Observations) -> Observations:
    """Return the same observations from pivot encoders that count on beyond a turn."""
    turn = np.array([robot.castors[i].pivot_counts_per_rev for i in robot.pivot_encoders], dtype=float)
    read = np.array([observation["pivot"] for observation in observations])
    counts = unwrapped(read, turn)
    return [{**observation, "pivot": count} for observation, count in zip(observations, counts, strict=True)]


def _drive(robot: RobotDescription, twist: Callable[[float], Array], seconds: float, turns: bool = True) -> Drive:
    from scipy.integrate import solve_ivp  # slow to import, and only checks need it

    geometry, n = Geometry.of(robot), len(robot.castors)
    allowed = _allowed_twists(geometry, turns)
    if np.hypot(*(allowed @ twist(0.0))[:2]) < 0.01:
        raise InputError(f"robot {robot.name!r} cannot drive ahead; check the estimator on another")

    def rates(t: float, state: Array) -> Array:
        current, soon = allowed @ twist(t), allowed @ twist(t + 1e-6)
        turning = castor_rates(geometry, state[3 : 3 + n], current)
        steered = np.isnan(turning)
        if steered.any():  # without an offset: follows the direction in which its pivot moves
            u, later = pivot_velocity(geometry, current), pivot_velocity(geometry, soon)
            cross = u[:, 0] * later[:, 1] - u[:, 1] * later[:, 0]
            turning = np.where(steered, cross / np.sum(u**2, axis=-1) / 1e-6, turning)
        cos, sin = np.cos(state[2]), np.sin(state[2])
        velocity = [cos * current[0] - sin * current[1], sin * current[0] + cos * current[1], current[2]]
        return np.concatenate([velocity, turning, inverse(geometry, state[3 : 3 + n], turning, current).rate])

    theta = trailing_angles(geometry, allowed @ twist(0.0))
    state = np.concatenate([np.zeros(3), theta, np.zeros(len(robot.wheels))])
    t = robot.sample_period * np.arange(round(seconds / robot.sample_period) + 1)
    solution = solve_ivp(rates, (0.0, t[-1]), state, method="DOP853", t_eval=t, rtol=1e-9, atol=1e-10).y.T
    encoders = Encoders(geometry, np.zeros(len(robot.driven_wheels)))
    wheel = np.diff(encoders.wheel(solution[:, 3 + n :]), axis=0, prepend=0.0)
    pivot = encoders.pivot(solution[:, 3 : 3 + n])
    observations = [{"wheel": wheel[k], "pivot": pivot[k], "time": t[k : k + 1]} for k in range(len(t))]
    if robot.gyro is not None:
        for k, observation in enumerate(observations):
            observation["gyro"] = (allowed @ twist(t[k]))[2:]
    if robot.fixes is not None:
        for k, observation in enumerate(observations):
            observation["fix"] = solution[k, :3] if k % FIXED_EVERY == 0 else np.full(3, np.nan)
            observation["fix_age"] = np.zeros(1)
    return Drive(solution[:, :3], observations)


def _allowed_twists(geometry: Geometry, turns: bool) -> Array:
    """Return the projection (3, 3) of twists onto those that fixed castors allow; turns False: without turning."""
    matrix, _ = constraint_matrix(geometry, geometry.angle)
    held = np.concatenate([np.zeros_like(geometry.standard), geometry.standard & geometry.fixed[geometry.wheel_castor]])
    rows = np.concatenate([matrix[held], np.array([[0.0, 0.0, 1.0]])[: 0 if turns else 1]])
    return np.eye(3) - np.linalg.pinv(rows, rcond=1e-10) @ rows
