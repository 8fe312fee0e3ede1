"""What an estimator is: anything with `reset` and `update`, or with `estimate`, as below. No base class is needed."""

from collections.abc import Mapping
from typing import Any, Protocol, runtime_checkable

from castor_envs.geometry.arrays import Array
from castor_envs.sensors.observation import Observations

Observation = Mapping[str, Array]
"""What an estimator sees of one sample.

- ``wheel`` (..., driven wheels): encoder counts since the sample before, in the order of `robot.driven_wheels`
- ``pivot`` (..., pivot encoders): absolute counts, in the order of `robot.pivot_encoders`; they may wrap at
  `pivot_counts_per_rev`
- ``time`` (..., 1): s
- ``gyro`` (..., 1): yaw rate, rad/s, where the robot has one
- ``fix`` (..., 3) and ``fix_age`` (..., 1), where a log has external fixes of the pose: x, y (m), psi (rad, wrapped
  or not) of the body in N, NaN where this sample has none (psi alone: none of the heading), and how long ago that was
  true, s. Some are wrong; `robot.fixes` says how exact the others are
- ``command`` (..., driven wheels) and ``steering_command`` (..., driven castors): what the motors were told in the
  period that led to this sample, rad/s, 0 in the first; only where a log has them (those of tasks in physics do, of
  perfect rolling and of most measured data do not, and the environments' observations do not)

Of a train of N axles and F = N - 1 frames, front first, it sees

- ``wheel`` (2N,): encoder counts since the sample before, axle by axle, left then right
- ``time`` (1,): s
- ``rps`` (3F,): each frame's relative pose, x (m), y (m), phi (rad) of its front axle in its rear axle's frame; NaN
  where there is no reading
- ``rps_age`` (F,): s since each of these was taken
- ``command`` (2N,): as above

Motor torques are not among them.

Only estimators with ``batched = True`` are given leading axes.
"""


@runtime_checkable
class Smoother(Protocol):
    """Estimates the poses of a whole log at once, each by what came before and after it.

    A class with `update` is judged by that, sample by sample, whatever else it has: give a smoother a class without
    `update`. Boards show its name with ``(smoother)`` behind it, as it sees the future. It is given single vehicles.
    """

    def estimate(self, robot: Any, pose: Array, observations: Observations, /) -> Array:
        """Return the poses (K, 3), of a train (K, N, 3), at all K samples of a log that starts at `pose`.

        observations: the arrays (K, ...) of what `Observation` says, None where there is none. Raises `Declined` as
        `Estimator.reset` does.
        """
        ...


@runtime_checkable
class Estimator(Protocol):
    """Follows a robot's pose, or the poses of all axles of a train, by what its sensors report.

    An estimator class is constructed without arguments. With the class attribute ``batched = True`` it says that
    its arithmetic broadcasts: `reset` may then get a `Geometry` with leading axes, and pose and observations
    leading axes too. Without the attribute, and on a train, it is only given single vehicles and 1-D observations.

    After an update an estimator may have two attributes. `covariance` (..., 3, 3), of a train (N, 3, 3): that of the
    pose returned, in N, m and rad; scored as NEES, which shows whether it may be trusted. `status`: None, or a text
    that says what is wrong now, such as why relative poses cannot be used.
    """

    def reset(self, robot: Any, pose: Array, /) -> None:
        """Start anew.

        With a robot (`RobotDescription` or `Geometry`) at `pose` (..., 3) = x, y (m) and psi (rad) of the body in N;
        with a train (`TrainDescription`) at `pose` (N, 3), those of its axles, front first. Raises `Declined`
        (`castor_envs.errors`) where the estimator does not serve this robot or train; any other exception is a fault.

        A `reset` (or a smoother's `estimate`) with a further parameter `covariance`, None by default, also gets that of
        the start pose, (..., 3, 3), of a train (N, 3, 3), m and rad: 0 where it is the true pose, as on all boards but
        those of snapshots, where axles start from a belief. Environments do not tell it.
        """
        ...

    def update(self, observation: Observation, /) -> Array:
        """Take one sample, return the pose (..., 3) or (N, 3) at its time: x, y (m), psi (rad, unwrapped).

        Real numbers of any type are taken as float64, which has the precision that scores show.
        The first sample after `reset` is taken at the start pose, with wheel increments 0.
        """
        ...
