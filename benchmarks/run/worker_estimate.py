"""What happens in a worker process: an estimator follows observations. The truth is not in this process.

An estimator gets the vehicle as the episode describes it, where it starts, and one observation after another. The
parent gets back its poses at the evaluation samples and scores them.
"""

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import cycle, islice
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.results.rows import DECLINED
from benchmarks.tasks.task import Episode
from castor_envs.errors import Declined, one_line
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.processes import MOST_MEMORY, end_if_forked
from castor_envs.sensors.observation import Observations
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.robot import RobotDescription
from estimators.plugins.registry import CalibrationEntry, EstimatorEntry, declines, load_estimator
from estimators.robots.cast import SmallTurnWarning
from estimators.trains.relative_poses import RelativePoseWarning

Entry = TypeVar("Entry", EstimatorEntry, CalibrationEntry)

FEWEST_TIMED = 50


@dataclass(frozen=True, eq=False)
class ObservedRun:
    """What a worker gets of a run: the vehicle, where it starts, the observations, which poses to return.

    start: (3,), of a train (N, 3).
    """

    robot: Vehicle
    start: Array
    observations: Observations
    samples: NDArray[np.intp]


def observed_runs(episode: Episode) -> list[ObservedRun]:
    """Return what estimators may see of an episode."""
    return [ObservedRun(episode.robot, run.start.copy(), run.log.observations(), run.samples) for run in episode.runs]


@dataclass(frozen=True)
class Failure:
    """An estimator failed; `reason` goes on the leaderboard."""

    reason: str


class FailedError(Exception):
    """Raised where an estimator or a calibration method fails."""


def estimate_singly(spec: str, source_hash: str, runs: Sequence[ObservedRun]) -> list[Array] | Failure:
    """Return the estimated poses of each run, (M, 3) or (N, M, 3) of a train, or how the first failing run failed."""
    estimates = []
    for number, run in enumerate(runs, start=1):
        try:
            poses = _follow(loaded(load_estimator, spec, source_hash), run.robot, run.start, run.observations)
        except FailedError as failure:
            return Failure(f"{failure} of run {number}" if "at sample" in str(failure) else str(failure))
        bad = np.argwhere(~np.isfinite(poses).all(axis=-1))[:, -1]
        if bad.size:
            return Failure(f"returned NaN or infinity at sample {bad.min()} of run {number}")
        estimates.append(poses[..., run.samples, :])
    return estimates


def estimate_stacked(
    spec: str, source_hash: str, episodes: Sequence[Sequence[ObservedRun]]
) -> list[list[Array] | Failure] | Failure:
    """Return the estimated poses of each run of robots' episodes, on stacks of runs alike in layout and length.

    A pose that is not finite fails only its episode; any other error fails the whole stack, and the parent then tries
    the episodes one by one.
    """
    runs = [(e, r, run) for e, episode in enumerate(episodes) for r, run in enumerate(episode)]
    groups: dict[tuple, list[tuple[int, int, ObservedRun]]] = {}
    for member in runs:
        groups.setdefault(_stack_key(member[2]), []).append(member)
    estimates: list[list[Any]] = [[None] * len(episode) for episode in episodes]
    failures: dict[int, tuple[int, Failure]] = {}
    for members in groups.values():
        geometry = Geometry.of([_robot_of(run) for _, _, run in members])
        start = np.stack([run.start for _, _, run in members])
        observations = Observations.stack([run.observations for _, _, run in members])
        try:
            poses = _follow(loaded(load_estimator, spec, source_hash), geometry, start, observations)
        except FailedError as failure:
            return Failure(str(failure))
        for (e, r, run), run_poses in zip(members, poses, strict=True):
            estimates[e][r] = run_poses[run.samples]
            good = np.isfinite(run_poses).all(axis=-1)
            if not good.all() and (e not in failures or r < failures[e][0]):
                k = np.argmin(good)
                failures[e] = (r, Failure(f"returned NaN or infinity at sample {k} of run {r + 1}"))
    return [failures[e][1] if e in failures else estimates[e] for e in range(len(episodes))]


