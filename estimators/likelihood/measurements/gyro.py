"""Yaw rates of one log's gyro, as equations about a state.

Over the step from sample k to k + 1, of duration dt, the mean of both readings is

    (1 + scale) (psi[k + 1] - psi[k]) / dt + bias + latency (rate[k] - rate[k + 1]) / dt + noise

White noise of readings is given as that of their mean in each step: neighbouring means share a reading, so the turn
over any longer time is as certain as it is. Bias and latency are numbers of the log alone, normal about what the robot
file says. A bias that walks is piecewise linear; what it does within a piece counts as noise.
"""

import math

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import Gyro
from estimators.likelihood.elimination import Prior, Rows
from estimators.likelihood.reduction import Leftover
from estimators.likelihood.rolling import GAP
from estimators.steps.gyro import bias_deviation

LATENCY = 0.05
"""s: prior standard deviation of how late a gyro is read: filters of gyros delay by a few milliseconds to as much."""

FEWEST = 3
"""Least number of steps with readings at both ends of which a bias is told."""

FREEDOM = 20.0
"""Degrees of freedom with which the noise in the robot file counts beside those of a log's residuals. Where counts are
coarse, a gyro tells the turn from sample to sample far better than wheels do, and hardly any of its noise shows."""

PIECES, SHORTEST = 24, 10.0
"""Most pieces of a bias that walks, and the shortest, s."""

BEYOND_NOISE = 3 * math.sqrt(6)
"""Standard deviations of readings beyond which three readings off a line show that the rate changed at once."""


class GyroRates:
    """The yaw rates of a log; none where the log or the robot has no gyro.

    steps (S,): with readings at both ends, that are no gaps. scale: by which the gyro is known to read too much, as a
    part.
    """

    def __init__(self, layout: Geometry, log: Log) -> None:
        """layout: with the gyro as the robot file describes it."""
        self.scale = 0.0
        self.steps: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
        if layout.gyro is None or log.gyro is None:
            return
        duration, mean = np.diff(log.t), (log.gyro[1:] + log.gyro[:-1]) / 2
        steps = np.flatnonzero(np.isfinite(mean) & (duration <= GAP * np.median(duration)))
        if len(steps) < FEWEST:
            return
        self._described = layout.gyro.noise
        self.steps, self._samples, self._duration = steps, len(log), duration[steps]
        self._mean = mean[steps] - layout.gyro.bias
        changes = (np.diff(log.gyro) / duration)[steps]
        pieces = _pieces(layout.gyro, log.t)
        middle = (log.t[steps] + log.t[steps + 1]) / 2
        walked = np.clip((middle[:, None] - pieces[:-1]) / np.diff(pieces), 0.0, 1.0)
        within = layout.gyro.bias_walk * np.diff(pieces) if len(pieces) > 1 else np.zeros(1)
        self._columns = np.column_stack([np.ones(len(steps)), walked, -changes])
        walks = layout.gyro.bias_walk * np.sqrt(np.diff(pieces))
        deviation = np.array([max(bias_deviation(layout.gyro), 1e-9), *walks.tolist(), LATENCY])
        self._prior = Prior(np.zeros(len(deviation)), deviation)
        # the turn within a piece strays from a line's by as much as white noise of this size would make it
        kinks, strays = _kinks(log.gyro, layout.gyro.noise)[steps], float(within.max()) / np.sqrt(12 * self._duration)
        self._uneven: Array = np.sqrt(kinks**2 + strays**2)

    @property
    def prior(self) -> Prior:
        """The prior of the log's own numbers (q,): bias, rad/s, by how much it walks in each piece, and latency, s."""
        return self._prior if len(self.steps) else Prior(np.zeros(0), np.zeros(0))

    def weights(self, noise: float) -> Array:
        """Return one over the standard deviation of every equation (S, 1), s/rad. noise: of a reading, rad/s."""
        weight: Array = 1 / np.sqrt(noise**2 + self._uneven**2)
        return weight[:, None]

    def numbers(self, state: Array, weights: Array) -> Array:
        """Return the most likely numbers (q,) of the log at a state (K, m)."""
        columns = weights * self._columns
        information = columns.T @ columns + np.diag(self._prior.deviation**-2.0)
        found: Array = np.linalg.solve(information, -columns.T @ (weights[:, 0] * self._off(state))).astype(np.float64)
        return found

    def off(self, state: Array, numbers: Array) -> Array:
        """Return by how much the rates of a state (K, m) exceed those read (S, 1), rad/s, with these numbers (q,)."""
        return (self._off(state) + self._columns @ numbers)[:, None]

    def rows(self, state: Array, weights: Array, values: Array, scales: Array, others: int) -> Rows:
        """Return the equations linearised about a state. values (S, 1): `off`, times the weights. scales (P,): change
        of the gyro's scale per unit of each parameter; others: numbers between these and those of the log."""
        by_turn, rate = weights[:, 0] * (1 + self.scale) / self._duration, weights[:, 0] * self._rate(state)
        own, by_heading = weights * self._columns, by_turn[:, None, None]

        def by_numbers(chosen: slice) -> Array:
            of_scales = rate[chosen, None] * scales
            return np.concatenate([of_scales, np.zeros((len(of_scales), others)), own[chosen]], axis=1)[:, None]

        return Rows(self.steps, values, (-by_heading).__getitem__, by_heading.__getitem__, by_numbers, own=2)

    def with_described(self, left: Leftover, noise: float) -> Leftover:
        """Return the residuals of a log with a noise, rad/s, and with those by which the robot file knows it."""
        if not (len(self.steps) and self._described):
            return left
        squares = left.squares["gyro"] + FREEDOM * (self._described / noise) ** 2
        expected = left.expected["gyro"] + FREEDOM
        return Leftover(left.squares | {"gyro": squares}, left.expected | {"gyro": expected})

    def drawn(self, random: np.random.Generator, noise: float, probes: int) -> Array:
        """Return drawn errors of every equation (S, 1, probes), over its standard deviation."""
        white, uneven = random.normal(size=(self._samples, probes)), random.normal(size=(len(self.steps), probes))
        means = noise * (white[self.steps] + white[self.steps + 1]) / 2
        return (self.weights(noise) * (means + self._uneven[:, None] * uneven))[:, None]

    def _off(self, state: Array) -> Array:
        return (1 + self.scale) * self._rate(state) - self._mean

    def _rate(self, state: Array) -> Array:
        return (state[self.steps + 1, 2] - state[self.steps, 2]) / self._duration


def _pieces(gyro: Gyro, t: Array) -> Array:
    """Return the times between which a bias is linear, s; of one that does not walk the first alone."""
    if gyro.bias_walk == 0.0:
        return t[:1]
    count = min(max(math.ceil((t[-1] - t[0]) / SHORTEST), 1), PIECES)
    return np.linspace(t[0], t[-1], count + 1)


def _kinks(rate: Array, noise: float) -> Array:
    """Return the standard deviation (K - 1,) of every step's mean rate, rad/s, where the rate changed at once, at any
    time in the step: by how far three readings are off a line beyond their noise, rad/s."""
    off = np.abs(np.diff(rate, 2, prepend=rate[:1], append=rate[-1:]))
    off = np.maximum(np.nan_to_num(off) - BEYOND_NOISE * noise, 0.0)
    return np.maximum(off[1:], off[:-1]) / math.sqrt(12)
