"""How far wheels disagree: the part of the encoders' readings that no motion of the body explains.

Wheels whose speeds disagree creep until they agree, so the contact model alone finds nothing improbable in the slip.
But a robot in good order hardly disagrees, as the controller that drives its wheels uses the same description. The
usual disagreement is therefore estimated as a noise level, and what exceeds it is evidence.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from operator import itemgetter

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from estimators.likelihood.creep_prediction import UNEVEN
from estimators.likelihood.elimination import blocks, most_of
from estimators.likelihood.log_likelihood import LogLikelihood
from estimators.likelihood.rolling import Changes

WINDOW, QUICK = 1.0, 0.2
"""s: windows over which disagreement is summed. In the long ones errors of rounding, and of castors that turn between
two commands, average out; how the short ones differ within a long one shows what repeats with each turn of a wheel, or
comes with acceleration. Each kind has its own usual size."""

LEAST = 4e-4
"""Least size of disagreement in a long window, as a part of the way. Rounding alone leaves as much."""

FARTHEST = 2.0
"""Disagreement, in its usual sizes, beyond which Huber's loss is linear and no more quadratic."""

LEAST_KEPT = 1e-3
"""Least part of a row's slip that must show as disagreement with the other rows, so that the slip can be estimated."""

MOST_CAUSED = 1.5
"""Largest factor of the disagreement that is predicted of effects in the model. It is 1 if a controller that does not
know of them holds its wheels at speed, 0 if wheels give way to each other, or what least squares give: as makes the
rest the likeliest."""

MOST_ROUNDS, SETTLED = 10, 0.1
"""Most rounds in which it is found by how much each row disagrees more, and the change, in standard errors, at which
they end: the usual size follows what is left."""

BY_TURNING = (0.0, *np.geomspace(1e-5, 1e-2, 16).tolist())
"""Amounts that are tried of disagreement of contacts that motors turn on the floor, m after 1 rad."""

BODY = 3
"""Degrees of freedom of the body's motion, which is fitted to the rows of every step."""

LASTING = (0.9, 0.95, 0.98)
"""Correlations that are tried of disagreement in neighbouring long windows that lasts: on a circle it is the same all
the time, so that its windows are hardly more than one measurement."""

MEDIAN = 0.6745
"""Median of the absolute value of a standard normal number."""

Sizes = tuple[float, float]
"""Standard deviations of disagreement as a part of the way: along the wheel's rolling, and to its side."""


