"""An error-state extended Kalman filter that learns a robot's dimensions while it drives, from redundancy alone.

It estimates the pose, and with it all numbers that it depends on: wheel radii, half tracks, castor offsets, encoder
zeros and places of the pivots, each near what the description says. Six wheels and three castors of the prototype say
nine things about a motion of three degrees of freedom; what contradicts is put down to the numbers that explain it.

Counts themselves are measured, not their increments: each count and each pivot's reading is off by its own rounding, so
that no remainder is ever lost. A castor does not slip to its side: a measurement of zero. The equations of a sample are
those of `wheel_odometry`, about whose solution they are linear. Measurements that contradict the others, as over a
bump, are released while they do (`GATE`). A gyro, if the description has one, measures the turn of each sample: half of
its readings at both ends. External fixes correct it, late and wrong ones too (`fixes`). The state of a robot with n
castors and d wheels with encoders is

    pose (3)         in the frame of the start pose
    swivel (n)       angles of the castors beyond what their encoders read, rad
    roll (d)         angles of the wheels beyond what their counts say, rad
    motion (3)       of the sample, beyond the solution of `wheel_odometry`
    swiveled (n)     of the sample, beyond what was read
    numbers          beyond those described: radius (d, relative), lateral (d); offset, zero, x and y of pivots (n each)
    bias (1)         of the gyro, rad/s

Wheels on modules without offset that motors steer (swerve) turn as they are commanded, by the numbers described, and
agree with these though the true ones differ: contacts creep by what contradicts, until their forces balance. Of such a
robot numbers change the motion alone that balances (`balanced`), and no agreement of wheels tells anything about them;
but where a description is to be taken as not calibrated, as wheels contradict it, they roll and do not creep.

A description may state tolerances, which are the prior of the numbers. Where it states none, nobody tells whether it is
calibrated: two filters run side by side, one for each column of Table I of Doebbler et al. Their log-likelihoods
decide, as multiple-model estimation does (Magill, IEEE Trans. Automatic Control 10(4), 1965).
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array, vectors
from castor_envs.geometry.se2 import wrap
from castor_envs.motion.kinematics import Geometry, left_of, unit
from castor_envs.sensors.encoders import castor_angles
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.tolerances import Tolerances
from estimators.protocol import Observation
from estimators.robots.castor_odometry import start
from estimators.robots.fixes import Belief, FixUpdates
from estimators.robots.gyro import GyroTurns
from estimators.robots.wheel_odometry import Equations, EquationsOfSamples, moved, solve

CALIBRATED = Tolerances(radius=4.6e-4, lateral=4.6e-4, offset=1e-3, pivot_zero=2e-4, pivot=5e-5)
UNCALIBRATED = Tolerances(radius=2.4e-2, lateral=1e-2, offset=2.5e-3, pivot_zero=1e-3, pivot=5e-5)
"""Table I of Doebbler et al., whose mean absolute errors are taken as those of uniform distributions. It has no zeros
before calibration that a filter could begin from (8 deg) and no pivots: a milliradian, and as exact as the catalogue of
effects says that a chassis is machined."""

TRUST = 100.0
"""Log-likelihood (natural logarithm) by which a description must be unlikely to be calibrated before it counts as not.
Errors as those of Table I make more difference within seconds; slip of steered castors makes less."""

SLIP, SIDE_SLIP = 5e-4, 2e-4
"""m after 1 m: standard deviations of the random walks of slip along a wheel's rolling direction and to its side."""

UNSEEN = 20.0
"""Factor on `SLIP` of wheels that slip where no redundancy shows it; what fixes of the pose then tell."""

UNEVEN = 2.0
"""Error of a castor's angle half-way, as a part of the change of its swivel rate, where the rate begins from zero."""

GATE = 3.5
"""Standard deviations of a measurement's residual beside all others beyond which it is released. Of normal residuals
one in 2000 is."""

TIE = 2.0
"""Twice the log-likelihood ratio up to which it is not known which of two measurements contradicts: both are released.
With one equation more than needed, as of two wheels and a gyro, it never is."""

