"""What happens in a worker process: an estimator follows observations. The truth is not in this process.

An estimator gets the vehicle as the episode describes it, where it starts, and one observation after another. The
parent gets back its poses at the evaluation samples, with their covariance if it gives one, and scores them.
"""

import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import cycle, islice
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.results.rows import DECLINED, UpdateCost
from benchmarks.tasks.task import Episode
from castor_envs.errors import Declined, message_of, one_line
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.processes import MOST_MEMORY, end_if_forked
from castor_envs.sensors.observation import OPTIONAL, Observations
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.robot import RobotDescription
from estimators.plugins.real_numbers import real_numbers
from estimators.plugins.registry import CalibrationEntry, EstimatorEntry, declines, load_estimator
from estimators.plugins.uncertainty import covariance_of, has_status, invalid, takes_covariance
from estimators.robots.cast import SmallTurnWarning
from estimators.trains.relative_poses import RelativePoseWarning

Entry = TypeVar("Entry", EstimatorEntry, CalibrationEntry)

FEWEST_TIMED = 50

REPEATED = 1e-9
"""m and rad: poses of two passes that differ by less are the same, but for rounding."""


@dataclass(frozen=True, eq=False)
class ObservedRun:
    """What a worker gets of a run: the vehicle, where it starts, the observations, which poses to return.

    start: (3,), of a train (N, 3), and its covariance (3, 3) or (N, 3, 3); None where it is the true pose.
    """

    robot: Vehicle
    start: Array
    observations: Observations
    samples: NDArray[np.intp]
    start_covariance: Array | None = None

    @classmethod
    def of(
        cls, robot: Vehicle, log: Log, start: Array, start_covariance: Array | None, samples: NDArray[np.intp]
    ) -> "ObservedRun":
        """Return what estimators may see of a log, in a run of the benchmark and wherever else they are asked."""
        return cls(robot, start.copy(), log.observations(), samples, start_covariance)


def observed_runs(episode: Episode) -> list[ObservedRun]:
    """Return what estimators may see of an episode."""
    return [
        ObservedRun.of(episode.robot, run.log, run.start, run.belief_covariance, run.samples) for run in episode.runs
    ]


@dataclass(frozen=True, eq=False)
class Estimate:
    """What an estimator made of a run, at its samples.

    poses: (M, 3), of a train (N, M, 3). covariance: (M, 3, 3) or (N, M, 3, 3). stated: (M,), whether it had a
    status. Each is None if the estimator gives none.
    """

    poses: Array
    covariance: Array | None
    stated: NDArray[np.bool_] | None

    def among(self, places: NDArray[np.intp]) -> "Estimate":
        """Return the estimate at some of its samples."""
        covariance = None if self.covariance is None else self.covariance[..., places, :, :]
        return Estimate(self.poses[..., places, :], covariance, None if self.stated is None else self.stated[places])


@dataclass(frozen=True)
class Failure:
    """An estimator failed; `reason` goes on the leaderboard."""

    reason: str


class FailedError(Exception):
    """Raised where an estimator or a calibration method fails."""


def estimate_singly(spec: str, source_hash: str, runs: Sequence[ObservedRun]) -> list[Estimate] | Failure:
    """Return the estimate of each run, or how the first failing run failed."""
    estimates = []
    for number, run in enumerate(runs, start=1):
        try:
            entry = loaded(load_estimator, spec, source_hash)
            followed = _follow(entry, run.robot, _Start.of(run), run.observations, run.samples)
        except FailedError as failure:
            return Failure(f"{failure} of run {number}" if "at sample" in str(failure) else str(failure))
        if (wrong := _wrong(followed, run.samples)) is not None:
            return Failure(f"{wrong} of run {number}")
        estimates.append(followed.at(run.samples))
    return estimates


def estimate_stacked(
    spec: str, source_hash: str, episodes: Sequence[Sequence[ObservedRun]]
) -> list[list[Estimate] | Failure] | Failure:
    """Return the estimate of each run of robots' episodes, on stacks of runs alike in layout and length.

    A pose or a covariance that is not finite fails only its episode; any other error fails the whole stack, and the
    parent then tries the episodes one by one.
    """
    runs = [(e, r, run) for e, episode in enumerate(episodes) for r, run in enumerate(episode)]
    groups: dict[tuple, list[tuple[int, int, ObservedRun]]] = {}
    for member in runs:
        groups.setdefault(_stack_key(member[2]), []).append(member)
    estimates: list[list[Any]] = [[None] * len(episode) for episode in episodes]
    failures: dict[int, tuple[int, Failure]] = {}
    for members in groups.values():
        geometry = Geometry.of([_robot_of(run) for _, _, run in members])
        start = _Start(*map(np.stack, zip(*(_Start.of(run) for _, _, run in members), strict=True)))
        observations = Observations.stack([run.observations for _, _, run in members])
        watched = np.unique(np.concatenate([run.samples for _, _, run in members]))
        try:
            together = _follow(loaded(load_estimator, spec, source_hash), geometry, start, observations, watched)
        except FailedError as failure:
            return Failure(str(failure))
        for i, (e, r, run) in enumerate(members):
            followed = together.member(i)
            estimates[e][r] = followed.at(run.samples)
            wrong = _wrong(followed, run.samples)
            if wrong is not None and (e not in failures or r < failures[e][0]):
                failures[e] = (r, Failure(f"{wrong} of run {r + 1}"))
    return [failures[e][1] if e in failures else estimates[e] for e in range(len(episodes))]


