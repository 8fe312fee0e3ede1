"""The reference against clean logs: whether it is mounted otherwise, or its clock set otherwise, than in these.

Which point a reference tracks, how its axes are turned, and the offset of its clock are unknown numbers of every fit,
so that no log alone tells of a fault. Clean logs tell what these numbers were, and how much they scatter from log to
log. Each is judged by itself: in good order it differs from that of the clean logs by its tolerance, as an effect of
the catalogue does, and a fault is Cauchy distributed. How much it scatters is unknown, with the prior that all random
effects have (`random_effects`).
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import expit, softmax

from castor_envs.effects.clocks import ClockOffset
from castor_envs.effects.reference import ReferenceLeverX, ReferenceLeverY, ReferenceYaw
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, described, stacked
from discrepancy.measurement.design_matrix import numbers_of, schur_complement
from discrepancy.posterior.answers import SHOWN, Answer
from discrepancy.posterior.calibrated import CREDIBLE, FAULT, FREEDOM, SIGNATURE, prior_log_odds
from discrepancy.posterior.linearise import Linearised
from discrepancy.posterior.priors import ALIKE, bounds_of, same_effects
from discrepancy.posterior.single_effects import LOG_WEIGHTS, SCALES, credible
from estimators.calibration.maximum_likelihood.tracker import MOUNT
from estimators.likelihood.measurements.poses import TIMED

KINDS: tuple[type[Effect[RobotDescription]], ...] = (ReferenceLeverX, ReferenceLeverY, ReferenceYaw, ClockOffset)
"""Effects on the reference that every fit takes as unknown numbers, in the order of `Shown`."""

SCATTERS = np.geomspace(0.1, 1e4, 120)
"""Standard deviations from log to log that are considered, in tolerances: even in their logarithm."""

POSES = np.array([1, 1, 1, TIMED])
"""Reference poses of a log from which on it tells each of them."""

UNKNOWN = 1e6
"""Standard deviation, in tolerances, of what a log does not tell."""


@dataclass(frozen=True, eq=False)
class Shown:
    """What logs show of the reference: the tracked point (m, m), its axes (rad) and the offset of its clock (s) in each
    log (L, 4), and their variances (L, 4)."""

    size: Array
    variance: Array

    @classmethod
    def by(cls, seen: Linearised) -> "Shown":
        """Return what linearised logs show, each by itself, beside the effects in their robot."""
        sizes, variances = np.zeros((2, len(seen.designs), len(KINDS)))
        for log, design in enumerate(seen.designs):
            unchanged, mount = stacked(design.geometry, []), seen.shared.mount
            at = design.geometry, unchanged, np.zeros(0), design.state, design.clock
            information, gradient = design.model.reduce(*at, mount, seen.noise, rate=design.rate).with_own
            information[range(3), range(3)] += MOUNT**-2.0
            gradient[:3] += mount / MOUNT**2
            covariance = np.linalg.inv(information)
            numbers = np.append(mount, design.clock[0]) - (covariance @ gradient)[: len(KINDS)]
            sizes[log], variances[log] = numbers, np.diag(covariance)[: len(KINDS)]
            variances[log, design.model.poses_used < POSES] = np.inf
        return cls(sizes, variances)

    def of(self, k: int) -> tuple[Array, Array]:
        """Return what logs show of one number, in tolerances, and its variances (L,)."""
        tolerance = KINDS[k].tolerance
        return self.size[:, k] / tolerance, np.minimum(self.variance[:, k] / tolerance**2, UNKNOWN**2)


def reference_answers(
    robot: RobotDescription,
    before: RobotDescription,
    logs: Sequence[Log],
    seen: Linearised,
    held_out: Shown | None,
    clean: Shown,
    names: int,
) -> list[Answer]:
    """Return the answers on how the reference is mounted and its clock set, other than in clean logs.

    before: the robot as it was described for these. seen: the logs linearised beside the named effects. names: number
    of possible answers, all of the same prior probability.
    """
    answers, shown, (_, unseen) = [], Shown.by(seen), same_effects(robot.as_described())
    for k, kind in enumerate(KINDS):
        known = sum(effect.value for effect in robot.effects if isinstance(effect, kind))
        known -= sum(effect.value for effect in before.effects if isinstance(effect, kind))
        change = _Change(clean.of(k), shown.of(k), known / kind.tolerance)
        probability = float(expit(change.log_bayes_factor + prior_log_odds(names)))
        if probability < CREDIBLE:
            continue
        (variant,) = kind.variants(robot)
        size, error = change.size * kind.tolerance, change.error * kind.tolerance
        confirmed = None if held_out is None else change.confirmed(held_out.of(k))
        candidate, cost = Candidate(described(variant), (variant,)), size * _apparent(kind, logs, seen)
        answer = Answer.judged_apart(candidate, probability, size, error, cost, confirmed)
        alike = tuple(family for family, looks in unseen.items() if _alone(looks, k))
        answers.append(replace(_or_rivals(answer, rivals(seen, k, size, unseen)), alike=alike))
    return answers


def rivals(seen: Linearised, k: int, size: float, unseen: Collection[str]) -> dict[str, float]:
    """Return the families of candidates that do in these logs what a change of the k-th number of `KINDS` by a size
    does, each with its log odds against that (natural logarithm): as far as the logs differ, by more than the error of
    a signature, and as the priors of both sizes do. Fits take that number as unknown, so that statistics of candidates
    do not show them.

    In each log all other nuisances are as it tells itself. unseen: families that no log shows.
    """
    count = len(seen.usual)
    total = np.zeros((count + 1, count + 1))
    for design in seen.designs:
        reduced = design.reduce(seen.shared.mount, seen.noise)
        information, shared = reduced.with_own[0].copy(), len(reduced.information)
        at = numbers_of(design.candidates, seen.columns)
        seen.shared.add_priors(information[:shared, :shared], np.zeros((shared, 1)), len(at))
        number = shared - len(seen.shared.mount) + k  # before the clock's offset, the first of the log's own numbers
        first = np.append(np.arange(len(at)), number)
        order = np.append(first, np.delete(np.arange(len(information)), first))
        of_log, _ = schur_complement(information[np.ix_(order, order)], np.zeros(len(order)), len(first))
        at = np.append(at, count)
        total[np.ix_(at, at)] += of_log
    prior_of_change, found = _log_prior(size, KINDS[k].tolerance), dict[str, float]()
    for candidate, columns in seen.columns.items():
        known, shared_with = float(total[columns[0], columns[0]]), float(total[columns[0], count])
        if len(columns) > 1 or not candidate.kinds or candidate.family in unseen or not known or not shared_with:
            continue
        amplitude, (low, high) = size * shared_with / known, bounds_of(candidate.kinds[0])
        if low <= amplitude <= high:
            lost = size**2 * float(total[count, count] - shared_with**2 / known) / 2
            lost /= 1 + SIGNATURE**2 * amplitude**2 * known
            found[candidate.family] = _log_prior(amplitude, candidate.kinds[0].tolerance) - prior_of_change - lost
    return found


def _log_prior(size: float, tolerance: float) -> float:
    """Return the logarithm, up to a constant, of the prior density of a fault's logarithm of size."""
    part = abs(size) / (FAULT * tolerance)
    return float(np.log(part / (1 + part**2)))