RELEASED = 2e-2
"""m: standard deviation of the slip of a released measurement in a sample."""

FREE = 5e-2
"""m and rad: prior standard deviation of how a sample's motion differs from the solution of `wheel_odometry`, so large
that it says nothing."""

STEADY, CHANGING, TURNED = 0.02, 0.41, 3.0
"""Standard deviation of what a castor swivels beyond what was read, in steps of its encoder: of a castor that a motor
holds while its reading stays, of others, and of one that the floor turns."""

REPEATED = 5.0
"""Factor on the variance of rounding for a reading that repeats: its error is that of the last."""

LEAST_WAY = 0.02
"""Of the way of the contact that rolls farthest in a sample: the shortest one for which a stiffness is computed."""

LEAST = 1e-12
"""m^2: least variance of slip in a sample."""

BIAS = 0.02
"""rad/s: prior standard deviation of a gyro's bias, which no description tells: 1 deg/s, as data sheets of cheap ones
say."""

DRIFT = 1e-4
"""rad/s in a root second: random walk of a gyro's bias, 0.04 deg/s in a minute, as of a chip that warms up."""


class _Layout:
    """Where each part of the state of a robot with n castors and d wheels stands."""

    def __init__(self, n: int, d: int) -> None:
        sizes = {"pose": 3, "swivel": n, "roll": d, "motion": 3, "swiveled": n}
        sizes |= {"radius": d, "lateral": d, "offset": n, "zero": n, "x": n, "y": n, "bias": 1}
        ends = np.cumsum(list(sizes.values()))
        parts = dict(zip(sizes, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))
        self.size = int(ends[-1])
        self.pose, self.swivel, self.roll = parts["pose"], parts["swivel"], parts["roll"]
        self.motion, self.swiveled = parts["motion"], parts["swiveled"]
        self.radius, self.lateral, self.offset = parts["radius"], parts["lateral"], parts["offset"]
        self.numbers = np.concatenate([parts[name] for name in ("radius", "lateral", "offset", "zero", "x", "y")])
        self.zero, self.x, self.y, self.bias = parts["zero"], parts["x"], parts["y"], parts["bias"]


class _Sample(NamedTuple):
    """The equations of a sample about the solution that the numbers known so far give.

    pose (..., 3) after it. turn (...): rad. left (..., m): residual of each equation, m. derivative (..., m, D): of the
    residuals by the state. by_angle (..., m): by the castor's angle, m/rad. way (..., m): of the pivot, m. rolled
    (..., d): angles that the wheels turn, rad.
    """

    pose: Array
    turn: Array
    left: Array
    derivative: Array
    by_angle: Array
    way: Array
    rolled: Array


class _Measured(NamedTuple):
    """Measurements: derivative (..., m, D) by the state, residuals `left` (..., m), and variances (..., m)."""

    derivative: Array
    left: Array
    variance: Array


