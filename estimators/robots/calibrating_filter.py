"""An error-state extended Kalman filter that learns a robot's dimensions while it drives, from redundancy alone.

It estimates the pose, and with it all numbers that it depends on: wheel radii, half tracks, castor offsets, encoder
zeros and places of the pivots, each near what the description says. Six wheels and three castors of the prototype say
nine things about a motion of three degrees of freedom; what contradicts is put down to the numbers that explain it.

Counts themselves are measured, not their increments: each count and each pivot's reading is off by its own rounding, so
that no remainder is ever lost. A castor does not slip to its side: a measurement of zero. The equations of a sample are
those of `rolling_equations`, about whose solution they are linear; of the sample's motion itself hardly anything is
known before (`kalman`). Contacts creep under the forces of a motion, as masses and slip stiffness in the description
say, up to a factor that is learned; beyond that they creep in such a way that forces on the body and about each pivot
balance (`creep`). Measurements that contradict the others, as over a bump, are released while they do (`GATE`). A gyro,
if the description has one, measures the turn of each sample by the mean of its readings at both ends, so that the noise
of a reading is part of two samples. External fixes correct the pose, late and wrong ones too (`fixes`). The state of a
robot with n castors, d wheels with encoders and c castors that do not slip to their side is

    pose (3)         in the frame of the start pose
    swivel (n)       angles of the castors beyond what their encoders read, rad
    roll (d)         angles of the wheels beyond what their counts say, rad
    side (c)         slip to the side in the sample, m
    turn (1)         of the sample as the gyro reads it; where there is a gyro
    numbers          beyond those described: radius (d, relative), lateral (d); offset, zero, x and y of pivots (n each)
    compliance (1)   by what part contacts creep more under forces than described
    bias (1)         of the gyro beyond the one described, rad/s; its scale (1), by which part it says that the body
                     turns too far; and the noise of its last reading (1), rad/s

Of these `sample` measures roll, side and turn; `rounding` says for how long swivel stays what it is.

Motors turn wheels by the numbers described, so that these agree better with them than with the true ones: contacts
creep by what contradicts, and counts show a part of it (`creep.shown`). Modules without offset that motors steer
(swerve) are taken to show none: no agreement of their wheels tells anything about numbers, which change the motion
alone. Where a description is to be taken as not calibrated, as wheels contradict it, they roll and do not creep.

A description may state tolerances, which are the prior of the numbers. Where it states none, nobody tells whether it is
calibrated: two filters run side by side, one for each column of Table I of Doebbler et al. Their log-likelihoods
decide, as multiple-model estimation does (Magill, IEEE Trans. Automatic Control 10(4), 1965).
"""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import Gyro, RobotDescription
from castor_envs.vehicles.tolerances import Tolerances
from estimators.filtering.creep import CARRIED, FIXED, OF_CASTOR, ROWS, STEERED, TRAILING, UNSURE, inertias, shown
from estimators.filtering.fixes import Belief, FixUpdates
from estimators.filtering.release import CONTRADICTED
from estimators.filtering.sample import ADVANCE, DRIFT, FILTER, SLIP, SWIVEL, WHEEL
from estimators.protocol import Observation
from estimators.steps.gyro import GyroTurns, bias_deviation
from estimators.steps.rolling_equations import NUMBERS, Rows
from estimators.steps.stacked import Part, Stack

CALIBRATED = Tolerances(radius=4.6e-4, lateral=4.6e-4, offset=1e-3, pivot_zero=2e-4, pivot=5e-5)
UNCALIBRATED = Tolerances(radius=2.4e-2, lateral=1e-2, offset=2.5e-3, pivot_zero=1e-3, pivot=5e-5)
"""Table I of Doebbler et al., whose mean absolute errors are taken as those of uniform distributions. It has no zeros
before calibration that a filter could begin from (8 deg) and no pivots: a milliradian, and as exact as the catalogue of
effects says that a chassis is machined."""

HALF_WAY = 3.5e-4
"""rad: standard deviation of an error that the angles of a castor that the floor turns have half-way through samples,
beside that of its encoder's zero, where a description states none. On 24 squares of no board 1.95 mm become 1.55 in
perfect rolling and 2.03 become 1.69 in physics, over cables they stay; twice as much does as well."""

