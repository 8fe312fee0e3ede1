"""External fixes of a pose: what late ones say of the pose now, and which of them are not believed.

A fix is of the pose some time ago. The poses of the last seconds are remembered; what moved since is taken from them,
so that a late fix corrects the pose now through the same equations as a fresh one (as by extrapolation of late
measurements, Larsen et al., Proc. FUSION 1998).

Some fixes are wrong (`WRONG`) and then anywhere; one that is likelier wrong than right is left out. If the next one is
left out too, and the way between both is the way that was driven, then not the fixes are wrong but the pose, and it is
taken from them. Where fixes say no heading, the way that was driven is that of the heading followed; as this may be
lost as well, three whose ways are as long as those driven, in whatever direction, tell the same.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
from castor_envs.vehicles.robot import Fixes
from estimators.protocol import Observation

LATEST = 10.0
"""s: older fixes are left out, and no pose is remembered longer."""

WRONG, ANYWHERE = 0.05, 20.0
"""The part of fixes that are wrong, as where one place looks like another; and the side, m, of the square in which
these may lie."""

DRIVEN = 0.05
"""Part of a way, and of a turn, by which odometry between two fixes may be off."""

SAME_WAY = 16.26623619623813
"""The chi-square distribution of three degrees of freedom is below this but for 1 in 1000: so often the same way is not
recognised."""

LOST = (10.0, 10.0, np.pi)
"""m, m, rad: standard deviations of a pose that is to be taken from fixes."""


class Belief(NamedTuple):
    """State (..., D) whose first three entries are x, y (m) and psi (rad), covariance (..., D, D), and log-likelihood
    (...), natural logarithm."""

    state: Array
    covariance: Array
    log_likelihood: Array


class _Refused(NamedTuple):
    """The fix (..., 3) that was left out last, and the pose (..., 3) followed at its time; NaN where it was not.

    heading (...): standard deviation of the fix's heading, rad; 0 where it says none, and the one followed stands in.
    as_far (...): whether it has no heading and is as far from the fix left out before as was driven.
    """

    fix: Array
    pose: Array
    heading: Array
    as_far: NDArray[np.bool_]


class FixUpdates:
    """Corrects a bank of filters by fixes. Arithmetic broadcasts: axes are robots of a stack, and filters of the bank.

    sensor: how exact fixes are. start (..., 3): the pose in N in whose frame the filters' poses are.
    """

    def __init__(self, sensor: Fixes, start: Array) -> None:
        self._deviation = np.array([sensor.noise_position, sensor.noise_position, sensor.noise_heading])
        self._start = start
        self._times: list[Array] = []
        self._poses: list[Array] = []
        self._refused: _Refused | None = None

    def update(self, observation: Observation, belief: Belief) -> Belief:
        """Take one sample, return the belief (..., filters) after its fix; the same object if it has none."""
        now, time = belief.state[..., :3], np.array(observation["time"][..., 0])
        self._remember(time, now)
        if "fix" not in observation or not np.isfinite(observation["fix"]).any():
            return belief
        fix = se2.relative_pose(self._start, observation["fix"])[..., None, :]
        then = self._pose_at(time - observation["fix_age"][..., 0])
        left = fix - then
        left[..., 2] = wrap(left[..., 2])
        says = np.isfinite(left)
        derivative = np.zeros((*left.shape, belief.state.shape[-1]))
        derivative[..., [0, 1, 2], [0, 1, 2]] = 1.0
        derivative[..., 0, 2], derivative[..., 1, 2] = now[..., 1] - then[..., 1], then[..., 0] - now[..., 0]
        derivative = np.where(says[..., None], derivative, 0.0)
        left, variance = np.where(says, left, 0.0), np.where(says, self._deviation**2, 1.0)

        corrected, likelihood = _updated(belief, derivative, left, variance)
        likelihood += np.log(1 - WRONG) - says.sum(axis=-1) * np.log(2 * np.pi) / 2
        wrong = np.log(WRONG) - np.where(says, np.log([ANYWHERE, ANYWHERE, 2 * np.pi]), 0.0).sum(axis=-1)
        log_likelihood = belief.log_likelihood + np.logaddexp(likelihood, wrong)
        right: NDArray[np.bool_] = np.greater(likelihood, wrong)
        claim = then + left  # where a fix says nothing, what was followed
        heading = np.where(says[..., 2], self._deviation[2], 0.0)
        if self._refused is None:
            self._refused = _Refused(np.full_like(then, np.nan), then, heading, np.zeros(right.shape, dtype=bool))
        last = self._refused
        same, as_far = _goes_on(last, claim, then, self._deviation)
        lost: NDArray[np.bool_] = ~right & (same | (as_far & last.as_far))
        if lost.any():
            unknown = belief.covariance.copy()
            unknown[..., [0, 1, 2], [0, 1, 2]] += np.where(lost[..., None], np.square(LOST), 0.0)
            corrected, _ = _updated(belief._replace(covariance=unknown), derivative, left, variance)
        there: NDArray[np.bool_] = np.any(says, axis=-1)
        refused = there & ~right & ~lost
        fixed = np.where(refused[..., None], claim, np.nan)
        self._refused = _Refused(
            np.where(there[..., None], fixed, last.fix),
            np.where(there[..., None], then, last.pose),
            np.where(there, heading, last.heading),
            np.where(there, refused & as_far, last.as_far),
        )
        taken = there & (right | lost)
        after = Belief(
            np.where(taken[..., None], corrected.state, belief.state),
            np.where(taken[..., None, None], corrected.covariance, belief.covariance),
            np.where(there, log_likelihood, belief.log_likelihood),
        )
        self._poses = [se2.compose(after.state[..., :3], se2.relative_pose(now, pose)) for pose in self._poses]
        return after

    def _remember(self, time: Array, pose: Array) -> None:
        self._times.append(time)
        self._poses.append(pose.copy())
        while len(self._times) > 2 and np.all(self._times[1] < time - LATEST):
            del self._times[0], self._poses[0]

    def _pose_at(self, time: Array) -> Array:
        """Return the poses (..., filters, 3) at times (...), s; NaN before the first that is remembered."""
        times, poses = np.stack(self._times), np.stack(self._poses)
        if len(times) == 1:
            return np.where((time < times[0])[..., None, None], np.nan, poses[0])
        after = np.clip(np.sum(times < time, axis=0), 1, len(times) - 1)[None]

        def both(values: Array) -> tuple[Array, Array]:
            at = after.reshape(after.shape + (1,) * (values.ndim - after.ndim))
            return np.take_along_axis(values, at - 1, axis=0)[0], np.take_along_axis(values, at, axis=0)[0]

        (began, ended), (first, second) = both(times), both(poses)
        part = np.clip((time - began) / (ended - began), 0.0, 1.0)[..., None, None]
        return np.where((time < times[0])[..., None, None], np.nan, first + part * (second - first))


def _goes_on(last: _Refused, fix: Array, pose: Array, deviation: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return whether (...) the way from the fix left out last to this one is the way that was driven, and whether
    without a heading it is as long. deviation (3,): of x and y, m, and of the heading, rad, of fixes."""
    driven, claimed = se2.relative_pose(last.pose, pose), se2.relative_pose(last.fix, fix)
    off = claimed - driven
    off[..., 2] = wrap(off[..., 2])
    way, turn = np.hypot(driven[..., 0], driven[..., 1]), np.abs(driven[..., 2])
    along = 2 * deviation[0] ** 2 + (DRIVEN * way) ** 2
    across = along + (way * last.heading) ** 2
    about = 2 * deviation[2] ** 2 + (DRIVEN * turn) ** 2
    unlike = (off[..., 0] ** 2 + off[..., 1] ** 2) / across + off[..., 2] ** 2 / about
    longer = np.hypot(claimed[..., 0], claimed[..., 1]) - way
    as_far = np.less(longer**2, SAME_WAY * along) & np.equal(last.heading, 0.0)
    return np.less(unlike, SAME_WAY), as_far  # of NaN: False


def _updated(belief: Belief, derivative: Array, left: Array, variance: Array) -> tuple[Belief, Array]:
    """Return the belief after a measurement, and the measurement's log-likelihood (...) but for powers of 2 pi."""
    with_state = belief.covariance @ np.swapaxes(derivative, -1, -2)
    joint = derivative @ with_state + variance[..., None] * np.eye(variance.shape[-1])
    inverse = np.linalg.inv(joint)
    gain = with_state @ inverse
    covariance = belief.covariance - gain @ np.swapaxes(with_state, -1, -2)
    state = belief.state + np.einsum("...ij,...j->...i", gain, left)
    explained = np.einsum("...i,...ij,...j->...", left, inverse, left)
    after = belief._replace(state=state, covariance=(covariance + np.swapaxes(covariance, -1, -2)) / 2)
    return after, np.asarray((np.linalg.slogdet(inverse)[1] - explained) / 2)