class Timed(NamedTuple):
    """What following runs twice showed: CPU times of updates, ns, and whether both passes gave the same poses."""

    spent: list[int]
    repeats: bool


def time_updates(spec: str, source_hash: str, runs: Sequence[ObservedRun], afresh: bool = False) -> Timed | Failure:
    """Return the CPU times of updates of a single vehicle, and whether the same log gives the same poses again.

    Over the first run, or, where it is short, over several runs and repeatedly: at least FEWEST_TIMED updates. The
    first observation of a run, that of the start pose, does not count. Each run is followed twice, and of each sample
    the cheaper update counts: what the sample costs every time is seen, an interruption or a compilation is not. Of a
    smoother it is the whole time, divided by the samples. Poses that differ between the passes come from state that
    is kept between episodes, or from random numbers without a seed.

    afresh: this process has followed none of the runs, and results that are kept of a run (`functools.lru_cache`) are
    not to make its updates look cheap: those of the first pass count, of each run once, after a drive that is nearly
    the same, on which what is compiled has been compiled. `update_cost` leaves out interruptions by a second process.
    """
    spent: list[int] = []
    repeats = True
    try:
        for run in islice(runs if afresh else cycle(runs), FEWEST_TIMED):
            entry = loaded(load_estimator, spec, source_hash)
            start = _Start.of(run)
            if afresh:
                with suppress(FailedError):  # the run itself may not fail
                    _follow(entry, run.robot, start, _nearly(run.observations))
            passes: list[list[int]] = [[], []]
            first, second = (_follow(entry, run.robot, start, run.observations, spent=times).poses for times in passes)
            repeats = repeats and np.allclose(first, second, rtol=0.0, atol=REPEATED, equal_nan=True)
            counted = passes[0] if afresh else list(map(min, *passes))
            spent += counted[1:] or counted
            if len(spent) >= FEWEST_TIMED:
                break
    except FailedError as failure:
        return Failure(str(failure))
    return Timed(spent, repeats)


def update_cost(passes: Sequence[Timed]) -> UpdateCost:
    """Return what an update costs by one process or several that timed the same updates: of each the cheapest."""
    cheapest = [min(times) for times in zip(*(timed.spent for timed in passes), strict=True)]
    return UpdateCost(float(np.mean(cheapest)) / 1e3, max(cheapest) / 1e3, all(timed.repeats for timed in passes))


def _nearly(observations: Observations) -> Observations:
    """Return observations of a drive that is nearly the same, so that no result of one is also one of the other."""
    parts = {name: getattr(observations, name) for name in ("wheel", *OPTIONAL)}
    return replace(observations, **{name: 0.999 * part for name, part in parts.items() if part is not None})


