"""How far wheels disagree: the part of the encoders' readings that no motion of the body explains.

Wheels whose speeds disagree creep until they agree, so the contact model alone finds nothing improbable in the slip.
But a robot in good order hardly disagrees, as the controller that drives its wheels uses the same description. The
usual disagreement is therefore estimated as a noise level, and what exceeds it is evidence.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
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
from estimators.likelihood.statistics import least_squares

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

TURNED = 1e-3
"""m after 1 rad: prior standard deviation of what contacts that motors turn on the floor slip on average, along and
across, alike on all castors: they hardly turn about the middle of a tyre, but about a point of its contact patch. Four
clean logs of a `powered-caster` to and fro show 0.9 to 1.4 mm across."""

BODY = 3
"""Degrees of freedom of the body's motion, which is fitted to the rows of every step."""

LASTING = (0.0, 0.9, 0.95, 0.98)
"""Correlations that are tried of disagreement in neighbouring long windows, in which no motor turns contacts. It may
last: on a circle it is the same all the time, so that its windows are hardly more than one measurement, and wheels that
were driven against each other as castors turned go on so until these turn again, by about 1 rad."""

MEDIAN = 0.6745
"""Median of the absolute value of a standard normal number."""


@dataclass(frozen=True, eq=False)
class Disagreement:
    """The disagreement of wheels in one log, summed over W windows, as a part of the way rolled in each window.

    seen (W, rows): disagreement that the robot's effects do not cause; doubt (W, rows): standard deviation of what they
    cause. shared (W, rows, n): disagreement for each standard deviation of n numbers that all windows share: what
    contacts slip on average as motors turn them (`TURNED`), and by how much more or less of what effects cause is there
    in each row (`UNEVEN`); in `seen` they have their likeliest values. turned (W, rows): standard deviation of what
    motors that turn contacts on the floor cause, if that is 1 m after 1 rad; linked (W, rows): part that turning leaves
    of what was there in the window before. by_size (W, rows, C): change of disagreement per unit of each candidate's
    size, in single precision. counted (W,): windows that count. along (rows,): true for rolling constraints, false for
    side slip. t (W,): when windows begin, s. way (K - 1,): way of every step, the mean of its window. steps (W,):
    number of steps in each window. quick: information (C, C), score (C,) and log-likelihood by how short windows differ
    within these, and products of `shared` there with changes by sizes (n, C) and with itself (n, n). share: part of
    what the robot's effects cause that is there, in the first way; NaN: they cause none.
    """

    seen: Array
    doubt: Array
    shared: Array
    turned: Array
    linked: Array
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
        """Return the disagreement of a log beyond that which the robot's effects cause, or the parts of this that
        explain most.

        changes: of the candidates' sizes. t (K,): times of samples, s. caused (K - 1, rows, c): by the effects in c
        ways, of which the first may be all there is.
        released (K - 1, rows): steps in which a contact may slip freely; their windows do not count.
        """
        geometry, state = changes.geometry, changes.state
        seen, way = model.disagreement(geometry, state), np.abs(model.rolled(geometry, state)).max(axis=1)
        short = max(round(QUICK / np.median(np.diff(t))), 1)
        parts = max(round(WINDOW / np.median(np.diff(t)) / short), 1)
        starts = np.arange(0, len(way), parts * short)
        rolled = way_of(way, starts)
        counted = ~np.logical_or.reduceat(released.any(axis=1), starts)
        along = model.rows < len(geometry.radius)
        turns = model.turned(geometry, state)
        turned = _part_of_way(np.abs(turns), starts, rolled)
        linked = np.where(_linked(counted)[:, None], np.exp(-np.add.reduceat(np.abs(turns), starts, axis=0)), 0.0)
        by_turning = _by_turning(model, geometry, state, turns, along)
        ways, free = np.eye(caused.shape[-1]), ~released.any(axis=1)
        shares = [(0 * np.sum(ways, axis=0), False)]
        shares += [(ways[0], False)] if np.any(caused) else []
        for count in 1 + np.flatnonzero(np.any(caused, axis=(0, 1))):
            of_ways = caused[free, :, :count].reshape(-1, count)
            fitted = least_squares(of_ways, seen[free].reshape(-1))
            share = np.clip(fitted, 0.0, MOST_CAUSED) @ ways[:count]
            shares += [(share, False), (share, True)]

        def beside(left: Array, shared: Array, summed: Array) -> tuple[Array, _Quick, Array, Array, float]:
            """Return disagreement in long and short windows, score (n,) and information (n, n) on numbers that windows
            share, and the log-likelihood. left (K - 1, rows); shared (K - 1, rows, n), and summed over windows."""
            of_way = np.add.reduceat(left, starts, axis=0) / rolled[:, None]
            quick = _Quick.of(left, shared, turns, way, short, parts, along, counted)
            usual = _usual(of_way, counted, along, turned, linked)
            independent = usual.whitened(of_way)
            weight, likely = _weighed(independent, usual, counted)
            shown = usual.whitened(summed) * weight[..., None]
            score, information = (
                of_long + of_short
                for of_long, of_short in zip(_of_shared(shown, independent * weight), quick.of_shared(), strict=True)
            )
            return of_way, quick, score, np.eye(len(score)) + information, likely + quick.likely

        found = []
        for share, by_row in shares:
            left, doubted = seen - caused @ share, list[Array]()
            for k in np.flatnonzero(share) if by_row else ():  # what vanishes, and what is left
                doubted.append(UNEVEN * np.hypot(share[k], 1 - share[k]) * caused[..., k, None] * np.eye(len(along)))
            shared = np.concatenate([by_turning, *doubted], axis=-1)
            summed: Array = np.add.reduceat(shared, starts, axis=0) / rolled[:, None, None]
            numbers = np.zeros(shared.shape[-1])
            of_way, quick, score, information, likely = beside(left, shared, summed)
            for _ in range(MOST_ROUNDS if len(numbers) else 0):
                change = np.linalg.solve(information, score - numbers)
                numbers = numbers + change
                of_way, quick, score, information, likely = beside(left - shared @ numbers, shared, summed)
                if change @ information @ change < SETTLED**2 * len(numbers):
                    break
            unlikely = float(np.sum(numbers**2)) / 2
            quick.likely -= unlikely
            likely -= unlikely + float(np.linalg.slogdet(information)[1]) / 2
            found.append((likely, of_way, quick, share, summed))
        _, of_way, quick, share, summed = max(found, key=itemgetter(0))
        doubt = np.add.reduceat(UNEVEN * np.abs(caused @ share), starts, axis=0) / rolled[:, None]
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
            shared=summed,
            turned=turned,
            linked=linked,
            by_size=np.concatenate(by_size),
            counted=counted,
            along=along,
            t=t[starts],
            way=way,
            steps=steps,
            quick=quick.statistics(),
            share=float(share[0]) if len(shares) > 1 else np.nan,
        )

    @cached_property
    def usual(self) -> "Usual":
        """Usual disagreement, with the likeliest amount for contacts that motors turn on the floor. The slip that the
        fit sees there is no measure of it: that is larger with a wrong model."""
        return _usual(self.seen, self.counted, self.along, self.turned, self.linked)

    @cached_property
    def scale(self) -> Array:
        """The usual size (W, rows) beside the effects in the model: where these cause much, it is larger. By medians
        alone, so that what happens at times, and lasts then, does not affect it."""
        usual = _usual(self.seen, self.counted, self.along, self.turned, np.zeros_like(self.linked))
        return np.hypot(usual.size, self.doubt)

    def beside(self, columns: Sequence[int]) -> Array:
        """Return the disagreement (W, rows) in units of its `scale`, after least squares of these columns; 0 in windows
        that do not count."""
        scale = self.scale
        left = (self.counted[:, None] * self.seen / scale).reshape(-1)
        if len(columns):
            by_size = (self.by_size[..., list(columns)] / scale[..., None]).reshape(len(left), len(columns))
            by_size = np.repeat(self.counted, self.seen.shape[1])[:, None] * by_size
            left = left - by_size @ least_squares(by_size, left)
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
        seen = self.usual.whitened(self.seen)
        weight, likely = _weighed(seen, self.usual, self.counted)
        by_size, shared = (self.usual.whitened(of) * weight[..., None] for of in (self.by_size, self.shared))
        columns, shared = by_size.reshape(self.seen.size, -1), shared.reshape(self.seen.size, -1)
        information, score = columns.T @ columns, columns.T @ (seen * weight).reshape(-1)
        crossed, of_shared = shared.T @ columns + self.quick[3], shared.T @ shared + self.quick[4]
        of_shared = np.eye(len(of_shared)) + of_shared
        information = information + self.quick[0] - crossed.T @ np.linalg.solve(of_shared, crossed)
        score = score + self.quick[1]
        likely += self.quick[2] - float(np.linalg.slogdet(of_shared)[1]) / 2
        masked = np.array([[1.0, -1.0], [-1.0, 1.0]])  # the masked amount of a size disagrees less by as much
        return np.kron(masked, information).astype(np.float64), np.concatenate([score, -score]), likely


