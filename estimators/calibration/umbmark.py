"""UMBmark's correction of systematic odometry errors: wheel base and wheel diameters of a differential robot.

Borenstein and Feng, "UMBmark: A Method for Measuring, Comparing, and Correcting Dead-reckoning Errors in Mobile
Robots", University of Michigan UM-MEAM-94-22, 1994; "Measurement and Correction of Systematic Odometry Errors in Mobile
Robots", IEEE Trans. Robotics and Automation 12(6), 1996.

The robot drives a square of side L by its odometry, clockwise and counter-clockwise, first side along its x axis. A
wrong wheel base ("type A") turns every corner by alpha too little; unequal wheels ("type B") bend every side by beta,
to the left where the right wheel is the larger. To first order the centres of gravity of the return errors are at

    x_cw = -2 L (alpha + beta)          x_ccw = -2 L (alpha - beta)

and y holds the same two sums. As in the published worked example (OptiOdom), x alone is used. The method is of first
order in the errors: the remaining error falls with their square, so a second set of runs, with the corrected robot,
corrects what remains of large errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import Declined, InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose, relative_pose
from castor_envs.logs.log import Log
from castor_envs.vehicles.axle import AxleCorrection, driven_axle
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.protocol import Recording, Report, Result, in_recording, names_of
from estimators.robots.dead_reckoning import DeadReckoning

CLOSED = 0.25
"""Largest distance of a run's end from its start, as a fraction of the side: beyond it, odometry did not close the
square."""

TURNED = np.pi / 4
"""rad: largest difference of a run's true turn from a full turn: half a corner."""


FIRST_ORDER = "the method is of first order: of errors of per cents, calibrate again with the calibrated robot"


class StandardErrors(NamedTuple):
    """One standard deviation of each result: rad, rad, -, -, m, and m of the right and of the left diameter."""

    alpha: float
    beta: float
    wheel_base_factor: float
    diameter_ratio: float
    wheel_base: float
    diameters: tuple[float, float]


@dataclass(frozen=True, eq=False)
class UMBmarkCorrection:
    """The result of the runs.

    alpha: angle by which every corner was turned too little, rad. beta: angle by which every side bent to the left,
    rad. wheel_base_factor: E_b, true over described wheel base. diameter_ratio: E_d, right over left wheel diameter,
    over the same of the robot as described (whose wheels may be unequal already). axle: corrected wheel base and
    diameters. covariance_of_angles and covariance: (2, 2) of alpha, beta (rad^2) and of E_b, E_d; None from single
    runs.
    """

    alpha: float
    beta: float
    wheel_base_factor: float
    diameter_ratio: float
    axle: AxleCorrection
    covariance_of_angles: Array | None
    covariance: Array | None

    @property
    def standard_errors(self) -> StandardErrors:
        """The standard errors, first order; raises InputError where a direction was driven only once."""
        if self.covariance is None or self.covariance_of_angles is None:
            raise InputError("standard errors need the spread of the runs; record at least 2 runs in each direction")
        alpha, beta = np.sqrt(np.diag(self.covariance_of_angles))
        base, ratio = np.sqrt(np.diag(self.covariance))
        # D_R = 2 D / (1 + 1/rho) and D_L = 2 D / (1 + rho) with rho = D_R / D_L: D_R + D_L is fixed.
        rho = self.axle.diameter_ratio
        diameter = 2 * self.axle.nominal_diameter / (1 + rho) ** 2 * rho / self.diameter_ratio * ratio
        length = self.axle.nominal_wheel_base * base
        alpha, beta, base, ratio, length, diameter = map(float, (alpha, beta, base, ratio, length, diameter))
        return StandardErrors(alpha, beta, base, ratio, length, (diameter, diameter))


