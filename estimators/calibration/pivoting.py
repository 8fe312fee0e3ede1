"""Doebbler's calibration: one castor is held, the base turns about its pivot, clockwise and counter-clockwise.

Doebbler et al., "Odometry and Calibration Methods for Multi-Castor Vehicles", III.A, eqs. 1-9: from both directions
every other castor's offset r_c, pivot bias beta, wheel radii r_w and half tracks d follow in closed form. Known is the
distance D between two pivots. Bearings are in the body's frame; theta_perp is the direction in which the pivot travels
when the base turns clockwise (the bearing from the held pivot, less 90 deg). Angles are unwrapped, wheel 1 is the left
one, and c are the angles by which wheels turned, as sizes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import Declined, InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
from castor_envs.logs.log import Log, pivot_jumps, unwrapped
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.protocol import Recording, Report, Result, in_recording

STEADY = 2.0
"""Counts by which a castor's angle may still move for it to have swung in."""

HELD = np.radians(5.0)
"""Angle by which a held castor's wheels may turn under load. A brake gives a little; a base that drags it, far more."""

SLIPPING = 0.02
"""Share of a wheel's turn by which it may stray from an even share of the base's; speeding up costs a little slip."""

FAR = 2.0
"""Factor by which a length may differ from the robot file's; dimensions are measured better than that."""

ROUNDING = 3.0
"""Counts of apparent deviation that rounding may cause."""


class CastorParameters(NamedTuple):
    """The parameters of a castor in eqs. 1-9: r_c (...) m, beta (...) rad, r_w and d (..., 2) m, left wheel first."""

    offset: Array
    pivot_zero: Array
    radius: Array
    half_track: Array


def from_turns(
    distance: ArrayLike,
    theta_perp: ArrayLike,
    gamma: tuple[ArrayLike, ArrayLike],
    turn: tuple[ArrayLike, ArrayLike],
    rolled: tuple[ArrayLike, ArrayLike],
) -> CastorParameters:
    """Return a castor's parameters from a clockwise and a counter-clockwise turn, each a pair (cw, ccw).

    distance: D (...), m. theta_perp (...), rad. gamma: measured castor angle (...), rad. turn: size of the base's turn
    (...), rad. rolled: c of both wheels (..., 2), rad.
    """
    cw, ccw = (np.asarray(angle, dtype=float) for angle in gamma)
    turn_cw, turn_ccw = (np.asarray(angle, dtype=float)[..., None] for angle in turn)
    c_cw, c_ccw = (np.asarray(c, dtype=float) for c in rolled)
    distance, side = np.asarray(distance, dtype=float), np.array([1.0, -1.0])
    between = wrap(ccw - cw - np.pi) + np.pi  # next to 180 deg: castors trail
    path_angle = (np.pi - between) / 2  # eq. 1
    pivot_zero = wrap(cw + between / 2 - np.pi / 2 - np.asarray(theta_perp))  # eq. 2
    offset = distance * np.sin(path_angle)  # eq. 3
    arm = (distance * np.cos(path_angle))[..., None]
    total = turn_ccw * c_cw + turn_cw * c_ccw
    radius = 2 * arm * turn_ccw * turn_cw / total  # eq. 8
    half_track = side * arm * (turn_ccw * c_cw - turn_cw * c_ccw) / total  # eq. 9
    return CastorParameters(offset, pivot_zero, radius, half_track)


@dataclass(frozen=True, eq=False)
class Turn:
    """One run: the log of a base that turned about the pivot of castor `held` (from 1). No reference is needed."""

    log: Log
    held: int


@dataclass(frozen=True, eq=False)
class PivotingCalibration:
    """Parameters of all castors (n,), the mean of `estimates` (e, n), one for each castor that was held; NaN for none.

    errors: standard errors, from the rounding of counts, or from the spread of the estimates if that is larger. Slip
    that is the same about every castor is not included. robot: as it was described.
    """

    robot: RobotDescription
    parameters: CastorParameters
    errors: CastorParameters
    estimates: CastorParameters

    def applied(self) -> RobotDescription:
        """Return the robot with the estimated parameters; a castor that was never free keeps its numbers."""
        found = self.parameters
        castors = []
        for i, castor in enumerate(self.robot.castors):
            if np.isfinite(found.offset[i]):
                numbers = zip(castor.wheels, found.radius[i], found.half_track[i] * [1.0, -1.0], strict=True)
                wheels = tuple(replace(w, radius=float(r), lateral=float(d)) for w, r, d in numbers)
                castor = replace(
                    castor, offset=float(found.offset[i]), pivot_zero=float(found.pivot_zero[i]), wheels=wheels
                )
            castors.append(castor)
        return replace(self.robot, castors=tuple(castors))


