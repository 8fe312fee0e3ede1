"""Calibration of any robot from any logs: the parameters that make all counts and reference poses most likely.

Gauss and Newton's method on the squares of `log_likelihood`, in which the states of logs are eliminated. The noise of
slip and of reference poses is estimated as well: the squares of each kind are brought to their expected values
(variance components by restricted maximum likelihood; expected values from drawn residuals). Changes of parameters on
which the logs hold next to no information keep the robot file's numbers and are reported (`unseen`).

A reference may track any point of the body, with axes turned against the body's and a clock that is early or late. All
of this is fitted beside the robot's parameters, so that it does not bias them; and so is how far contacts creep
(`creep`).
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from castor_envs.errors import Declined, InputError
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.mounting import turn_of_tracker
from castor_envs.geometry.se2 import wrap
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.creep import Creep
from estimators.calibration.parameters import Parameter, geometry_with, parameters_of, robot_with, values_of
from estimators.likelihood.creep_prediction import LEAST_NOISE
from estimators.likelihood.log_likelihood import ExtraColumns, Leftover, LogLikelihood, Noise, Reduced, moved_along

UNSEEN = 0.03
"""A change of the parameters is unseen if its standard error is larger: as a part of each length, or in rad. Rounding
errors are not quite random, and estimates of hardly seen changes would consist of them."""

MOUNT = np.array([1.0, 1.0, 1.0])
"""m, m, rad: prior standard deviations of the tracked point and its heading; wide enough not to matter."""

TURNED = 0.25
"""rad: usual angle between a tracker's axes and the body's, which should be parallel."""

MOUNT_SEEN = 0.5
"""A number of the mount is seen if its standard error is less than this part of its prior standard deviation."""

LEAST = Noise(along=1e-5, across=1e-5, position=1e-5, heading=1e-5)
ROUNDS, PROBES = 60, 4
CONVERGED, NOISE_CONVERGED, NOISE_CONVERGED_BY_ERROR = 0.01, 0.02, 0.1
"""Converged when no parameter moves by more than the first part of its standard error (with creep, which is predicted
less well, the third), and no noise changes by more than the second part of itself or, where few residuals determine it,
the third part of its standard error."""

FARTHEST = 0.2
"""Largest change of a parameter in a step, as a part of its scale."""

FARTHEST_POINT = 3.0
"""Largest distance of the tracked point from the robot's origin, as a multiple of the robot's size."""

LEAST_FREEDOM = 1e-3
"""Least degrees of freedom of residuals with which noise is estimated."""

SHORTEST, SLACK = 1 / 64, 0.01
"""Least part of a step that is taken; and the increase of the sum of squares that is accepted, as rounding may cause
it."""

WARM_UP = 2
"""Rounds in which states and noise converge before parameters move."""

CHANGE = 1e-6
"""Step for numerical derivatives, as a part of a parameter's scale: rolling is linear in lengths, so only rounding
limits it."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Estimates of P parameters of a robot from logs.

    before, after (P,): SI. covariance (P, P): of `after`; unseen directions count as known. unseen (u, P): orthogonal
    changes, in parts of the parameters' scales, that the logs do not show; `after` keeps the robot file's numbers
    there. information (P, P): of all logs, in the same scales. noise: as found. mount (3,): the tracked point in B, m,
    and how its axes are turned, rad; mount_covariance (3, 3): that of `mount_prior` where the logs do not show it, as
    when all end where they began. clocks (logs, 2): the reference at t is the pose at t + clock[0] + clock[1] (t -
    t_0), in s and s/s. poses: how many reference poses the logs hold. left: rms distance (m) between odometry, which
    starts at the most likely pose at a log's first reference pose, and the reference, before and, accounting for creep,
    after; None without a reference. creeps: whether contacts creep: not where wheels hardly slip, or creep is left out;
    creep_left_out: why; "" if it is not.
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
    poses: int
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


class State(NamedTuple):
    """All unknowns: parameters (P,), mount (3,), the state and clock of each log, and the factors of creep (1 + rows,);
    without creep (0,)."""

    found: Array
    mount: Array
    states: list[Array]
    clocks: Array
    factors: Array = np.zeros(0)


