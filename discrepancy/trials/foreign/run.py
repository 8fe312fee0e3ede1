"""Makes the log of a foreign simulator's run, as the robot's encoders and the reference report it.

The same run can be read again for the same robot with other effects on its sensors.
"""

from dataclasses import dataclass

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.trajectories import Trajectory
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials.foreign.build import Build
from discrepancy.trials.foreign.sensors import Sensors, reading_times, reference_poses, reference_times
from discrepancy.trials.noise import Noise


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """A run: states at N + 1 times of the physics, of which every `every`-th is a sample.

    t (N + 1,): s. angle (N + 1, w + n): of wheels since the start, and of castors, rad, true and unwrapped. pose
    (N + 1, 3): of the point that the reference tracks. command (K, driven wheels), steering (K, driven castors): rad/s,
    the last row 0. phase (driven wheels,): of encoders, counts.
    """

    t: Array
    angle: Array
    pose: Array
    command: Array
    steering: Array
    phase: Array
    every: int
    seed: int


class Counters:
    """Changes of counts on their way into the log; in this class none."""

    def count(self, build: Build, t: Array, wheel: Array, random: np.random.Generator) -> Array:
        """Return wheel counts (K, driven wheels), not rounded yet, at times t (K,), as the log receives them."""
        return wheel


def start_angles(build: Build, motion: Trajectory, random: np.random.Generator) -> Array:
    """Return the castors' angles (n,) at the start: free ones about half a radian off where they would trail."""
    trailing = build.trailing(np.array(motion.runs[0].legs[0].motion, dtype=float))
    off = random.uniform(-0.5, 0.5, len(trailing))
    return np.where([kind == "free" for kind in build.steering], trailing + off, trailing)


def read(
    run: Run,
    robot: RobotDescription,
    *,
    outside: Counters | None = None,
    rounded: bool = True,
    noise: Noise = Noise(),  # noqa: B008
) -> Log:
    """Return a run's log as the encoders of a robot report it, with its effects on sensors, time and counts.

    Jitter reads the encoders at uneven times; effects after it in the robot file are not affected by it.
    """
    sensors, substeps = Sensors(robot), run.every
    rows = [slice(0, 1), *(slice(k + 1, k + substeps + 1) for k in range(0, len(run.t) - 1, substeps))]
    seen = np.vstack([sensors.push(run.t[samples], run.angle[samples]) for samples in rows])
    t = run.t[::substeps]
    sampled = _at(reading_times(robot, t), run.t, seen)
    wheel = sensors.wheels(sampled, run.phase, rounded=False)
    if outside is not None:
        wheel = outside.count(sensors.build, t, wheel, np.random.default_rng([run.seed, 4]))
    taken = reference_times(robot, t)
    true = reference_poses(robot, run.pose)
    pose = np.column_stack([np.interp(taken, run.t, column, right=np.nan) for column in true.T])
    return Log(
        t,
        np.round(wheel) if rounded else wheel,
        sensors.pivots(sampled, rounded=rounded),
        run.command,
        run.steering if run.steering.shape[1] else None,
        reference=noise.sparse(pose, np.random.default_rng([run.seed, 3])),
    )


def _at(instants: Array, t: Array, values: Array) -> Array:
    """Return values (N, c) at times (K,); after the last time they are extrapolated."""
    last = (values[-1] - values[-2]) / (t[-1] - t[-2])
    beyond = np.maximum(instants - t[-1], 0.0)[:, None] * last
    return np.column_stack([np.interp(instants, t, column) for column in values.T]) + beyond
