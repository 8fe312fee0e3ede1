"""Doebbler's simulations, all parameter sets at once, under conditions that the paper does not specify.

UMBmark (IV.B, Table II): the same draws as the tasks in `benchmarks.tasks.kinematic`: with seed 0, set k is their case
k. Calibration by pivoting (Table I): the base turns about each castor's pivot, both ways, in steady rolling: the angles
at which castors trail and the distances that wheels roll are known in closed form, and only the counts are rounded.
What the paper does not specify, such as how far the base turns and how well the distance D between pivots is known, is
in `benchmarks.papers.assumptions`.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import cache, partial
from typing import Literal, NamedTuple, get_args

import numpy as np

from benchmarks.papers.assumptions import Assumptions
from benchmarks.progress import RunProgress, SilentProgress
from benchmarks.scoring.square_metrics import return_errors, umbmark
from benchmarks.tasks.kinematic import NORMAL, UNCALIBRATED_BETA, ParameterErrors
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import Rolled, roll
from castor_envs.motion.trajectories import Direction, Trajectory
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.pivoting import CastorParameters, from_turns
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
    conditions: Conditions, errors: ParameterErrors, progress: RunProgress | None = None, at_a_time: int = CHUNK
) -> dict[str, Array]:
    """Return E_max,syst (sets,), m, of IPEC-1, CAST-1 and CAST-0; reports every set to `progress` (`advance`).

    at_a_time: runs each way that are computed together, which changes nothing but the time and memory it takes.
    """
    progress = progress or SilentProgress()
    found = []
    chunk = max(1, at_a_time // conditions.assumed.runs)
    chunks = [range(first, min(first + chunk, conditions.sets)) for first in range(0, conditions.sets, chunk)]
    # Estimators are compiled code, which threads run side by side.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for cases, errors_of in zip(
            chunks, pool.map(partial(_errors_of_cases, conditions, errors), chunks), strict=True
        ):
            found.append(errors_of)
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
    # Lossy encoders start every increment anew from a whole count: no phase matters, and all runs are the same.
    runs = assumed.runs if conditions.encoders == "honest" else 1
    drawn = [Encoders.random_phase(real, _random(case, 1, assumed), 2, runs) for case in cases]
    phases = np.stack(drawn, axis=1)
    returns: dict[str, list[Array]] = {}
    for direction, phase in zip(("cw", "ccw"), phases, strict=True):
        rolled = rolled_square(assumed, direction)
        for name, end in _ends(rolled, real, described, phase, conditions).items():
            returns.setdefault(name, []).append(return_errors(rolled.pose[0], rolled.pose[-1], end))
    return {name: umbmark(cw, ccw).e_max_syst for name, (cw, ccw) in returns.items()}


def _random(case: int, stream: int, assumed: Assumptions) -> np.random.Generator:
    """Return the generator of parameter errors (stream 0) or phases (1); seed 0 draws as the tasks do."""
    return np.random.default_rng([case, stream, assumed.seed])


def rolled_square(assumed: Assumptions, direction: Direction) -> Rolled:
    """Return how the true robot's joints move on the square; raises InputError if its motors are too slow for it."""
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
    """Return the motion of a robot's joints, computed once for all parameter sets and tables."""
    return roll(robot, square)


def _ends(
    rolled: Rolled, real: Geometry, described: Geometry, phase: Array, conditions: Conditions
) -> dict[str, Array]:
    """Return every estimator's last pose (cases, runs, 3), from encoder readings; phase (cases, runs, wheels)."""
    step = conditions.step
    estimators = {"IPEC-1": IPEC(1, step), "CAST-1": CAST(1, step), "CAST-0": CAST(0, step)}
    encoders = Encoders(real, phase)
    angle = rolled.wheel_angle[:, None, None, :]
    if conditions.encoders == "honest":
        wheel = np.diff(encoders.wheel(angle), axis=0)
    else:
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


@dataclass(frozen=True)
class ErrorsLeft:
    """Mean absolute errors over all sets and castors, each with its standard error: relative, of beta in rad."""

    offset: tuple[float, float]
    pivot_zero: tuple[float, float]
    radius: tuple[float, float]
    half_track: tuple[float, float]