@threadpool_limits.wrap(limits=1)  # of linear algebra: small matrices, for which more threads wait for each other
def calibrate(
    robot: RobotDescription, logs: Sequence[Log], *, pivots: bool = False, noise: Noise | None = None
) -> Calibration:
    """Calibrate a robot from logs of any motion, with or without reference poses.

    pivots: whether the pivots of free castors are to be found too. noise: known sizes, of all that contacts slip; None:
    they are found, and creep of contacts with them.
    Raises InputError, saying what to record instead, where the logs show nothing, contradict the robot beyond repair,
    or hold counts that jump.
    """
    if not logs:
        raise Declined("there is no log; record one")
    described, parameters = Geometry.of(robot), parameters_of(robot, pivots)
    scale, before = _scales(parameters), values_of(described, parameters)
    logs, turn = straightened(described, logs)
    models = [LogLikelihood(described, log, k) for k, log in enumerate(logs)]
    poses = sum(model.poses for model in models)
    _check(robot, logs, parameters)
    try:
        at, sizes, solution = fitted(models, described, parameters, before, noise, placed=mount_prior(described))
        left_out = ""
        if noise is None:
            at, sizes, solution, left_out = _with_creep(robot, logs, models, parameters, before, at, sizes, solution)
        robot_with(robot, parameters, at.found)
    except (np.linalg.LinAlgError, ValueError):
        raise InputError(CONTRADICTION.format(robot.name, "")) from None
    strange = _strange(sizes, at.mount, described)
    if strange:
        raise InputError(CONTRADICTION.format(robot.name, f" but with {', '.join(strange)}"))
    if not solution.seen.any():
        raise Declined(_nothing(robot, poses))
    if solution.moved > 1.0:
        raise InputError(CONTRADICTION.format(robot.name, ""))
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
        poses=poses,
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
    at: State,
    sizes: Noise,
    solution: "_Solution",
) -> tuple[State, Noise, "_Solution", str]:
    """Return the most likely state, sizes of noise and last step with creep, from those without it; and why creep is
    left out, "" if it is not, or wheels hardly slip."""
    rolling = sizes.along <= LEAST_NOISE.along and sizes.across <= LEAST_NOISE.across  # creep would leave more slip
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
            models, described, parameters, before, None, start, placed=placed, least=LEAST_NOISE, creep=creep
        )
        robot_with(robot, parameters, found[0].found)
        if found[2].moved < 1.0 and found[2].seen.any():
            return *found, ""
        if found[2].moved < 1.0:
            left_out = "with it, these logs show none of the numbers; give reference poses"
    _without_creep(models)
    return at, sizes, solution, left_out


def _without_creep(models: Sequence[LogLikelihood]) -> None:
    for model in models:
        model.balance(None)
        model.expect(np.zeros((len(model.counts) - 1, len(model.rows))))


def straightened(described: Geometry, logs: Sequence[Log]) -> tuple[list[Log], float]:
    """Return logs with the axes of their tracker nearly along the body's, and the angle by which they were turned.

    For a small angle the logs stay as they are: it is fitted with all other unknowns. turn: rad, to the left.
    """
    models = [LogLikelihood(described, log) for log in logs]
    turn = turn_of_tracker([model.ways(described) for model in models], _size(described))
    return [_turned(log, -turn) if turn else log for log in logs], turn


def _turned(log: Log, by: float) -> Log:
    return log if log.reference is None else replace(log, reference=log.reference + np.array([0.0, 0.0, by]))


