"""Calibration of any robot from any logs: the parameters that make all counts and reference poses most likely.

Gauss and Newton's method on the squares of `LogLikelihood`, in which the states of logs are eliminated. The noise of
slip and of reference poses is estimated as well: the squares of each kind are brought to their expected values
(variance components by restricted maximum likelihood; expected values from drawn residuals). Changes of parameters on
which the logs hold next to no information keep the robot file's numbers and are reported (`unseen`).

A reference may track any point of the body, with axes turned against the body's and a clock that is early or late. All
of this is fitted beside the robot's parameters, so that it does not bias them; and so is how far contacts creep
(`creep`). Where it has positions alone, the fit starts from odometry that is turned to follow them.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from castor_envs.errors import Declined, InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import wrap
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.creep import Creep
from estimators.calibration.maximum_likelihood.fit import (
    FARTHEST,
    State,
    changed_by_each,
    columns_of,
    fitted,
    scales_of,
)
from estimators.calibration.maximum_likelihood.newton_step import Solution, solved
from estimators.calibration.maximum_likelihood.noise import MOST
from estimators.calibration.maximum_likelihood.tracker import MOUNT_SEEN, mount_prior, straightened
from estimators.calibration.parameters import Parameter, geometry_with, parameters_of, robot_with, values_of
from estimators.likelihood.creep_prediction import LEAST_NOISE
from estimators.likelihood.log_likelihood import LogLikelihood, Noise
from estimators.likelihood.measurements.gyro_check import gyro_against_wheels

FARTHEST_POINT = 3.0
"""Largest distance of the tracked point from the robot's origin, as a multiple of the robot's size."""

CONTRADICTION = (
    "the logs cannot be made to fit robot {!r}{}; look for channels that are swapped, reversed or dead, counts per "
    "turn or dimensions that are wrong by a factor, reference poses not in m and rad, and poses that jump"
)

ON_CIRCLES = (
    "; or drive straights between turns: on circles alone, positions without headings hardly show how large wheels are "
    "and how far ahead the tracked point is"
)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Estimates of P parameters of a robot from logs.

    before, after (P,): SI. covariance (P, P): of `after`; unseen directions count as known. unseen (u, P): orthogonal
    changes, in parts of the parameters' scales, that the logs do not show; `after` keeps the robot file's numbers
    there. information (P, P): of all logs, in the same scales. noise: as found. mount (3,): the tracked point in B, m,
    and how its axes are turned, rad; mount_covariance (3, 3): that of `mount_prior` where the logs do not show it, as
    when all end where they began. clocks (logs, 2): the reference at t is the pose at t + clock[0] + clock[1] (t -
    t_0), in s and s/s. gyro (logs, 2): its bias at the log's start beyond the robot file's, rad/s, and its latency, s;
    NaN where a log has none. gyro_scale: by which it reads too much, as a part. poses: how many reference poses the
    logs hold; headings: how many of these have one. left: rms distance (m) between the reference and odometry, moved
    and turned as a whole to come nearest to it, before and, accounting for creep, after; None without a reference.
    creeps: whether contacts creep: not where wheels hardly slip, or creep is left out; creep_left_out: why; "" if it is
    not.
    """

    robot: RobotDescription
    parameters: tuple[Parameter, ...]
    before: Array
    after: Array
    covariance: Array
    unseen: Array
    information: Array
    noise: Noise
    mount: Array
    mount_covariance: Array
    clocks: Array
    gyro: Array
    gyro_scale: float
    poses: int
    headings: int
    left: tuple[float, float] | None
    creeps: bool
    creep_left_out: str

    @property
    def calibrated(self) -> RobotDescription:
        """The robot with the estimated parameters."""
        return robot_with(self.robot, self.parameters, self.after)

    @property
    def standard_errors(self) -> Array:
        """Standard errors of `after` (P,); 0 for parameters that keep their numbers."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    @property
    def mount_errors(self) -> Array:
        """Standard errors (3,) of the mount: m, m, rad."""
        return np.sqrt(np.diag(self.mount_covariance))

    @property
    def mount_seen(self) -> NDArray[np.bool_]:
        """Which numbers (3,) of the mount the logs show: with errors much smaller than those of the prior."""
        return self.mount_errors < MOUNT_SEEN * mount_prior(Geometry.of(self.robot))


@threadpool_limits.wrap(limits=1)  # of linear algebra: small matrices, for which more threads wait for each other
def calibrate(
    robot: RobotDescription,
    logs: Sequence[Log],
    *,
    pivots: bool = False,
    noise: Noise | None = None,
    names: Sequence[str] | None = None,
) -> Calibration:
    """Calibrate a robot from logs of any motion, with or without reference poses.

    pivots: whether the pivots of free castors are to be found too. noise: known sizes, of all that contacts slip; None:
    they are found, and creep of contacts with them. names: of the logs, for messages; "log 1" and so on if left out.
    Raises InputError, saying what to record instead, where the logs show nothing, contradict the robot beyond repair,
    or hold counts that jump.
    """
    if not logs:
        raise Declined("there is no log; record one")
    described, parameters = Geometry.of(robot), parameters_of(robot, pivots)
    scale, before = scales_of(parameters), values_of(described, parameters)
    names = names or [f"log {number}" for number in range(1, len(logs) + 1)]
    logs, turn = straightened(described, logs)
    models = [LogLikelihood(described, log, k) for k, log in enumerate(logs)]
    poses, headings = (sum(getattr(model, what) for model in models) for what in ("poses", "headings"))
    _check(robot, logs, names, parameters)
    with_gyro = any(model.gyro_steps for model in models)
    scale_of_gyro = robot.gyro.scale_tolerance if robot.gyro is not None and with_gyro else 0.0
    try:
        at, sizes, solution = fitted(
            models, described, parameters, before, noise, placed=mount_prior(described), gyro_scale=scale_of_gyro
        )
        left_out = ""
        if noise is None:
            at, sizes, solution, left_out = _with_creep(
                robot, logs, models, parameters, before, scale_of_gyro, at, sizes, solution
            )
        robot_with(robot, parameters, at.found)
    except (np.linalg.LinAlgError, ValueError):
        raise InputError(CONTRADICTION.format(robot.name, "")) from None
    strange = _strange(Noise() if noise else sizes, at.mount, described)  # noise that is known is no finding
    contradiction = CONTRADICTION + ("" if headings or not poses else ON_CIRCLES)
    if strange:
        raise InputError(contradiction.format(robot.name, f" but with {', '.join(strange)}"))
    if not solution.seen.any():
        raise Declined(_nothing(robot, poses))
    if solution.moved > 1.0:
        raise InputError(contradiction.format(robot.name, ""))
    way, variance = solution.way[:, solution.seen], 1 / solution.strength[solution.seen]
    return Calibration(
        robot=robot,
        parameters=parameters,
        before=before,
        after=at.found,
        covariance=(way * variance) @ way.T * np.outer(scale, scale),
        unseen=solution.way[:, ~solution.seen].T,
        information=(solution.way * solution.strength) @ solution.way.T,
        noise=sizes,
        mount=np.append(at.mount[:2], wrap(at.mount[2] + turn)),
        mount_covariance=solution.shared_covariance[-len(at.mount) :, -len(at.mount) :],
        clocks=at.clocks,
        gyro=np.array([_gyro(model, state, sizes) for model, state in zip(models, at.states, strict=True)]),
        gyro_scale=float(at.gyro_scale.sum()),
        poses=poses,
        headings=headings,
        left=_left(models, [geometry_with(described, parameters, v) for v in (before, at.found)], at),
        creeps=len(at.factors) > 0,
        creep_left_out=left_out,
    )


def _with_creep(
    robot: RobotDescription,
    logs: Sequence[Log],
    models: list[LogLikelihood],
    parameters: tuple[Parameter, ...],
    before: Array,
    gyro_scale: float,
    at: State,
    sizes: Noise,
    solution: Solution,
) -> tuple[State, Noise, Solution, str]:
    """Return the most likely state, sizes of noise and last step with creep, from those without it; and why creep is
    left out, "" if it is not, or wheels hardly slip."""
    slips = ((getattr(sizes, kind), getattr(LEAST_NOISE, kind)) for kind in ("along", "across", "turning"))
    rolling = all(size <= least for size, least in slips)  # creep would leave more slip
    if rolling or solution.moved > 1.0 or not solution.seen.any():
        return at, sizes, solution, ""
    try:
        creep = Creep(robot, parameters, models, logs, at.states)
    except InputError as error:
        return at, sizes, solution, str(error)
    described, start = Geometry.of(robot), (at._replace(factors=creep.expected), sizes)
    placed = mount_prior(described)
    left_out = "as predicted it does not fit the logs"
    with suppress(np.linalg.LinAlgError, ValueError):
        found = fitted(
            models,
            described,
            parameters,
            before,
            None,
            start,
            placed=placed,
            least=LEAST_NOISE,
            creep=creep,
            gyro_scale=gyro_scale,
        )
        robot_with(robot, parameters, found[0].found)
        if found[2].moved < 1.0 and found[2].seen.any():
            return *found, ""
        if found[2].moved < 1.0:
            left_out = "with it, these logs show none of the numbers; give reference poses"
    _without_creep(models)
    return at, sizes, solution, left_out


def _gyro(model: LogLikelihood, state: Array, noise: Noise) -> tuple[float, float]:
    """Return the bias at the log's start, rad/s, and the latency, s, of a log's gyro."""
    numbers = model.gyro_numbers(state, noise) if model.gyro_steps else np.full(2, np.nan)
    return float(numbers[0]), float(numbers[-1])


def _without_creep(models: Sequence[LogLikelihood]) -> None:
    for model in models:
        model.balance(None)
        model.expect(np.zeros((len(model.counts) - 1, len(model.rows))))


def information_of(
    robot: RobotDescription,
    parameters: tuple[Parameter, ...],
    logs: Sequence[Log],
    noise: Noise,
    creeps: bool = False,
) -> Array:
    """Return the information (P, P) that logs which fit a robot hold on its parameters, in parts of their scales, at
    known noise. creeps: see `Calibration`."""
    geometry, scale = Geometry.of(robot), scales_of(parameters)
    steps = changed_by_each(geometry, parameters, values_of(geometry, parameters))
    models = [LogLikelihood(geometry, log) for log in logs]
    states, columns = [model.start(geometry) for model in models], []
    deviations, seen = mount_prior(geometry), (np.zeros((len(scale), len(scale))), np.zeros(len(scale)))
    if creeps:
        creep = Creep(robot, parameters, models, logs, states)
        columns, seen = creep.predict(values_of(geometry, parameters), states), creep.disagreement(*steps, states)
        deviations = np.concatenate([creep.deviations, deviations])
    reductions = [
        model.reduce(
            *steps, state, np.zeros(2), np.zeros(3), noise, 0, columns_of(model, columns[n : n + 1], np.zeros(0))
        )
        for n, (model, state) in enumerate(zip(models, states, strict=True))
    ]
    solution = solved(reductions, seen, scale, 0 * deviations, deviations, np.zeros(len(scale)), FARTHEST)
    return (solution.way * solution.strength) @ solution.way.T


def _strange(noise: Noise, mount: Array, described: Geometry) -> list[str]:
    """Return findings that no sound robot with a sound reference shows, in words."""
    size = described.reach
    away, turned = float(np.hypot(*mount[:2])), abs(float(mount[2]))
    found = []
    if max(noise.along, noise.across) > MOST.along:
        found.append(f"slip of {1e3 * max(noise.along, noise.across):.3g} mm after 1 m")
    if noise.turning > MOST.turning:
        found.append(f"slip of {1e3 * noise.turning:.3g} mm where a wheel turns by 1 rad on the floor")
    if noise.position > MOST.position or noise.heading > MOST.heading:
        found.append(f"reference noise of {1e3 * noise.position:.3g} mm and {np.degrees(noise.heading):.3g} deg")
    if noise.gyro > MOST.gyro:
        found.append(f"gyro noise of {np.degrees(noise.gyro):.3g} deg/s")
    if away > FARTHEST_POINT * size or turned > np.pi / 4:
        found.append(f"a tracked point {1e3 * away:.3g} mm off the origin, turned by {np.degrees(turned):.3g} deg")
    return found


def _left(models: list[LogLikelihood], geometries: list[Geometry], at: State) -> tuple[float, float] | None:
    """Return the rms distance between odometry and reference by each of two geometries; None without reference."""
    tracked = [fit for fit in zip(models, at.clocks, strict=True) if fit[0].poses]
    if not tracked:
        return None

    def rms(geometry: Geometry) -> float:
        off = np.concatenate([model.errors(geometry, clock, at.mount) for model, clock in tracked])[:, :2]
        return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))

    before, after = geometries
    left = rms(after)
    _without_creep(models)  # plain odometry by the robot file
    return rms(before), left


def _check(
    robot: RobotDescription, logs: Sequence[Log], names: Sequence[str], parameters: tuple[Parameter, ...]
) -> None:
    if not parameters:
        raise Declined(f"robot {robot.name!r} has no encoder whose numbers could be found")
    for name, log in zip(names, logs, strict=True):
        check = None if robot.gyro is None else gyro_against_wheels(robot, log)
        if check is not None and check.mistaken:
            raise InputError(f"{name}: gyro_z {check.verdict}")
    turned = np.max([np.ptp(log.wheel, axis=0) for log in logs], axis=0)
    if not turned.any():
        raise InputError("no wheel turned in any log; record a drive")
    for k in np.flatnonzero(turned == 0)[:1]:
        name = robot.wheel_names[robot.driven_wheels[k]]
        raise InputError(
            f"wheel {name} never counts while others do; mend its encoder, or record a drive in which it turns"
        )


def _nothing(robot: RobotDescription, poses: int) -> str:
    if poses:
        return "the logs show none of the robot's numbers; drive at least a metre, and turn, between reference poses"
    return (
        f"without reference poses nothing is observable of robot {robot.name!r}: its encoders cannot contradict each "
        "other, or did not move enough to; give logs with ref_x, ref_y and ref_psi, at least at start and end, or with "
        "ref_x and ref_y on the way"
    )
