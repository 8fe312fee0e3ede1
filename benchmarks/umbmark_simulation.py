"""Doebbler's simulated UMBmark (IV.B), many parameter sets at once, under conditions that the paper leaves open.

The same draws as the tasks in `benchmarks.tasks.kinematic`: set k is their case k.
"""

from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np

from benchmarks.metrics import return_errors, umbmark
from benchmarks.progress import RunProgress, SilentProgress
from benchmarks.tasks.kinematic import (
    RUNS,
    Corners,
    Distribution,
    ParameterErrors,
    parameter_set,
    phase_source,
    rolled_square,
    true_robot,
)
from castor_envs.encoders import Encoders
from castor_envs.errors import InputError
from castor_envs.kinematics import Array, Geometry
from castor_envs.rolling import Rolled
from estimators.cast import CAST
from estimators.ipec import IPEC

Step = Literal["arc", "euler"]
WheelEncoders = Literal["honest", "lossy"]

#: Sets computed at a time: enough for numpy, few enough for the processor's cache.
CHUNK = 100


@dataclass(frozen=True)
class Conditions:
    """What the paper does not say, and what we take; the defaults are those of the kinematic tasks.

    - corners: "turn": on the spot, heading along the side, as UMBmark was made for; "fixed": the heading never changes
    - sets: the paper's number
    - runs: five each way, the paper's number and UMBmark's
    - distribution: "uniform": "up to 4 %" is twice Table I's mean error of a wheel's radius, as it is for a uniform
      one; "normal": the other usual choice, with the same mean absolute errors
    - encoders: "honest": counts are rounded from the angle itself, as counters do; "lossy": every increment between
      two samples is rounded and its remainder lost, as a simulation does that forgets to carry it
    - step: "arc": a castor's exact motion between two samples; "euler": straight along the heading at their end, as
      Borenstein's text has it
    """

    corners: Corners = "turn"
    sets: int = 1000
    runs: int = RUNS
    distribution: Distribution = "uniform"
    encoders: WheelEncoders = "honest"
    step: Step = "arc"

    def __post_init__(self) -> None:
        """Refuse what is not known."""
        kinds = {"corners": Corners, "distribution": Distribution, "encoders": WheelEncoders, "step": Step}
        for name, kind in kinds.items():
            value, known = getattr(self, name), get_args(kind)
            if value not in known:
                raise InputError(f"unknown {name} {value!r}; known: {', '.join(known)}")
        for name in ("sets", "runs"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} must be at least 1, got {getattr(self, name)}")


class MeanError(NamedTuple):
    """Mean of E_max,syst over the parameter sets and its standard error (NaN for one set), m."""

    mean: float
    standard_error: float


def mean_errors(
    conditions: Conditions, errors: ParameterErrors, progress: RunProgress | None = None
) -> dict[str, MeanError]:
    """Return the mean E_max,syst of IPEC-1, CAST-1 and CAST-0 over the parameter sets."""
    return {name: _mean(found) for name, found in errors_of_sets(conditions, errors, progress).items()}


def errors_of_sets(
    conditions: Conditions, errors: ParameterErrors, progress: RunProgress | None = None
) -> dict[str, Array]:
    """Return E_max,syst (sets,), m, of IPEC-1, CAST-1 and CAST-0; `progress` is told of every set (`advance`)."""
    progress = progress or SilentProgress()
    found = []
    for first in range(0, conditions.sets, CHUNK):
        cases = range(first, min(first + CHUNK, conditions.sets))
        found.append(_errors_of_cases(conditions, errors, cases))
        progress.advance(len(cases))
    return {name: np.concatenate([part[name] for part in found]) for name in found[0]}


def _mean(found: Array) -> MeanError:
    spread = float(np.std(found, ddof=1)) if len(found) > 1 else float("nan")
    return MeanError(float(np.mean(found)), spread / len(found) ** 0.5)


def _errors_of_cases(conditions: Conditions, errors: ParameterErrors, cases: range) -> dict[str, Array]:
    """Return E_max,syst (cases,) of every estimator."""
    real = Geometry.of(true_robot())
    described = Geometry.of([parameter_set(errors, case, conditions.distribution) for case in cases]).expand(1)
    # Clockwise runs first, as the tasks draw them: (directions, cases, runs, driven wheels).
    drawn = [Encoders.random_phase(real, phase_source(case), 2, conditions.runs) for case in cases]
    phases = np.stack(drawn, axis=1)
    returns: dict[str, list[Array]] = {}
    for direction, phase in zip(("cw", "ccw"), phases, strict=True):
        rolled = rolled_square(direction, conditions.corners)
        for name, end in _ends(rolled, real, described, phase, conditions).items():
            returns.setdefault(name, []).append(return_errors(rolled.pose[0], rolled.pose[-1], end))
    return {name: umbmark(cw, ccw).e_max_syst for name, (cw, ccw) in returns.items()}


def _ends(
    rolled: Rolled, real: Geometry, described: Geometry, phase: Array, conditions: Conditions
) -> dict[str, Array]:
    """Return where every estimator ends, (cases, runs, 3), on what the encoders say; phase (cases, runs, wheels)."""
    step = conditions.step
    estimators = {"IPEC-1": IPEC(1, step), "CAST-1": CAST(1, step), "CAST-0": CAST(0, step)}
    encoders = Encoders(real, phase)
    angle = rolled.wheel_angle[:, None, None, :]
    if conditions.encoders == "honest":
        wheel = np.diff(encoders.wheel(angle), axis=0)
    else:  # Every increment starts anew from a whole count, so no phase matters.
        wheel = Encoders(real, np.zeros(1)).wheel(np.diff(angle, axis=0))
    wheel = np.concatenate([np.zeros_like(wheel[:1]), wheel])
    pivot = encoders.pivot(rolled.castor_angle)[:, None, None, :]
    pose = np.broadcast_to(rolled.pose[0], (*phase.shape[:2], 3))
    ends = {}
    for name, estimator in estimators.items():
        estimator.reset(described, pose)
        for k, t in enumerate(rolled.t):
            ends[name] = estimator.update({"wheel": wheel[k], "pivot": pivot[k], "time": np.array([t])})
    return ends