def from_errors(robot: RobotDescription, cw: ArrayLike, ccw: ArrayLike, side: float) -> UMBmarkCorrection:
    """Return the correction from return errors (n, 2 or 3) of clockwise and of counter-clockwise runs.

    robot: the description that odometry used. cw, ccw: true minus odometry, x, y (m), in the frame of the axle at the
    start. side: L of the square, m. Raises InputError for a robot that is not differential, directions without a run,
    errors that are not finite or too large for the method, a side not above 0.
    """
    base, right, left = _axle(robot)
    _check_side(side)
    x_cw, x_ccw = _errors("clockwise", cw)[:, 0], _errors("counter-clockwise", ccw)[:, 0]
    # Centres of gravity, and the two first-order sums of the module's text solved for alpha and beta.
    alpha = float((np.mean(x_cw) + np.mean(x_ccw)) / (-4 * side))
    beta = float((np.mean(x_cw) - np.mean(x_ccw)) / (-4 * side))
    if not (abs(alpha) < np.pi / 2 and abs(beta) < np.pi):
        raise InputError(
            f"return errors turn corners by {np.degrees(alpha):.3g} deg and bend sides by {np.degrees(beta):.3g} deg, "
            f"too much for a square of side {side:g} m; check the side and the units (m), or mend the description first"
        )
    # E_b: a corner of 90 deg was truly one of 90 deg - alpha, so b_true = b 90 deg / (90 deg - alpha).
    base_factor = (np.pi / 2) / (np.pi / 2 - alpha)
    # Radius of a bent side R = (L / 2) / sin(beta / 2), E_d = (R + b/2) / (R - b/2). Divided by R, beta = 0 is no
    # special case; h = b / (2 R).
    h = float(base_factor * base * np.sin(beta / 2) / side)
    if abs(h) >= 1:
        raise InputError(
            f"sides bend with a radius of {side / 2 / abs(np.sin(beta / 2)):.3g} m, within half the wheel base of "
            f"{base_factor * base:.3g} m; check the side and the units (m), or record a longer square"
        )
    ratio, ratio_by_h = (1 + h) / (1 - h), 2 / (1 - h) ** 2
    # The sum of the diameters stays (c_L = 2 / (E_d + 1), c_R = 2 / (1/E_d + 1) on equal nominal ones).
    axle = AxleCorrection(base, (right + left) / 2, base_factor, ratio * right / left)
    angles = _covariance_of_angles(x_cw, x_ccw, side)
    # First order: E_b by alpha; E_d by alpha (through the true wheel base in h) and beta.
    base_by_alpha = base_factor / (np.pi / 2 - alpha)
    h_by_alpha, h_by_beta = h * base_by_alpha / base_factor, base_factor * base * np.cos(beta / 2) / (2 * side)
    jacobian = np.array([[base_by_alpha, 0.0], [ratio_by_h * h_by_alpha, ratio_by_h * h_by_beta]])
    covariance = None if angles is None else jacobian @ angles @ jacobian.T
    return UMBmarkCorrection(alpha, beta, base_factor, ratio, axle, angles, covariance)


def from_logs(
    robot: RobotDescription,
    logs: Sequence[Log],
    directions: Sequence[Literal["cw", "ccw"]],
    side: float,
    names: Sequence[str] | None = None,
) -> UMBmarkCorrection:
    """Return the correction from logs of single squares with a reference at start and end.

    robot: as described; its dead reckoning is compared with the reference. directions: in which each square was driven.
    side: m. names: of the logs, for messages; "log 1" and so on if left out. Raises InputError as `from_errors` does,
    and for logs without reference or whose square was not closed.
    """
    return from_errors(robot, *return_errors(robot, logs, directions, side, names), side)


def return_errors(
    robot: RobotDescription,
    logs: Sequence[Log],
    directions: Sequence[Literal["cw", "ccw"]],
    side: float,
    names: Sequence[str] | None = None,
) -> tuple[Array, Array]:
    """Return the return errors (n, 3) of clockwise and of counter-clockwise runs, as `from_errors` takes them.

    Arguments and errors as for `from_logs`.
    """
    driven_axle(robot)
    _check_side(side)
    if len(logs) != len(directions):
        raise InputError(f"{len(logs)} logs, but {len(directions)} directions; give 'cw' or 'ccw' for each log")
    errors: dict[str, list[Array]] = {"cw": [], "ccw": []}
    names = names or [f"log {number}" for number in range(1, len(logs) + 1)]
    for name, log, direction in zip(names, logs, directions, strict=True):
        if direction not in errors:
            raise InputError(f"{name}: unknown direction {direction!r}; give 'cw' or 'ccw'")
        errors[direction].append(_return_error(robot, log, direction, side, name))
    return np.reshape(errors["cw"], (-1, 3)), np.reshape(errors["ccw"], (-1, 3))