def time_updates(spec: str, source_hash: str, runs: Sequence[ObservedRun]) -> float | Failure:
    """Return the median CPU time of an update of a single vehicle, microseconds.

    Over the first run, or, where it is short, over several runs and repeatedly: at least FEWEST_TIMED updates. The
    first observation of a run, that of the start pose, does not count.
    """
    spent: list[int] = []
    try:
        for run in islice(cycle(runs), FEWEST_TIMED):
            times: list[int] = []
            _follow(loaded(load_estimator, spec, source_hash), run.robot, run.start, run.observations, times)
            spent += times[1:] or times
            if len(spent) >= FEWEST_TIMED:
                break
    except FailedError as failure:
        return Failure(str(failure))
    return float(np.median(spent)) / 1e3


def _stack_key(run: ObservedRun) -> tuple:
    geometry = Geometry.of(_robot_of(run))
    layout = ("wheel_castor", "counts_per_rev", "pivot_counts_per_rev", "standard", "fixed", "driven")
    return (
        *(getattr(geometry, name).tobytes() for name in layout),
        geometry.sample_period,
        geometry.gyro,
        geometry.tolerances,
        len(run.observations),
        run.observations.gyro is None,
    )


def _robot_of(run: ObservedRun) -> RobotDescription:
    if not isinstance(run.robot, RobotDescription):
        raise TypeError(f"only robots are stacked, and {run.robot.name!r} is a train")
    return run.robot


@lru_cache(maxsize=8)
def loaded(load: Callable[[str], Entry], spec: str, source_hash: str) -> Entry:
    """Return what a spec names; raises FailedError if it cannot be loaded or has changed since the parent loaded it."""
    try:
        entry = load(spec)
    except BaseException as error:
        end_if_forked()
        raise FailedError(f"could not be loaded by a worker process: {one_line(error)}") from None
    end_if_forked()
    if entry.source_hash != source_hash:
        raise FailedError("its source changed while the benchmark ran; run again")
    return entry


def _follow(
    entry: EstimatorEntry,
    robot: Vehicle | Geometry,
    start: Array,
    observations: Observations,
    spent: list[int] | None = None,
) -> Array:
    """Return the poses (..., K, 3) of a new estimator; append the CPU time of each update, ns, to `spent`.

    robot: a single vehicle, or the geometry of a stack of robots. start (..., 3): the leading axes are those of the
    stack, or a train's axles. Warnings of estimators about unusable relative poses or small turns are not shown.
    """
    poses = np.empty((*start.shape[:-1], len(observations), 3))
    stage = "when constructed"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RelativePoseWarning)
            warnings.simplefilter("ignore", SmallTurnWarning)
            estimator = entry.factory()
            stage = "in reset"
            estimator.reset(robot, start.copy())
            end_if_forked()
            for k in range(len(observations)):
                stage = f"in update at sample {k}"
                observation = observations.at(k)
                began = time.process_time_ns()
                answer = estimator.update(observation)
                end_if_forked()
                if spent is not None:
                    spent.append(time.process_time_ns() - began)
                poses[..., k, :] = _pose(answer, start.shape, stage)
    except FailedError:
        raise
    except BaseException as error:
        end_if_forked()
        if stage == "in reset" and (reason := _declined(error, robot)) is not None:
            raise FailedError(DECLINED + reason) from None
        raise FailedError(f"{raised(error)} {stage}") from None
    return poses


def _pose(answer: Any, shape: tuple[int, ...], stage: str) -> Array:
    try:
        pose = np.asarray(answer, dtype=float)
    except (TypeError, ValueError):
        raise FailedError(f"returned {type(answer).__name__} instead of {shape} numbers {stage}") from None
    if pose.shape != shape:
        raise FailedError(f"returned shape {pose.shape} instead of {shape} {stage}")
    return pose


def _declined(error: BaseException, robot: Vehicle | Geometry) -> str | None:
    """Return why an estimator's `reset` declines, as one printable line; None if the exception means something else."""
    # On a stack only a stated `Declined` counts; single runs show the rest.
    return declines(error, robot) if isinstance(error, Declined) or not isinstance(robot, Geometry) else None


def raised(error: BaseException) -> str:
    """Say in one line what a plug-in raised."""
    limit = f" (a worker process may take {MOST_MEMORY / 2**30:.1f} GiB)" if isinstance(error, MemoryError) else ""
    return f"raised {one_line(error)}{limit}"