def _or_rivals(answer: Answer, log_odds: dict[str, float]) -> Answer:
    """Return the answer on a change of the reference with its rivals in the credible set, if they belong there."""
    name, probability = answer.credible[0], answer.probability
    parts = dict(zip((name, *log_odds), probability * softmax([0.0, *log_odds.values()]), strict=True))
    names = tuple(dict.fromkeys((name, *credible(parts))))
    likeliest = sorted(parts, key=lambda family: -parts[family])
    shown = {family: float(parts[family]) for family in likeliest if family in names or parts[family] > SHOWN}
    return replace(answer, probabilities=shown | {"nothing": 1 - probability}, credible=names)


def _alone(looks: Array, k: int) -> bool:
    """Whether a shift of the tracked point and its axes (3,) is one of its k-th number alone."""
    if k >= len(looks):
        return False
    parts = looks / [kind.tolerance for kind in KINDS[: len(looks)]]
    return bool(parts[k] ** 2 > (1 - ALIKE) * (parts @ parts) > 0)


def _apparent(kind: type[Effect[RobotDescription]], logs: Sequence[Log], seen: Linearised) -> Array:
    """Return by how much odometry seems to be off (2,), rms, m and rad, per unit of an effect on the reference."""
    if kind is ReferenceYaw:
        return np.array([0.0, 1.0])
    if kind is not ClockOffset:
        return np.array([1.0, 0.0])
    speeds = [np.gradient(state[:, :3], log.t, axis=0) for log, state in zip(logs, seen.state.states, strict=True)]
    square = np.mean(np.concatenate(speeds) ** 2, axis=0)
    return np.sqrt([square[0] + square[1], square[2]])