def fitted(
    models: list[LogLikelihood],
    described: Geometry,
    parameters: tuple[Parameter, ...],
    before: Array,
    noise: Noise | None,
    start: tuple[State, Noise] | None = None,
    rounds: int = ROUNDS,
    placed: Array = MOUNT,
    least: Noise = LEAST,
    creep: Creep | None = None,
    probes: int = PROBES,
) -> tuple[State, Noise, "_Solution"]:
    """Return the most likely state, the sizes of noise, and the last step, which is near 0 on convergence.

    noise: known sizes; None: they are fitted. start: state and noise of the same logs to begin with; None: state by
    counts. rounds: most steps. placed (3,): prior standard deviations of the mount. least: lower bounds of noise.
    creep: of contacts, whose factors are fitted too; None: models expect what they are told to. probes: number of draws
    of residuals (`LogLikelihood.reduce`) by which noise is fitted.
    """
    scale = _scales(parameters)
    if afresh := start is None:
        states = [model.start(described) for model in models]
        start = State(before, np.zeros(3), states, np.zeros((len(models), 2))), Noise()
    at, sizes = start
    sizes, probes = (sizes, probes) if noise is None else (noise, 0)
    warm_up = WARM_UP if parameters and afresh else 0
    k = 0
    while True:
        steps = _changed(described, parameters, at.found)
        columns, seen = [], (np.zeros((len(scale), len(scale))), np.zeros(len(scale)))
        if creep:
            columns, seen = creep.predict(at.found, at.states), creep.disagreement(*steps, at.states)
            creep.expect(columns, at.factors)
        reductions = [
            model.reduce(*steps, state, clock, at.mount, sizes, probes, _columns(model, columns[n : n + 1]))
            for n, (model, state, clock) in enumerate(zip(models, at.states, at.clocks, strict=True))
        ]
        deviations = np.concatenate([creep.deviations, placed]) if creep else placed
        expected = np.concatenate([creep.expected, np.zeros(3)]) if creep else np.zeros(3)
        shared = np.concatenate([at.factors, at.mount]) - expected
        farthest, converged = FARTHEST if k >= warm_up else 0.0, NOISE_CONVERGED_BY_ERROR if creep else CONVERGED
        solution = _solve(reductions, seen, scale, shared, deviations, (at.found - before) / scale, farthest)

        def squares(
            state: State,
            columns: list[Array] = columns,
            seen: tuple[Array, Array] = seen,
            found: Array = at.found,
            prior: tuple[Array, Array] = (expected, deviations),
        ) -> float:
            if creep:
                creep.expect(columns, state.factors)
            change = (state.found - found) / scale
            off = (np.concatenate([state.factors, state.mount]) - prior[0]) / prior[1]
            return float(off @ off + change @ seen[0] @ change - 2 * change @ seen[1])

        at, left, part = _stepped(reductions, described, parameters, at, solution, squares)
        last, sizes = sizes, sizes if noise else resized(sizes, left, least)
        done = k > warm_up and part == 1 and solution.moved < converged and _same(sizes, last, left)
        lost = not np.isfinite(at.found).all() or np.any(np.abs(at.found - before) > 10 * scale)
        if done or lost or (len(scale) and not solution.seen.any()) or k + 1 == rounds:
            return at, sizes, solution._replace(moved=np.inf) if lost else solution
        del reductions  # they hold many times the memory of the logs
        k += 1


def _changed(described: Geometry, parameters: tuple[Parameter, ...], values: Array) -> tuple[Geometry, Geometry, Array]:
    """Return the geometry with parameters of these values, geometries in each of which one is larger, and by how
    much."""
    change = CHANGE * _scales(parameters)
    return (
        geometry_with(described, parameters, values),
        geometry_with(described, parameters, values + np.diag(change)),
        change,
    )


def _columns(model: LogLikelihood, slips: list[Array]) -> ExtraColumns | None:
    """Return the columns of a log's slips (K - 1, rows, R), if there are any."""
    return ExtraColumns(np.zeros((*model.counts.shape, 0)), tuple(slips)) if slips else None


def _same(sizes: Noise, last: Noise, left: list[Leftover]) -> bool:
    """Whether each noise changed by no more than `NOISE_CONVERGED` of itself, or `NOISE_CONVERGED_BY_ERROR` of its
    standard error."""
    for name, size in asdict(sizes).items():
        freedom = sum(leftover.expected.get(name, 0.0) for leftover in left)
        error = 1 / np.sqrt(2 * max(freedom, LEAST_FREEDOM))
        if abs(size / getattr(last, name) - 1) > max(NOISE_CONVERGED, NOISE_CONVERGED_BY_ERROR * error):
            return False
    return True


