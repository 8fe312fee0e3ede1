"""What logs say for and against every candidate, all else eliminated: one linear problem.

Driven wheels that disagree creep until they come to terms (`LogLikelihood.fought`), and hide a part of what is wrong:
none where they yield, all where they hold. It is found, between none and all. How far all contacts creep is predicted
(`slipping`); what part of the prediction is true is found too.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from castor_envs.kinematics import Array, Geometry
from castor_envs.logs import Log
from castor_envs.robot import RobotDescription
from discrepancy.candidates import Candidate, Channels, signatures_of, stacked
from discrepancy.places import slips_of, with_cables
from discrepancy.slipping import Slipping
from estimators.calibration.log_likelihood import GAP, LogLikelihood, More, Noise, Reduced
from estimators.calibration.maximum_likelihood import MOUNT, State, fitted

BURST = 0.05
"""Part of a log's steps in which slip that comes in bursts is looked for."""

PARTS = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Of an effect that wheels may hide by coming to terms: what is tried."""

DOUBT = 0.5
"""Standard deviation of the part of creep that is as predicted, and of what wheels hide of known effects beside it."""

SETTLED = 2
"""Rounds in which these parts and the noise that is left settle."""

CREEP = 1.5e-4
"""Standard deviation of what a wheel may always roll too much, as a part of its way, and a castor to the side: contact
is not as rigid as rolling. Beyond this something is significant."""

LEAST_SLIP = 3e-5
"""m after 1 m: contacts are taken to slip at least so much at random. Those of a simulator that hardly do are no better
known for that."""

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
    wheels may creep by `CREEP`.

    left: rms of what odometry is off the reference, m and rad; None without one. parts: of the creep predicted, and
    what more wheels hide of each of the robot's effects. clock_errors (logs, 2): standard errors of `state.clocks`.
    slips (K - 1, w) of each log: of wheels beyond what is expected, m.
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

    @property
    def places(self) -> tuple[Candidate, ...]:
        """The candidates that are at a place on the floor."""
        return tuple(one for one in self.candidates if one.at_a_place)

    def foretold(self, candidate: Candidate, part: float, amplitudes: Sequence[float]) -> float:
        """Return the deviance that a candidate of some amplitudes, hidden in part, takes away, or adds, if below 0."""
        if (k := self.index(candidate)) is None:
            return 0.0
        (information, pull), columns, size = self.plain, self.columns[k], np.array(amplitudes)
        both = np.concatenate([columns, columns + len(pull) // 2])
        change = np.concatenate([size, part * size])
        return float(2 * change @ pull[both] - change @ information[np.ix_(both, both)] @ change)

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
) -> Evidence:
    """Return what logs say of all candidates beyond the effects that the robot's file has.

    noise: sizes to hold to; None: found. start: evidence of the same logs, to begin with what it found. among:
    candidates to look at; None: all, and rivals without a name. places: of the floor, to look at beside those that the
    logs speak for.
    Raises InputError for logs that the robot cannot have made.
    """
    geometry = Geometry.of(robot.as_built())
    models = [LogLikelihood(geometry, log) for log in logs]
    none, begin = np.zeros(0), None if start is None else (start.state, start.noise)
    at, sizes, _ = fitted(models, geometry, (), none, noise, begin)
    if robot.effects:  # What its sensors make of angles is known: take it off the counts, and settle again.
        channels = Channels(robot)
        for model, log, state in zip(models, logs, at.states, strict=True):
            counts = state[:, 3:]
            model.correct(channels.read(robot, log, counts) - counts)
        at, sizes, _ = fitted(models, geometry, (), none, noise, (at, sizes))
    slipping = [Slipping(robot, model, log, state) for model, log, state in zip(models, logs, at.states, strict=True)]
    known, sure = [one.known() for one in slipping], [one.sure() for one in slipping]
    for model, slips in zip(models, sure, strict=True):
        model.expect(slips)
    parts = np.zeros(1 + len(robot.effects))
    for _ in range(SETTLED):
        parts = _parts_of(models, geometry, at, sizes, known, parts)
        for model, slips, certain in zip(models, known, sure, strict=True):
            model.expect(certain + slips @ parts)
        at, sizes, _ = fitted(models, geometry, (), none, noise, (at, sizes))

    beyond = tuple(
        slips_of(robot, model, log, state, certain + one @ parts)
        for model, log, state, one, certain in zip(models, logs, at.states, known, sure, strict=True)
    )
    if among is None:
        places = with_cables(places, robot, logs, at, beyond)
    told: list[tuple[tuple[Candidate, ...], Reduced]] = []
    least = replace(sizes, along=max(sizes.along, LEAST_SLIP), across=max(sizes.across, LEAST_SLIP))
    for k, (model, log, state, clock, own, slip) in enumerate(
        zip(models, logs, at.states, at.clocks, known, slipping, strict=True)
    ):
        of = f" of log {k + 1}" if len(logs) > 1 else ""
        found = signatures_of(robot, log, state, model.wanted(state), among, of, places)
        changed = stacked(geometry, found.geometries)
        fought = model.fought(geometry, changed, found.steps, state, found.readings, slip.yields)
        always = model.rolled(geometry, state)[..., None] * np.eye(len(model.rows))
        direct = [model.rows_of(one.rolling, one.side)[..., None] for one in found.slips]
        for column in found.places:  # what wheels disagree by is taken for creep as long as no cable is known
            direct[column] -= parts[0] * slip.seen_as_creep(found.slips[column])[..., None]
        slips = np.concatenate([*direct, fought, own, always], axis=-1)
        readings = np.pad(found.readings, ((0, 0), (0, 0), (0, slips.shape[-1] - len(direct))))
        more = More(readings, slips)
        reduced = model.reduce(geometry, changed, found.steps, state, clock, at.mount, least, 0, more)
        told.append((found.candidates, reduced))
    candidates, information, gradient = _together(told)
    n, e, r = 2 * sum(one.columns for one in candidates), len(parts), len(models[0].rows)
    information[n + e + r :, n + e + r :] += np.diag(MOUNT**-2.0)
    gradient[n + e + r :] += at.mount / MOUNT**2
    information[n : n + e, n : n + e] += np.eye(e) / DOUBT**2
    creep = np.arange(n + e, n + e + r)
    rigid, sober = np.delete(np.arange(len(gradient)), creep), np.arange(len(gradient))
    plain = _without(information[np.ix_(rigid, rigid)], gradient[rigid], n)
    information[creep, creep] += CREEP**-2.0
    return Evidence(
        candidates=candidates,
        columns=_columns(candidates),
        plain=plain,
        sober=_without(information[np.ix_(sober, sober)], gradient[sober], n),
        noise=sizes,
        state=at,
        left=_left(models, geometry, at),
        burst=_burst(models, logs, geometry, at),
        parts=tuple(parts.tolist()),
        slips=beyond,
        clock_errors=np.array([np.sqrt(np.diag(np.linalg.inv(reduced.clock))) for _, reduced in told]),
    )


def _together(told: Sequence[tuple[tuple[Candidate, ...], Reduced]]) -> tuple[tuple[Candidate, ...], Array, Array]:
    """Return all candidates of several logs, and what these say of their amplitudes together, then what wheels hide of
    each, and then of the numbers that all logs share: information and gradient."""
    candidates = tuple(dict.fromkeys(one for some, _ in told for one in some))
    columns = dict(zip(candidates, _columns(candidates), strict=True))
    half = sum(one.columns for one in candidates)
    shared = len(told[0][1].information) - 2 * sum(one.columns for one in told[0][0])
    information, gradient = np.zeros((2 * half + shared, 2 * half + shared)), np.zeros(2 * half + shared)
    for some, reduced in told:
        own = np.concatenate([np.zeros(0, dtype=np.intp), *(columns[one] for one in some)])
        at = np.concatenate([own, own + half, np.arange(2 * half, 2 * half + shared)])
        information[np.ix_(at, at)] += reduced.information
        gradient[at] += reduced.gradient[:, 0]
    return candidates, information, gradient


def _without(information: Array, gradient: Array, n: int) -> tuple[Array, Array]:
    """Return information (n, n) and pull (n,) of the first n numbers, the others eliminated."""
    both = np.linalg.solve(information[n:, n:], np.column_stack([information[n:, :n], gradient[n:]]))
    told = information[:n, :n] - information[:n, n:] @ both[:, :n]
    return (told + told.T) / 2, -(gradient[:n] - information[:n, n:] @ both[:, n])


def _columns(candidates: Sequence[Candidate]) -> tuple[NDArray[np.intp], ...]:
    ends = np.cumsum([one.columns for one in candidates])
    return tuple(np.arange(end - one.columns, end) for one, end in zip(candidates, ends, strict=True))


def _parts_of(
    models: Sequence[LogLikelihood], geometry: Geometry, at: State, noise: Noise, known: Sequence[Array], parts: Array
) -> Array:
    """Return what part of the creep predicted there is, and what more wheels hide of each of the robot's effects, (e,),
    as far as the logs tell."""
    none, e = stacked(geometry, []), known[0].shape[-1]
    information, gradient = np.zeros(()), np.zeros(())
    for model, state, clock, slips in zip(models, at.states, at.clocks, known, strict=True):
        more = More(np.zeros((len(state), state.shape[1] - 3, e)), slips)
        reduced = model.reduce(geometry, none, np.zeros(0), state, clock, at.mount, noise, 0, more)
        information, gradient = information + reduced.information, gradient + reduced.gradient[:, 0]
    information[e:, e:] += np.diag(MOUNT**-2.0)
    gradient[e:] += at.mount / MOUNT**2
    told, pull = _without(information, gradient, e)
    sure = np.eye(e) / DOUBT**2
    parts = parts + np.linalg.solve(told + sure, pull + sure @ ((np.arange(e) == 0.0) - parts))
    return np.clip(parts, [0.0, *[-1.0] * (e - 1)], [2.0, *[1.0] * (e - 1)])


def _left(models: Sequence[LogLikelihood], geometry: Geometry, at: State) -> tuple[float, float] | None:
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
