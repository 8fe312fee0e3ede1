"""What is shown: the drives of an episode or of a log, with the poses that estimators gave."""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from benchmarks.run.worker_estimate import ObservedRun
from benchmarks.tasks.task import Episode
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import OPTIONAL, REQUIRED, Log, poses_taken, positions_taken
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription
from estimators.likelihood.log_likelihood import LogLikelihood

MOST_POSES = 1000
"""Of a drive that are shown, spread evenly, and as many again where a reference was taken."""
DENSE = 1.0
"""s: a reference that is taken this often, in the median, shows the path between its poses."""


@dataclass(frozen=True, eq=False)
class Drive:
    """One drive: a log of a vehicle, and what estimators made of it.

    start: where they started, (3,), of a train (N, 3). samples (M,): those at which their poses are known. estimates:
    by name, (M, 3), of a train (N, M, 3). floor: what was driven on, None where nobody knows. start_covariance: of the
    start, (3, 3) or (N, 3, 3), m and rad; None where it is the true pose.
    """

    name: str
    vehicle: Vehicle
    log: Log
    start: Array
    samples: NDArray[np.intp]
    floor: Floor | None = None
    estimates: Mapping[str, Array] = field(default_factory=dict)
    start_covariance: Array | None = None

    @property
    def observed(self) -> ObservedRun:
        """What estimators get of it."""
        return ObservedRun.of(self.vehicle, self.log, self.start, self.start_covariance, self.samples)

    @cached_property
    def truth(self) -> Array:
        """The reference poses at the samples, (M, 3) or (N, M, 3); NaN where none was taken."""
        reference = self.log.reference
        rows = np.full((len(self.samples), self.start.size), np.nan) if reference is None else reference[self.samples]
        return rows if self.start.ndim == 1 else rows.reshape(len(rows), -1, 3).swapaxes(0, 1)

    @cached_property
    def known(self) -> NDArray[np.bool_]:
        """At which samples (M,) there is a reference, of a robot a position at least."""
        return np.asarray(np.isfinite(self.truth.reshape(-1, len(self.samples), 3)[..., 0]).all(axis=0))

    @cached_property
    def headed(self) -> NDArray[np.bool_]:
        """At which samples (M,) there is a whole reference pose."""
        return np.asarray(np.isfinite(self.truth.reshape(-1, len(self.samples), 3)).all(axis=(0, 2)))

    @cached_property
    def dense(self) -> bool:
        """Whether the reference shows the path."""
        reference = self.log.reference
        taken = self.log.t[:0] if reference is None else self.log.t[np.isfinite(reference[:, 0])]
        return len(taken) > 2 and float(np.median(np.diff(taken))) <= DENSE

    @cached_property
    def way(self) -> Array:
        """How far it had driven at the samples (M,), m: by the reference where that is dense, else by the wheels."""
        if self.dense:
            assert self.log.reference is not None
            taken = np.isfinite(self.log.reference[:, 0])
            t, places = self.log.t[taken], self.log.reference[taken, :2]
            driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))])
        else:
            robots = self.vehicle.modules if isinstance(self.vehicle, TrainDescription) else (self.vehicle,)
            wheels = [robot.wheels[k] for robot in robots for k in robot.driven_wheels]
            metres = np.array([2 * np.pi * wheel.radius / (wheel.counts_per_rev or np.inf) for wheel in wheels])
            rolled = np.abs(np.diff(self.log.wheel, axis=0)) @ metres / len(metres)
            t, driven = self.log.t, np.concatenate([[0.0], np.cumsum(rolled)])
        return np.interp(self.log.t[self.samples], t, driven)

    def errors(self, name: str) -> tuple[Array, Array]:
        """Return how far an estimate is off at the samples (M,), m, and in heading, rad; of a train, the axles' means.

        NaN where there is no reference. Heading errors keep their sign.
        """
        off = self.estimates[name] - self.truth
        position, heading = np.hypot(off[..., 0], off[..., 1]), off[..., 2]
        return (position, heading) if self.start.ndim == 1 else (position.mean(axis=0), heading.mean(axis=0))

    def path(self, axle: int = 0) -> Array:
        """Return the places (k, 2) that the reference shows, m, of a train's axle, with NaN at its gaps."""
        assert self.log.reference is not None
        return self._with_gaps(self.log.t, self.log.reference[:, 3 * axle : 3 * axle + 2])

    def against_way(self, values: Array) -> tuple[Array, Array]:
        """Return the distance driven (k,), m, and values (k,) of those at the samples (M,) that are known, with NaN at
        the gaps of the reference."""
        x, y = self._with_gaps(self.log.t[self.samples], np.column_stack([self.way, values])).T
        at = np.flatnonzero(np.isnan(y))
        x[at] = (x[at - 1] + x[at + 1]) / 2
        return x, y

    def _with_gaps(self, t: Array, values: Array) -> Array:
        """Return the rows that are known of values (K, c) at times t (K,), and between them, where a dense reference
        has a gap, a row of NaN."""
        known = np.isfinite(values).all(axis=1)
        t, values = t[known], values[known]
        return np.insert(values, np.flatnonzero(np.diff(t) > DENSE) + 1, np.nan, axis=0) if self.dense else values

    def followed(self, estimates: Mapping[str, Array]) -> "Drive":
        """Return the drive with estimates in place of those that it has."""
        return dataclasses.replace(self, estimates=estimates)