def _stepped(
    reductions: list[Reduced],
    described: Geometry,
    parameters: tuple[Parameter, ...],
    at: State,
    solution: "_Solution",
    more_squares: Callable[[State], float],
) -> tuple[State, list[Leftover], float]:
    """Return the state after a step, the residuals of each log, and the part of the step that was taken.
    more_squares: makes the models expect the slips of a state, and returns its squares but for those of `reductions`.

    All unknowns are moved by the whole step, or half of it, and so on, until the exact (not linearised) sum of squares
    is no larger than before, with the weights of the state before. Each time, poses are moved in the world and, if that
    fails, relative to each other (`moved_along`).
    """
    scale, first = _scales(parameters), len(at.factors)
    moved_by = np.concatenate([scale[:, None] * solution.step, solution.shared])

    def squares(state: State) -> float:
        more, geometry = more_squares(state), geometry_with(described, parameters, state.found)
        logs = zip(reductions, state.states, state.clocks, strict=True)
        return sum(reduced.squares(geometry, path, clock, state.mount) for reduced, path, clock in logs) + more

    def part_of(part: float, moved: Callable[[Array, Array], Array]) -> State:
        return State(
            at.found + part * scale * solution.step[:, 0],
            at.mount + part * solution.shared[first:, 0],
            [moved(old, part * (new - old)) for old, (new, _, _) in zip(at.states, full_step, strict=True)],
            at.clocks + part * (np.array([clock for _, clock, _ in full_step]) - at.clocks),
            at.factors + part * solution.shared[:first, 0],
        )

    full_step = [reduced.finish(moved_by) for reduced in reductions]
    largest, part = squares(at) + SLACK, 1.0
    while True:
        for moved in (np.add, moved_along):
            after = part_of(part, moved)
            if squares(after) <= largest or part <= SHORTEST:
                left = full_step if part == 1 else [reduced.finish(moved_by, part) for reduced in reductions]
                return after, [leftover for _, _, leftover in left], part
        part /= 2


def _scales(parameters: tuple[Parameter, ...]) -> Array:
    return np.array([p.scale for p in parameters])


def information_of(
    robot: RobotDescription,
    parameters: tuple[Parameter, ...],
    logs: Sequence[Log],
    noise: Noise,
    creeps: bool = False,
) -> Array:
    """Return the information (P, P) that logs which fit a robot hold on its parameters, in parts of their scales, at
    known noise. creeps: see `Calibration`."""
    geometry, scale = Geometry.of(robot), _scales(parameters)
    steps = _changed(geometry, parameters, values_of(geometry, parameters))
    models = [LogLikelihood(geometry, log) for log in logs]
    states, columns = [model.start(geometry) for model in models], []
    deviations, seen = mount_prior(geometry), (np.zeros((len(scale), len(scale))), np.zeros(len(scale)))
    if creeps:
        creep = Creep(robot, parameters, models, logs, states)
        columns, seen = creep.predict(values_of(geometry, parameters), states), creep.disagreement(*steps, states)
        deviations = np.concatenate([creep.deviations, deviations])
    reductions = [
        model.reduce(*steps, state, np.zeros(2), np.zeros(3), noise, 0, _columns(model, columns[n : n + 1]))
        for n, (model, state) in enumerate(zip(models, states, strict=True))
    ]
    solution = _solve(reductions, seen, scale, 0 * deviations, deviations, np.zeros(len(scale)), FARTHEST)
    return (solution.way * solution.strength) @ solution.way.T


CONTRADICTION = (
    "the logs cannot be made to fit robot {!r}{}; look for channels that are swapped, reversed or dead, counts per "
    "turn or dimensions that are wrong by a factor, reference poses not in m and rad, and poses that jump"
)

MOST = Noise(along=0.015, across=0.015, position=0.15, heading=0.3)
"""Largest noise of a sound robot and reference: more has another cause."""


def mount_prior(described: Geometry) -> Array:
    """Return the prior standard deviations (3,), m, m, rad, of a tracked point."""
    size = _size(described)
    return np.array([size, size, TURNED])


def _size(described: Geometry) -> float:
    """Return the largest distance of a robot's wheels from its origin, m."""
    return float(np.max(np.hypot(*described.pivot.T) + described.offset) + np.max(np.abs(described.lateral)))


def _strange(noise: Noise, mount: Array, described: Geometry) -> list[str]:
    """Return findings that no sound robot with a sound reference shows, in words."""
    size = _size(described)
    away, turned = float(np.hypot(*mount[:2])), abs(float(mount[2]))
    found = []
    if max(noise.along, noise.across) > MOST.along:
        found.append(f"slip of {1e3 * max(noise.along, noise.across):.3g} mm after 1 m")
    if noise.position > MOST.position or noise.heading > MOST.heading:
        found.append(f"reference noise of {1e3 * noise.position:.3g} mm and {np.degrees(noise.heading):.3g} deg")
    if away > FARTHEST_POINT * size or turned > np.pi / 4:
        found.append(f"a tracked point {1e3 * away:.3g} mm off the origin, turned by {np.degrees(turned):.3g} deg")
    return found


