"""What commands tell of forces: the work of the wheels' servos is the energy that the robot gains.

A servo lets its wheel fall behind the command in proportion to its torque: in rate or, if it integrates, in angle. So
in any time, with phi the angle of each wheel and c the servos' compliance (rad/s or rad for each N m),

    sum over wheels of the integral of behind d(phi) = c (kinetic energy gained + weight lifted) + nuisances + noise.

Forces by which wheels are driven against each other cancel, as they do no work where wheels roll. The starts and stops
of a log determine c, with an error that is part of a slope's. Steps without a command and gaps of a log say nothing;
after each, an integrator begins anew. Nuisances: a constant error of how far each wheel is behind, one in proportion to
its rate or angle, friction, and, known to within a standard deviation, what happens within a sample: a servo that does
not integrate acts at any time in it; the integral of one that does has another mean than that of a sample's ends, as
commands step at each sample and wheels follow within it. Noise of windows is white; besides, an integrator that is held
at its limit loses count, so how far a wheel is behind wanders, the more the more it lags in rate. Each log shows the
size of both.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from castor_envs.effects.catalogue import floor_of
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import rotate
from castor_envs.geometry.steps import Motion, smoothed
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.weight import castor_center, chassis
from discrepancy.hypotheses.candidates import Candidate
from estimators.likelihood.rolling import GAP

WINDOW, MOST = 0.5, 512
"""s: length of windows, in which the transients of servos average out; and most windows that are solved together."""

WANDERING = (0.0, *np.geomspace(0.01, 1000.0, 11).tolist())
"""Variances of wandering, relative to that of white noise, among which the likeliest is chosen."""

DEPENDENT = 1e-8
"""Singular value, as a part of the largest, below which columns of length 1 are dependent."""

WITHIN = {False: (0.0, 12**-0.5), True: (-1 / 16, 1 / 48)}
"""Mean and standard deviation of what happens within samples, for servos that integrate (True) and others. Commands act
on these at any time within a sample, which is a delay in sample periods. An integral's mean over a sample exceeds that
of its ends by a part of the step of the command times the period: 1/12 where the lag falls evenly within a sample, less
where it falls soon, and little where the command is no step."""

EVIDENT = 2 * np.log(19)
"""Least deviance that compliance has to explain (a likelihood ratio of 19) for such a mean to be taken off: of stiff
servos no lag falls."""


class Pull(NamedTuple):
    """Information (C, C) and score (C,) of the amplitudes of candidates by the commands of a log; and its
    log-likelihood where all are 0, relative to that with the likeliest slope of the floor."""

    information: Array
    score: Array
    log_likelihood: float


class _Rows(NamedTuple):
    """Rows of W windows. work (W, 1): of servos, in units of c. gained (W, 1): energy, J. moved (W, 2): mass times way
    in N, kg m. turned (W, d): angle by which each driven wheel turns, rad. others (W, n): further nuisances. sampled
    (W, 1): how work differs by what happens within samples, up to a factor that is known to within a standard deviation
    (`WITHIN`). wandered (W, d): how much the wheels have wandered, in any unit. counted (W, 1): how much each row
    counts."""

    work: Array
    gained: Array
    moved: Array
    turned: Array
    others: Array
    sampled: Array
    wandered: Array
    counted: Array


class _Fit(NamedTuple):
    """explained: the deviance that compliance explains, whatever happens within samples; information (2, 2) and score
    (2,) of the accelerations (m/s2) that add to the downhill gravity of the robot's floor, 0 where servos do not
    comply."""

    explained: float
    information: Array
    score: Array


def pull_of(robot: RobotDescription, log: Log, motion: Motion, candidates: Sequence[Candidate]) -> Pull:
    """Return what the commands of a log say of candidates beyond the robot's effects: nothing where there are no
    commands, or where wheels do not fall behind them as the robot gains energy."""
    floor, count = floor_of(robot, Floor()), sum(candidate.columns for candidate in candidates)
    pulls = np.zeros((2, count))  # m/s2 for each unit
    for k, kind in enumerate(candidate.kinds[:1] for candidate in candidates for _ in range(candidate.columns)):
        if kind and kind[0].creep == "forces":
            steeper = np.array(kind[0].floor(robot, floor).downhill_gravity)
            pulls[:, k] = (steeper - floor.downhill_gravity) / kind[0].value
    information, score = np.zeros((2, 2)), np.zeros(2)
    if log.command is not None and robot.driven_wheels:
        kinds = [(integrates, _rows(robot, log.command[:-1], motion, integrates=integrates)) for integrates in WITHIN]
        windows = len(kinds[0][1].work)
        for part in np.array_split(np.arange(windows), -(-windows // MOST)):
            fits = [_fitted(_Rows(*(of[part] for of in rows)), *WITHIN[integrates]) for integrates, rows in kinds]
            fit = max((fit for fit in fits if fit is not None), key=lambda fit: fit.explained, default=None)
            if fit is not None:
                information, score = information + fit.information, score + fit.score
    likely = -float(score @ np.linalg.pinv(information, hermitian=True) @ score) / 2
    return Pull(pulls.T @ information @ pulls, pulls.T @ score, likely)


def _rows(robot: RobotDescription, command: Array, motion: Motion, *, integrates: bool) -> _Rows:
    """Return the rows of a log for proportional servos, or for those that integrate. command (K - 1, d): rad/s."""
    built, period = robot.as_built(), motion.period[:, None]
    driven = list(built.driven_wheels)
    angle = motion.wheel_angle[:, driven]
    rate = np.diff(angle, axis=0) / period
    gap = period[:, 0] > GAP * np.median(period)
    silent = ~np.all(np.isfinite(command), axis=1) | gap
    counted = ~silent[:, None]
    counted[np.convolve(gap, np.ones(5), mode="same") > 0] = False  # energies depend on two steps before and after
    command = np.clip(command, -built.max_wheel_speed, built.max_wheel_speed)
    lag = np.where(counted, command - rate, 0.0)
    rate = smoothed(rate)
    turned = rate * period
    if integrates:
        step = np.where(counted, np.diff(command, axis=0, prepend=command[:1]), 0.0) * period
        step[~np.isfinite(step)] = 0.0  # after a silence
        behind = np.cumsum(lag * period, axis=0) - lag * period / 2
        sampled = _summed(step * turned)
        others = [turned * (angle[1:] + angle[:-1]) / 2, _summed(turned * rate), _summed(turned * lag)]
        outages = np.cumsum(np.diff(silent.astype(int), prepend=0) > 0)[:, None]
        others += [turned * (outages == outage) for outage in range(1, int(outages[-1, 0]) + 1)]
    else:
        behind, others = lag, [turned * rate]
        sampled = float(np.median(period)) * _gained(_summed(rate**2) / 2)
    others = np.concatenate([*others, _summed(np.abs(turned))], axis=1)
    energy, weighed = _summed(np.array([built.wheels[k].inertia for k in driven]) * rate**2) / 2, np.zeros((1, 2))
    trailing = [wheel for k, wheel in enumerate(built.wheels) if k not in driven]
    spinning = sum(wheel.inertia / wheel.radius**2 for wheel in trailing)  # as a mass, for these roll with the chassis
    for mass, inertia, place, heading in _bodies(built, motion):
        speed, turning = (smoothed(np.diff(of, axis=0) / period) for of in (place, heading[:, None]))
        energy += ((mass + spinning) * _summed(speed**2) + inertia * turning**2) / 2
        spinning = 0.0
        weighed = weighed + mass * place
    moved, pull = np.diff(weighed, axis=0), np.array(floor_of(robot, Floor()).downhill_gravity)
    parts = [_summed(behind * turned), _gained(energy) - moved @ pull[:, None], moved, turned, others, sampled]
    parts = [part * counted for part in parts]

    starts = np.arange(0, len(period), max(round(WINDOW / float(np.median(period))), 1))
    size = np.sqrt(np.add.reduceat(_summed(turned * rate) * counted, starts))
    usual = np.hypot(size, np.median(size) / 4) + 1e-12  # at rest, where nothing says how large
    wandered = np.cumsum(np.add.reduceat(lag**2 * period, starts), axis=0)
    work, gained, moved, turned, others, sampled = (np.add.reduceat(part, starts) / usual for part in parts)
    return _Rows(work, gained, moved, turned, others, sampled, wandered, (size / usual) ** 2)


def _fitted(rows: _Rows, within: float, doubt: float) -> _Fit | None:
    """Return the likeliest fit; None where there are too few rows. within, doubt: mean and standard deviation of what
    happens within samples (`WITHIN`)."""
    index, wandered = np.arange(len(rows.work)), rows.wandered - rows.wandered[0]
    covariance = np.einsum("iw,jw,ijw->ij", rows.turned, rows.turned, wandered[np.minimum.outer(index, index)])
    variance, turn = np.linalg.eigh(covariance / max(float(np.mean(np.diag(covariance))), 1e-30))
    known = turn.T @ np.concatenate([rows.gained, rows.moved, rows.work], axis=1)
    others, sampled = turn.T @ np.concatenate([rows.turned, rows.others], axis=1), turn.T @ rows.sampled
    likeliest, explained, noise, weight = -np.inf, 0.0, 1.0, np.ones((len(known), 1))
    for wandering in WANDERING:
        tried = 1 / np.sqrt(1 + wandering * np.maximum(variance[:, None], 0.0))
        left, _, rank = _beside(known * tried, others * tried)
        freedom = float(rows.counted.sum()) - rank - 5  # three coefficients, and two as the noise is estimated
        if freedom <= 0:
            return None
        remaining, by, _ = _beside(left[:, 3:], left[:, :3])
        size = float(np.sum(remaining**2)) / freedom + 1e-30
        likelihood = float(np.sum(np.log(tried))) - float(rows.counted.sum()) / 2 * float(np.log(size))
        if likelihood > likeliest:
            stiff, *_ = _beside(left[:, 3:], left[:, 1:3])
            explained = float(np.copysign(np.sum(stiff**2 - remaining**2) / size, by[0, 0]))
            likeliest, noise, weight = likelihood, size, tried
    if explained > EVIDENT:
        known[:, 3:] -= within * sampled
    prior = np.append(np.zeros(others.shape[1]), np.sqrt(noise) / doubt)
    nuisances = np.concatenate([np.concatenate([others, sampled], axis=1) * weight, prior[None]])
    left, *_ = _beside(np.concatenate([known * weight, np.zeros((1, 4))]), nuisances)
    _, (compliance, *lifted), _ = _beside(left[:, 3:], left[:, :3])
    if compliance <= 0:
        return _Fit(explained, np.zeros((2, 2)), np.zeros(2))
    pull = -np.array(lifted) / compliance
    slopes, *_ = _beside(compliance * left[:, 1:3], left[:, :1] - left[:, 1:3] @ pull)
    information = slopes.T @ slopes / noise
    return _Fit(explained, information, information @ pull[:, 0])


def _beside(columns: Array, others: Array) -> tuple[Array, Array, int]:
    """Return what of columns (W, k) others (W, n) cannot explain, the coefficients (n, k) of these, and how many of
    them are independent."""
    length = np.sqrt(np.sum(others**2, axis=0)) + 1e-30
    by, _, rank, _ = np.linalg.lstsq(others / length, columns, rcond=DEPENDENT)
    by = by / length[:, None]
    return columns - others @ by, by, int(rank)


def _bodies(robot: RobotDescription, motion: Motion) -> Iterator[tuple[float, float, Array, Array]]:
    """Yield mass, inertia, places of the centre of mass (K, 2) and angles (K,) of the chassis and the castors that
    turn; those that a motor turns as if they did not, as it does the work."""
    place, heading = motion.pose[:, :2], motion.pose[:, 2]
    mass, inertia, center = chassis(robot)
    yield mass, inertia, place + rotate(center, heading), heading
    for i, castor in enumerate(robot.castors):
        if castor.steering != "fixed":
            arm = np.array(castor.pivot) + rotate(castor_center(robot, i), motion.castor_angle[:, i])
            turned = motion.castor_angle[:, i] if castor.steering == "free" else 0.0
            yield castor.mass, castor.inertia, place + rotate(arm, heading), heading + turned


def _summed(of_wheels: Array) -> Array:
    """Return the sum over wheels (k, 1)."""
    return np.sum(of_wheels, axis=1, keepdims=True)


def _gained(energy: Array) -> Array:
    """Return by how much the energy of steps (k, 1) grows in each, from half-way between steps to half-way."""
    return np.diff(np.concatenate([energy[:1], (energy[1:] + energy[:-1]) / 2, energy[-1:]]), axis=0)