TRUST = 100.0
"""Log-likelihood (natural logarithm) by which a description must be unlikely to be calibrated before it counts as not.
Errors as those of Table I make more difference within seconds; slip of steered castors makes less."""

UNSEEN = 20.0
"""Factor on `SLIP` of wheels that slip where no redundancy shows it; what fixes of the pose then tell."""

UNEVEN = 2.0
"""Error of the angle half-way of a castor that a motor turns, as a part of the change of its swivel rate, where the
rate begins from zero."""

COMPLIANCE = 1.0
"""Standard deviation of by how much contacts creep more under forces than described, as a part: perfectly rolling
wheels do not at all, and of tyres hardly more than the order of magnitude is known."""

GATE = 3.0
"""Standard deviations of a measurement's residual beside all others beyond which it is released. Of normal residuals
one in 370 is."""

START, POSE, STATE, COVARIANCE, LOG_LIKELIHOOD, GYRO, FREED, _, _, CLOCK, _, _ = range(4, 16)
"""Of the stack's parts."""

OF_GYRO = [-3, -2, -1]
"""Where bias, scale and noise of the last reading stand in the state of a robot with a gyro."""


class _Numbers(NamedTuple):
    """Where the numbers learned stand in the state: of d wheels, or n castors, each."""

    radius: slice
    lateral: slice
    offset: slice
    zero: slice
    x: slice
    y: slice

    @classmethod
    def of(cls, at: int, n: int, d: int) -> "_Numbers":
        """Return the places of numbers that begin at `at`."""
        ends = (at + np.cumsum([0, d, d, n, n, n, n])).tolist()
        return cls(*map(slice, ends[:-1], ends[1:]))


