"""Estimators of a robot's pose from its encoders, of a train's from relative poses too, and how others are plugged in.

Of robots: `DeadReckoning` uses one castor, `IPEC` two, `CAST` and `CASTArc` two or more. Of trains: `TrainOdometry`
alone, `TwoTruckIPEC` on two axles, `RMSPEC`, `TrainLeastSquares` and `GRPEC` (Methods 1, 2 and 3 of Vogt and Minor) and
`InlierLeastSquares` on any number. `load_estimator` finds these and plug-ins by name; the `Estimator` protocol says
what a plug-in needs.
"""

from estimators.cast import CAST
from estimators.cast_arc import CASTArc
from estimators.dead_reckoning import DeadReckoning
from estimators.grpec import GRPEC, GRPECXY, GRPECDev, GRPECPhi
from estimators.inlier_least_squares import InlierLeastSquares
from estimators.ipec import IPEC
from estimators.protocol import Estimator, Observation
from estimators.registry import EstimatorEntry, builtin_names, load_estimator
from estimators.relative_poses import RelativePoseWarning
from estimators.rmspec import RMSPEC
from estimators.train_least_squares import TrainLeastSquares
from estimators.train_odometry import TrainOdometry
from estimators.two_truck_ipec import TwoTruckIPEC

__all__ = [
    "CAST",
    "GRPEC",
    "GRPECXY",
    "IPEC",
    "RMSPEC",
    "CASTArc",
    "DeadReckoning",
    "Estimator",
    "EstimatorEntry",
    "GRPECDev",
    "GRPECPhi",
    "InlierLeastSquares",
    "Observation",
    "RelativePoseWarning",
    "TrainLeastSquares",
    "TrainOdometry",
    "TwoTruckIPEC",
    "builtin_names",
    "load_estimator",
]