def calibrate(robot: RobotDescription, turns: Sequence[Turn]) -> PivotingCalibration:
    """Calibrate all castors of a robot on two or more split castors from turns both ways about held castors.

    Several turns about one castor in one direction are averaged. Raises InputError, saying what to record instead,
    where a direction is missing, the held castor was not held, the base did not turn, wheels slipped, or a count jumps.
    """
    _check(robot)
    n, held = len(robot.castors), sorted({turn.held for turn in turns})
    if not turns:
        raise Declined("there is no log; record a turn clockwise and one counter-clockwise about a held castor")
    if held[0] < 1 or held[-1] > n:
        raise InputError(f"castor {held[-1] if held[-1] > n else held[0]} cannot have been held: there are {n}")
    estimates, errors = [], []
    for castor in held:
        measured = [_measured(robot, turn) for turn in turns if turn.held == castor]
        ways = [[m for m in measured if m.ccw == ccw] for ccw in (False, True)]
        for way, missing in zip(ways, ("clockwise", "counter-clockwise"), strict=True):
            if not way:
                raise Declined(f"castor {castor} was held for turns in one direction only; record one {missing} too")
        estimates.append(_estimate(robot, castor, *(_mean(way) for way in ways)))
        errors.append(_rounding(robot, castor, *(_mean(way) for way in ways)))
    stacked, rounding = _stacked(estimates), _stacked(errors)
    _check_sizes(robot, stacked)
    parts = zip(stacked, rounding, strict=True)
    return PivotingCalibration(
        robot,
        CastorParameters(*map(_mean_of_known, stacked)),
        CastorParameters(*(np.fmax(_of_mean(error), _spread(part)) for part, error in parts)),
        stacked,
    )


def held_castor(robot: RobotDescription, log: Log) -> int:
    """Return the number (from 1) of the castor whose wheels stood in a log; raises InputError if not just one did."""
    _check(robot)
    per_wheel = np.array([wheel.counts_per_rev for wheel in robot.wheels], dtype=float)
    turned = np.ptp(log.wheel, axis=0) * 2 * np.pi / per_wheel
    still = np.flatnonzero(turned.reshape(-1, 2).max(axis=1) <= HELD) + 1
    if len(still) != 1:
        found = "none" if not len(still) else " and ".join(map(str, still))
        raise Declined(
            f"castors whose wheels stood: {found}; record turns in which the wheels of just one castor are blocked"
        )
    return int(still[0])


class _Measured(NamedTuple):
    """Measurements of one turn: gamma (n,), size of the turn, wheel angles (n, 2), direction."""

    gamma: Array
    turn: Array
    rolled: Array
    ccw: bool


def _check(robot: RobotDescription) -> None:
    if len(robot.castors) < 2:
        raise Declined(f"robot {robot.name!r} has one castor; this calibration holds one and calibrates others")
    for i, castor in enumerate(robot.castors, start=1):
        if len(castor.wheels) != 2 or not all(w.driven and w.grip == "standard" for w in castor.wheels):
            raise Declined(f"robot {robot.name!r}: castor {i} needs two driven wheels with grip 'standard'")
        if castor.pivot_counts_per_rev is None:
            raise Declined(f"robot {robot.name!r}: castor {i} has no pivot encoder")


def _check_sizes(robot: RobotDescription, found: CastorParameters) -> None:
    """Raise InputError where a length is out of all proportion to the robot file (`FAR`)."""
    for i, castor in enumerate(robot.castors):
        for name, values, described in (
            ("r_c", found.offset, castor.offset),
            ("r_w", found.radius, [wheel.radius for wheel in castor.wheels]),
            ("d", found.half_track, np.abs([wheel.lateral for wheel in castor.wheels])),
        ):
            ratio = values[:, i] / described
            if np.any(np.isfinite(ratio) & ((ratio < 1 / FAR) | (ratio > FAR))):
                raise InputError(
                    f"castor {i + 1} would have {name} of {np.nanmean(ratio):.2g} times the robot file's; look for "
                    "encoders or castors that are swapped, and counts per turn or dimensions that are wrong by a factor"
                )