@dataclass(frozen=True, eq=False)
class Shown:
    """What a page is about. failed: by estimator, why it has no poses. scores: by estimator and metric, in SI.

    commands: lines that repeat what the page shows. origin: what stands under provenance, by what it is.
    """

    title: str
    subtitle: str
    drives: Sequence[Drive]
    failed: Mapping[str, str] = field(default_factory=dict)
    scores: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    commands: Sequence[str] = ()
    origin: Mapping[str, str] = field(default_factory=dict)

    @property
    def estimators(self) -> list[str]:
        """The names of all estimators that gave poses, in their order."""
        return list(dict.fromkeys(name for drive in self.drives for name in drive.estimates))


def drives_of(episode: Episode, stored: bool = False) -> list[Drive]:
    """Return the drives of an episode; those that only give the systematic error come as well.

    stored: for estimates as results keep them, at `Run.samples` alone; else for more poses between these.
    """
    names = names_of(episode)
    return [
        Drive(
            name,
            episode.robot,
            run.log,
            run.start,
            run.samples if stored or run.belief is not None else np.union1d(run.samples, _evenly(len(run.log))),
            run.floor,
            start_covariance=run.belief_covariance,
        )
        for name, run in zip(names, episode.runs, strict=True)
    ]


def names_of(episode: Episode) -> list[str]:
    """Return what to call the runs of an episode."""
    return [
        ", ".join(filter(None, [f"run {k}", run.direction, "baseline" if run.baseline else None]))
        for k, run in enumerate(episode.runs, start=1)
    ]


def drive_of(name: str, vehicle: Vehicle, log: Log, floor: Floor | None = None) -> Drive:
    """Return the drive of a log, from its first reference pose on; without any, it starts at x = y = psi = 0.

    Where the reference has positions alone, it starts at the first one, with the heading of odometry that is turned to
    follow them there.
    """
    known = poses_taken(log) if len(poses_taken(log)) else positions_taken(log)
    if len(known) and known[0] > 0:
        log, known = _from_row(log, int(known[0])), known - known[0]
    if len(known):
        assert log.reference is not None
        start = log.reference[0] if log.reference.shape[1] == 3 else log.reference[0].reshape(-1, 3)
        if isinstance(vehicle, RobotDescription) and np.isnan(start[2]):
            start = LogLikelihood(Geometry.of(vehicle), log).guessed[0]
    else:
        start = _origin(vehicle)
    return Drive(name, vehicle, log, start, np.union1d(_evenly(len(log)), known[_evenly(len(known))]), floor)


def _origin(vehicle: Vehicle) -> Array:
    """Return the pose at the origin; of a train, all axles' poses, straight, its front axle there."""
    if not isinstance(vehicle, TrainDescription):
        return np.zeros(3)
    behind = np.cumsum([0.0, *(frame.length for frame in vehicle.frames)])
    return np.column_stack([-behind, np.zeros((len(behind), 2))])


def _evenly(rows: int) -> NDArray[np.intp]:
    """Return at most `MOST_POSES` of so many rows, the first and the last with them."""
    return np.unique(np.linspace(0, max(rows - 1, 0), min(rows, MOST_POSES)).astype(np.intp))


def _from_row(log: Log, first: int) -> Log:
    """Return a log without its first rows."""
    parts = {name: getattr(log, name) for name in (*REQUIRED, *OPTIONAL)}
    kept = {name: values[first:] for name, values in parts.items() if values is not None}
    return dataclasses.replace(log, **kept, extra={name: cells[first:] for name, cells in log.extra.items()})
