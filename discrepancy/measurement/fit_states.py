"""Fits the states of logs and the creep of contacts, which depend on each other, alternately.

The shape of creep is predicted (`creep_prediction`); its factors are estimated.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, stacked
from discrepancy.measurement.creep_prediction import CREEPS, FORCED, QUICK, Slipping
from discrepancy.measurement.design_matrix import Shared, joint, schur_complement
from estimators.calibration.maximum_likelihood import ROUNDS, State, fitted
from estimators.likelihood.channels import Channels
from estimators.likelihood.log_likelihood import ExtraColumns, LogLikelihood, Noise, Reduced

DOUBT = 0.5
"""Prior standard deviation of the factors of predicted creep."""

MOST_CREEP = 4.0
"""Largest factor of predicted creep."""

AS_DESCRIBED, AS_USUAL, RIGID = 0.01, 0.05, 0.25
"""Prior standard deviations: of the factor of creep under forces, and of all factors where clean logs give them. And
the factor of creep under forces below which contacts are taken for rigid ones."""

MOST_ROUNDS, SETTLED = 12, 0.03
"""Most rounds in which predicted creep, its factors, states and noise follow each other by a step, before a last round
to convergence; and the change of the prediction in a round, in standard deviations of the least slip noise, at which
these end. Two rounds leave the log evidence of 60 s of `asoc-prototype` in good order 180 lower, and that of `omnimate`
with a backlash of 54 mrad in the model 6,700; sixteen raise them by 20 and 15 (all with a least
slip noise of 0.1 mm after 1 m)."""


class Slips(NamedTuple):
    """Slips of one log's contacts at a state: those taken as predicted, and those known up to factors."""

    slipping: Slipping
    certain: Array
    known: Array


def fit_states(
    robot: RobotDescription,
    models: list[LogLikelihood],
    logs: Sequence[Log],
    start: tuple[State, Noise] | None,
    usual: Array | None,
    least: Noise,
) -> tuple[State, Noise, Shared, list[Slips]]:
    """Return the states, the noise, the shared nuisances, and the slips of each log.

    They are fitted together, as creep depends on how wheels disagree in the fitted state, and the state on creep.
    start: state and noise to begin with. usual: factors of predicted creep in clean logs. least: lower bounds of noise.
    """
    geometry, no_values = Geometry.of(robot.as_built()), np.zeros(0)
    if start is None:
        at, sizes, _ = fitted(models, geometry, (), no_values, None, least=least)
    else:
        at, sizes = start
    off: list[Array | float] = [0.0] * len(models)  # the errors of its sensors, which are subtracted from the counts
    if robot.effects:
        off = _corrected(robot, models, logs, at, off)
        if start is None:
            at, sizes, _ = fitted(models, geometry, (), no_values, None, (at, sizes), least=least)
    parts, left, expected = np.zeros(CREEPS), MOST_ROUNDS, None
    while True:
        slips = []
        for model, log, state in zip(models, logs, at.states, strict=True):
            slipping = Slipping(robot, model, log, state)
            slips.append(Slips(slipping, slipping.sure(), slipping.known()))
        _expect(models, slips, parts)
        shared = _shared(models, geometry, at, sizes, [log_slips.known for log_slips in slips], parts, usual)
        parts = shared.parts
        before, expected = expected, _expect(models, slips, parts)
        settled = before is not None and _change(models, geometry, at, least, before, expected) < SETTLED
        left = 0 if settled else left - 1
        at, sizes, _ = fitted(models, geometry, (), no_values, None, (at, sizes), 1 if left else ROUNDS, least=least)
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
        corrections.append(seen - channels.unread(robot, log, seen, state[:, 3:]))
        model.correct(corrections[-1] - before)
    return corrections


def _expect(models: Sequence[LogLikelihood], slips: Sequence[Slips], parts: Array) -> list[Array]:
    """Set the expected slips of each model, and return them."""
    expected = [log_slips.certain + log_slips.known @ parts for log_slips in slips]
    for model, log_expected in zip(models, expected, strict=True):
        model.expect(log_expected)
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


def _foreseen(usual: Array | None, rigid: bool) -> tuple[Array, Array]:
    """Return the prior means and standard deviations of the factors (CREEPS,) of predicted creep. rigid: whether
    contacts hardly creep under forces."""
    if usual is not None:
        return usual, np.full(CREEPS, AS_USUAL)
    expected, doubt = np.ones(CREEPS), np.full(CREEPS, DOUBT)
    doubt[FORCED], expected[QUICK] = AS_DESCRIBED, 0.5
    expected[FORCED] = 0.0 if rigid else 1.0
    return expected, doubt


def _shared(
    models: Sequence[LogLikelihood],
    geometry: Geometry,
    at: State,
    noise: Noise,
    known: Sequence[Array],
    parts: Array,
    usual: Array | None,
) -> Shared:
    """Return the shared nuisances with the most probable factors of predicted creep."""
    unchanged = stacked(geometry, [])
    reductions: list[tuple[tuple[Candidate, ...], Reduced]] = []
    for model, state, clock, slips in zip(models, at.states, at.clocks, known, strict=True):
        extra = ExtraColumns(np.zeros((len(state), state.shape[1] - 3, 0)), (slips,))
        reductions.append(((), model.reduce(geometry, unchanged, np.zeros(0), state, clock, at.mount, noise, 0, extra)))
    _, information, gradient, _ = joint(reductions)
    freely = Shared(parts, _foreseen(None, False)[0], np.full(CREEPS, DOUBT), at.mount)
    rigid = bool(_best(information, gradient, freely)[FORCED] < RIGID)
    shared = Shared(parts, *_foreseen(usual, rigid), at.mount)
    return replace(shared, parts=np.clip(_best(information, gradient, shared), 0.0, MOST_CREEP))


def _best(information: Array, gradient: Array, shared: Shared) -> Array:
    """Return the most probable factors (e,), given logs and priors."""
    information, gradient = information.copy(), gradient.copy()
    shared.add_priors(information, gradient, 0)
    return shared.parts + np.linalg.solve(*schur_complement(information, gradient[:, 0], len(shared.parts)))