def _measured(robot: RobotDescription, turn: Turn) -> _Measured:
    log, held = turn.log, turn.held - 1
    per_pivot = np.array([castor.pivot_counts_per_rev for castor in robot.castors], dtype=float)
    per_wheel = np.array([wheel.counts_per_rev for wheel in robot.wheels], dtype=float)
    for i in range(len(per_pivot)):
        if (jumps := pivot_jumps(log.pivot[:, i], per_pivot[i])).size:
            raise InputError(f"pivot {i + 1} jumps by over half a turn at row {jumps[0] + 1}; sample faster")
    pivot, wheel = unwrapped(log.pivot, per_pivot), log.wheel - log.wheel[0]
    gave = np.abs(wheel[:, 2 * held : 2 * held + 2] * 2 * np.pi / per_wheel[2 * held : 2 * held + 2]).max()
    if gave > HELD:
        raise InputError(
            f"castor {turn.held} was not held: its wheels turned by {np.degrees(gave):.0f} deg; block them, turn with "
            "a lower voltage, or name the castor that was held"
        )

    free = [i for i in range(len(per_pivot)) if i != held]
    moving = np.abs(pivot[:, free] - pivot[-1, free]).max(axis=1) > STEADY
    start = int(np.flatnonzero(moving)[-1]) + 1 if moving.any() else 0
    angle = -(pivot[start:, held] - pivot[start, held]) * 2 * np.pi / per_pivot[held]
    if np.abs(angle[-1]) < np.pi / 6:
        raise InputError(
            f"about castor {turn.held} the base turned by {np.degrees(angle[-1]):.1f} deg after its castors had swung "
            "in; record at least half a turn, castors aligned"
        )
    since = wheel[start:] - wheel[start]
    share = since[-1] / angle[-1]
    rounding = ROUNDING + np.abs(share) * 2 * np.pi / per_pivot[held]
    slip = np.abs(since - angle[:, None] * share).max(axis=0) - rounding - SLIPPING * np.abs(since[-1])
    slip[2 * held : 2 * held + 2] = -np.inf
    worst = int(np.argmax(slip))
    if slip[worst] > 0:
        raise InputError(
            f"wheel {robot.wheel_names[worst]} slipped while the base turned about castor {turn.held}: it strays "
            f"by over {100 * SLIPPING:g} % from an even share of the turn; turn with a lower voltage"
        )
    free_wheels = np.repeat(np.arange(len(per_pivot)) != held, 2)
    for k in np.flatnonzero(free_wheels & (since[-1] <= 0))[:1]:
        raise InputError(
            f"wheel {robot.wheel_names[k]} counts {since[-1, k]:g} while the base turned about castor {turn.held}, and "
            "wheels of castors that trail roll forward; look for an encoder that is dead, reversed or swapped"
        )
    rolled = np.abs(since[-1]) * 2 * np.pi / per_wheel
    gamma = pivot[start:].mean(axis=0) * 2 * np.pi / per_pivot
    return _Measured(gamma, np.abs(angle[-1]), rolled.reshape(-1, 2), bool(angle[-1] > 0))


def _mean(way: list[_Measured]) -> _Measured:
    """Return the mean of turns in one direction; angles next to the first one's, wheels by their share of the turn."""
    gamma = way[0].gamma + np.mean([wrap(m.gamma - way[0].gamma) for m in way], axis=0)
    turn = np.mean([m.turn for m in way], axis=0)
    return _Measured(gamma, turn, np.mean([m.rolled * turn / m.turn for m in way], axis=0), way[0].ccw)


def _estimate(robot: RobotDescription, held: int, cw: _Measured, ccw: _Measured) -> CastorParameters:
    """Return the parameters of all castors from turns about one; NaN of that one itself."""
    pivot = np.array([castor.pivot for castor in robot.castors])
    away = pivot - pivot[held - 1]
    distance, bearing = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0])
    found = from_turns(
        distance,
        bearing - np.pi / 2,
        (cw.gamma, ccw.gamma),
        (np.full(len(pivot), cw.turn), np.full(len(pivot), ccw.turn)),
        (np.maximum(cw.rolled, 1e-12), np.maximum(ccw.rolled, 1e-12)),
    )
    blind = np.arange(len(pivot)) == held - 1
    return CastorParameters(*(np.where(blind if part.ndim == 1 else blind[:, None], np.nan, part) for part in found))


