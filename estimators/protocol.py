"""What an estimator is: anything with `reset` and `update` as below. No base class is needed."""

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

from castor_envs.kinematics import Array, Geometry
from castor_envs.robot import RobotDescription

Observation = Mapping[str, Array]
"""What an estimator sees of one sample.

- ``wheel`` (..., driven wheels): encoder counts since the sample before, in the order of `robot.driven_wheels`
- ``pivot`` (..., pivot encoders): absolute counts, in the order of `robot.pivot_encoders`; they may wrap at
  `pivot_counts_per_rev`
- ``time`` (..., 1): s
- ``gyro`` (..., 1): yaw rate, rad/s, where the robot has one

Only estimators with ``batched = True`` are given leading axes.
"""


@runtime_checkable
class Estimator(Protocol):
    """Follows a robot's pose by what its sensors report.

    An estimator class is constructed without arguments. With the class attribute ``batched = True`` it says that
    its arithmetic broadcasts: `reset` may then get a `Geometry` with leading axes, and pose and observations
    leading axes too. Without the attribute it is only given single robots and 1-D arrays.
    """

    def reset(self, robot: RobotDescription | Geometry, pose: Array) -> None:
        """Start anew with this robot at `pose` (..., 3) = x, y (m) and psi (rad) of the body in N.

        Raises ValueError (InputError is one) where the estimator cannot serve this robot.
        """
        ...

    def update(self, observation: Observation) -> Array:
        """Take one sample and return the pose (..., 3) at its time: x, y (m), psi (rad, unwrapped), float64.

        The first sample after `reset` is that of the start itself, with wheel increments 0.
        """
        ...
