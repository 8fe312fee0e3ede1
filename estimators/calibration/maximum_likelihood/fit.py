"""The fit of all unknowns of several logs: Gauss and Newton's method on the squares of `LogLikelihood`.

The states of logs are eliminated. Sizes of noise are found as well (`noise`).
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from estimators.calibration.maximum_likelihood.newton_step import Solution, solved
from estimators.calibration.maximum_likelihood.noise import LEAST, Pace, resized, same_noise
from estimators.calibration.maximum_likelihood.tracker import MOUNT
from estimators.calibration.parameters import Parameter, geometry_with
from estimators.likelihood.log_likelihood import ExtraColumns, LogLikelihood, Noise, moved_along
from estimators.likelihood.reduction import Leftover, Reduced

ROUNDS, PROBES = 60, 8
"""Most steps; draws of residuals by which noise is fitted. With four, slip of 0.026 mm after 1 m (by sixteen draws)
seems to be 0.031 mm; with eight 0.027."""

CONVERGED, CONVERGED_WITH_CREEP = 0.01, 0.1
"""Converged when no parameter moves by more than this part of its standard error; creep is predicted less well."""

FARTHEST = 0.2
"""Largest change of a parameter in a step, as a part of its scale."""

SHORTEST, SLACK = 1 / 64, 0.01
"""Least part of a step that is taken; and the increase of the sum of squares that is accepted, as rounding may cause
it."""

WARM_UP = 2
"""Rounds in which states and noise converge before parameters move."""

NEARLY = 0.3
"""Sizes of noise are extrapolated while parameters move by no more than this part of their standard errors."""

CHANGE = 1e-6
"""Step for numerical derivatives, as a part of a parameter's scale: rolling is linear in lengths, so only rounding
limits it."""


class State(NamedTuple):
    """All unknowns: parameters (P,), mount (3,), the state and clock of each log, the factors of creep (1 + rows,),
    without creep (0,), and by which part the gyro reads too much (1,); where that is known (0,)."""

    found: Array
    mount: Array
    states: list[Array]
    clocks: Array
    factors: Array = np.zeros(0)
    gyro_scale: Array = np.zeros(0)

    @property
    def shared(self) -> Array:
        """The numbers (n,) that all logs share beside the parameters: factors of creep, scale of the gyro, mount."""
        return np.concatenate([self.factors, self.gyro_scale, self.mount])


class CreepModel(Protocol):
    """Creep of contacts in several logs, known up to factors (1 + rows,)."""

    @property
    def expected(self) -> Array:
        """The prior means (1 + rows,)."""
        ...

    @property
    def deviations(self) -> Array:
        """The prior standard deviations (1 + rows,)."""
        ...

    def predict(self, values: Array, states: Sequence[Array]) -> list[Array]:
        """Return the creep (K - 1, rows, 1 + rows) in each log by parameters of these values, at these states."""
        ...

    def expect(self, columns: Sequence[Array], factors: Array) -> object:
        """Make models expect the creep of columns with these factors."""
        ...

    def disagreement(
        self, geometry: Geometry, changed: Geometry, change: Array, states: Sequence[Array]
    ) -> tuple[Array, Array]:
        """Return information (P, P) and score (P,) on the parameters by how far wheels disagree, in their scales."""
        ...


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
    creep: CreepModel | None = None,
    probes: int = PROBES,
    gyro_scale: float = 0.0,
) -> tuple[State, Noise, Solution]:
    """Return the most likely state, the sizes of noise, and the last step, which is near 0 on convergence.

    noise: known sizes; None: they are fitted. start: state and noise of the same logs to begin with; None: state by
    counts. rounds: most steps. placed (3,): prior standard deviations of the mount. least: lower bounds of noise.
    creep: of contacts, whose factors are fitted too; None: models expect what they are told to. probes: number of draws
    of residuals (`LogLikelihood.reduce`) by which noise is fitted. gyro_scale: prior standard deviation of the scale of
    the gyro, as a part; 0: it is exact.
    """
    scale = scales_of(parameters)
    if afresh := start is None:
        states = [model.start(described) for model in models]
        start = State(before, np.zeros(3), states, np.zeros((len(models), 2))), first_noise(described, least)
        start = start[0]._replace(gyro_scale=np.zeros(1 if gyro_scale else 0)), start[1]
    at, sizes = start
    sizes, probes = (sizes, probes) if noise is None else (noise, 0)
    warm_up = WARM_UP if parameters and afresh else 0
    pace: Pace | None = None
    k = 0
    while True:
        steps = changed_by_each(described, parameters, at.found)
        columns, seen = [], (np.zeros((len(scale), len(scale))), np.zeros(len(scale)))
        if creep:
            columns, seen = creep.predict(at.found, at.states), creep.disagreement(*steps, at.states)
            creep.expect(columns, at.factors)
        _scale_gyros(models, at)
        reductions = [
            model.reduce(
                *steps, state, clock, at.mount, sizes, probes, columns_of(model, columns[n : n + 1], at.gyro_scale)
            )
            for n, (model, state, clock) in enumerate(zip(models, at.states, at.clocks, strict=True))
        ]
        of_gyro = np.full(len(at.gyro_scale), gyro_scale)
        deviations = np.concatenate([*([creep.deviations] if creep else []), of_gyro, placed])
        expected = np.concatenate([*([creep.expected] if creep else []), 0 * of_gyro, np.zeros(3)])
        shared = at.shared - expected
        farthest, converged = FARTHEST if k >= warm_up else 0.0, CONVERGED_WITH_CREEP if creep else CONVERGED
        solution = solved(reductions, seen, scale, shared, deviations, (at.found - before) / scale, farthest)

        def squares(
            state: State,
            columns: list[Array] = columns,
            seen: tuple[Array, Array] = seen,
            found: Array = at.found,
            prior: tuple[Array, Array] = (expected, deviations),
        ) -> float:
            if creep:
                creep.expect(columns, state.factors)
            _scale_gyros(models, state)
            change = (state.found - found) / scale
            off = (state.shared - prior[0]) / prior[1]
            return float(off @ off + change @ seen[0] @ change - 2 * change @ seen[1])

        at, left, part, gain = _stepped(reductions, described, parameters, at, solution, squares)
        last, sizes = sizes, sizes if noise else resized(sizes, left, least)
        arrived = part == 1 or gain < SLACK
        done = k > warm_up and arrived and solution.moved < converged and same_noise(sizes, last, left)
        lost = not np.isfinite(at.found).all() or np.any(np.abs(at.found - before) > 10 * scale)
        if done or lost or (len(scale) and not solution.seen.any()) or k + 1 == rounds:
            return at, sizes, solution._replace(moved=np.inf) if lost else solution
        del reductions  # they hold many times the memory of the logs
        # a fit of states alone is one of many, about counts yet to be corrected: its noise need not be the limit
        if noise is None and len(scale) and k >= warm_up and part == 1 and solution.moved < NEARLY:
            sizes, pace = Pace.extrapolated(last, sizes, pace, least)
        else:
            pace = None
        k += 1


def changed_by_each(
    described: Geometry, parameters: tuple[Parameter, ...], values: Array
) -> tuple[Geometry, Geometry, Array]:
    """Return the geometry with parameters of these values, geometries in each of which one is larger, and by how
    much."""
    change = CHANGE * scales_of(parameters)
    return (
        geometry_with(described, parameters, values),
        geometry_with(described, parameters, values + np.diag(change)),
        change,
    )


def first_noise(described: Geometry, least: Noise) -> Noise:
    """Return sizes of noise to begin with: of a gyro as described."""
    return Noise() if described.gyro is None else Noise(gyro=max(described.gyro.noise, least.gyro))


def columns_of(model: LogLikelihood, slips: list[Array], gyro_scale: Array) -> ExtraColumns | None:
    """Return the columns of a log's slips (K - 1, rows, R) and of the gyro's scale, (1,) if it is unknown, if there are
    any."""
    scale = np.zeros((len(model.counts) - 1, len(model.rows), len(gyro_scale)))
    parts = [*slips, *([scale] if len(gyro_scale) else [])]
    if not parts:
        return None
    scales = np.concatenate([np.zeros(sum(part.shape[-1] for part in slips)), 0 * gyro_scale + 1])
    return ExtraColumns(np.zeros((*model.counts.shape, 0)), tuple(parts), gyro_scales=scales)


def _scale_gyros(models: list[LogLikelihood], at: State) -> None:
    for model in models if len(at.gyro_scale) else ():
        model.scale_gyro(float(at.gyro_scale[0]))


def _stepped(
    reductions: list[Reduced],
    described: Geometry,
    parameters: tuple[Parameter, ...],
    at: State,
    solution: Solution,
    more_squares: Callable[[State], float],
) -> tuple[State, list[Leftover], float, float]:
    """Return the state after a step, the residuals of each log, the part of the step that was taken, and by how much
    the sum of squares became smaller.
    more_squares: makes the models expect the slips of a state, and returns its squares but for those of `reductions`.

    All unknowns are moved by the whole step, or half of it, and so on, until the exact (not linearised) sum of squares
    is no larger than before, with the weights of the state before. Each time, poses are moved in the world and, if that
    fails, relative to each other (`moved_along`).
    """
    scale, first = scales_of(parameters), len(at.factors)
    place = first + len(at.gyro_scale)
    moved_by = np.concatenate([scale[:, None] * solution.step, solution.shared])

    def squares(state: State) -> float:
        more, geometry = more_squares(state), geometry_with(described, parameters, state.found)
        logs = zip(reductions, state.states, state.clocks, strict=True)
        return sum(reduced.squares(geometry, path, clock, state.mount) for reduced, path, clock in logs) + more

    def part_of(part: float, moved: Callable[[Array, Array], Array]) -> State:
        return State(
            at.found + part * scale * solution.step[:, 0],
            at.mount + part * solution.shared[place:, 0],
            [moved(old, part * (new - old)) for old, (new, _, _) in zip(at.states, full_step, strict=True)],
            at.clocks + part * (np.array([clock for _, clock, _ in full_step]) - at.clocks),
            at.factors + part * solution.shared[:first, 0],
            at.gyro_scale + part * solution.shared[first:place, 0],
        )

    full_step = [reduced.finish(moved_by) for reduced in reductions]
    before, part = sum(reduced.at_state for reduced in reductions) + more_squares(at), 1.0
    while True:
        for moved in (np.add, moved_along):
            after = part_of(part, moved)
            gain = before - squares(after)
            if gain >= -SLACK or part <= SHORTEST:
                left = full_step if part == 1 else [reduced.finish(moved_by, part) for reduced in reductions]
                return after, [leftover for _, _, leftover in left], part, gain
        part /= 2


def scales_of(parameters: tuple[Parameter, ...]) -> Array:
    """Return the unit (P,) of changes of each parameter, m or rad."""
    return np.array([p.scale for p in parameters])
