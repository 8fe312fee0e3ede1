"""What logs say for and against every candidate, all else eliminated: one linear problem.

Driven wheels that disagree creep until they come to terms (`LogLikelihood.fought`), and hide a part of what is wrong:
none where they yield, all where they hold, and more beside creep that was taken for theirs. It is found.
"""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.cables import with_cables
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.hypotheses.wheel_tracks import slips_of
from discrepancy.inference.creep_prior import sober
from discrepancy.inference.design_matrix import Columns, Shared, columns_of, quieter, together, without
from discrepancy.inference.fit_states import settled
from estimators.calibration.log_likelihood import GAP, LogLikelihood, Noise
from estimators.calibration.maximum_likelihood import State

BURST = 0.05
"""Part of a log's steps in which slip that comes in bursts is looked for."""

PARTS = (0.0, 0.25, 0.5, 0.75, 1.0, 1.25, 1.5)
"""Of an effect that wheels may hide by coming to terms: what is tried."""

QUIETENS, MOST_QUIET, MUCH_LESS = 10.0, 2, 0.8
"""Noise is what at most so many effects leave that take away so much each, if that is less than such a part of it."""

Chosen = Sequence[tuple[int, float]]
"""Candidates, each with the part of it that wheels hide."""


JUMPS = 0.005
"""Part of the steps, the very worst, that does not count there: encoders may jump."""


@dataclass(frozen=True)
class Burst:
    """Where most slip is: share of its squares in the worst `BURST` of all steps but for `JUMPS`.

    And the worst step's log (from 0), time (s) and place (m, in the reference's frame).
    """

    share: float
    log: int
    t: float
    x: float
    y: float