class _Quick:
    """How the disagreement in short windows differs within long ones, as a part of the way, and the statistics of
    sizes by it, which are summed block by block: there are too many windows to keep how each changes by every size."""

    def __init__(self, rolled: Array, way: Array, short: int, parts: int) -> None:
        """rolled, way (V,): way of each of V short windows, and the same as a divisor. short: steps in a short window;
        parts: short windows in a long one."""
        self._rolled, self._way, self._short, self._parts = rolled, way, short, parts
        self._seen = self._weight = np.zeros((0, 0))
        self._shared = np.zeros((0, 0, 0))
        self._sums: tuple[Array | float, Array | float, Array | float] = (0.0, 0.0, 0.0)
        self.likely = 0.0

    @classmethod
    def of(
        cls,
        disagreement: Array,
        shared: Array,
        turns: Array,
        way: Array,
        short: int,
        parts: int,
        along: NDArray[np.bool_],
        counted: NDArray[np.bool_],
    ) -> "_Quick":
        """Return this for the disagreement (K - 1, rows) in steps, m, of this way (K - 1,), and for that by numbers
        which all windows share (K - 1, rows, n); turns (K - 1, rows): angles by which motors turn contacts on the
        floor, rad; counted (W,): long windows that count."""
        starts = np.arange(0, len(way), short)
        quick = cls(way_of(way, starts), np.add.reduceat(way, starts), short, parts)
        quick._seen = quick._differences(disagreement, slice(0, len(way)))
        counts = np.repeat(counted, parts)[: len(starts)]
        sizes = (_size(quick._seen[counts][:, rows], parts * LEAST) for rows in (along, ~along))
        turned = _part_of_way(np.abs(turns), starts, quick._rolled)
        free = (parts - 1) / parts
        quick._shared = quick._differences(shared, slice(0, len(way)))
        independent = np.where(along, *sizes), np.zeros_like(turned)
        each = [Usual.of(*independent, by_turning * turned) for by_turning in _amounts(turned)]
        weighed = [(_weighed(usual.whitened(quick._seen), usual, counts, free), usual) for usual in each]
        (weight, quick.likely), usual = max(weighed, key=lambda one: one[0][1])
        quick._weight = weight / usual.new
        return quick

    def add(self, by_size: Array, steps: slice) -> None:
        """Add a block of steps that begins with a long window; by_size (k, rows, C): change of disagreement, m."""
        differences = self._differences(by_size, steps)
        windows = slice(steps.start // self._short, steps.start // self._short + len(differences))
        seen = (self._seen * self._weight)[windows].reshape(-1)
        columns = (differences * self._weight[windows, :, None]).reshape(len(seen), by_size.shape[-1])
        information, score, crossed = self._sums
        shared = (self._shared * self._weight[..., None])[windows].reshape(len(seen), -1)
        crossed = crossed + shared.T @ columns
        self._sums = information + columns.T @ columns, score + columns.T @ seen, crossed

    def of_shared(self) -> tuple[Array, Array]:
        """Return score (n,) and information (n, n) of the numbers that all windows share, in standard deviations."""
        return _of_shared(self._shared * self._weight[..., None], self._seen * self._weight)

    def statistics(self) -> tuple[Array, Array, float, Array, Array]:
        """Return information (C, C) and score (C,) of sizes, the log-likelihood where all are 0, and the products of
        disagreement by shared numbers with that by sizes (n, C) and with itself (n, n)."""
        information, score, crossed = (np.asarray(of_sizes) for of_sizes in self._sums)
        return information, score, self.likely, crossed, self.of_shared()[1]

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


def way_of(way: Array, starts: NDArray[np.intp]) -> Array:
    """Return the way (W,) in windows, m; at rest, where nothing says how far, a part of what is usual."""
    rolled = np.add.reduceat(way, starts)
    return np.hypot(rolled, np.median(rolled) / 4) + 1e-9


def _by_turning(
    model: LogLikelihood, geometry: Geometry, state: Array, turns: Array, along: NDArray[np.bool_]
) -> Array:
    """Return the disagreement (K - 1, rows, 2), m, for each standard deviation of what contacts slip as motors turn
    them (`TURNED`), along and across; (K - 1, rows, 0) where no motor does. turns (K - 1, rows): by which angle,
    rad."""
    slips = [TURNED * turns * kind for kind in (along, ~along)] if np.any(turns) else []
    found = [of - model.explained(geometry, state, of) for of in slips]
    return np.stack(found, axis=-1) if found else np.zeros((*turns.shape, 0))


def _of_shared(shown: Array, seen: Array) -> tuple[Array, Array]:
    """Return score (n,) and information (n, n) of numbers by which disagreement (W, rows) changes by `shown` (W, rows,
    n), both in standard deviations."""
    columns = shown.reshape(seen.size, -1)
    return columns.T @ seen.reshape(-1), columns.T @ columns


def _amounts(turned: Array) -> tuple[float, ...]:
    """Return the amounts of disagreement by turning that are tried: where no motor turns contacts, none does any."""
    return BY_TURNING if np.any(turned) else BY_TURNING[:1]


def _part_of_way(variance: Array, starts: NDArray[np.intp], rolled: Array) -> Array:
    """Return standard deviations of sums over windows (W, ...), as a part of the way (W,), from variances of steps."""
    return np.sqrt(np.add.reduceat(variance, starts, axis=0)) / rolled[:, None]


@dataclass(frozen=True, eq=False)
class Usual:
    """Usual disagreement: the part (W, rows) of that in the window before that is left, and the size (W, rows) of what
    is new; or several of these, along a last axis."""

    kept: Array
    new: Array

    @classmethod
    def of(cls, size: Array | float, kept: Array, turned: Array) -> "Usual":
        """Return this where disagreement of a size (rows,), of which a part (W, rows) is left in the next window, is
        there as well as what motors cause that turn contacts (W, rows)."""
        return cls(kept, np.sqrt(np.square(size) * (1 - kept**2) + turned**2))

    @property
    def size(self) -> Array:
        """The size (W, rows) of all disagreement."""
        variance = self.new**2
        for k in range(1, len(variance)):
            variance[k] += self.kept[k] ** 2 * variance[k - 1]
        return np.sqrt(variance)

    def whitened(self, values: Array | NDArray[np.float32]) -> Array:
        """Return what is new in values (W, rows, ...), in units of its size: of usual disagreement the standard
        deviation is 1, and nothing correlates."""
        kept, new = (of.reshape(*of.shape, *[1] * (values.ndim - of.ndim)) for of in (self.kept, self.new))
        found = values / new
        found[1:] -= kept[1:] * values[:-1] / new[1:]
        return found


def _usual(seen: Array, counted: NDArray[np.bool_], along: NDArray[np.bool_], turned: Array, linked: Array) -> Usual:
    """Return the likeliest usual disagreement: of each kind its size, by the median, and how much of it lasts (one of
    `LASTING`, if it may), and of both how much motors cause that turn contacts. What is new in a window is at least
    `LEAST`."""
    amounts, kinds = np.array(_amounts(turned)), []
    for rows in (along, ~along):
        if np.any(rows):
            by_turning, sizes = amounts * turned[:, rows, None], _lasting(seen[:, rows], counted, linked[:, rows])
            each = [Usual.of(size, kept[..., None], by_turning) for size, kept in sizes]
            log_density = [_log_density(one.whitened(seen[:, rows, None]), one, counted) for one in each]
            kinds.append((rows, each, np.array(log_density)))
    amount = int(np.argmax(sum(log_density.max(axis=0) for *_, log_density in kinds)))
    usual = Usual(np.zeros_like(seen), np.full(seen.shape, LEAST))
    for rows, each, log_density in kinds:
        best = each[int(np.argmax(log_density[:, amount]))]
        usual.kept[:, rows], usual.new[:, rows] = best.kept[..., 0], best.new[..., amount]
    return usual


def _lasting(seen: Array, counted: NDArray[np.bool_], linked: Array) -> list[tuple[float, Array]]:
    """Return for each of `LASTING`, if disagreement of a kind (W, rows) may last, its size by the median, and which
    part (W, rows) of it is left in the next window."""
    found = []
    for lasting in LASTING if np.any(linked) else LASTING[:1]:
        kept = lasting * linked
        off = Usual.of(1.0, kept, np.zeros_like(kept)).whitened(seen)[counted]
        least = LEAST / math.sqrt(1 - lasting**2)
        size = float(np.median(np.abs(off))) / MEDIAN if lasting and off.size else _size(seen[counted])
        found.append((max(size, least), kept))
    return found


def _linked(counted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which windows (W,) follow another one that counts."""
    return counted & np.concatenate([[False], counted[:-1]])


def _weighed(seen: Array, usual: Usual, counted: NDArray[np.bool_], free: float = 1.0) -> tuple[Array, float]:
    """Return the weights (W, rows) of disagreements that are whitened, and their log-likelihood; beyond `FARTHEST`
    times its usual size the loss of a disagreement is linear, no more quadratic.

    free: part of the windows that are independent. A motion of the body has been fitted to each step, so of n rows
    n - 3 are, and the others follow from these.
    """
    free *= max(seen.shape[1] - BODY, 0) / seen.shape[1]
    off = np.abs(seen)
    weight: Array = np.sqrt(free * np.minimum(FARTHEST / np.maximum(off, 1e-12), 1.0)) * counted[:, None]
    return weight, free * float(_log_density(seen, usual, counted))


def _log_density(seen: Array, usual: Usual, counted: NDArray[np.bool_]) -> Array:
    """Return the log density (...), by Huber's loss, of disagreements (W, rows, ...) that are whitened, but for a
    constant."""
    unlikely = (np.log(usual.new) + _loss(np.abs(seen)))[counted]
    return -unlikely.reshape(-1, *unlikely.shape[2:]).T.copy().sum(axis=-1)


def _loss(off: Array) -> Array:
    """Return Huber's loss of disagreements in their usual sizes."""
    return np.where(off > FARTHEST, FARTHEST * (off - FARTHEST / 2), off**2 / 2)


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