def direction_of(log: Log) -> Literal["cw", "ccw"]:
    """Return the direction in which a log with a reference went round; raises InputError where it has none at start or
    end."""
    ends = np.full((2, 3), np.nan) if log.reference is None else log.reference[[0, -1]]
    if not np.isfinite(ends).all():
        raise Declined("has no reference at its start and end; record the true pose, with its heading, at both")
    return "ccw" if ends[1, 2] > ends[0, 2] else "cw"


def directions_of(recordings: Sequence[Recording]) -> list[Literal["cw", "ccw"]]:
    """Return the direction of each square; raises InputError that names a recording that has none."""
    directions = []
    for recording in recordings:
        try:
            directions.append(direction_of(recording.log))
        except InputError as error:
            raise in_recording(error, recording) from None
    return directions


def corrected(robot: RobotDescription, correction: UMBmarkCorrection) -> RobotDescription:
    """Return the robot with the corrected wheel base and diameters; all else, and the middle of the axle, stays."""
    return correction.axle.apply(robot)


def _axle(robot: RobotDescription) -> tuple[float, float, float]:
    """Return the described wheel base and the diameters of the right and left wheel, m."""
    driven_axle(robot)
    left, right = (robot.wheels[k] for k in robot.driven_wheels)
    return left.lateral - right.lateral, 2 * right.radius, 2 * left.radius


def _check_side(side: float) -> None:
    if not (np.isfinite(side) and side > 0):
        raise InputError(f"the side of the square is {side} m; give its length, above 0")


def _errors(direction: str, values: ArrayLike) -> Array:
    """Return return errors (n, 2 or 3) after checking them."""
    errors = np.asarray(values, dtype=float)
    if errors.size == 0:
        raise Declined(
            f"no {direction} run; record runs in both directions: one alone cannot distinguish wheel base from wheel "
            "diameters"
        )
    if errors.ndim != 2 or errors.shape[1] not in (2, 3):
        raise InputError(f"{direction} return errors have shape {errors.shape}; give (n, 2): x and y (m) of n runs")
    for k in np.flatnonzero(~np.isfinite(errors).all(axis=1))[:1]:
        raise InputError(f"{direction} run {k + 1} has an error that is not finite; mend it, or leave the run out")
    return errors


def _covariance_of_angles(x_cw: Array, x_ccw: Array, side: float) -> Array | None:
    """Return the covariance (2, 2) of alpha and beta, rad^2, from the spread of the runs' x errors (n,) and (m,), m.

    Each centre of gravity has the variance of its own direction's runs over their number; both are independent, and
    alpha and beta are their sum and difference over -4 L. None where a direction has one run alone.
    """
    if min(len(x_cw), len(x_ccw)) < 2:
        return None
    cw, ccw = np.var(x_cw, ddof=1) / len(x_cw), np.var(x_ccw, ddof=1) / len(x_ccw)
    return np.array([[cw + ccw, cw - ccw], [cw - ccw, cw + ccw]], dtype=float) / (4 * side) ** 2


def _check_odometry(name: str, path: Array, turn: float, side: float) -> None:
    """Raise InputError where odometry (K, 3) of a completed square is so far off that the robot file must be wrong."""
    turned, length = path[-1, 2] - path[0, 2], float(np.sum(np.hypot(*np.diff(path[:, :2], axis=0).T)))
    if not 0.5 < turned / turn < 2.0:
        raise InputError(
            f"{name}: by its counts the robot turned by {np.degrees(turned):.4g} deg, and truly by "
            f"{np.degrees(turn):.4g}; look for channels that are swapped or reversed, and the wheel base in the file"
        )
    if not 0.7 < length / (4 * side) < 1.4:
        raise InputError(
            f"{name}: by its counts the robot drove {length:.3g} m, and round a square of {side:g} m it is "
            f"{4 * side:g}; check the side, and radii and counts per turn in the robot file"
        )


