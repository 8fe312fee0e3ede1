"""What a task is: a robot drives, and a log of what its encoders said is what the estimators get."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from castor_envs.logs import Log
from castor_envs.robot import RobotDescription

Case = int | str

EVALUATION_PERIOD = 0.5
"""Trajectories are stored and scored every so many seconds, and at the last pose."""


@dataclass(frozen=True, eq=False)
class Run:
    """One drive of an episode.

    log: with the truth as its reference, which has a pose at least in its first row; the runner hands estimators the
    observations alone. direction: round a UMBmark square, None for other paths. baseline: the drive only gives the
    systematic error that the extended UMBmark takes off (the same square on the clean floor); it is not scored itself.
    """

    log: Log
    direction: Literal["cw", "ccw"] | None = None
    baseline: bool = False

    def __post_init__(self):
        if self.log.reference is None or not np.isfinite(self.log.reference[0]).all():
            raise ValueError("the log of a run needs a reference pose in its first row")

    @cached_property
    def samples(self) -> NDArray[np.intp]:
        """The samples (M,) that are stored and scored.

        Of those with a reference pose the ones nearest to the times t_0, t_0 + EVALUATION_PERIOD, ..., and the last.
        """
        assert self.log.reference is not None
        known = np.flatnonzero(np.isfinite(self.log.reference).all(axis=1))
        t = self.log.t[known]
        wanted = np.arange(t[0], t[-1], EVALUATION_PERIOD)
        after = np.searchsorted(t, wanted)
        before = np.maximum(after - 1, 0)
        nearest = np.where(wanted - t[before] < t[after] - wanted, before, after)
        return known[np.unique(np.append(nearest, len(t) - 1))]

    @cached_property
    def truth(self) -> NDArray[np.float64]:
        """The true poses (M, 3) at `samples`."""
        assert self.log.reference is not None
        return self.log.reference[self.samples]


@dataclass(frozen=True, eq=False)
class Episode:
    """What one case of a task recorded: the robot as the estimators are told it is, and the runs it drove."""

    robot: RobotDescription
    runs: tuple[Run, ...]

    def __post_init__(self):
        if not any(not run.baseline for run in self.runs):
            raise ValueError("an episode needs a run that is not a baseline")

    @cached_property
    def digest(self) -> str:
        """A hash of all that estimates and scores depend on, to know an episode again."""
        seen = hashlib.sha256(self.robot.hash().encode())
        for run in self.runs:
            seen.update(f"{run.direction} {run.baseline}".encode())
            for array in (run.log.t, run.log.wheel, run.log.pivot, run.log.gyro, run.log.reference):
                data = b"" if array is None else np.ascontiguousarray(array, dtype=float).tobytes()
                seen.update(len(data).to_bytes(8, "little") + data)
        return seen.hexdigest()[:16]


@runtime_checkable
class Task(Protocol):
    """A test with a fixed meaning; change what it records, and its version goes up.

    Tasks are sent to other processes, so they pickle: a frozen dataclass at the top of a module does.
    """

    @property
    def name(self) -> str:
        """What users call it: lower-case words joined by hyphens."""
        ...

    @property
    def version(self) -> int:
        """Counted up whenever the same case records something else; old rows then never mix with new ones."""
        ...

    @property
    def title(self) -> str:
        """One line for the leaderboard."""
        ...

    @property
    def description(self) -> str:
        """What is driven, what is wrong with the robot's description, and what the task shows."""
        ...

    @property
    def metric(self) -> str:
        """The metric that ranks: a key of `benchmarks.evaluation.METRICS`."""
        ...

    @property
    def robot(self) -> RobotDescription:
        """A robot of the layout that the estimators will be given."""
        ...

    @property
    def missing(self) -> str | None:
        """Why the task cannot be run (its data are not there), or None."""
        ...

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the first n cases (None: the official number): seeds, or names of letters, digits and ``_ . -``."""
        ...

    def record(self, case: Case) -> Episode:
        """Return the episode of a case: the same one, bit for bit, every time and in every process."""
        ...