@dataclass(frozen=True, eq=False)
class Disagreement:
    """The disagreement of wheels in one log, summed over W windows, as a part of the way rolled in each window.

    seen (W, rows): disagreement that the robot's effects do not cause; doubt (W, rows): standard deviation of what they
    cause. uneven (W, rows): what one row may disagree more, for each standard deviation of one number of that row,
    which all windows share; in `seen` it has its likeliest value. turned (W, rows): standard deviation of what motors
    that turn contacts on the floor cause, if that is 1 m after 1 rad. by_size (W, rows, C): change of disagreement per
    unit of each candidate's size, in single precision. counted (W,): windows that count. along (rows,): true for
    rolling constraints, false for side slip. t (W,): when windows begin, s. way (K - 1,): way of every step, the mean
    of its window. steps (W,): number of steps in each window. quick: information (C, C), score (C,) and log-likelihood
    by how short windows differ within these, and product (rows, C) of changes by sizes and of `uneven` there, and its
    square (rows,). share: part of what the robot's effects cause that is there; NaN: they cause none.
    """

    seen: Array
    doubt: Array
    uneven: Array
    turned: Array
    by_size: NDArray[np.float32]
    counted: NDArray[np.bool_]
    along: NDArray[np.bool_]
    t: Array
    way: Array
    steps: NDArray[np.intp]
    quick: tuple[Array, Array, float, Array, Array]
    share: float

    @classmethod
    def of(
        cls, model: LogLikelihood, changes: Changes, t: Array, caused: Array, released: NDArray[np.bool_]
    ) -> "Disagreement":
        """Return the disagreement of a log beyond that (K - 1, rows) which the robot's effects cause, or the part of
        this that explains most.

        changes: of the candidates' sizes. t (K,): times of samples, s.
        released (K - 1, rows): steps in which a contact may slip freely; their windows do not count.
        """
        geometry, state = changes.geometry, changes.state
        seen, way = model.disagreement(geometry, state), np.abs(model.rolled(geometry, state)).max(axis=1)
        short = max(round(QUICK / np.median(np.diff(t))), 1)
        parts = max(round(WINDOW / np.median(np.diff(t)) / short), 1)
        starts = np.arange(0, len(way), parts * short)
        rolled = _rolled(way, starts)
        counted = ~np.logical_or.reduceat(released.any(axis=1), starts)
        along = model.rows < len(geometry.radius)
        turns = model.turned(geometry, state)
        turned = _part_of_way(turns, starts, rolled)
        shares = [(0.0, 0.0)]
        if np.any(caused):
            free = ~released.any(axis=1)
            share = float(np.clip(np.sum((seen * caused)[free]) / np.sum(caused[free] ** 2), 0.0, MOST_CAUSED))
            shares = [(1.0, 0.0), (0.0, 0.0), (share, 0.0)]
            shares += [(share, UNEVEN * float(np.hypot(share, 1 - share)))]  # by row: what vanishes, and what is left

        def beside(left: Array, uneven: Array) -> tuple[Array, _Quick, Array, Array, float]:
            """Return disagreement in long and short windows, score and information on what each row disagrees more,
            and the log-likelihood."""
            of_way = np.add.reduceat(left, starts, axis=0) / rolled[:, None]
            quick = _Quick.of(left, uneven, turns, way, short, parts, along, counted)
            usual = _usual(of_way, counted, along, turned)
            independent = usual.whitened(of_way)
            weight, likely = _weighed(independent, usual, counted)
            by_quick, quickly = quick.by_row()
            shown = usual.whitened(np.add.reduceat(uneven, starts, axis=0) / rolled[:, None]) * weight
            score, information = np.sum(independent * weight * shown, axis=0), 1 + np.sum(shown**2, axis=0)
            return of_way, quick, score + by_quick, information + quickly, likely + quick.likely

        found = []
        for share, by_row in shares:
            left, uneven, more = seen - share * caused, by_row * caused, np.zeros(len(along))
            of_way, quick, score, information, likely = beside(left, uneven)
            for _ in range(MOST_ROUNDS if by_row else 0):
                change = (score - more) / information
                more = more + change
                of_way, quick, score, information, likely = beside(left - more * uneven, uneven)
                if np.all(np.abs(change) < SETTLED * information**-0.5):
                    break
            unlikely = float(np.sum(more**2)) / 2
            quick.likely -= unlikely
            likely -= unlikely + float(np.sum(np.log(information))) / 2
            found.append((likely, of_way, quick, share, uneven))
        _, of_way, quick, share, uneven = max(found, key=itemgetter(0))
        doubt, uneven = (
            np.add.reduceat(of_steps, starts, axis=0) / rolled[:, None]
            for of_steps in (UNEVEN * np.abs(share * caused), uneven)
        )
        by_size = []
        most = most_of(len(changes.change) + changes.readings.shape[-1] + changes.slips.shape[-1])
        for steps in blocks(len(way), max(most // (parts * short), 1) * parts * short):
            by_step = model.agreement_by(changes, steps)
            first = steps.start // (parts * short)
            sums = np.add.reduceat(by_step, np.arange(0, len(by_step), parts * short))
            by_size.append((sums / rolled[first : first + len(sums), None, None]).astype(np.float32))
            quick.add(by_step, steps)
        steps = np.diff(np.append(starts, len(way)))
        way = np.repeat(rolled / steps, steps)
        return cls(
            seen=of_way,
            doubt=doubt,
            uneven=uneven,
            turned=turned,
            by_size=np.concatenate(by_size),
            counted=counted,
            along=along,
            t=t[starts],
            way=way,
            steps=steps,
            quick=quick.statistics(),
            share=share if len(shares) > 1 else np.nan,
        )

    def sizes(self) -> Sizes:
        """Return the usual size of disagreement, by the median, so that exceptional windows do not affect it."""
        along, across = (_size(self.seen[self.counted][:, rows]) for rows in (self.along, ~self.along))
        return along, across

    @cached_property
    def _noise(self) -> "_Usual":
        return _usual(self.seen, self.counted, self.along, self.turned)

    @property
    def usual(self) -> Array:
        """The usual size (W, rows) of disagreement in every window, with the likeliest amount for contacts that motors
        turn on the floor. The slip that the fit sees there is no measure of it: that is larger with a wrong model."""
        return self._noise.size

    @cached_property
    def scale(self) -> Array:
        """The usual size (W, rows) beside the effects in the model: where these cause much, it is larger. By medians
        alone, so that what happens at times, and lasts then, does not affect it."""
        usual = _usual(self.seen, self.counted, self.along, self.turned, may_last=False)
        return np.hypot(usual.size, self.doubt)

    def beside(self, columns: Sequence[int]) -> Array:
        """Return the disagreement (W, rows) in units of its `scale`, after least squares of these columns; 0 in windows
        that do not count."""
        scale = self.scale
        left = (self.counted[:, None] * self.seen / scale).reshape(-1)
        if len(columns):
            by_size = (self.by_size[..., list(columns)] / scale[..., None]).reshape(len(left), len(columns))
            by_size = np.repeat(self.counted, self.seen.shape[1])[:, None] * by_size
            left = left - by_size @ np.linalg.lstsq(by_size, left, rcond=1e-9)[0]
        return left.reshape(self.seen.shape)

    def slips(self, row: int, size: Array) -> Array:
        """Return the slips of every step (K - 1, rows, 1), m, where one row disagrees by `size` (W,), as a part of the
        way."""
        slips = np.zeros((len(self.way), len(self.along), 1))
        slips[:, row, 0] = np.repeat(size, self.steps) * self.way
        return slips

    def statistics(self) -> tuple[Array, Array, float]:
        """Return information and score of sizes (C,) and of the masked amount of each (C,), and the log-likelihood
        where all of these are 0."""
        seen, uneven = self._noise.whitened(self.seen), self._noise.whitened(self.uneven)
        weight, likely = _weighed(seen, self._noise, self.counted)
        by_size, seen, uneven = self._noise.whitened(self.by_size) * weight[..., None], seen * weight, uneven * weight
        columns = by_size.reshape(self.seen.size, -1)
        information, score = columns.T @ columns, columns.T @ seen.reshape(-1)
        crossed = np.einsum("wr,wrc->rc", uneven, by_size) + self.quick[3]
        of_rows = 1 + np.sum(uneven**2, axis=0) + self.quick[4]
        information = information + self.quick[0] - (crossed.T / of_rows) @ crossed
        score, likely = score + self.quick[1], likely + self.quick[2] - float(np.sum(np.log(of_rows))) / 2
        masked = np.array([[1.0, -1.0], [-1.0, 1.0]])  # the masked amount of a size disagrees less by as much
        return np.kron(masked, information).astype(np.float64), np.concatenate([score, -score]), likely


class _Quick:
    """How the disagreement in short windows differs within long ones, as a part of the way, and the statistics of
    sizes by it, which are summed block by block: there are too many windows to keep how each changes by every size."""

    def __init__(self, rolled: Array, way: Array, short: int, parts: int) -> None:
        """rolled, way (V,): way of each of V short windows, and the same as a divisor. short: steps in a short window;
        parts: short windows in a long one."""
        self._rolled, self._way, self._short, self._parts = rolled, way, short, parts
        self._seen = self._weight = self._uneven = np.zeros((0, 0))
        self._sums: tuple[Array | float, Array | float, Array | float] = (0.0, 0.0, 0.0)
        self.likely = 0.0

    @classmethod
    def of(
        cls,
        disagreement: Array,
        uneven: Array,
        turns: Array,
        way: Array,
        short: int,
        parts: int,
        along: NDArray[np.bool_],
        counted: NDArray[np.bool_],
    ) -> "_Quick":
        """Return this for the disagreement (K - 1, rows) in steps, m, of this way (K - 1,), and for what each row may
        disagree more, likewise; turns (K - 1, rows): variance of what motors that turn contacts on the floor cause;
        counted (W,): long windows that count."""
        starts = np.arange(0, len(way), short)
        quick = cls(_rolled(way, starts), np.add.reduceat(way, starts), short, parts)
        quick._seen = quick._differences(disagreement, slice(0, len(way)))
        counts = np.repeat(counted, parts)[: len(starts)]
        sizes = (_size(quick._seen[counts][:, rows], parts * LEAST) for rows in (along, ~along))
        turned = _part_of_way(turns, starts, quick._rolled)
        free = (parts - 1) / parts
        quick._uneven = quick._differences(uneven, slice(0, len(way)))
        usual = _with_turning(
            quick._seen, _Usual.independent(np.where(along, *sizes), len(counts)), counts, turned, free
        )
        weight, quick.likely = _weighed(usual.whitened(quick._seen), usual, counts, free)
        quick._weight = weight / usual.size
        return quick

    def add(self, by_size: Array, steps: slice) -> None:
        """Add a block of steps that begins with a long window; by_size (k, rows, C): change of disagreement, m."""
        differences = self._differences(by_size, steps)
        windows = slice(steps.start // self._short, steps.start // self._short + len(differences))
        seen = (self._seen * self._weight)[windows].reshape(-1)
        columns = (differences * self._weight[windows, :, None]).reshape(len(seen), by_size.shape[-1])
        information, score, crossed = self._sums
        uneven = (self._uneven * self._weight**2)[windows]
        crossed = crossed + np.einsum("vr,vrc->rc", uneven, differences)
        self._sums = information + columns.T @ columns, score + columns.T @ seen, crossed

    def by_row(self) -> tuple[Array, Array]:
        """Return score and information (rows,) of what each row disagrees more, in its standard deviations."""
        shown = self._uneven * self._weight
        return np.sum(self._seen * self._weight * shown, axis=0), np.sum(shown**2, axis=0)

    def statistics(self) -> tuple[Array, Array, float, Array, Array]:
        """Return information (C, C) and score (C,) of sizes, the log-likelihood where all are 0, the product (rows, C)
        of changes by sizes and of what each row may disagree more, and the square (rows,) of that."""
        information, score, crossed = (np.asarray(of_sizes) for of_sizes in self._sums)
        return information, score, self.likely, crossed, self.by_row()[1]

    def _differences(self, by_step: Array, steps: slice) -> Array:
        """Return sums over short windows (v, ...) beyond their share of the long window's sum, over the way."""
        sums = np.add.reduceat(by_step, np.arange(0, len(by_step), self._short))
        first = steps.start // self._short
        way, rolled = (
            of[first : first + len(sums)].reshape(-1, *[1] * (sums.ndim - 1)) for of in (self._way, self._rolled)
        )
        longs = np.arange(0, len(sums), self._parts)
        whole = np.add.reduceat(sums, longs) / np.maximum(np.add.reduceat(way, longs), 1e-12)
        return (sums - np.repeat(whole, self._parts, axis=0)[: len(sums)] * way) / rolled


def _rolled(way: Array, starts: NDArray[np.intp]) -> Array:
    """Return the way (W,) in windows, m; at rest, where nothing says how far, a part of what is usual."""
    rolled = np.add.reduceat(way, starts)
    return np.hypot(rolled, np.median(rolled) / 4) + 1e-9


def _part_of_way(variance: Array, starts: NDArray[np.intp], rolled: Array) -> Array:
    """Return standard deviations of sums over windows (W, ...), as a part of the way (W,), from variances of steps."""
    return np.sqrt(np.add.reduceat(variance, starts, axis=0)) / rolled[:, None]


@dataclass(frozen=True, eq=False)
class _Usual:
    """Usual disagreement: its size (W, rows), and its correlation (W, rows) with that of the window before."""

    size: Array
    correlation: Array

    @classmethod
    def independent(cls, size: Array, count: int) -> "_Usual":
        """Return this for windows, so many, that do not correlate; size (rows,)."""
        return cls(np.tile(size, (count, 1)), np.zeros((count, len(size))))

    def whitened(self, values: Array | NDArray[np.float32]) -> Array:
        """Return values (W, rows, ...) in units of the size, without what the window before lets expect: of usual
        disagreement the standard deviation is 1, and nothing correlates."""
        size, correlation = (of.reshape(*of.shape, *[1] * (values.ndim - 2)) for of in (self.size, self.correlation))
        units = values / size
        units[1:] -= correlation[1:] * units[:-1]
        return units / np.sqrt(1 - correlation**2)


def _usual(
    seen: Array, counted: NDArray[np.bool_], along: NDArray[np.bool_], turned: Array, may_last: bool = True
) -> _Usual:
    """Return the usual disagreement, by medians, with the likeliest amount for contacts that motors turn. It may last
    where no motor turns contacts: where one does, it comes with turning."""
    lasting = may_last and not np.any(turned)
    kinds = np.array([_correlated(seen[:, rows], counted, lasting) for rows in (along, ~along)])
    size, correlation = np.where(along[:, None], *kinds).T
    usual = _Usual(np.tile(size, (len(seen), 1)), np.outer(_linked(counted), correlation))
    return _with_turning(seen, usual, counted, turned)


def _linked(counted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which windows (W,) follow another one that counts."""
    return counted & np.concatenate([[False], counted[:-1]])


def _with_turning(seen: Array, usual: _Usual, counted: NDArray[np.bool_], turned: Array, free: float = 1.0) -> _Usual:
    """Return usual disagreement with the likeliest amount for contacts that motors turn."""
    each = [replace(usual, size=np.hypot(usual.size, by_turning * turned)) for by_turning in BY_TURNING]
    return max(each, key=lambda one: _weighed(one.whitened(seen), one, counted, free)[1])


def _weighed(seen: Array, usual: _Usual, counted: NDArray[np.bool_], free: float = 1.0) -> tuple[Array, float]:
    """Return the weights (W, rows) of disagreements that are whitened, and their log-likelihood; beyond `FARTHEST`
    times its usual size the loss of a disagreement is linear, no more quadratic.

    free: part of the windows that are independent. A motion of the body has been fitted to each step, so of n rows
    n - 3 are, and the others follow from these.
    """
    free *= max(seen.shape[1] - BODY, 0) / seen.shape[1]
    off = np.abs(seen)
    weight: Array = np.sqrt(free * np.minimum(FARTHEST / np.maximum(off, 1e-12), 1.0)) * counted[:, None]
    volume = np.log(usual.size) + np.log1p(-(usual.correlation**2)) / 2
    return weight, -free * float(np.sum((volume + _loss(off))[counted]))


def _loss(off: Array) -> Array:
    """Return Huber's loss of disagreements in their usual sizes."""
    return np.where(off > FARTHEST, FARTHEST * (off - FARTHEST / 2), off**2 / 2)


def _correlated(seen: Array, counted: NDArray[np.bool_], lasting: bool) -> tuple[float, float]:
    """Return the size of disagreement (W, rows) of one kind, and the correlation of neighbouring windows, with which it
    is the likeliest: 0, or, if it may last, one of `LASTING`, where what is new in each window is at least `LEAST`."""
    if not seen[counted].size:
        return LEAST, 0.0
    linked, found = _linked(counted), []
    for correlation in (0.0, *(LASTING if lasting else ())):
        alone = _Usual(np.ones(seen.shape), np.full(seen.shape, correlation) * linked[:, None])
        off = np.abs(alone.whitened(seen)[counted])
        least = LEAST / math.sqrt(1 - correlation**2)
        size = max(float(np.median(off)) / MEDIAN, least) if correlation else _size(seen[counted])
        volume = off.size * math.log(size) + float(np.sum(np.log1p(-(alone.correlation[counted] ** 2)))) / 2
        found.append((volume + float(np.sum(_loss(off / size))), size, correlation))
    _, size, correlation = min(found)
    return size, correlation


def of_row(model: LogLikelihood, geometry: Geometry, state: Array, row: int) -> tuple[Array, Array]:
    """Return by how much a row disagrees with the other rows in every step (K - 1,), m, and the change of it per metre
    of slip of that row."""
    slips = np.zeros((len(state) - 1, len(model.rows)))
    slips[:, row] = 1.0
    by_slip = model.explained(geometry, state, slips) - slips
    return model.disagreement(geometry, state)[:, row], -by_slip[:, row]


def slip_of_row(model: LogLikelihood, geometry: Geometry, state: Array, row: int) -> tuple[Array, NDArray[np.bool_]]:
    """Return the slip of a row in every step (K - 1,), m, if no other row slips, and where (K - 1,) the other rows tell
    it."""
    seen, by_slip = of_row(model, geometry, state, row)
    return seen / np.maximum(by_slip, LEAST_KEPT), by_slip > LEAST_KEPT


def _size(seen: Array, least: float = LEAST) -> float:
    """Return the size of disagreement (W, rows), inflated where neighbouring windows correlate, as these are fewer
    independent measurements."""
    if not seen.size:
        return least
    size = max(float(np.median(np.abs(seen))) / MEDIAN, least)
    held = np.clip(seen / size, -FARTHEST, FARTHEST)
    alike = float(np.mean(held[1:] * held[:-1]) / max(np.mean(held**2), 1e-12)) if len(seen) > 1 else 0.0
    alike = min(max(alike, 0.0), 0.9)
    return size * float(np.sqrt((1 + alike) / (1 - alike)))
