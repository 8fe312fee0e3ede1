"""A slippery patch of the floor, found where wheels slip far more than elsewhere, and judged by simulation.

Sliding depends on forces that no encoder measures, and has either sign, so a patch is not a column of the linear
problem. A scan for two variances proposes rectangles (`hypotheses.patches`), and replays of the logs in simulation give
the likelihood of each, against friction that is lower on all of the floor: where wheels fight, replays are wrong
everywhere. A replay is lost as a whole, as when a castor that is pushed swings round otherwise than the robot's: its
errors of wheels, pivots and place have a multivariate t distribution (Lange, Little and Taylor, JASA 84(408), 1989),
whose scales and degrees of freedom the replays without a patch show.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit, gammaln

from castor_envs.effects.clocks import ClockSkew
from castor_envs.effects.floor import FrictionPatch
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.physics.contact_motion import ContactMotion
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, described, without
from discrepancy.hypotheses.patches import CELL, box_of, near, patch_at, patches_of, within
from discrepancy.hypotheses.wheel_tracks import placed
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.calibrated import LOG_ODDS, prior_log_odds
from discrepancy.posterior.linearise import Linearised
from discrepancy.validation.replay import Replay, replay
from estimators.likelihood.channels import Channels

SLIPPERY = (0.75, 0.85, 0.9, 0.94, 0.97, 0.99)
"""Parts of friction that may be missing, all with the same prior probability."""

TRIED = SLIPPERY[3]
"""Part of friction with which rectangles are compared; the likeliest is evaluated with all parts."""

WINDOW = 1.0
"""s: length of a replayed window. Castors that are pushed backwards depart from their way by the factor e in about the
time in which the robot drives their offset: in windows of 2 s replays of clean logs of straight lines to and fro are
lost, and a patch may seem to be right by chance; in 0.5 s wheels that fight do not begin to slide."""

NORMAL = 1e4
"""Degrees of freedom from which on a t distribution is a normal one, to 0.02 % of its variance."""

PLACE = 2e-3
"""m: least error that a replay is assumed to have against a tracker's poses."""


@dataclass(frozen=True)
class Slippery:
    """A patch, the standard deviation of its value, and the log odds of its presence."""

    effect: FrictionPatch
    error: float
    log_odds: float


def slippery_in(robot: RobotDescription, logs: Sequence[Log], seen: Linearised, names: int) -> Slippery | None:
    """Return the likeliest patch on which wheels slide; None if its probability is below `CREDIBLE`, or robot or logs
    cannot be replayed.

    names: number of other possible answers, all of the same prior probability; a patch is equally likely anywhere on
    the way.
    """
    motions, slips = placed(robot, logs, seen.state, seen.slips)
    if not motions:
        return None
    try:
        replays = _Replays(robot, logs, seen)
    except InputError:  # a robot that cannot be replayed
        return None
    tried = [(patch, replays.gain(patch, TRIED)) for patch in patches_of(robot, motions, slips)]
    patch, most = max(tried, key=lambda found: found[1], default=(None, 0.0))
    if patch is None or most <= 0:
        return None
    way = np.concatenate([motion.pose[:, :2] for motion in motions])
    area, odds = float(np.prod(np.ptp(way, axis=0))), prior_log_odds(names)
    if replays.judged(patch, area, odds).log_odds < LOG_ODDS:
        return None
    odds -= max(_log_mean(replays.gains(replays.whole_floor)), 0.0)
    patch, _ = max((replays.refined(*proposed) for proposed in tried), key=lambda found: found[1])
    found = replays.judged(patch, area, odds)
    return found if found.log_odds >= LOG_ODDS else None


def _log_mean(log_factors: Array) -> float:
    """Return the logarithm of the mean of likelihood ratios, given theirs."""
    return float(np.logaddexp.reduce(log_factors) - np.log(len(log_factors)))


def confirmed_by(robot: RobotDescription, logs: Sequence[Log], seen: Linearised, patch: Slippery) -> float:
    """Return the log-likelihood ratio (natural logarithm) of other logs with a patch, or with the patch that these logs
    show in the same place.

    A second patch is tried because a single log hardly determines how far a patch extends.
    """
    try:
        as_found = _Replays(robot, logs, seen).gain(patch.effect, patch.effect.value)
    except InputError:  # logs that cannot be replayed
        return 0.0
    again = slippery_in(robot, logs, seen, 1)
    if again is None or not (_holds(patch.effect, again.effect) or _holds(again.effect, patch.effect)):
        return as_found
    return max(as_found, again.log_odds)


