"""Fits the states of logs and the creep of contacts, which depend on each other, alternately.

The shape of creep is predicted (`estimators.likelihood.creep_prediction`); its factors are estimated.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from castor_envs.effects.encoders import TickLoss
from castor_envs.effects.parts import channel
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, stacked
from discrepancy.measurement.design_matrix import PROBES, Shared, joint, schur_complement
from estimators.calibration.maximum_likelihood.fit import ROUNDS, State, fitted
from estimators.likelihood.channels import Channels
from estimators.likelihood.creep_prediction import DOUBT, UNEVEN, Slipping
from estimators.likelihood.disagreement import slip_of_row
from estimators.likelihood.log_likelihood import ExtraColumns, LogLikelihood, Noise
from estimators.likelihood.reduction import Reduced

AS_DESCRIBED, AS_USUAL, RIGID = 0.01, 0.05, 0.25
"""Prior standard deviations of the factor of creep under forces, as descriptions tell, and where clean logs do; where
nothing is known it is `DOUBT`. And the factor below which contacts are taken for rigid ones."""

MOST_CREEP, MOST_UNEVEN = 4.0, 1.0
"""Largest factor of creep under forces; and by which part at most a contact creeps more or less than predicted, so that
no wrong encoder passes for contacts."""

MOST_ROUNDS, SETTLED = 12, 0.2
"""Most rounds in which predicted creep, its factors, states and noise follow each other by a step, before a last round
to convergence; and the change of the prediction in a round, in standard deviations of the least slip noise, at which
these end. For a prototype in good order the change stays at 0.12, however many rounds. Of 20 s of `omnimate` with a
backlash of 50 mrad in the model, two rounds leave the log evidence 660 lower than twelve, and the nine that this takes
none."""


def fit_states(
    robot: RobotDescription,
    models: list[LogLikelihood],
    logs: Sequence[Log],
    start: tuple[State, Noise] | None,
    usual: float | None,
    least: Noise,
) -> tuple[State, Noise, Shared, list[Slipping]]:
    """Return the states, the noise, the shared nuisances, and the creep of each log.

    They are fitted together, as creep under forces depends on the motion in the fitted state, and the state on creep.
    start: state and noise to begin with. usual: factor of creep under forces in clean logs. least: lower bounds of
    noise.
    """
    geometry, no_values = Geometry.of(robot.as_built()), np.zeros(0)
    if start is None:
        at, sizes, _ = fitted(models, geometry, (), no_values, None, least=least, probes=PROBES)
    else:
        at, sizes = start
    off: list[Array | float] = [0.0] * len(models)  # the errors of its sensors, which are subtracted from the counts
    if robot.effects:
        off = _corrected(robot, models, logs, at, off)
        if start is None:
            at, sizes, _ = fitted(models, geometry, (), no_values, None, (at, sizes), least=least, probes=PROBES)
    factors, left, expected = np.zeros(1 + len(models[0].rows)), MOST_ROUNDS, None
    while True:
        slips = [Slipping(robot, model, log, state) for model, log, state in zip(models, logs, at.states, strict=True)]
        sure, creep = [slipping.sure() for slipping in slips], [slipping.columns() for slipping in slips]
        for model, slipping in zip(models, slips, strict=True):
            model.balance(slipping.stiffness)
        doubt = [UNEVEN * slipping.by_effects if log.undone else 0.0 for slipping, log in zip(slips, logs, strict=True)]
        _expect(models, sure, creep, factors, doubt)
        shared = _shared(models, geometry, at, sizes, creep, factors, usual)
        factors = shared.creep
        before, expected = expected, _expect(models, sure, creep, factors, doubt)
        settled = before is not None and _change(models, geometry, at, least, before, expected) < SETTLED
        left = 0 if settled else left - 1
        at, sizes, _ = fitted(
            models, geometry, (), no_values, None, (at, sizes), 1 if left else ROUNDS, least=least, probes=PROBES
        )
        if not left:
            return at, sizes, replace(shared, mount=at.mount), slips
        if robot.effects:
            off = _corrected(robot, models, logs, at, off)


def _corrected(
    robot: RobotDescription,
    models: Sequence[LogLikelihood],
    logs: Sequence[Log],
    at: State,
    off: Sequence[Array | float],
) -> list[Array | float]:
    """Subtract the errors of a robot's sensors at a state from the counts, in place of those subtracted before
    (`off`)."""
    channels, corrections = Channels(robot), []
    for model, log, state, before in zip(models, logs, at.states, off, strict=True):
        seen = model.counts + before
        corrections.append(seen - channels.unread(robot, log, seen, _turned(robot, channels, model, log, seen, state)))
        model.correct(corrections[-1] - before)
    return corrections


def _turned(
    robot: RobotDescription, channels: Channels, model: LogLikelihood, log: Log, seen: Array, state: Array
) -> Array:
    """Return the counts (K, s + d) of a state; of a wheel whose encoder loses counts at speed, those that explain the
    counts seen (K, s + d) and are the likeliest: by the other wheels, as its own do not tell how fast it turns, or,
    where these do not tell either, by the state's poses, which follow the reference."""
    counts, geometry, lost = state[:, 3:].copy(), channels.geometry, {}
    for effect in robot.effects:
        if isinstance(effect, TickLoss):
            k = channel(robot, effect.castor, effect.wheel, effect.name)
            column = len(channels.sensed) + int(np.searchsorted(channels.driven, k))
            per_count = 2 * np.pi / channels.per_rev[column]
            as_read = np.column_stack([state[:, :3], model.counts])
            as_read[:, 3 + column] = seen[:, column]
            row = int(np.flatnonzero(model.rows == k)[0])
            slip, told = slip_of_row(model, geometry, as_read, row)
            slip = np.where(told, slip, model.residuals(geometry, as_read)[:, row])
            read = np.diff(seen[:, column]) * per_count
            missing = effect.turned(np.diff(log.t), read, read + slip / geometry.radius[k], per_count) - read
            lost[column] = lost.get(column, 0.0) + missing / per_count
    for column, missing in lost.items():
        counts[1:, column] = counts[0, column] + np.cumsum(np.diff(seen[:, column]) + missing)
    return counts