@dataclass(frozen=True, eq=False)
class Evidence:
    """Of candidates with C columns in all: columns of each; information (2C, 2C) and pull (2C,), the slope of the log-
    likelihood, by the amplitudes and then by what wheels hide of each; plain: where contact is rigid, sober: where all
    wheels may creep (`sober`), and each as unevenly as the logs allow.

    left: rms of what odometry is off the reference, m and rad; None without one. parts: of the creep predicted where
    wheels disagree, and under forces, and what more wheels hide of each of the robot's effects. clock_errors (logs, 2):
    standard errors of `state.clocks`. slips (K - 1, w) of each log: of wheels beyond what is expected, m. poses: of the
    reference, in use.
    """

    candidates: tuple[Candidate, ...]
    columns: tuple[NDArray[np.intp], ...]
    plain: tuple[Array, Array]
    sober: tuple[Array, Array]
    noise: Noise
    state: State
    left: tuple[float, float] | None
    burst: Burst
    parts: tuple[float, ...]
    clock_errors: Array
    slips: tuple[Array, ...]
    poses: int

    def best(self, chosen: Chosen, sober: bool = False) -> tuple[Array, Array, float]:
        """Return the best amplitudes of some candidates together (c,), their covariance (c, c), and what they gain:

        the deviance that they take away, twice the log-likelihood that they add.
        """
        if not chosen:
            return np.zeros(0), np.zeros((0, 0)), 0.0
        information, pull = self.sober if sober else self.plain
        columns = np.concatenate([self.columns[k] for k, _ in chosen])
        parts = np.concatenate([np.full(len(self.columns[k]), part) for k, part in chosen])
        half = len(pull) // 2
        mix = np.concatenate([np.eye(len(columns)), np.diag(parts)])
        both = np.concatenate([columns, columns + half])
        own, slope = mix.T @ information[np.ix_(both, both)] @ mix, mix.T @ pull[both]
        there = np.diag(own) > 0  # what the rest explains wholly may come out below 0
        scale = np.where(there, np.sqrt(np.where(there, np.diag(own), 1.0)), np.inf)
        strength, way = np.linalg.eigh(own / np.outer(scale, scale))
        way = way[:, strength > 1e-8] / scale[:, None]
        covariance = (way / strength[strength > 1e-8]) @ way.T
        amplitudes = covariance @ slope
        return amplitudes, covariance, float(amplitudes @ slope)

    def parted(self, k: int, others: Chosen = ()) -> float:
        """Return the part of candidate k that wheels hide most likely, beside others."""
        return max(PARTS, key=lambda part: self.best([*others, (k, part)])[2])

    def greedily(self, most: int, least: float) -> list[tuple[int, float]]:
        """Return effects, one by one, each of which takes away most, and `least` or more, beside those before."""
        chosen: list[tuple[int, float]] = []
        named = [k for k, candidate in enumerate(self.candidates) if candidate.kinds]
        for _ in range(most):
            before = self.best(chosen)[2]
            tried = [(k, self.parted(k, chosen)) for k in named if k not in dict(chosen)]
            best = max(tried, key=lambda one: self.best([*chosen, one])[2], default=None)
            if best is None or self.best([*chosen, best])[2] - before < least:
                break
            chosen.append(best)
        return chosen

    @property
    def steps(self) -> int:
        """How many steps the logs have."""
        return sum(len(state) - 1 for state in self.state.states)

    @property
    def places(self) -> tuple[Candidate, ...]:
        """The candidates that are at a place on the floor."""
        return tuple(one for one in self.candidates if one.at_a_place)

    def foretold(self, candidate: Candidate, part: float, amplitudes: Sequence[float] | Array) -> float:
        """Return the deviance that a candidate of some amplitudes, hidden in part, takes away, or adds, if below 0."""
        if (k := self.index(candidate)) is None:
            return 0.0
        (information, pull), columns, size = self.plain, self.columns[k], np.array(amplitudes)
        both = np.concatenate([columns, columns + len(pull) // 2])
        change = np.concatenate([size, part * size])
        return float(2 * change @ pull[both] - change @ information[np.ix_(both, both)] @ change)

    def expecting(self, k: int, part: float, amplitudes: Sequence[float] | Array) -> "Evidence":
        """Return the evidence of logs in which nothing is but candidate k, hidden in part."""
        information, size = self.plain[0], np.asarray(amplitudes)
        truth = np.zeros(len(information))
        truth[self.columns[k]] = size
        truth[self.columns[k] + len(truth) // 2] = part * size
        return replace(self, plain=(information, information @ truth))

    def index(self, candidate: Candidate) -> int | None:
        """Return the place of a candidate; None where the motion leaves it without any trace."""
        return next((k for k, one in enumerate(self.candidates) if one == candidate), None)

    def less(self, known: Sequence[tuple[Candidate, float, Array]]) -> "Evidence":
        """Return the evidence without what some candidates, with hidden parts and amplitudes, account for."""
        both = []
        for information, pull in (self.plain, self.sober):
            taken = np.zeros(len(pull))
            for candidate, part, amplitudes in known:
                if (k := self.index(candidate)) is not None:
                    taken[self.columns[k]] += amplitudes
                    taken[self.columns[k] + len(pull) // 2] += part * amplitudes
            both.append((information, pull - information @ taken))
        return replace(self, plain=both[0], sober=both[1])


def evidence_of(
    robot: RobotDescription,
    logs: Sequence[Log],
    noise: Noise | None = None,
    start: Evidence | None = None,
    among: Sequence[Candidate] | None = None,
    places: Sequence[Candidate] = (),
    usual: Evidence | None = None,
) -> Evidence:
    """Return what logs say of all candidates beyond the effects that the robot's file has.

    noise: sizes to hold to; None: found. start: evidence of the same logs, to begin with what it found. among:
    candidates to look at; None: all, and rivals without a name. places: of the floor, to look at beside those that the
    logs speak for. usual: that of clean logs, which creep about as much.
    Raises InputError for logs that the robot cannot have made.
    """
    geometry = Geometry.of(robot.as_built())
    models = [LogLikelihood(geometry, log, k) for k, log in enumerate(logs)]
    begin = None if start is None else (start.state, start.noise)
    at, sizes, shared, slips = settled(
        robot, models, logs, noise, begin, None if usual is None else np.array(usual.parts)
    )
    beyond = tuple(
        slips_of(robot, model, log, state, one.certain + one.known @ shared.parts)
        for model, log, state, one in zip(models, logs, at.states, slips, strict=True)
    )
    if among is None:
        places = with_cables(places, robot, logs, at, beyond)
    columns = [
        Columns.of(robot, model, log, state, clock, one.slipping, one.known, shared.parts, among, places, of)
        for model, log, state, clock, one, of in zip(
            models, logs, at.states, at.clocks, slips, _names_of(logs), strict=True
        )
    ]
    candidates, information, gradient, clocks = _told(columns, shared, sizes)
    plain = _rigid(candidates, information, gradient, shared)
    seen = Evidence(
        candidates=candidates,
        columns=columns_of(candidates),
        plain=plain,
        sober=plain,
        noise=sizes,
        state=at,
        left=gap_of(models, geometry, at),
        burst=_burst(models, logs, geometry, at),
        parts=tuple(shared.parts.tolist()),
        slips=beyond,
        clock_errors=clocks,
        poses=sum(model.poses_used for model in models),
    )
    some = [candidates[k] for k, _ in seen.greedily(MOST_QUIET, QUIETENS)]
    if some and noise is None:
        less = quieter(columns, some, shared, sizes)
        if _much_less(less, sizes):
            _, information, gradient, _ = _told(columns, shared, less)
            seen = replace(seen, plain=_rigid(candidates, information, gradient, shared))
    if among is not None:
        return replace(seen, sober=seen.plain)
    along = models[0].rows < len(geometry.radius)
    creeping = sober(seen, information, gradient, len(shared.parts), along, usual is not None)
    return replace(seen, sober=creeping)


def _names_of(logs: Sequence[Log]) -> list[str]:
    return [f" of log {k + 1}" for k in range(len(logs))] if len(logs) > 1 else [""]


def _much_less(sizes: Noise, than: Noise) -> bool:
    return min(a / b for a, b in zip(astuple(sizes), astuple(than), strict=True)) < MUCH_LESS


def _told(
    columns: Sequence[Columns], shared: Shared, noise: Noise
) -> tuple[tuple[Candidate, ...], Array, Array, Array]:
    """Return all candidates, what logs say of all numbers together, and standard errors of the clocks (logs, 2)."""
    told = [one.reduce(shared.mount, noise) for one in columns]
    each = [(one.candidates, reduced) for one, reduced in zip(columns, told, strict=True)]
    candidates, information, gradient, _ = together(each)
    shared.believed(information, gradient, 2 * sum(one.columns for one in candidates))
    clocks = np.array([np.sqrt(np.diag(np.linalg.inv(reduced.clock))) for reduced in told])
    return candidates, information, gradient[:, 0], clocks


def _rigid(candidates: Sequence[Candidate], information: Array, gradient: Array, shared: Shared) -> tuple[Array, Array]:
    """Return information and pull of candidates, and of what wheels hide of each, where nothing creeps unforeseen."""
    n = 2 * sum(one.columns for one in candidates)
    rigid = np.concatenate([np.arange(n + len(shared.parts)), np.arange(-len(shared.mount), 0)])
    return without(information[np.ix_(rigid, rigid)], gradient[rigid], n)


def gap_of(models: Sequence[LogLikelihood], geometry: Geometry, at: State) -> tuple[float, float] | None:
    """Return the rms of what odometry is off the reference, m and rad; None without a reference."""
    tracked = [one for one in zip(models, at.states, at.clocks, strict=True) if one[0].poses]
    if not tracked:
        return None
    off = np.concatenate([model.errors(geometry, state, clock, at.mount) for model, state, clock in tracked])
    return float(np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1)))), float(np.sqrt(np.mean(off[:, 2] ** 2)))


def _burst(models: Sequence[LogLikelihood], logs: Sequence[Log], geometry: Geometry, at: State) -> Burst:
    slips = []
    for model, log, state in zip(models, logs, at.states, strict=True):
        step = np.diff(log.t)
        gap = np.pad(step > GAP * np.median(step), 1)
        known = ~(gap[:-2] | gap[1:-1] | gap[2:])  # nor are the steps beside a gap well known
        slips.append(np.where(known, np.sum(model.missed(geometry, state) ** 2, axis=1), 0.0))
    ordered = np.sort(np.concatenate(slips))[::-1]
    ordered = ordered[max(2, round(JUMPS * len(ordered))) :]
    share = float(ordered[: max(1, round(BURST * len(ordered)))].sum() / max(ordered.sum(), 1e-30))
    worst = int(np.argmax([slip.max() for slip in slips]))
    k = int(np.argmax(slips[worst]))
    x, y, _ = at.states[worst][k, :3].tolist()
    return Burst(share, worst, float(logs[worst].t[k]), x, y)