def _holds(first: FrictionPatch, second: FrictionPatch) -> bool:
    """Whether the centre of the second patch lies on the first."""
    return bool(within(np.array([[second.x, second.y]]), box_of(first))[0])


def inside(robot: RobotDescription, logs: Sequence[Log], seen: Linearised, patch: Slippery) -> list[NDArray[np.bool_]]:
    """Return the steps (K - 1, rows) of each log in which wheels stand on a patch, or castors with a wheel on it."""
    steps = []
    for contacts, design in zip(_contacts(robot, logs, seen), seen.designs, strict=True):
        wheels = patch.effect.inside(contacts)
        of = np.asarray(robot.wheel_castors)
        sideways = np.stack([np.any(wheels[:, of == castor], axis=1) for castor in of], axis=1)
        steps.append(np.column_stack([wheels, sideways])[:, design.model.rows])
    return steps


def answer_of(patch: Slippery, cost: Array, confirmed: float | None) -> Answer:
    """Return the answer for a patch. cost (2,): of the whole patch; confirmed: see `Answer`."""
    candidate = Candidate(described(patch.effect), (patch.effect,))
    size = patch.effect.value, patch.error
    return Answer.judged_apart(candidate, float(expit(patch.log_odds)), *size, cost, confirmed)


def _contacts(robot: RobotDescription, logs: Sequence[Log], seen: Linearised) -> list[ContactMotion]:
    """Return how the contacts move in each log."""
    motions = (
        Channels(robot).motion(log, state, consistent_wheels=True)
        for log, state in zip(logs, seen.state.states, strict=True)
    )
    return [ContactMotion(robot.as_built(), motion) for motion in motions]


