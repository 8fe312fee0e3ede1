"""Estimators of a robot's pose from its encoders, and how others are plugged in.

`DeadReckoning` uses one castor, `IPEC` two, `CAST` and `CASTArc` two or more. `load_estimator` finds these and
plug-ins by name; the `Estimator` protocol says what a plug-in needs.
"""

from estimators.cast import CAST
from estimators.cast_arc import CASTArc
from estimators.dead_reckoning import DeadReckoning
from estimators.ipec import IPEC
from estimators.protocol import Estimator, Observation
from estimators.registry import EstimatorEntry, builtin_names, load_estimator

__all__ = [
    "CAST",
    "IPEC",
    "CASTArc",
    "DeadReckoning",
    "Estimator",
    "EstimatorEntry",
    "Observation",
    "builtin_names",
    "load_estimator",
]