class CalibratingFilter:
    """The filter; serves every robot whose wheels determine its motion.

    When to use: a redundant base (two or more castors with encoders) whose dimensions are not exactly known. It cannot
    learn what no redundancy shows: of differential robots, tricycles and three omni wheels it knows nothing that
    `wheel-odometry` does not; on swerve bases the common scale of radii stays as described, and on powered casters,
    whose short offsets turn them by half a radian in a sample, it is learned wrong where the description
    is not calibrated. It fails where all wheels slip together.
    """

    batched = True

    def reset(self, robot: RobotDescription | Geometry, pose: ArrayLike) -> None:
        """Start at `pose` (..., 3); raises Declined where the wheels do not determine how the robot moves."""
        geometry, self._start = start(robot, pose)
        self._equations = equations = EquationsOfSamples(geometry)
        self._geometry, wheels = geometry, equations.wheels
        self._weight = 1.0 / equations.variances()[..., None, :]
        self._at = at = _Layout(geometry.n_castors, len(wheels))
        self._count = equations.angle_per_count
        step = np.where(geometry.fixed, 0.0, np.nan_to_num(2 * np.pi / geometry.pivot_counts_per_rev))
        self._step = step
        self._creeps = bool(np.all(geometry.driven & ~geometry.fixed)) and bool(np.all(geometry.offset == 0))
        self._floor_turns = (geometry.trailing & ~geometry.fixed & ~geometry.driven)[..., None, :]
        self._steered = bool(np.any(~geometry.fixed & ~self._floor_turns[..., 0, :]))
        lead = geometry.offset.shape[:-1]
        priors = (CALIBRATED, UNCALIBRATED) if geometry.tolerances is None else (geometry.tolerances,)
        slips = (1.0,) if geometry.fixes is None else (1.0, UNSEEN)
        unlikely = np.repeat(TRUST * np.arange(len(priors)), len(slips))
        self._creeping = np.array([errors is not UNCALIBRATED for errors in priors for _ in slips])
        self._slip = SLIP * np.tile(slips, len(priors))[:, None]
        priors = [errors for errors in priors for _ in slips]
        variance = np.zeros((*lead, len(priors), at.size))
        variance[..., at.swivel], variance[..., at.roll] = step**2 / 12, self._count**2 / 12
        for k, errors in enumerate(priors):
            variance[..., k, at.radius] = errors.radius**2
            variance[..., k, at.lateral] = (errors.lateral * geometry.lateral[..., wheels]) ** 2
            variance[..., k, at.offset] = (errors.offset * geometry.offset) ** 2
            variance[..., k, at.zero] = errors.pivot_zero**2
            variance[..., k, np.concatenate([at.x, at.y])] = errors.pivot**2
        variance[..., at.bias] = BIAS**2
        shape = (*np.broadcast_shapes(lead, self._start.shape[:-1]), len(priors))
        self._state = np.zeros((*shape, at.size))
        self._covariance = np.broadcast_to(variance[..., None] * np.eye(at.size), (*shape, at.size, at.size)).copy()
        self._log_likelihood = np.zeros(shape) - unlikely
        self._angle: Array | None = None
        self._swivel, self._gyro, self._turns = np.zeros_like(step), geometry.gyro, GyroTurns()
        self._fixes = None if geometry.fixes is None else FixUpdates(geometry.fixes, self._start)

    def update(self, observation: Observation) -> Array:
        """Take one sample, return the pose (..., 3)."""
        read = castor_angles(self._geometry, observation.get("pivot", np.empty(0)))
        before = read if self._angle is None else self._angle
        swivel = wrap(read - before)
        rolled = observation["wheel"][..., self._equations.read_wheels] * self._count
        self._angle, last, self._swivel = read, self._swivel, swivel
        turned = self._turned_by_gyro(observation)
        moves = np.any(swivel != 0, axis=-1) | np.any(rolled != 0, axis=-1) | (turned is not None)
        if np.any(moves):
            sample = self._sample(before[..., None, :], swivel[..., None, :], rolled[..., None, :])
            uneven = UNEVEN * (swivel - last) ** 2 / (np.abs(swivel) + np.abs(last) + self._step + 1e-9)
            state, covariance, measured = self._predicted(sample, swivel, rolled, uneven)
            if turned is not None:
                covariance[..., self._at.bias, self._at.bias] += DRIFT**2 * turned[-1][..., None]
                measured = self._with_gyro(measured, sample, state, *turned)
            found = self._updated(state, covariance, measured)
            self._state, self._covariance, self._log_likelihood = (
                np.where(moves.reshape(moves.shape + (1,) * (new.ndim - moves.ndim)), new, old)
                for new, old in zip(found, (self._state, self._covariance, self._log_likelihood), strict=True)
            )
        if self._fixes is not None:
            belief = Belief(self._state, self._covariance, self._log_likelihood)
            self._state, self._covariance, self._log_likelihood = self._fixes.update(observation, belief)
        return self.pose

    @property
    def pose(self) -> Array:
        """The pose (..., 3) now: x, y (m), psi (rad)."""
        return se2.compose(self._start, np.sum(self._parts[..., None] * self._state[..., self._at.pose], axis=-2))

    @property
    def geometry(self) -> Geometry:
        """The robot as learned so far: its numbers (...), of the likelier of both filters."""
        at, wheels, geometry = self._at, self._equations.wheels, self._geometry
        likelier = np.argmax(self._log_likelihood, axis=-1)[..., None, None]
        state = np.take_along_axis(self._state, likelier, axis=-2)[..., 0, :]
        radius, lateral = (of + 0 * state[..., :1] for of in (geometry.radius, geometry.lateral))
        radius[..., wheels] *= np.exp(state[..., at.radius])
        lateral[..., wheels] += state[..., at.lateral]
        return dataclasses.replace(
            geometry,
            radius=radius,
            lateral=lateral,
            offset=geometry.offset + state[..., at.offset],
            pivot_zero=geometry.pivot_zero + state[..., at.zero],
            pivot=geometry.pivot + vectors(state[..., at.x], state[..., at.y]),
        )

    @property
    def gyro_bias(self) -> Array:
        """The bias (...) of the gyro as learned so far, rad/s."""
        return np.sum(self._parts * self._state[..., self._at.bias[0]], axis=-1)

    @property
    def covariance(self) -> Array:
        """The covariance (..., 3, 3) of x, y (m) and psi (rad), in the world's axes."""
        parts, at = self._parts, self._at.pose
        poses = self._state[..., at]
        away = poses - np.sum(parts[..., None] * poses, axis=-2, keepdims=True)
        both = self._covariance[..., at[:, None], at] + away[..., :, None] * away[..., None, :]
        covariance = np.sum(parts[..., None, None] * both, axis=-3)
        turn = se2.rotation(self._start[..., 2])
        return turn @ covariance @ np.swapaxes(turn, -1, -2)

    @property
    def _parts(self) -> Array:
        """The probabilities (..., filters): that the description is calibrated, and that it is not."""
        parts = np.exp(self._log_likelihood - self._log_likelihood.max(axis=-1, keepdims=True))
        return parts / parts.sum(axis=-1, keepdims=True)

    def _sample(self, before: Array, swivel: Array, rolled: Array) -> _Sample:
        """Return the equations of a sample. before, swivel (..., 1, n): read; rolled (..., 1, d)."""
        at, geometry, equations = self._at, self._geometry, self._equations
        state = self._described if self._creeps else self._state
        of, wheels, d = equations.castor, equations.wheels, len(equations.wheels)
        radius = geometry.radius[..., None, wheels] * np.exp(state[..., at.radius])
        lateral = geometry.lateral[..., None, wheels] + state[..., at.lateral]
        offset = geometry.offset[..., None, :] + state[..., at.offset]
        x, y = (geometry.pivot[..., None, :, k] + state[..., part] for k, part in enumerate((at.x, at.y)))
        e = unit(before + state[..., at.swivel] - state[..., at.zero] + swivel / 2)[..., of, :]
        roller = equations.roller[..., None, :]
        direction, turned = e + roller[..., None] * left_of(e), left_of(e) - roller[..., None] * e
        direction[..., d:, :], turned[..., d:, :] = left_of(e)[..., d:, :], -e[..., d:, :]
        arm = np.empty((*state.shape[:-1], len(of)))
        arm[..., :d] = lateral + roller[..., :d] * offset[..., of[:d]]
        arm[..., d:] = offset[..., of[d:]]
        left_of_pivot, swivel = vectors(-y, x)[..., of, :], swivel[..., of] + np.zeros_like(arm)
        lever = np.sum(left_of_pivot * direction, axis=-1)
        way_rolled = np.zeros_like(arm)
        way_rolled[..., :d] = radius * rolled
        matrix = vectors(direction[..., 0], direction[..., 1], lever - arm * np.cos(swivel / 2))
        motion = solve(Equations(matrix, way_rolled, arm, swivel), self._weight)
        a, turn = 2 * np.sin(motion.turn / 2)[..., None], motion.turn[..., None] + swivel
        left = np.sum(direction * motion.displacement[..., None, :], axis=-1) + lever * a - 2 * arm * np.sin(turn / 2)
        path = motion.displacement[..., None, :] + left_of_pivot * a[..., None]
        by_angle, row = np.sum(turned * path, axis=-1), np.arange(len(of))
        derivative = np.zeros((*state.shape[:-1], len(of), at.size))
        derivative[..., at.motion] = vectors(direction[..., 0], direction[..., 1], lever - arm)
        derivative[..., row, at.swivel[of]], derivative[..., row, at.zero[of]] = by_angle, -by_angle
        derivative[..., row, at.swiveled[of]] = by_angle / 2 - arm
        derivative[..., row, at.x[of]], derivative[..., row, at.y[of]] = a * direction[..., 1], -a * direction[..., 0]
        derivative[..., row[:d], at.lateral] = -turn[..., :d]
        derivative[..., row[:d], at.offset[of[:d]]] = -roller[..., :d] * turn[..., :d]
        derivative[..., row[d:], at.offset[of[d:]]] = -turn[..., d:]
        pose = moved(state[..., at.pose], motion)
        rolled = left[..., :d] / (radius * np.sinc(turn[..., :d] / (2 * np.pi)))
        way = np.hypot(path[..., 0], path[..., 1])
        if self._creeps:
            derivative[..., row[:d], at.radius] = -radius * rolled
            creeping, numbers = self._creeping[:, None], derivative[..., at.numbers]
            numbers = np.where(creeping[..., None], self._balanced(derivative, way), numbers)
            derivative[..., at.numbers] = numbers
            by_numbers = creeping * np.einsum("...ij,...j->...i", numbers, self._state[..., at.numbers])
            left = left + by_numbers
            rolled = rolled + by_numbers[..., :d] / radius
        return _Sample(pose, motion.turn, left, derivative, by_angle, way, rolled)

    @property
    def _described(self) -> Array:
        """The state, in filters whose contacts creep with the numbers as described."""
        state = self._state.copy()
        state[..., self._at.numbers] *= ~self._creeping[:, None]
        return state

    def _balanced(self, derivative: Array, way: Array) -> Array:
        """Return by how much equations change with the numbers (..., m, numbers) where contacts, whose ways in the
        sample are (..., m), m, creep until they balance.

        Creep is in proportion to the way and to the force (`castor_envs.physics.tyre`); wheels carry equal loads.
        """
        at, equations = self._at, self._equations
        wheels = np.concatenate([np.ones(len(equations.wheels)), equations.standard_wheels])
        farthest = np.maximum(way.max(axis=-1, keepdims=True), np.sqrt(LEAST))
        stiffness = wheels / np.maximum(way / farthest, LEAST_WAY)
        return balanced(derivative[..., at.motion], stiffness, derivative[..., at.numbers])

    def _predicted(
        self, sample: _Sample, swivel: Array, rolled: Array, uneven: Array
    ) -> tuple[Array, Array, _Measured]:
        """Return the state and covariance after a sample, and what it measures: counts, readings of pivots, no side
        slip."""
        at, equations = self._at, self._equations
        of, d, n = equations.castor, len(equations.wheels), self._geometry.n_castors
        state = self._described if self._creeps else self._state
        radius = self._geometry.radius[..., None, equations.wheels] * np.exp(state[..., at.radius])
        changed, step = (swivel != 0)[..., None, :], self._step

        transition = np.broadcast_to(np.eye(at.size), self._covariance.shape).copy()
        transition[..., at.swivel, at.swiveled] = 1.0
        transition[..., at.roll, :] = sample.derivative[..., :d, :] / radius[..., None]
        transition[..., at.roll, at.roll] = 1.0
        if not self._creeps:
            transition[..., at.roll, at.radius] = -sample.rolled
        half_way = self._state[..., 2] + sample.turn / 2
        c, s = np.cos(half_way), np.sin(half_way)
        x, y = (sample.pose[..., k] - self._state[..., k] for k in (0, 1))
        for row, entries in enumerate(((c, -s, -y / 2), (s, c, x / 2), (0.0, 0.0, 1.0))):
            for column, entry in zip(at.motion, entries, strict=True):
                transition[..., row, column] = entry
        transition[..., 0, 2], transition[..., 1, 2] = -y, x
        covariance, anew = self._covariance.copy(), np.concatenate([at.motion, at.swiveled])
        covariance[..., anew, :] = 0.0
        covariance[..., :, anew] = 0.0
        covariance[..., at.motion, at.motion] = FREE**2
        held = np.where(changed, CHANGING, STEADY)
        covariance[..., at.swiveled, at.swiveled] = (np.where(self._floor_turns, TURNED, held) * step) ** 2
        covariance = transition @ covariance @ np.swapaxes(transition, -1, -2)
        bent = self._bent(sample, swivel[..., None, of], uneven[..., None, of])
        slip = self._slip**2 * np.abs(radius * rolled[..., None, :]) + LEAST + bent[..., :d]
        covariance[..., at.roll, at.roll] += slip / radius**2
        state = self._state.copy()
        state[..., at.pose] = sample.pose
        state[..., at.roll] += sample.rolled - rolled[..., None, :]

        derivative = np.zeros((*state.shape[:-1], n + len(of), at.size))
        derivative[..., np.arange(d), at.roll] = 1.0
        derivative[..., d + np.arange(n), at.swivel] = 1.0
        derivative[..., d + n :, :] = sample.derivative[..., d:, :]
        across = np.arange(len(of) - d)
        derivative[..., d + n + across, at.swiveled[of[d:]]] -= sample.by_angle[..., d:]  # the castor's angle is now
        variance = np.empty(derivative.shape[:-1])
        variance[..., :d] = self._count**2 / 12
        repeated = np.where(self._floor_turns, REPEATED * step**2 / 12, 1.0)
        variance[..., d : d + n] = np.where(changed, step**2 / 12, repeated) + self._geometry.fixed
        variance[..., d + n :] = SIDE_SLIP**2 * sample.way[..., d:] + LEAST + bent[..., d:]
        left = np.concatenate([-state[..., at.roll], -state[..., at.swivel], -sample.left[..., d:]], axis=-1)
        return state, covariance, _Measured(derivative, left, variance)

    def _turned_by_gyro(self, observation: Observation) -> tuple[Array, Array, Array] | None:
        """Return by how much the body turns in a sample as a gyro says, rad, the variance of that, and the sample's
        duration, s, (..., 1) each; None where there is no gyro, or no sample before."""
        read = None if self._gyro is None else self._turns.read(observation)
        if self._gyro is None or read is None or not np.any(read.duration > 0):
            return None
        turn, duration, uneven = (part[..., None] for part in read)
        return turn, (duration * self._gyro.noise) ** 2 / 2 + uneven**2 + LEAST, duration

    def _with_gyro(
        self, measured: _Measured, sample: _Sample, state: Array, turned: Array, noise: Array, duration: Array
    ) -> _Measured:
        """Return measurements with that of a turn (..., 1) by the gyro; noise: its variance."""
        row = np.zeros((*state.shape[:-1], 1, self._at.size))
        row[..., self._at.motion[2]] = 1.0
        row[..., self._at.bias] = duration[..., None, None]
        error = (turned - sample.turn - duration * state[..., self._at.bias[0]])[..., None]
        parts = zip(measured, (row, error, noise[..., None] + 0 * error), (-2, -1, -1), strict=True)
        return _Measured(*(np.concatenate([part, more], axis=axis) for part, more, axis in parts))

    def _bent(self, sample: _Sample, swivel: Array, off: Array) -> Array:
        """Return the variance (..., m), m^2, of equations of castors that do not turn evenly in a sample.

        off (..., m): error of the angle half-way, rad. And a castor that trails its pivot turns along a tractrix, whose
        chord differs from that of a circle by the third order of the way over the offset.
        """
        offset = self._geometry.offset[..., None, self._equations.castor]
        trailing = sample.way**2 * swivel / (24 * np.where(offset > 0, offset, np.inf))
        return (sample.by_angle * off) ** 2 + (sample.way * np.minimum(off, 1.0) ** 2 / 2) ** 2 + trailing**2

    def _updated(self, state: Array, covariance: Array, measured: _Measured) -> tuple[Array, Array, Array]:
        """Return the state, covariance and log-likelihood after measurements.

        What motors steer turns and slips so little in a short sample that `FREE` is 1e12 times as uncertain; then
        rounding of the gain would leave negative variances, which Joseph's form of the covariance does not.
        """
        derivative, left, variance = measured
        at, d, n = self._at, len(self._equations.wheels), self._geometry.n_castors
        with_state = covariance @ np.swapaxes(derivative, -1, -2)
        joint = derivative @ with_state + variance[..., None] * np.eye(variance.shape[-1])
        slip = np.full(variance.shape, RELEASED)
        slip[..., :d] /= self._geometry.radius[..., None, self._equations.wheels]
        slip[..., d : d + n] = 0.0  # readings of pivots are never released, nor is a gyro
        slip[..., d + n + len(self._equations.castors) :] = 0.0
        released, inverse = _released(joint, left, slip**2)
        covariance[..., at.roll, at.roll] += released[..., :d]
        with_state[..., at.roll, np.arange(d)] += released[..., :d]
        gain = with_state @ inverse
        state = state + np.einsum("...ij,...j->...i", gain, left)
        covariance = covariance - gain @ np.swapaxes(with_state, -1, -2)
        if self._steered:
            noise = np.concatenate([variance[..., :d], variance[..., d:] + released[..., d:]], axis=-1)
            excess = covariance @ np.swapaxes(derivative, -1, -2) - gain * noise[..., None, :]
            covariance = covariance - excess @ np.swapaxes(gain, -1, -2)
        explained = np.einsum("...i,...ij,...j->...", left, inverse, left)
        log_likelihood = self._log_likelihood - (explained - np.linalg.slogdet(inverse)[1]) / 2
        return state, (covariance + np.swapaxes(covariance, -1, -2)) / 2, np.asarray(log_likelihood, dtype=np.float64)


