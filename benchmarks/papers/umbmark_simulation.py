"""Doebbler's simulated UMBmark (IV.B), many parameter sets at once, under conditions that the paper leaves open.

The same draws as the tasks in `benchmarks.tasks.kinematic`: with seed 0, set k is their case k.
"""

from dataclasses import dataclass, field
from functools import cache
from typing import Literal, NamedTuple, get_args

import numpy as np

from benchmarks.papers.assumptions import Assumptions
from benchmarks.progress import RunProgress, SilentProgress
from benchmarks.scoring.square_metrics import return_errors, umbmark
from benchmarks.tasks.kinematic import ParameterErrors
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.kinematics import Geometry
from castor_envs.motion.rolling import Rolled, roll
from castor_envs.motion.trajectories import Direction, Trajectory
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.robot import RobotDescription
from estimators.robots.cast import CAST
from estimators.robots.ipec import IPEC

Step = Literal["arc", "euler", "euler-axle"]
WheelEncoders = Literal["honest", "lossy"]

#: Runs each way computed at a time: enough for numpy, few enough for the processor's cache.
CHUNK = 500


@dataclass(frozen=True)
class Conditions:
    """One simulation; the defaults are those of the kinematic tasks.

    - assumed: what the paper does not say, and what we take
    - sets: the paper's number
    - encoders: "honest": counts are rounded from the angle itself, as counters do; "lossy": every increment between
      two samples is rounded and its remainder lost, as a simulation does that forgets to carry it
    - step: "arc": a castor's exact motion between two samples; "euler": straight along the heading at their end, as
      Borenstein's text has it, and the pivot's swing about the axle across that heading too; "euler-axle": the axle
      as in "euler", the swing exact
    """

    assumed: Assumptions = field(default_factory=Assumptions)
    sets: int = 1000
    encoders: WheelEncoders = "honest"
    step: Step = "arc"

    def __post_init__(self) -> None:
        """Refuse what is not known."""
        kinds = {"encoders": WheelEncoders, "step": Step}
        for name, kind in kinds.items():
            value, known = getattr(self, name), get_args(kind)
            if value not in known:
                raise InputError(f"unknown {name} {value!r}; known: {', '.join(known)}")
        if self.sets < 1:
            raise InputError(f"sets must be at least 1, got {self.sets}")


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
    chunk = max(1, CHUNK // conditions.assumed.runs)
    for first in range(0, conditions.sets, chunk):
        cases = range(first, min(first + chunk, conditions.sets))
        found.append(_errors_of_cases(conditions, errors, cases))
        progress.advance(len(cases))
    return {name: np.concatenate([part[name] for part in found]) for name in found[0]}


def _mean(found: Array) -> MeanError:
    spread = float(np.std(found, ddof=1)) if len(found) > 1 else float("nan")
    return MeanError(float(np.mean(found)), spread / len(found) ** 0.5)


def _errors_of_cases(conditions: Conditions, errors: ParameterErrors, cases: range) -> dict[str, Array]:
    """Return E_max,syst (cases,) of every estimator."""
    assumed = conditions.assumed
    real = Geometry.of(assumed.base_of_three)
    files = [errors.applied(assumed.base, _random(case, 0, assumed), assumed.distribution) for case in cases]
    described = Geometry.of(files).expand(1)
    # Clockwise runs first, as the tasks draw them: (directions, cases, runs, driven wheels).
    drawn = [Encoders.random_phase(real, _random(case, 1, assumed), 2, assumed.runs) for case in cases]
    phases = np.stack(drawn, axis=1)
    returns: dict[str, list[Array]] = {}
    for direction, phase in zip(("cw", "ccw"), phases, strict=True):
        rolled = rolled_square(assumed, direction)
        for name, end in _ends(rolled, real, described, phase, conditions).items():
            returns.setdefault(name, []).append(return_errors(rolled.pose[0], rolled.pose[-1], end))
    return {name: umbmark(cw, ccw).e_max_syst for name, (cw, ccw) in returns.items()}


def _random(case: int, stream: int, assumed: Assumptions) -> np.random.Generator:
    """Return what draws parameter errors (stream 0) or phases (1); a seed of 0 is as in the tasks, which have none."""
    return np.random.default_rng([case, stream, assumed.seed])


def rolled_square(assumed: Assumptions, direction: Direction) -> Rolled:
    """Return what the true robot's joints do on the square; raises InputError if its motors are too slow for it."""
    base = assumed.base_of_three
    rolled = _rolled(base, assumed.square(direction))
    needed = float(np.max(np.abs(np.diff(rolled.wheel_angle, axis=0)))) / base.sample_period
    if needed > base.max_wheel_speed:
        raise InputError(
            f"robot {assumed.robot}: its wheels reach {base.max_wheel_speed:g} rad/s, and the square asks for "
            f"{needed:.3g}; choose a lower speed or turn rate, or a larger corner radius"
        )
    return rolled


@cache
def _rolled(robot: RobotDescription, square: Trajectory) -> Rolled:
    """Return what a robot's joints do, once for all parameter sets and tables."""
    return roll(robot, square)


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