def _rounding(robot: RobotDescription, held: int, cw: _Measured, ccw: _Measured) -> CastorParameters:
    """Return standard errors of `_estimate` from the rounding of counts: numbers moved by it one after another."""
    pivot = 2 * np.pi / np.array([castor.pivot_counts_per_rev for castor in robot.castors], dtype=float)
    wheel = 2 * np.pi / np.array([w.counts_per_rev for w in robot.wheels], dtype=float).reshape(-1, 2)
    rounded, difference = 1 / np.sqrt(12), 1 / np.sqrt(6)  # of a rounded number, of the difference of two
    best = _estimate(robot, held, cw, ccw)
    changes = []
    for turn, opposite in ((cw, ccw), (ccw, cw)):
        for moved in (
            turn._replace(gamma=turn.gamma + rounded * pivot),
            turn._replace(turn=turn.turn + difference * pivot[held - 1]),
            turn._replace(rolled=turn.rolled + difference * wheel * [1.0, 0.0]),
            turn._replace(rolled=turn.rolled + difference * wheel * [0.0, 1.0]),
        ):
            pair = (moved, opposite) if turn is cw else (opposite, moved)
            changes.append(_estimate(robot, held, *pair))
    by_part = zip(best, *changes, strict=True)
    return CastorParameters(*(np.sqrt(sum((part - at) ** 2 for part in parts)) for at, *parts in by_part))


def _stacked(castors: list[CastorParameters]) -> CastorParameters:
    return CastorParameters(*(np.stack(parts) for parts in zip(*castors, strict=True)))


def _mean_of_known(values: Array) -> Array:
    known = np.isfinite(values)
    count = known.sum(axis=0)
    return np.where(count > 0, np.where(known, values, 0.0).sum(axis=0) / np.maximum(count, 1), np.nan)


def _of_mean(errors: Array) -> Array:
    """Return standard errors of means of independent estimates."""
    known = np.isfinite(errors)
    count = known.sum(axis=0)
    total = np.sqrt(np.where(known, errors**2, 0.0).sum(axis=0))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _spread(values: Array) -> Array:
    """Return the standard error of the mean that the estimates (e, ...) show; NaN where there are fewer than two."""
    known = np.isfinite(values)
    count = known.sum(axis=0)
    squares = np.where(known, (values - _mean_of_known(values)) ** 2, 0.0).sum(axis=0)
    return np.where(count > 1, np.sqrt(squares / np.maximum(count * (count - 1), 1)), np.nan)


class PivotingMethod:
    """Turns about held castors, both ways (Doebbler, eqs. 1-9); bases on two or more split castors."""

    title = "pivoting about held castors (Doebbler, eqs. 1-9)"
    takes_squares = False
    finds_pivots = False

    def calibrate(self, robot: RobotDescription, recordings: Sequence[Recording]) -> RobotDescription:
        """Return the robot with the mean of the parameters by turns about each castor."""
        return self._fit(robot, recordings).applied()

    def report(self, robot: RobotDescription, recordings: Sequence[Recording]) -> Report:
        """Return the same with every parameter of the castors that turned, and its standard error."""
        found = self._fit(robot, recordings)
        calibrated, errors, results = found.applied(), found.errors, []
        for i, (old, new) in enumerate(zip(robot.castors, calibrated.castors, strict=True)):
            if not np.isfinite(found.parameters.offset[i]):
                continue
            numbers = [
                ("offset", "m", old.offset, new.offset, errors.offset[i]),
                ("pivot_zero", "rad", old.pivot_zero, new.pivot_zero, errors.pivot_zero[i]),
            ]
            for k, side in enumerate(("left", "right")):
                before, after = old.wheels[k], new.wheels[k]
                numbers.append((f"{side} radius", "m", before.radius, after.radius, errors.radius[i, k]))
                numbers.append((f"{side} lateral", "m", before.lateral, after.lateral, errors.half_track[i, k]))
            for dimension, unit, before, after, error in numbers:
                results.append(Result(f"castor {i + 1} {dimension}", unit, before, after, float(error)))
        return Report(tuple(results), calibrated)

    def _fit(self, robot: RobotDescription, recordings: Sequence[Recording]) -> PivotingCalibration:
        turns = []
        for recording in recordings:
            try:
                turns.append(Turn(recording.log, recording.held or held_castor(robot, recording.log)))
            except InputError as error:
                raise in_recording(error, recording) from None
        return calibrate(robot, turns)


METHODS = {"pivoting": PivotingMethod}