class _Solution(NamedTuple):
    """step (P, 1 + probes), in scales; shared (n, 1 + probes) and its covariance (n, n): of the factors of creep, if it
    is fitted, and the mount; moved: in standard errors.

    strength (P,), way (P, P): eigenvalues and eigenvectors (columns) of the information, in scales; seen (P,): which
    directions the logs show.
    """

    step: Array
    shared: Array
    shared_covariance: Array
    moved: float
    strength: Array
    way: Array
    seen: NDArray[np.bool_]


def _solve(
    reductions: list[Reduced],
    seen_apart: tuple[Array, Array],
    scale: Array,
    shared: Array,
    deviations: Array,
    away: Array,
    farthest: float,
) -> _Solution:
    """Return the next step; seen_apart: further information (P, P) and score (P,), in scales; shared (n,): numbers of
    `_Solution.shared` beyond their prior means, with prior standard deviations; away (P,): current deviation from the
    robot file, in scales."""
    information = np.sum([reduced.information for reduced in reductions], axis=0)
    gradient = np.sum([reduced.gradient for reduced in reductions], axis=0)
    n = len(scale)
    information[:n, :n] += seen_apart[0] / np.outer(scale, scale)
    gradient[:n, 0] -= seen_apart[1] / scale
    information[n:, n:] += np.diag(deviations**-2.0)
    gradient[n:, 0] += shared / deviations**2
    solved = np.linalg.solve(information[n:, n:], np.column_stack([information[n:, :n], gradient[n:]]))
    eliminated = np.outer(scale, scale) * (information[:n, :n] - information[:n, n:] @ solved[:, :n])
    slope = scale[:, None] * (gradient[:n] - information[:n, n:] @ solved[:, n:])
    strength, way = np.linalg.eigh(eliminated)
    seen = strength > UNSEEN**-2
    along = -(way.T @ slope) / np.where(seen, strength, np.inf)[:, None]
    along[~seen, 0] = -(way.T @ away)[~seen]
    along[:, 0] *= min(1.0, farthest / max(float(np.abs(way @ along[:, 0]).max(initial=0.0)), 1e-12))
    moved = float(np.sqrt(np.sum(along[seen, 0] ** 2 * strength[seen])))
    step = way @ along
    set_by = -(solved[:, n:] + solved[:, :n] @ (scale[:, None] * step))
    by_seen = solved[:, :n] @ (scale[:, None] * way[:, seen])
    covariance = np.linalg.inv(information[n:, n:]) + (by_seen / strength[seen]) @ by_seen.T
    return _Solution(step, set_by, covariance, moved, strength, way, seen)


def resized(sizes: Noise, left: list[Leftover], least: Noise = LEAST) -> Noise:
    """Return the sizes of noise, none below `least`, at which the sums of squares equal their expected values."""
    better = asdict(sizes)
    for name, size in asdict(sizes).items():
        squares, expected = (
            sum(getattr(leftover, part).get(name, 0.0) for leftover in left) for part in Leftover._fields
        )
        if expected > 0:
            ratio = squares / expected
            change = ratio if ratio < 0.25 else np.sqrt(ratio)  # There is hardly any: go on towards none faster.
            better[name] = max(size * float(np.clip(change, 0.05, 5.0)), getattr(least, name))
    return Noise(**better)


def _left(models: list[LogLikelihood], geometries: list[Geometry], at: State) -> tuple[float, float] | None:
    """Return the rms distance between odometry and reference by each of two geometries; None without reference."""
    tracked = [fit for fit in zip(models, at.states, at.clocks, strict=True) if fit[0].poses]
    if not tracked:
        return None

    def rms(geometry: Geometry) -> float:
        off = np.concatenate([model.errors(geometry, state, clock, at.mount) for model, state, clock in tracked])[:, :2]
        return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))

    before, after = geometries
    left = rms(after)
    _without_creep(models)  # plain odometry by the robot file
    return rms(before), left


def _check(robot: RobotDescription, logs: Sequence[Log], parameters: tuple[Parameter, ...]) -> None:
    if not parameters:
        raise Declined(f"robot {robot.name!r} has no encoder whose numbers could be found")
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
        "other, or did not move enough to; give logs with ref_x, ref_y and ref_psi, at least at start and end"
    )