def _expect(
    models: Sequence[LogLikelihood],
    sure: Sequence[Array],
    creep: Sequence[Array],
    factors: Array,
    doubt: Sequence[Array | float],
) -> list[Array]:
    """Set the expected slips of each model, with the doubt about those that wrong wiring caused, and return them."""
    expected = [slips + columns @ factors for slips, columns in zip(sure, creep, strict=True)]
    for model, log_expected, log_doubt in zip(models, expected, doubt, strict=True):
        model.expect(log_expected, log_doubt)
    return expected


def _change(
    models: Sequence[LogLikelihood],
    geometry: Geometry,
    at: State,
    noise: Noise,
    before: Sequence[Array],
    expected: Sequence[Array],
) -> float:
    """Return the rms change of expected slips, in standard deviations of slip noise."""
    changes = [
        model.in_deviations(now - then, geometry, state, noise)
        for model, then, now, state in zip(models, before, expected, at.states, strict=True)
    ]
    return float(np.sqrt(np.mean(np.concatenate(changes) ** 2)))


def _shared(
    models: Sequence[LogLikelihood],
    geometry: Geometry,
    at: State,
    noise: Noise,
    creep: Sequence[Array],
    factors: Array,
    usual: float | None,
) -> Shared:
    """Return the shared nuisances with the most probable factors of predicted creep. That under forces is expected as
    in clean logs (`usual`) or as described, unless contacts are rigid."""
    unchanged = stacked(geometry, [])
    reductions: list[tuple[tuple[Candidate, ...], Reduced]] = []
    for model, state, clock, columns in zip(models, at.states, at.clocks, creep, strict=True):
        extra = ExtraColumns(np.zeros((len(state), state.shape[1] - 3, 0)), (columns,))
        reductions.append(((), model.reduce(geometry, unchanged, np.zeros(0), state, clock, at.mount, noise, 0, extra)))
    _, information, gradient, _ = joint(reductions)

    def best(expected: float, doubt: float) -> Shared:
        shared, total, slope = Shared.of(factors, (expected, doubt), at.mount), information.copy(), gradient.copy()
        shared.add_priors(total, slope, 0)
        return replace(shared, creep=factors + np.linalg.solve(*schur_complement(total, slope[:, 0], len(factors))))

    rigid = best(1.0, DOUBT).creep[0] < RIGID
    shared = best(0.0 if rigid else 1.0, AS_DESCRIBED) if usual is None else best(usual, AS_USUAL)
    return replace(
        shared, creep=np.clip(shared.creep, -MOST_UNEVEN, [MOST_CREEP] + [MOST_UNEVEN] * len(models[0].rows))
    )
