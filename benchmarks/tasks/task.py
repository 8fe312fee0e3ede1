"""What a task is: a robot or a train drives, and estimators get a log of its sensor readings."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from castor_envs.floor import Floor
from castor_envs.logs.log import Log
from castor_envs.logs.reference import ReferenceNoise
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.protocol import Recording
from estimators.plugins.registry import load_estimator

Case = int | str

EVALUATION_PERIOD = 0.5
"""s: trajectories are stored and scored at this interval, and at the last pose."""

MOST_SAMPLES = 1000
"""Of a run that are scored; those of longer ones have a longer interval."""


@dataclass(frozen=True, eq=False)
class Run:
    """One drive of an episode.

    log: with the truth as its reference, which has a pose at least in its first row; the runner hands estimators the
    observations alone. direction: round a UMBmark square, None for other paths. baseline: the drive only gives the
    systematic error that the extended UMBmark subtracts (the same square on the clean floor); it is not scored itself.

    belief: of a snapshot, the axles' poses (N, 3) that a train's estimator starts from instead of the true ones; the
    run is then scored at its last sample alone. belief_covariance (N, 3, 3): how exact it is said to be, m and rad; a
    true start has none. sound: the axles, from 1 at the front, whose belief is right, where the task knows.

    oracle: poses at `samples` of an estimator that is told what nobody can know, the true vehicle and what disturbs it:
    a yardstick, no strict bound. None where the task has none.

    reference_noise: how far a tracker's poses are off, each for itself, where the truth is no more than these; None
    where it is exact.

    floor: what was driven on, for pictures and exports; neither estimators nor scores see it. None where nobody knows.
    """

    log: Log
    direction: Literal["cw", "ccw"] | None = None
    baseline: bool = False
    belief: NDArray[np.float64] | None = None
    belief_covariance: NDArray[np.float64] | None = None
    sound: tuple[int, ...] = ()
    oracle: NDArray[np.float64] | None = None
    reference_noise: ReferenceNoise | None = None
    floor: Floor | None = None

    def __post_init__(self):
        if self.log.reference is None or not np.isfinite(self.log.reference[0]).all():
            raise ValueError("the log of a run needs a reference pose in its first row")
        if self.belief is not None:
            belief = np.array(self.belief, dtype=float)
            if self.axles is None or belief.shape != (self.axles, 3) or not np.isfinite(belief).all():
                raise ValueError(f"a belief holds a finite pose for each axle of a train, got {belief.shape}")
            object.__setattr__(self, "belief", belief)
        if self.belief_covariance is not None and (
            self.belief is None or self.belief_covariance.shape != (*self.belief.shape, 3)
        ):
            raise ValueError(f"the covariance of a belief is one for each axle, got {self.belief_covariance.shape}")
        if self.oracle is not None and self.oracle.shape != self.truth.shape:
            raise ValueError(f"an oracle's poses are those at `samples`, {self.truth.shape}, got {self.oracle.shape}")
        if any(not 1 <= axle <= (self.axles or 0) for axle in self.sound):
            raise ValueError(f"sound names axles from 1 to {self.axles}, got {self.sound}")

    @property
    def axles(self) -> int | None:
        """How many axles the train has that was driven; None for a robot."""
        assert self.log.reference is not None
        width = self.log.reference.shape[1]
        return None if width == 3 else width // 3

    @cached_property
    def samples(self) -> NDArray[np.intp]:
        """The samples (M,) that are stored and scored.

        Of those with a reference pose the ones nearest to the times t_0, t_0 + EVALUATION_PERIOD, ..., or at most
        `MOST_SAMPLES` evenly, and the last; of a snapshot the last alone.
        """
        assert self.log.reference is not None
        known = np.flatnonzero(np.isfinite(self.log.reference).all(axis=1))
        if self.belief is not None:
            return known[-1:]
        t = self.log.t[known]
        times = np.arange(t[0], t[-1], max(EVALUATION_PERIOD, float(t[-1] - t[0]) / MOST_SAMPLES))
        after = np.searchsorted(t, times)
        before = np.maximum(after - 1, 0)
        nearest = np.where(times - t[before] < t[after] - times, before, after)
        return known[np.unique(np.append(nearest, len(t) - 1))]

    @cached_property
    def truth(self) -> NDArray[np.float64]:
        """The true poses at `samples`: (M, 3) of a robot, (N, M, 3) of a train's axles."""
        assert self.log.reference is not None
        return self._poses(self.log.reference[self.samples])

    @property
    def start(self) -> NDArray[np.float64]:
        """Where estimators start: the belief or the true pose at the first sample, (3,), of a train (N, 3)."""
        assert self.log.reference is not None
        return self._poses(self.log.reference[:1])[..., 0, :] if self.belief is None else self.belief

    def _poses(self, rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return rows of a reference as poses, a train's with its axles first."""
        return rows if self.axles is None else rows.reshape(len(rows), self.axles, 3).swapaxes(0, 1)


@dataclass(frozen=True, eq=False)
class Calibration:
    """What an episode holds for calibration methods; its runs then only test the robot that a method returns.

    recordings: what methods get. odometry: the estimator, by its spec, that follows the runs with the calibrated robot;
    odometry_source: its source hash when the episode was recorded. true_robot: with the true parameters; None where
    nobody knows them.
    """

    recordings: tuple[Recording, ...]
    odometry: str
    odometry_source: str
    true_robot: RobotDescription | None = None

    @classmethod
    def by(
        cls, odometry: str, recordings: Sequence[Recording], true_robot: RobotDescription | None = None
    ) -> "Calibration":
        """Return the calibration with the source hash that the odometry has now."""
        return cls(tuple(recordings), odometry, load_estimator(odometry).source_hash, true_robot)


@dataclass(frozen=True, eq=False)
class Episode:
    """What one case of a task recorded: the vehicle as described to the estimators, and the runs it drove.

    calibration: in tasks that judge calibration methods, what these get.
    """

    robot: Vehicle
    runs: tuple[Run, ...]
    calibration: Calibration | None = None

    def __post_init__(self):
        if not any(not run.baseline for run in self.runs):
            raise ValueError("an episode needs a run that is not a baseline")
        if self.calibration is not None and not isinstance(self.robot, RobotDescription):
            raise ValueError("calibration is of single robots, not of trains")

    @cached_property
    def digest(self) -> str:
        """A hash of all that estimates and scores depend on, by which an episode is recognised; oracles are no part."""
        seen = hashlib.sha256(self.robot.hash().encode())
        for run in self.runs:
            seen.update(f"{run.direction} {run.baseline}".encode())
            seen.update(_log_bytes(run.log))
            further = {name: getattr(run.log, name) for name in _FURTHER}
            for name, array in (further | {"belief": run.belief, "belief covariance": run.belief_covariance}).items():
                if array is not None:
                    seen.update(name.encode() + _bytes(array))
            if run.reference_noise is not None:
                seen.update(f"reference noise {tuple(run.reference_noise)}".encode())
            if run.sound:
                seen.update(f"sound {run.sound}".encode())
        if self.calibration is not None:
            seen.update(f"{self.calibration.odometry} {self.calibration.odometry_source}".encode())
            if self.calibration.true_robot is not None:
                seen.update(self.calibration.true_robot.hash().encode())
            for recording in self.calibration.recordings:
                log = recording.log
                seen.update(f"recording {recording.held} {recording.side}".encode())
                seen.update(_log_bytes(log) + _bytes(log.command) + _bytes(log.steering_command))
        return seen.hexdigest()[:16]


_FURTHER = ("fix", "fix_age", "rps", "rps_age", "command", "steering_command")


def _log_bytes(log: Log) -> bytes:
    return b"".join(_bytes(array) for array in (log.t, log.wheel, log.pivot, log.gyro, log.reference))


def _bytes(array: NDArray | None) -> bytes:
    data = b"" if array is None else np.ascontiguousarray(array, dtype=float).tobytes()
    return len(data).to_bytes(8, "little") + data


@runtime_checkable
class Task(Protocol):
    """A test with a fixed meaning: whenever what it records changes, its version goes up.

    A task on data that others can replace may have a function `source_digest` that returns a hash of what a case's
    episode is made of: where it differs from that of the stored episode, the episode is recorded again (`source_of`).

    A task that judges calibration methods instead of estimators has a further attribute, `followed_by`: the spec of the
    estimator that follows the test runs; its episodes have a `Calibration`.

    Tasks are sent to other processes, so they must pickle, as a frozen dataclass at the top level of a module does.
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
        """What is driven, what is wrong with the description that estimators get, and what the task shows."""
        ...

    @property
    def metric(self) -> str:
        """The metric that ranks: a key of `benchmarks.scoring.registry.BOARD_METRICS`."""
        ...

    @property
    def robot(self) -> Vehicle:
        """A robot or a train of the layout that the estimators will be given."""
        ...

    @property
    def group(self) -> str:
        """The group that the overview shows it in: lower-case words joined by hyphens."""
        ...

    @property
    def standard(self) -> bool:
        """Whether ``castor-bench run`` runs it without being told to; slow tasks are run by name or group alone."""
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


def source_of(task: Task, case: Case) -> str | None:
    """Return a hash of the data that a case's episode is made of; None where the task says none or lacks its data."""
    offered = getattr(task, "source_digest", None)
    return None if offered is None or task.missing is not None else offered(case)


def odometry_of(task: Task) -> str | None:
    """Return the estimator that a task's calibrated robots are followed with; None for tasks that judge estimators."""
    return getattr(task, "followed_by", None)