def errors_left(sets: int, assumed: Assumptions | None = None, exact: bool = False) -> tuple[ErrorsLeft, ErrorsLeft]:
    """Return the errors before and after calibration, over `sets` robots.

    exact: D is known exactly; else with an error drawn for each pair of pivots. Raises InputError where a castor's
    offset is not below the distance between pivots.
    """
    assumed = assumed or Assumptions()
    random, robot = np.random.default_rng(assumed.seed), assumed.base
    pivot = np.array([castor.pivot for castor in robot.castors])
    n = len(pivot)

    def off(half_width: float, *shape: int) -> Array:
        normal = assumed.distribution == "normal"
        number = random.normal(0, NORMAL, (sets, *shape)) if normal else random.uniform(-1, 1, (sets, *shape))
        return half_width * number

    def drawn(nominal: Array, half_width: float) -> Array:
        return nominal * (1 + off(half_width, *nominal.shape))

    nominal_offset = np.array([castor.offset for castor in robot.castors])
    nominal_radius = np.array([[wheel.radius for wheel in castor.wheels] for castor in robot.castors])
    nominal_track = np.array([[abs(wheel.lateral) for wheel in castor.wheels] for castor in robot.castors])
    offset, radius = drawn(nominal_offset, UNCALIBRATED_BETA.offset), drawn(nominal_radius, UNCALIBRATED_BETA.radius)
    track, zero = drawn(nominal_track, UNCALIBRATED_BETA.lateral), off(UNCALIBRATED_BETA.pivot_zero, n)
    upper = np.triu(off(0.0 if exact else 2 * (assumed.distance_error / 100), n, n))
    known = 1 + upper + np.swapaxes(upper, 1, 2)
    per_pivot = np.array([castor.pivot_counts_per_rev for castor in robot.castors], dtype=float) / (2 * np.pi)
    per_wheel = np.array([[w.counts_per_rev for w in c.wheels] for c in robot.castors], dtype=float) / (2 * np.pi)
    angle = 2 * np.pi * assumed.turns

    found = []
    for held in range(n):
        free = [i for i in range(n) if i != held]
        away = pivot[free] - pivot[held]
        distance, perp = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0]) - np.pi / 2
        if np.any(offset[:, free] >= distance):
            raise InputError(f"robot {assumed.robot}: an offset is not below the distance from pivot {held + 1}")
        path = np.arcsin(offset[:, free] / distance)
        arm = (distance * np.cos(path))[..., None]
        gammas, rolled = [], []
        for way in (1.0, -1.0):  # clockwise, counter-clockwise
            theta = perp + path if way > 0 else perp + np.pi - path
            gammas.append(np.round((theta + zero[:, free]) * per_pivot[free]) / per_pivot[free])
            turned = angle * (arm + way * track[:, free] * [1.0, -1.0]) / radius[:, free]
            phase = random.uniform(size=turned.shape)
            rolled.append((np.round(turned * per_wheel[free] + phase) - np.round(phase)) / per_wheel[free])
        turn = np.full((sets, len(free)), angle)
        calibrated = from_turns(known[:, held, free] * distance, perp, tuple(gammas), (turn, turn), tuple(rolled))
        found.append((free, calibrated))

    def mean_of(part: str, shape: tuple[int, ...]) -> Array:
        total = np.zeros((sets, *shape))
        for free, calibrated in found:
            total[:, free] += getattr(calibrated, part)
        return total / (n - 1)

    def summed(error: Array) -> tuple[float, float]:
        by_set = np.abs(error).reshape(sets, -1).mean(axis=1)
        return float(by_set.mean()), float(by_set.std(ddof=1) / np.sqrt(sets))

    truth = (offset, zero, radius, track)
    nominal = (nominal_offset, np.zeros(n), nominal_radius, nominal_track)
    shapes = ((n,), (n,), (n, 2), (n, 2))
    estimate = [mean_of(part, shape) for part, shape in zip(CastorParameters._fields, shapes, strict=True)]
    scale = (offset, 1.0, radius, track)
    before, after = (
        ErrorsLeft(*(summed((g - t) / s) for g, t, s in zip(guess, truth, scale, strict=True)))
        for guess in (nominal, estimate)
    )
    return before, after