class _Replays:
    """Replays of the logs that have a reference, on an even floor and on floors with a patch.

    A patch changes only windows in which a wheel comes to it, so the others are not simulated again.
    """

    def __init__(self, robot: RobotDescription, logs: Sequence[Log], seen: Linearised) -> None:
        self._robot = without(robot, ClockSkew)
        posed = [k for k, log in enumerate(logs) if log.reference is not None]
        contacts = _contacts(robot, logs, seen)
        mount, states, clocks = seen.state.mount, seen.state.states, seen.state.clocks
        self._logs = [(logs[k], {"clock": clocks[k], "mount": mount, "path": states[k]}) for k in posed]
        self._contacts = [contacts[k] for k in posed]
        self._plain = [replay(self._robot, log, WINDOW, **by) for log, by in self._logs]
        self._errors = self._errors_of(self._plain)
        self._spread = _Spread.of(self._errors)

    def gain(self, patch: FrictionPatch, value: float) -> float:
        """Return the log-likelihood ratio (natural logarithm) of replays with a patch of a value."""
        robot = self._robot.with_effects(replace(patch, value=value))
        larger, replays = replace(patch, length=patch.length + CELL, width=patch.width + CELL), []
        for (log, by), contacts, plain in zip(self._logs, self._contacts, self._plain, strict=True):
            there = np.cumsum(np.append(False, larger.inside(contacts).any(axis=1)))
            first, last = np.searchsorted(log.t, plain.start, "right") - 1, np.searchsorted(log.t, plain.end)
            anew = there[np.minimum(last, len(there) - 1)] > there[first]
            replays.append(replay(robot, log, WINDOW, **by, like=plain, anew=anew))
        return self._spread.likelier(self._errors_of(replays), self._errors)

    def gains(self, patch: FrictionPatch) -> Array:
        """Return the log-likelihood ratios of replays with each part of friction missing on a rectangle."""
        return np.array([self.gain(patch, value) for value in SLIPPERY])

    def judged(self, patch: FrictionPatch, area: float, anywhere: float) -> Slippery:
        """Return what replays with all parts of friction say of a rectangle. area: m^2, of the way; anywhere: prior log
        odds (natural logarithm) of a patch anywhere on it."""
        log_factors = self.gains(patch)
        elsewhere = max(np.log(area / (patch.length * patch.width)), 0.0)
        log_odds = _log_mean(log_factors) - elsewhere + anywhere
        weight = np.exp(log_factors - log_factors.max())
        value = float(np.average(SLIPPERY, weights=weight))
        error = float(np.sqrt(np.average((np.array(SLIPPERY) - value) ** 2, weights=weight)))
        error = float(np.hypot(error, (1 - value) / 2))  # the rectangle is not known any better
        return Slippery(replace(patch, value=round(value, 3)), error, float(log_odds))

    def refined(self, patch: FrictionPatch, most: float) -> tuple[FrictionPatch, float]:
        """Return the rectangle near another with which replays are likeliest, its sides moved in steps of `CELL`, and
        the log-likelihood ratio. most: that of the rectangle itself."""
        better = True
        while better:
            better = False
            for box in near(box_of(patch), CELL):
                moved = patch_at(box)
                if (likelier := self.gain(moved, TRIED)) > most:
                    patch, most, better = moved, likelier, True
                    break
        return patch, most

    @property
    def whole_floor(self) -> FrictionPatch:
        """A rectangle on which all contacts are at all times."""
        places = np.concatenate([contacts.places().reshape(-1, 2) for contacts in self._contacts])
        (x, y), side = (places.min(axis=0) + places.max(axis=0)) / 2, 2 * float(np.hypot(*np.ptp(places, axis=0)))
        return FrictionPatch(x=float(x), y=float(y), length=side, width=side, value=TRIED)

    def _errors_of(self, replays: Sequence[Replay]) -> Array:
        """Return the errors (3, N) at the ends of windows: wheels, m; pivots, rad; place, m. NaN where there is no
        reference, and of robots without pivot encoders."""
        geometry = Geometry.of(self._robot.as_built())
        roll = np.nanmedian(2 * np.pi * geometry.radius / geometry.counts_per_rev)
        sensed = geometry.pivot_counts_per_rev[np.isfinite(geometry.pivot_counts_per_rev)]
        turn = float(np.median(2 * np.pi / sensed)) if len(sensed) else 0.0
        errors = []
        for left in replays:
            place = np.sum(left.body[:, :2] ** 2, axis=1)
            pivots = np.mean(left.pivots**2, axis=1) if left.pivots.shape[1] else np.full(len(place), np.nan)
            wheels = np.mean(left.wheels**2, axis=1)
            errors.append(np.sqrt([wheels + roll**2 / 6, pivots + turn**2 / 6 + 1e-8, place + PLACE**2]))
        return np.concatenate(errors, axis=1)


class _Spread(NamedTuple):
    """A multivariate t distribution about 0; of errors of which some are NaN, the marginal distribution of the others.
    scales (kinds,): NaN of kinds without any errors."""

    scales: Array
    freedom: float

    @classmethod
    def of(cls, errors: Array) -> "_Spread":
        """Return the most likely distribution of errors (kinds, N)."""
        shown = np.isfinite(errors).any(axis=1)
        seen, scales = errors[shown], np.full(len(errors), np.nan)

        def surprise(point: Array) -> float:
            return cls(np.exp(point[:-1]), float(np.exp(point[-1]))).surprise(seen)

        bounds = [(None, None)] * len(seen) + [np.log([1.0, NORMAL])]
        begin = np.append(np.log(np.nanmedian(np.abs(seen), axis=1)), 1.0)
        point = minimize(surprise, begin, method="L-BFGS-B", bounds=bounds).x
        scales[shown] = np.exp(point[:-1])
        return cls(scales, float(np.exp(point[-1])))

    def surprise(self, errors: Array) -> float:
        """Return minus the log-likelihood (natural logarithm, up to a constant) of errors (kinds, N)."""
        squares = np.nansum((errors / self.scales[:, None]) ** 2, axis=0)
        kinds, half = np.isfinite(errors).sum(axis=0), self.freedom / 2
        constant = gammaln(half + kinds / 2) - gammaln(half) - kinds / 2 * np.log(self.freedom)
        of_scales = np.nansum(np.isfinite(errors).sum(axis=1) * np.log(self.scales))
        return float(of_scales + np.sum((half + kinds / 2) * np.log1p(squares / self.freedom) - constant))

    def likelier(self, errors: Array, plain: Array) -> float:
        """Return the log-likelihood ratio of `errors` over `plain` (kinds, N)."""
        return self.surprise(plain) - self.surprise(errors)