class CalibratingFilter:
    """The filter; serves every robot whose wheels determine its motion.

    When to use: a redundant base (two or more castors with encoders) whose dimensions are not exactly known. It cannot
    learn what no redundancy shows: of differential robots, tricycles and three omni wheels it knows nothing that
    `wheel-odometry` does not; on swerve bases the common scale of radii stays as described, and on powered casters,
    whose short offsets turn them by half a radian in a sample, it is learned wrong where the description
    is not calibrated. It fails where all wheels slip together.
    """

    batched = True

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike, covariance: ArrayLike | None = None) -> None:
        """Start at `pose` (..., 3), whose covariance (..., 3, 3) may be given, m and rad.

        Raises Declined where the wheels do not determine how the robot moves.
        """
        geometry, start = Geometry.of(robot), np.array(pose, dtype=float)
        rows = Rows.of(geometry)
        castors, equations = rows.records(1.0 / rows.variances())
        n, d, m, gyro = len(rows.known), len(rows.wheels), len(rows.castor), int(geometry.gyro is not None)
        at = SWIVEL + n + m + gyro
        self._rows, self._at = rows, _Numbers.of(at, n, d)
        size = self._at.y.stop + 1 + len(OF_GYRO) * gyro

        carried = np.zeros(castors.shape, CARRIED)
        encoded = np.nan_to_num(2 * np.pi / geometry.pivot_counts_per_rev[rows.known])
        fixed, driven, offset = (of[..., rows.known] for of in (geometry.fixed, geometry.driven, geometry.offset))
        carried["step"], carried["offset"] = np.where(fixed, 0.0, encoded), offset
        trailing = geometry.trailing[..., rows.known] & np.logical_not(driven)
        carried["kind"] = np.where(fixed, FIXED, np.where(trailing, TRAILING, STEERED))
        chassis, mass, inertia = inertias(geometry)
        carried["lasted"] = 1.0
        carried["mass"], carried["inertia"] = mass[..., rows.known], inertia[..., rows.known]
        wheels = np.zeros((*geometry.offset.shape[:-1], d), WHEEL)
        wheels["radius"], wheels["lateral"] = geometry.radius[..., rows.wheels], geometry.lateral[..., rows.wheels]
        wheels["count"] = rows.angle_per_count

        tolerances = (CALIBRATED, UNCALIBRATED) if geometry.tolerances is None else (geometry.tolerances,)
        slips = (1.0,) if geometry.fixes is None else (1.0, UNSEEN)
        bank = [(errors, slip) for errors in tolerances for slip in slips]
        swerve = bool(np.all(geometry.driven & ~geometry.fixed)) and bool(np.all(geometry.offset == 0))
        filters = np.zeros(len(bank), FILTER)
        filters["slip"] = [SLIP * slip for _, slip in bank]
        filters["settles"] = [errors is UNCALIBRATED for errors, _ in bank]
        filters["unsure"] = 1.0 if swerve else UNSURE
        # of m equations, as many as no motion of the body and of castors that the floor turns explains
        redundant = max(m - 3 - int(np.sum(np.logical_not(np.logical_or(fixed, driven)))), 0) / m
        gives = np.ones((*np.shape(geometry.max_wheel_torque), len(bank)))
        for k, (errors, _) in enumerate(bank):
            if errors is UNCALIBRATED:
                continue
            if swerve:
                gives[..., k] = 0.0
            elif redundant > 0 and errors.radius > 0:
                gives[..., k] = shown(geometry, math.sqrt(redundant) * errors.radius)
        unlikely = np.array([TRUST * tolerances.index(errors) for errors, _ in bank])
        variance = np.zeros((*carried.shape[:-1], len(bank), size))
        variance[..., SWIVEL : SWIVEL + n] = carried["step"][..., None, :] ** 2 / 12
        variance[..., SWIVEL + n : SWIVEL + n + d] = wheels["count"][..., None, :] ** 2 / 12
        for k, (errors, _) in enumerate(bank):
            variance[..., k, self._at.radius] = errors.radius**2
            variance[..., k, self._at.lateral] = (errors.lateral * wheels["lateral"]) ** 2
            variance[..., k, self._at.offset] = (errors.offset * offset) ** 2
            half_way = np.where(trailing & (errors is CALIBRATED), HALF_WAY, 0.0)
            variance[..., k, self._at.zero] = errors.pivot_zero**2 + half_way**2
            variance[..., k, self._at.x] = variance[..., k, self._at.y] = errors.pivot**2
        variance[..., self._at.y.stop] = COMPLIANCE**2
        if geometry.gyro is not None:
            sensor = geometry.gyro
            variance[..., OF_GYRO] = np.square([bias_deviation(sensor), sensor.scale_tolerance, sensor.noise])
        known = variance[..., None] * np.eye(size)
        if covariance is not None:
            turn = se2.rotation(-start[..., 2])
            of_start = turn @ np.asarray(covariance, dtype=float) @ np.swapaxes(turn, -1, -2)
            lead = np.broadcast_shapes(known.shape[:-3], of_start.shape[:-2])
            known = np.broadcast_to(known, (*lead, *known.shape[-3:])).copy()
            known[..., :3, :3] = of_start[..., None, :, :]

        q = m + gyro
        clock = np.multiply.outer(geometry.sample_period, np.array([-np.inf, -np.inf, 1.0, 1.0]))
        parts = [
            *map(Part, (castors, carried, wheels, equations, start, start)),
            *(Part(np.zeros((len(bank), size)), 2), Part(known, 3), Part(-unlikely), Part(np.zeros(5))),
            *(Part(np.zeros((len(bank), of)), 2) for of in (q, 3 + 2 * n + d)),
            *(Part(chassis[..., None]), Part(clock), Part(gives)),
            Part(np.full((len(bank), n), CONTRADICTED), 2),
        ]
        room = [(1, m, NUMBERS), (ROWS, m), (size, at), (3, size), (at, size), (5, q), (2, q, q), (5, q), (4, 3)]
        room += [(OF_CASTOR, n), (4, 3), (m + 2, m)]
        self._stack = Stack(ADVANCE, geometry, parts, (filters, *map(np.zeros, room), UNEVEN, GATE))
        self._gyro, self._turns = geometry.gyro, GyroTurns(geometry.gyro, geometry.sample_period)
        self._fixes = None if geometry.fixes is None else FixUpdates(geometry.fixes, start)

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (..., 3); raises InputError where it has another number of counts."""
        self._stack.fit(observation)
        if "time" in observation:
            self._stack.parts[CLOCK][..., 0] = observation["time"][..., 0]
        if self._gyro is not None:
            self._read_gyro(self._gyro, observation)
        self._stack.advance(observation)
        if self._fixes is not None:
            before = Belief(*self._stack.parts[STATE : LOG_LIKELIHOOD + 1])
            after = self._fixes.update(observation, before)
            if after is not before:
                for part, new in zip(before, after, strict=True):
                    part[...] = new
                mean = np.sum(self._probabilities[..., None] * before.state[..., :3], axis=-2)
                self._stack.parts[POSE][...] = se2.compose(self._stack.parts[START], mean)
        return self.pose

    def _read_gyro(self, gyro: Gyro, observation: Observation) -> None:
        """Take what a gyro says of the body's turn in this sample."""
        read, told = self._turns.read(observation), self._stack.parts[GYRO]
        told[..., 0], told[..., 1], told[..., 2] = read.turn, read.variance, read.duration
        told[..., 3], told[..., 4] = gyro.noise, gyro.bias_walk or DRIFT

    @property
    def pose(self) -> Array:
        """The pose (..., 3) now: x, y (m), psi (rad)."""
        return self._stack.parts[POSE].copy()

    @property
    def released(self) -> NDArray[np.bool_]:
        """Which measurements (..., filters, q) were released in the last sample: counts of wheels, no side slip of
        castors, the gyro."""
        return self._stack.parts[FREED] > 0

    @property
    def geometry(self) -> Geometry:
        """The robot as learned so far: its numbers (...), of the likeliest filter."""
        at, rows, geometry = self._at, self._rows, self._rows.geometry
        state, log_likelihood = self._stack.parts[STATE], self._stack.parts[LOG_LIKELIHOOD]
        likeliest = np.argmax(log_likelihood, axis=-1)[..., None, None]
        learned = np.take_along_axis(state, likeliest, axis=-2)[..., 0, :]
        radius, lateral, offset, zero, pivot = (
            np.broadcast_to(of, (*learned.shape[:-1], *of.shape[of.ndim - axes :])).copy()
            for of, axes in (
                (geometry.radius, 1),
                (geometry.lateral, 1),
                (geometry.offset, 1),
                (geometry.pivot_zero, 1),
                (geometry.pivot, 2),
            )
        )
        radius[..., rows.wheels] *= np.exp(learned[..., at.radius])
        lateral[..., rows.wheels] += learned[..., at.lateral]
        offset[..., rows.known] += learned[..., at.offset]
        zero[..., rows.known] += learned[..., at.zero]
        pivot[..., rows.known, 0] += learned[..., at.x]
        pivot[..., rows.known, 1] += learned[..., at.y]
        return dataclasses.replace(
            geometry, radius=radius, lateral=lateral, offset=offset, pivot_zero=zero, pivot=pivot
        )

    @property
    def compliance(self) -> Array:
        """How many times as much as described contacts creep under forces (...), as learned so far."""
        of_filters = self._stack.parts[STATE][..., self._at.y.stop]
        return 1.0 + np.sum(self._probabilities * of_filters, axis=-1)

    @property
    def gyro_bias(self) -> Array:
        """The bias (...) of the gyro as learned so far, rad/s."""
        described = 0.0 if self._gyro is None else self._gyro.bias
        return described + np.sum(self._probabilities * self._stack.parts[STATE][..., OF_GYRO[0]], axis=-1)

    @property
    def gyro_scale(self) -> Array:
        """By which part (...) the gyro says that the body turns too far, as learned so far."""
        return np.sum(self._probabilities * self._stack.parts[STATE][..., OF_GYRO[1]], axis=-1)

    @property
    def covariance(self) -> Array:
        """The covariance (..., 3, 3) of x, y (m) and psi (rad), in the world's axes."""
        parts, poses = self._probabilities, self._stack.parts[STATE][..., :3]
        away = poses - np.sum(parts[..., None] * poses, axis=-2, keepdims=True)
        both = self._stack.parts[COVARIANCE][..., :3, :3] + away[..., :, None] * away[..., None, :]
        turn = se2.rotation(self._stack.parts[START][..., 2])
        return turn @ np.sum(parts[..., None, None] * both, axis=-3) @ np.swapaxes(turn, -1, -2)

    @property
    def _probabilities(self) -> Array:
        """The probabilities (..., filters) of all filters of the bank."""
        log_likelihood = self._stack.parts[LOG_LIKELIHOOD]
        parts = np.exp(log_likelihood - log_likelihood.max(axis=-1, keepdims=True))
        return parts / parts.sum(axis=-1, keepdims=True)


ESTIMATORS = {"filter": CalibratingFilter}