def _return_error(robot: RobotDescription, log: Log, direction: Literal["cw", "ccw"], side: float, name: str) -> Array:
    """Return true minus odometry (3,) at the end of a log, in the frame of the axle at its start: m, m, rad."""
    at = driven_axle(robot)
    axle = robot.castors[at]
    middle = sum(robot.wheels[k].lateral for k in robot.driven_wheels) / 2
    seat = compose([*axle.pivot, axle.angle], [-axle.offset, middle, 0.0])
    ends = np.full((2, 3), np.nan) if log.reference is None or not len(log) else log.reference[[0, -1]]
    for place, pose in zip(("start", "end"), ends, strict=True):
        if not np.isfinite(pose).all():
            wanted = "record the true pose, with its heading, at the start and the end"
            raise Declined(f"{name} has no reference at the {place}; {wanted}")
    if not np.isfinite(log.wheel).all():
        raise InputError(f"{name} has wheel counts that are not finite; record the counts of every sample")
    truth = relative_pose(compose(ends[0], seat), compose(ends[1], seat))
    away, turn = float(np.hypot(truth[0], truth[1])), float(truth[2])
    if away > CLOSED * side:
        raise InputError(
            f"{name}: the square was not closed: the robot truly ended {away:.3g} m from its start, over {CLOSED:g} of "
            f"the side of {side:g} m; record one whole square a log"
        )
    if abs(turn - (2 * np.pi if direction == "ccw" else -2 * np.pi)) > TURNED:
        raise InputError(
            f"{name}: the robot truly turned by {np.degrees(turn):.4g} deg, which is no {direction} square; record one "
            "whole square with all four corners, name its direction, and unwrap the heading"
        )
    odometry = DeadReckoning(at + 1)
    odometry.reset(robot, ends[0])
    path = np.array([odometry.update(observation) for observation in log.observations()])
    pose = path[-1]
    _check_odometry(name, path, turn, side)
    return truth - relative_pose(compose(ends[0], seat), compose(pose, seat))


class UMBmarkMethod:
    """UMBmark squares, both ways, with the true pose at start and end (Borenstein and Feng); differential robots."""

    title = "correction from UMBmark squares (Borenstein and Feng)"
    takes_squares = True
    finds_pivots = False

    def calibrate(self, robot: RobotDescription, recordings: Sequence[Recording]) -> RobotDescription:
        """Return the robot with corrected wheel base and diameters; the diameters' mean stays."""
        return corrected(robot, self._fit(robot, recordings))

    def report(self, robot: RobotDescription, recordings: Sequence[Recording]) -> Report:
        """Return the same with wheel base and diameters, and their standard errors."""
        found = self._fit(robot, recordings)
        errors, calibrated, axle = found.standard_errors, corrected(robot, found), driven_axle(robot)
        (left, right), (new_left, new_right) = (
            [wheel for wheel in vehicle.castors[axle].wheels if wheel.driven] for vehicle in (robot, calibrated)
        )
        base, new_base = left.lateral - right.lateral, new_left.lateral - new_right.lateral
        results = (
            Result("wheel base", "m", base, new_base, float(errors.wheel_base)),
            Result("left diameter", "m", 2 * left.radius, 2 * new_left.radius, float(errors.diameters[1])),
            Result("right diameter", "m", 2 * right.radius, 2 * new_right.radius, float(errors.diameters[0])),
        )
        return Report(results, calibrated, remarks=(FIRST_ORDER,))

    def _fit(self, robot: RobotDescription, recordings: Sequence[Recording]) -> UMBmarkCorrection:
        squares = [recording for recording in recordings if recording.side is not None]
        sides = sorted({square.side for square in squares if square.side is not None})
        if len(sides) != 1:
            found = "none" if not sides else ", ".join(f"{side:g} m" for side in sides)
            raise Declined(f"needs UMBmark squares of one side; sides of these recordings: {found}")
        logs = [square.log for square in squares]
        return from_logs(robot, logs, directions_of(squares), sides[0], names_of(squares))


METHODS = {"umbmark-correction": UMBmarkMethod}
