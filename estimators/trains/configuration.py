"""A train's configuration by odometry, and when relative poses may correct it: shared by all estimators of trains."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.errors import Declined, InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription
from estimators.protocol import Observation
from estimators.steps.castor_odometry import castor_records, castor_steps, displaced
from estimators.trains.relative_poses import MAX_AGE, RelativePoses, RelativePoseWarning, entry

__all__ = ["MAX_AGE", "Configuration", "RelativePoseWarning", "checked_interval", "next_to"]

DEFAULT_INTERVAL = 100
"""Sample periods between corrections, 5 s at 20 Hz.

A correction carries errors of the relative poses into the poses, where they stay, so rare corrections are better than
frequent ones: of 1, 20, 50, 100 and 200 this was best or nearly so for all estimators here, on cases 1000 to 1007 of
the tasks of driven trains, which no leaderboard uses.
"""

MOST_INTERVAL = 1_000_000
"""Sample periods, most of a day: a longer interval would mean no correction at all."""

SLACK = 1e-9
"""s, by which a sample may come early."""


class Configuration:
    """The odometry-derived (OD) poses of a train's axles, moved by every sample.

    Each axle is a separate differential robot: a fixed castor with two driven wheels, integrated by exact arcs.
    interval: sample periods between two corrections; None: no corrections, and relative poses are not read.

    poses: (N, 3) = x, y (m), psi (rad, unwrapped) in N. Raises Declined for anything but a train, InputError for
    poses of another shape.
    """

    def __init__(self, train: object, poses: ArrayLike, interval: int | None) -> None:
        if isinstance(train, RobotDescription | Geometry):
            name = f" {train.name!r}" if isinstance(train, RobotDescription) else ""
            raise Declined(f"serves trains, and this is a robot{name}; for robots there are others, as dead-reckoning")
        if not isinstance(train, TrainDescription):
            raise Declined(f"serves trains: give it a TrainDescription, not {type(train).__name__}")
        self.poses = np.array(poses, dtype=float)
        if self.poses.shape != (train.n_axles, 3):
            raise InputError(
                f"a train of {train.n_axles} axles starts at poses of shape ({train.n_axles}, 3), "
                f"got {self.poses.shape}"
            )
        if not np.isfinite(self.poses).all():
            raise InputError(f"the poses to start at are not finite: {self.poses.tolist()}; give numbers for all axles")
        self._axles = np.stack([castor_records(Geometry.of(module), [0]) for module in train.modules])
        self._sensors = RelativePoses(train)
        self._wait = None if interval is None else interval * train.sample_period
        self._time = np.nan
        self._corrected: float | None = None

    @property
    def status(self) -> str | None:
        """Which frame's relative pose cannot be used now, and why; None while all can, or none is needed."""
        return self._sensors.status

    @property
    def usable(self) -> NDArray[np.bool_]:
        """Which frames' (F,) relative poses can be used now."""
        return self._sensors.usable

    def advance(self, observation: Observation) -> Array | None:
        """Take one sample; return the relative poses (F, 3) if a correction is due and they are usable, else None.

        The first sample after construction starts the clock and is never corrected. A correction that is due stays due
        until `correct`. Raises InputError where the sample lacks something or has another size.
        """
        n = len(self._axles)
        wheel = entry(observation, "wheel", 2 * n, f"left and right of {n} axles").reshape(n, 2)
        if not np.isfinite(wheel).all():
            raise InputError(f"the observation's 'wheel' is not finite: {wheel.ravel()}; odometry needs every count")
        steps = castor_steps(self._axles, wheel)
        self.poses = displaced(self.poses, steps.x[:, 0], steps.y[:, 0], steps.turn[:, 0])
        if self._wait is None:
            return None
        relative = self._sensors.read(observation)
        self._take_time(float(entry(observation, "time", 1, "s")[0]))
        if self._corrected is None:
            self._corrected = self._time
            return None
        due = self._time - self._corrected >= self._wait - SLACK
        return relative if due else None

    def _take_time(self, time: float) -> None:
        if not np.isfinite(time) or time < self._time:
            raise InputError(f"the observation's 'time' is {time!r} s after {self._time!r} s; times must not go back")
        self._time = time

    def correct(self, poses: ArrayLike) -> None:
        """Replace the OD poses by corrected ones; odometry goes on from these."""
        self.poses = np.array(poses, dtype=float)
        self._corrected = self._time


def next_to(headings: ArrayLike, poses: ArrayLike) -> Array:
    """Return poses (..., 3) with whole turns added so that psi is next to `headings` (...), rad: unwrapped as they."""
    poses, headings = np.array(poses, dtype=float), np.asarray(headings, dtype=float)
    poses[..., 2] = headings + wrap(poses[..., 2] - headings)
    return poses


def checked_interval(interval: int) -> int:
    """Return the interval between corrections, in sample periods; raises InputError if it is invalid."""
    if not isinstance(interval, int | np.integer) or not 1 <= interval <= MOST_INTERVAL:
        raise InputError(
            f"the interval between corrections is a number of samples, 1 to {MOST_INTERVAL}; got {interval!r}"
        )
    return int(interval)