class _Change:
    """A change of a number from clean logs to others, in tolerances.

    log_bayes_factor: of a fault against good order. size, error: of a fault, and its standard deviation.
    """

    def __init__(self, clean: tuple[Array, Array], logs: tuple[Array, Array], known: float) -> None:
        """clean, logs: what each log shows, and its variances. known: of the change."""
        self._known = known
        log_prior = -FREEDOM * np.log(SCATTERS) - FREEDOM / (4 * SCATTERS**2)  # about half of the tolerance's square
        mean, variance, log_fit = _pooled(*clean)
        self._mean, self._variance, self._scatter = mean, variance, log_prior + log_fit
        change, variance, log_fit = self._to(logs)
        weight = self._scatter + log_fit
        wide = variance[:, None] + (FAULT * SCALES) ** 2
        of_fault = weight[:, None] + LOG_WEIGHTS + _log_normal(change[:, None], wide)
        fault = np.logaddexp.reduce(of_fault, axis=None)
        self.log_bayes_factor = float(fault - np.logaddexp.reduce(weight + _log_normal(change, variance + 0.5)))
        part, shrunk = np.exp(of_fault - fault), (FAULT * SCALES) ** 2 / wide
        sizes = change[:, None] * shrunk
        self.size = float(np.sum(part * sizes))
        self.error = float(np.sqrt(np.sum(part * (variance[:, None] * shrunk + (sizes - self.size) ** 2))))

    def confirmed(self, held_out: tuple[Array, Array]) -> float:
        """Return the log-likelihood ratio of held-out logs with a change of this size and in good order."""
        change, variance, log_fit = self._to(held_out)
        weight = self._scatter + log_fit
        changed, good = _log_normal(change - self.size, variance + self.error**2), _log_normal(change, variance + 0.5)
        return float(np.logaddexp.reduce(weight + changed) - np.logaddexp.reduce(weight + good))

    def _to(self, logs: tuple[Array, Array]) -> tuple[Array, Array, Array]:
        """Return the change to the mean of logs by `SCATTERS`, its variance, and the log-likelihood of their scatter
        about it."""
        mean, variance, log_fit = _pooled(*logs)
        return mean - self._mean - self._known, variance + self._variance, log_fit


def _pooled(size: Array, variance: Array) -> tuple[Array, Array, Array]:
    """Return, for each of `SCATTERS`, the mean of what logs show (L,), its variance, and the log-likelihood of what
    they show about it."""
    total = variance + SCATTERS[:, None] ** 2
    of_mean = 1 / np.sum(1 / total, axis=1)
    mean = of_mean * np.sum(size / total, axis=1)
    log_fit = np.sum(_log_normal(size - mean[:, None], total), axis=1) + np.log(of_mean) / 2
    return mean, of_mean, log_fit


def _log_normal(away: Array, variance: Array) -> Array:
    """Return the logarithm of a normal density, up to a constant."""
    return -(np.log(variance) + away**2 / variance) / 2