def balanced(moves: Array, stiffness: Array, disagreeing: Array) -> Array:
    """Return what is left of disagreements of contacts (..., m, c) after these crept until their forces balance.

    moves (..., m, p): by how much every contact moves for a unit of each free motion, A. stiffness (..., m): of their
    creep, in any unit, C. The creep that is taken off has A' C creep = 0: neither force nor torque is left.
    """
    forces = np.swapaxes(moves * stiffness[..., None], -1, -2)
    return moves @ np.linalg.solve(forces @ moves, forces @ disagreeing)


def _released(joint: Array, left: Array, slip: Array) -> tuple[Array, Array]:
    """Return the variances (..., m) that are added to measurements of residuals `left` (..., m) and covariance `joint`
    (..., m, m), and the inverse of the covariance with them.

    The residual of a measurement beside all others has the variance 1 / inverse[i, i]. While the largest exceeds
    `GATE` standard deviations, that measurement, and all that tie with it (`TIE`), get the variance `slip` (..., m);
    where that is 0, it stays.
    """
    released, inverse = np.zeros_like(left), np.asarray(np.linalg.inv(joint), dtype=np.float64)
    diagonal = np.arange(left.shape[-1])
    for _ in diagonal:
        beside = np.abs(np.einsum("...ij,...j->...i", inverse, left)) / np.sqrt(inverse[..., diagonal, diagonal])
        beside = np.where((slip > 0) & (released == 0), beside, 0.0)
        most = beside.max(axis=-1, keepdims=True)
        if not (most > GATE).any():
            break
        here = (most > GATE) & (beside > 0) & (beside**2 > most**2 - TIE)
        released = np.where(here, slip, released).astype(np.float64)
        inverse = np.asarray(np.linalg.inv(joint + released[..., None] * np.eye(len(diagonal))), dtype=np.float64)
    return released, inverse


ESTIMATORS = {"filter": CalibratingFilter}
