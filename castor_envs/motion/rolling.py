"""Perfect rolling: how far wheels and castors turn while the body follows a trajectory exactly. No physics, no slip."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.motion.controllers import trailing_angles
from castor_envs.motion.kinematics import Geometry, castor_rates, inverse, pivot_velocity
from castor_envs.motion.trajectories import Trajectory
from castor_envs.vehicles.robot import RobotDescription

SIDEWAYS = 1e-9
"""Sideways slip of fixed wheels, for a unit of motion, up to which it is a rounding error."""


class Rolled(NamedTuple):
    """Samples of a rolling robot: t (N,), pose (N, 3), castor_angle (N, n), wheel_angle (N, w), all unwrapped."""

    t: Array
    pose: Array
    castor_angle: Array
    wheel_angle: Array


def roll(robot: RobotDescription, trajectory: Trajectory, castor_angle: ArrayLike | None = None) -> Rolled:
    """Return what the robot's joints do on a trajectory, every sample period, the last sample at or after its end.

    castor_angle (n,): at the start; None: as after long trailing in the first direction of motion. The angles of
    castors that trail follow the no-side-slip constraint, integrated to 1e-10. Castors that are steered on the spot
    (offset 0) point along their pivot's path, or against it if that is nearer; between two legs they turn at once.
    Raises InputError for castors that nothing turns, and motions in which fixed wheels would slip sideways.
    """
    from scipy.integrate import solve_ivp  # takes longer to import than all of this package

    geometry = Geometry.of(robot)
    n, steered = geometry.n_castors, geometry.driven & ~geometry.trailing
    lost = np.isnan(castor_rates(geometry, np.zeros(n), np.zeros(3))) & ~steered
    if np.any(lost):
        raise InputError(
            f"robot {robot.name!r}: nothing turns castor {int(np.argmax(lost)) + 1}; perfect rolling needs castors "
            "that trail (offset above 0), are steered or fixed"
        )
    for leg in (leg for run in trajectory.runs for leg in run.legs):
        if np.any(np.abs(geometry.side_slip_of_fixed(leg.motion)) > SIDEWAYS):
            raise InputError(f"robot {robot.name!r} cannot drive {trajectory.name}: fixed wheels would slip sideways")
    if castor_angle is None:
        castor_angle = trailing_angles(geometry, trajectory.runs[0].legs[0].motion)

    def rates(t: float, state: Array) -> Array:
        twist = trajectory.twist_at(t)
        turning = np.where(steered, 0.0, castor_rates(geometry, state[:n], twist))
        return np.concatenate([turning, inverse(geometry, state[:n], turning, twist).rate])

    def pointed(state: Array, twist: Array) -> Array:
        """Return the state after steered castors have turned to a twist's direction, their wheels rolling with them."""
        u = pivot_velocity(geometry, twist)
        away = np.arctan2(u[:, 1], u[:, 0]) - state[:n]
        moving = np.hypot(u[:, 0], u[:, 1]) > 0
        turn = np.where(steered & moving, away - np.pi * np.round(away / np.pi), 0.0)
        return state + np.concatenate([turn, inverse(geometry, state[:n], turn, np.zeros(3)).rate])

    period = robot.sample_period
    t = np.arange(int(np.ceil(trajectory.duration / period - 1e-9)) + 1, dtype=np.float64) * period
    state = np.concatenate([np.asarray(castor_angle, dtype=float), np.zeros(len(robot.wheels))])
    samples = np.tile(state, (len(t), 1))
    breaks = trajectory.breakpoints()
    for start, end in pairwise(breaks):
        sampled = np.flatnonzero((t > start) & (t <= end))
        state = pointed(state, trajectory.twist_at((start + end) / 2))
        first, last = float(np.nextafter(start, end)), float(np.nextafter(end, start))
        # The motion is smooth between breakpoints only: stay strictly inside, or a step would see the next
        # leg's motion.
        solution = solve_ivp(
            lambda u, s, first=first, last=last: rates(min(max(u, first), last), s),
            (start, end),
            state,
            method="DOP853",
            rtol=1e-10,
            atol=1e-11,
            t_eval=np.append(t[sampled], end) if not len(sampled) or t[sampled[-1]] < end else t[sampled],
        )
        samples[sampled] = solution.y.T[: len(sampled)]
        state = solution.y[:, -1]
    samples[t > breaks[-1]] = state
    return Rolled(t, trajectory.at(t)[0], samples[:, :n], samples[:, n:])
