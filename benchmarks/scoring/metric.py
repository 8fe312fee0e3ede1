"""What a metric is, and what it is computed from. A new metric goes into `METRICS` of a module beside this one."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, wraps
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.tasks.task import Episode, Run
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.robot import RobotDescription

T = TypeVar("T")

MM: dict[str, Any] = {"unit": "m", "shown_unit": "mm", "factor": 1e3}
DEG: dict[str, Any] = {"unit": "rad", "shown_unit": "deg", "factor": 180.0 / np.pi}
PER_CENT: dict[str, Any] = {"unit": "1", "shown_unit": "%", "factor": 100.0}
"""Units of many metrics: the SI unit, the unit shown to people, and the factor between them."""


class Path(NamedTuple):
    """A scored run: the true and the estimated poses (M, 3) at its samples, of a train's axles (N, M, 3)."""

    run: Run
    true: Array
    estimate: Array


@dataclass(frozen=True, eq=False)
class Judged:
    """What metrics are computed from: an episode, and what an estimator or a calibration method made of it.

    estimates: for each run, the poses (M, 3) at `Run.samples`, of a train (N, M, 3). calibrated: the robot as a
    calibration method returned it. covariances: for each run (M, 3, 3), of a train (N, M, 3, 3), in the world's axes,
    m and rad; stated: for each run (M,), whether the estimator had a status. None where it gives none; both are ()
    where that is not known. Raises ValueError for estimates of another shape than the truth.
    """

    episode: Episode
    estimates: Sequence[Array]
    calibrated: RobotDescription | None = None
    covariances: Sequence[Array | None] = ()
    stated: Sequence[NDArray[np.bool_] | None] = ()
    _computed: dict[Any, Any] = field(default_factory=dict, init=False, repr=False)

    def __post_init__(self):
        for run, estimate in zip(self.episode.runs, self.estimates, strict=True):
            if estimate.shape != run.truth.shape:
                raise ValueError(f"estimates of shape {estimate.shape} for {run.truth.shape} evaluated poses")

    @cached_property
    def paths(self) -> list[Path]:
        """All runs, those on the clean floor that only give the systematic error (`Run.baseline`) too.

        Estimates lie in memory as they are read from files, since by that order sums are rounded.
        """
        estimated = map(np.ascontiguousarray, self.estimates)
        return [Path(run, run.truth, estimate) for run, estimate in zip(self.episode.runs, estimated, strict=True)]

    @cached_property
    def scored(self) -> list[Path]:
        """The runs that are scored themselves; there is at least one."""
        return [path for path in self.paths if not path.run.baseline]

    @cached_property
    def of_train(self) -> bool:
        """Whether the poses are those of a train's axles."""
        return self.episode.runs[0].axles is not None


def shared(function: Callable[[Judged], T]) -> Callable[[Judged], T]:
    """Compute something once for all metrics that need it, for each `Judged`."""

    @wraps(function)
    def computed_once(judged: Judged) -> T:
        if function not in judged._computed:
            judged._computed[function] = function(judged)
        return judged._computed[function]

    return computed_once


class Column(NamedTuple):
    """A metric's column on a terminal's board.

    place: columns stand by rising place. keep: where a terminal is too narrow for all, columns of lower `keep` go
    first; the mean time of an update has `TIME_KEEP`, the worst `WORST_TIME_KEEP`, the interval of the ranking metric
    `INTERVAL_KEEP`.
    """

    place: int
    keep: int


TIME_KEEP, WORST_TIME_KEEP, INTERVAL_KEEP = 40, 12, 160


@dataclass(frozen=True)
class Metric:
    """A metric: how it is computed, its name and units, and how people are shown it.

    compute: returns the value in SI, None where the metric does not apply, NaN where the paths are too short for it.
    key: the name in JSON, with the SI `unit`. title: its heading; short: the one in a terminal, in `shown_unit`, which
    is `factor` times SI. place: in lists of all metrics, by rising number. ranks: whether a task may rank by it, lower
    being better. column: None: only Markdown and JSON show it. on_boards: False: it is stored and never shown.
    """

    name: str
    compute: Callable[[Judged], Any]
    unit: str
    key: str
    title: str
    short: str
    shown_unit: str
    factor: float
    description: str
    place: int
    ranks: bool = True
    column: Column | None = None
    on_boards: bool = True

    def value(self, judged: Judged) -> float | None:
        """Return the value in SI, None where the metric does not apply."""
        value = self.compute(judged)
        return None if value is None else float(value)

    def shown(self, value: float | None) -> str:
        """Return a value in SI as text in the unit for people; rounding errors are shown as 0."""
        if value is None:
            return "–"
        return f"{value * self.factor if abs(value) > self.rounding else 0.0:#.4g}".rstrip(".")

    @property
    def rounding(self) -> float:
        """Values up to this, in SI, are shown as 0: 1e-6 of the unit for people, or 1e-9 m; poses round to 2e-15 m."""
        return 1e-6 / self.factor

    @property
    def within(self) -> tuple[float, float]:
        """Range of its mean: nothing is negative, and shares, which are shown in %, are at most 1."""
        return (0.0, math.inf if self.ranks or self.shown_unit != "%" else 1.0)
