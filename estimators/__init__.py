"""Estimators of a robot's pose from its encoders, and of a train's poses from relative poses too; plug-ins of both.

Of robots: `DeadReckoning` uses one castor, `IPEC` two, `CAST` and `CASTArc` two or more; `WheelOdometry` serves every
robot, and `HolmbergKhatib` and `TidyBot` are what others run of it; `CalibratingFilter` learns a robot's dimensions
while it drives. `estimators.peers` holds what others run on swerve drives and with a gyro. Of trains: `TrainOdometry`
alone, `TwoTruckIPEC` on two axles, `RMSPEC`, `TrainLeastSquares` and `GRPEC` (Methods 1, 2 and 3 of Vogt and Minor)
and `InlierLeastSquares` on any number; `TrainFilter` uses all samples so far. `load_estimator` finds these and plug-
ins by name; the `Estimator` protocol says what a plug-in needs. Estimators raise `Declined` for robots and trains
that they do not serve.
"""

from castor_envs.errors import Declined
from estimators.plugins.registry import EstimatorEntry, builtin_names, load_estimator
from estimators.protocol import Estimator, Observation
from estimators.robots.calibrating_filter import CalibratingFilter
from estimators.robots.cast import CAST, SmallTurnWarning
from estimators.robots.cast_arc import CASTArc
from estimators.robots.dead_reckoning import DeadReckoning
from estimators.robots.ipec import IPEC
from estimators.robots.wheel_odometry import HolmbergKhatib, TidyBot, WheelOdometry
from estimators.trains.grpec import GRPEC, GRPECXY, GRPECDev, GRPECPhi
from estimators.trains.inliers import InlierLeastSquares
from estimators.trains.least_squares import TrainLeastSquares
from estimators.trains.odometry import TrainOdometry
from estimators.trains.relative_poses import RelativePoseWarning
from estimators.trains.rmspec import RMSPEC
from estimators.trains.train_filter import TrainFilter
from estimators.trains.two_truck import TwoTruckIPEC

__all__ = [
    "CAST",
    "GRPEC",
    "GRPECXY",
    "IPEC",
    "RMSPEC",
    "CASTArc",
    "CalibratingFilter",
    "DeadReckoning",
    "Declined",
    "Estimator",
    "EstimatorEntry",
    "GRPECDev",
    "GRPECPhi",
    "HolmbergKhatib",
    "InlierLeastSquares",
    "Observation",
    "RelativePoseWarning",
    "SmallTurnWarning",
    "TidyBot",
    "TrainFilter",
    "TrainLeastSquares",
    "TrainOdometry",
    "TwoTruckIPEC",
    "WheelOdometry",
    "builtin_names",
    "load_estimator",
]