def _stack_key(run: ObservedRun) -> tuple:
    geometry = Geometry.of(_robot_of(run))
    layout = ("wheel_castor", "counts_per_rev", "pivot_counts_per_rev", "standard", "fixed", "driven")
    return (
        *(getattr(geometry, name).tobytes() for name in layout),
        geometry.sample_period,
        geometry.gyro,
        geometry.fixes,
        geometry.tolerances,
        len(run.observations),
        *(getattr(run.observations, part) is None for part in OPTIONAL),
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


@dataclass(frozen=True, eq=False)
class _Followed:
    """What an estimator made of all K samples of a run, or of a stack of runs along leading axes.

    poses: (..., K, 3). covariance (..., 3, 3) and stated (stack): by sample, of those that were watched; None where the
    estimator gives none.
    """

    poses: Array
    covariance: dict[int, Array | None]
    stated: dict[int, Array | None]

    def member(self, i: int) -> "_Followed":
        """Return run i of a stack."""
        parts = ({k: None if one is None else one[i] for k, one in of.items()} for of in (self.covariance, self.stated))
        return _Followed(self.poses[i], *parts)

    def at(self, samples: NDArray[np.intp]) -> Estimate:
        """Return the estimate at some of the samples that were watched."""
        covariances = [one for k in samples.tolist() if (one := self.covariance[k]) is not None]
        stated = [one for k in samples.tolist() if (one := self.stated[k]) is not None]
        return Estimate(
            self.poses[..., samples, :],
            np.stack(covariances, axis=-3) if len(covariances) == len(samples) else None,
            np.stack(stated).astype(bool) if len(stated) == len(samples) else None,
        )


class _Start(NamedTuple):
    """Where runs start: pose (..., 3) and its covariance (..., 3, 3)."""

    pose: Array
    covariance: Array

    @classmethod
    def of(cls, run: ObservedRun) -> "_Start":
        """Return the start of a run."""
        exactly = np.zeros((*run.start.shape, 3))
        return cls(run.start, exactly if run.start_covariance is None else run.start_covariance)

    def told_to(self, function: Callable[..., Any]) -> dict[str, Array]:
        """Return the covariance as an argument for an estimator's function that has a parameter of this name."""
        return {"covariance": self.covariance.copy()} if takes_covariance(function) else {}


def _wrong(followed: _Followed, samples: NDArray[np.intp]) -> str | None:
    """Return what is wrong with what an estimator gave on a run, and at which sample; None if nothing is."""
    bad = np.argwhere(~np.isfinite(followed.poses).all(axis=-1))[:, -1]
    if bad.size:
        return f"returned NaN or infinity at sample {bad.min()}"
    covariances = [(k, followed.covariance[k]) for k in samples.tolist()]
    without = [k for k, covariance in covariances if covariance is None]
    if 0 < len(without) < len(samples):
        return f"has a covariance at some samples, and none at sample {without[0]}"
    problems = ((k, invalid(covariance)) for k, covariance in covariances if covariance is not None)
    return next((f"{problem} at sample {k}" for k, problem in problems if problem is not None), None)


def _follow(
    entry: EstimatorEntry,
    robot: Vehicle | Geometry,
    start: _Start,
    observations: Observations,
    watched: NDArray[np.intp] | None = None,
    spent: list[int] | None = None,
) -> _Followed:
    """Return what a new estimator makes of a run; append the CPU time of each update, ns, to `spent`.

    robot: a single vehicle, or the geometry of a stack of robots. start: its leading axes are those of the stack, or a
    train's axles. watched: the samples at which its covariance and status are asked for; None: at none.
    Warnings of estimators about unusable relative poses or small turns are not shown.
    """
    followed = _Followed(np.empty((*start.pose.shape[:-1], len(observations), 3)), {}, {})
    asked = frozenset(() if watched is None else watched.tolist())
    stack = start.pose.shape[:-1] if isinstance(robot, Geometry) else ()
    stage = "when constructed"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RelativePoseWarning)
            warnings.simplefilter("ignore", SmallTurnWarning)
            estimator = entry.factory()
            if entry.smoother:
                given = observations.copied()
                stage, began = "in estimate", time.process_time_ns()
                answer = estimator.estimate(robot, start.pose.copy(), given, **start.told_to(estimator.estimate))
                end_if_forked()
                if spent is not None:
                    spent += [(time.process_time_ns() - began) // len(observations)] * len(observations)
                poses = _pose(answer, (len(observations), *start.pose.shape), stage)
                followed.poses[...] = np.moveaxis(poses, 0, -2)
                followed.covariance.update(dict.fromkeys(asked))
                followed.stated.update(dict.fromkeys(asked))
                return followed
            stage = "in reset"
            estimator.reset(robot, start.pose.copy(), **start.told_to(estimator.reset))
            end_if_forked()
            for k in range(len(observations)):
                stage = f"in update at sample {k}"
                observation = observations.at(k)
                began = time.process_time_ns()
                answer = estimator.update(observation)
                end_if_forked()
                if spent is not None:
                    spent.append(time.process_time_ns() - began)
                followed.poses[..., k, :] = _pose(answer, start.pose.shape, stage)
                if k in asked:
                    stage = f"at sample {k}"
                    try:
                        followed.covariance[k] = covariance_of(estimator, start.pose.shape)
                        followed.stated[k] = has_status(estimator, stack)
                    except ValueError as error:
                        raise FailedError(f"{message_of(error)} {stage}") from None
                    finally:
                        end_if_forked()
    except FailedError:
        raise
    except BaseException as error:
        end_if_forked()
        if stage in ("in reset", "in estimate") and (reason := _declined(error, robot)) is not None:
            raise FailedError(DECLINED + reason) from None
        raise FailedError(f"{raised(error)} {stage}") from None
    return followed


def _pose(answer: Any, shape: tuple[int, ...], stage: str) -> Array:
    try:
        return real_numbers(answer, shape)
    except ValueError as error:
        raise FailedError(f"returned {error} {stage}") from None


def _declined(error: BaseException, robot: Vehicle | Geometry) -> str | None:
    """Return why an estimator's `reset` declines, as one printable line; None if the exception means something else."""
    # On a stack only a stated `Declined` counts; single runs show the rest.
    return declines(error, robot) if isinstance(error, Declined) or not isinstance(robot, Geometry) else None


def raised(error: BaseException) -> str:
    """Say in one line what a plug-in raised."""
    limit = f" (a worker process may take {MOST_MEMORY / 2**30:.1f} GiB)" if isinstance(error, MemoryError) else ""
    return f"raised {one_line(error)}{limit}"
