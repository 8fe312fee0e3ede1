"""Fits the states of logs and the creep of contacts, which depend on each other, alternately.

The shape of creep is predicted (`estimators.likelihood.creep_prediction`); its factors are estimated.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from castor_envs.effects.encoders import TickLoss
from castor_envs.effects.parts import channel
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.measurement.design_matrix import PROBES, SharedNuisances
from estimators.calibration.maximum_likelihood.fit import ROUNDS, State, fitted
from estimators.likelihood.channels import Channels
from estimators.likelihood.creep_prediction import DOUBT, UNEVEN, Slipping
from estimators.likelihood.disagreement import slip_of_row
from estimators.likelihood.log_likelihood import LogLikelihood, Noise

AS_DESCRIBED, AS_USUAL, RIGID = 0.01, 0.05, 0.25
"""Prior standard deviations of the factor of creep under forces, as descriptions tell, and where clean logs do; where
nothing is known it is `DOUBT`. And the factor below which contacts are taken for rigid ones."""

MOST_CREEP, MOST_UNEVEN = 4.0, 1.0
"""Largest factor of creep under forces; and by which part at most a contact creeps more or less than predicted, so that
no wrong encoder passes for contacts."""

MOST_ROUNDS, SETTLED = 12, 0.05
"""Most rounds in which predicted creep, its factors, states and noise follow each other by a step, before a last round
to convergence; and the change of the prediction in a round, in standard deviations of the least slip noise, at which
these end. The log evidence then scatters by 0 to 1.1 (standard deviation of seven fits with different starts, on five
logs of 60 s), where 0.2 leaves up to 1.5."""


def fit_states(
    robot: RobotDescription,
    models: list[LogLikelihood],
    logs: Sequence[Log],
    start: tuple[State, Noise, SharedNuisances] | None,
    usual: float | None,
    least: Noise,
) -> tuple[State, Noise, SharedNuisances, list[Slipping]]:
    """Return the states, the noise, the shared nuisances, and the creep of each log.

    They are fitted together, as creep under forces depends on the motion in the fitted state, and the state on creep.
    start: state, noise and shared nuisances to begin with. usual: factor of creep under forces in clean logs. least:
    lower bounds of noise.
    """
    geometry, no_values = Geometry.of(robot.as_built()), np.zeros(0)
    fit = partial(fitted, models, geometry, (), no_values, None, least=least, probes=PROBES)
    if start is None:
        at, sizes, _ = fit()
    else:
        at, sizes, _ = start
    off: list[Array | float] = [0.0] * len(models)  # the errors of its sensors, which are subtracted from the counts
    held = start is not None and _plays(robot, models, at)
    if robot.effects:
        off = _corrected(robot, models, logs, at, off, held, loose=start is not None)
        if start is None:
            at, sizes, _ = fit((at, sizes))
    creep, left = _Creep.before(models, usual, start[2].creep if start else None), MOST_ROUNDS
    expected: Sequence[Array] | None = None
    last: tuple[_Creep, Array] | None = None  # the last prediction, and its difference to what was expected before it
    while True:
        slips = [Slipping(robot, model, log, state) for model, log, state in zip(models, logs, at.states, strict=True)]
        new, left = creep.predicted(slips, logs), left - 1
        creep = new
        if expected is not None:
            change = new.change(expected, geometry, at, least)
            if np.sqrt(np.mean(change**2)) < SETTLED:
                left = 0
            if last is not None:
                creep = new.part_way_back(*last, change)
            last = new, change
        expected = creep.expect(creep.columns, creep.factors)
        begin, rounds = (at._replace(factors=creep.factors), sizes), 1 if left else ROUNDS
        at, sizes, solution = fit(begin, rounds, creep=creep)
        creep = creep.found(at.factors, solution.shared_covariance)
        at = at._replace(factors=no_values)
        if not left:
            creep.expect(creep.columns, creep.factors)
            shared = SharedNuisances(creep.factors, creep.expected, creep.deviations, at.mount, creep.told)
            return at, sizes, shared, slips
        if robot.effects:
            off = _corrected(robot, models, logs, at, off, held or left <= MOST_ROUNDS / 2)


@dataclass(frozen=True, eq=False)
class _Creep:
    """Creep of contacts in logs, for a fit of its factors beside the states (`fitted`).

    sure (K - 1, rows), columns (K - 1, rows, 1 + rows): of each log, predicted slips, and creep that is known up to
    factors (1 + rows,), whose prior means and standard deviations are expected and deviations. doubt: of each log,
    about slips that wrong wiring caused. usual: factor of creep under forces in clean logs. told: whether the logs
    determine it better than `DOUBT`.
    """

    models: Sequence[LogLikelihood]
    usual: float | None
    factors: Array
    expected: Array
    deviations: Array
    sure: Sequence[Array] = ()
    columns: Sequence[Array] = ()
    doubt: Sequence[Array | float] = ()
    told: bool = False

    @classmethod
    def before(cls, models: Sequence[LogLikelihood], usual: float | None, factors: Array | None) -> "_Creep":
        """Return what is known of factors before any prediction; factors (1 + rows,): to begin with, or None."""
        rows, forced = np.zeros(len(models[0].rows)), (1.0, DOUBT) if usual is None else (usual, AS_USUAL)
        prior = np.append(forced[0], rows), np.append(forced[1], rows + UNEVEN)
        return cls(models, usual, np.append(0.0, rows) if factors is None else factors, *prior)

    def predicted(self, slips: Sequence[Slipping], logs: Sequence[Log]) -> "_Creep":
        """Balance contacts, and return creep as predicted at other states."""
        for model, slipping in zip(self.models, slips, strict=True):
            model.balance(slipping.stiffness)
        doubt = [UNEVEN * slipping.by_effects if log.undone else 0.0 for slipping, log in zip(slips, logs, strict=True)]
        sure, columns = [slipping.sure() for slipping in slips], [slipping.columns() for slipping in slips]
        return replace(self, sure=sure, columns=columns, doubt=doubt)

    def part_way_back(self, last: "_Creep", change: Array, changed: Array) -> "_Creep":
        """Return creep on the line through this prediction and the last where the difference to what was expected
        before each (`changed` and `change`) would be the smallest if it followed linearly: predictions may alternate.

        Anderson's acceleration of depth 1 (Walker and Ni, SIAM Journal on Numerical Analysis 49(4), 2011).
        """
        turned = changed - change
        part = float(np.clip(changed @ turned / (turned @ turned), -1.0, 1.0))
        sure = [new + part * (old - new) for new, old in zip(self.sure, last.sure, strict=True)]
        columns = [new + part * (old - new) for new, old in zip(self.columns, last.columns, strict=True)]
        return replace(self, sure=sure, columns=columns)

    def predict(self, values: Array, states: Sequence[Array]) -> list[Array]:
        """Return the columns, which do not follow the states of a fit."""
        return list(self.columns)

    def expect(self, columns: Sequence[Array], factors: Array) -> list[Array]:
        """Set the expected slips of each model, with the doubt about them, and return them."""
        expected = [slips + of_log @ factors for slips, of_log in zip(self.sure, columns, strict=True)]
        for model, log_expected, log_doubt in zip(self.models, expected, self.doubt, strict=True):
            model.expect(log_expected, log_doubt)
        return expected

    def change(self, before: Sequence[Array], geometry: Geometry, at: State, noise: Noise) -> Array:
        """Return by how much expected slips differ from those before, in standard deviations of slip noise."""
        expected = self.expect(self.columns, self.factors)
        changes = [
            model.in_deviations(now - then, geometry, state, noise)
            for model, then, now, state in zip(self.models, before, expected, at.states, strict=True)
        ]
        return np.concatenate([log.ravel() for log in changes])

    def disagreement(
        self, geometry: Geometry, changed: Geometry, change: Array, states: Sequence[Array]
    ) -> tuple[Array, Array]:
        """Return what disagreement of wheels tells of parameters, of which there are none."""
        return np.zeros((0, 0)), np.zeros(0)

    def found(self, factors: Array, covariance: Array) -> "_Creep":
        """Return the factors within bounds, and their prior: that under forces is expected as in clean logs or as
        described, unless contacts are rigid.

        factors (1 + rows,), covariance (n, n): as found with the prior so far, of these and other numbers.
        """
        rows = len(factors) - 1
        expected, deviations, told = self.expected.copy(), self.deviations.copy(), self.told
        if self.usual is None:
            information = np.linalg.inv(covariance[: 1 + rows, : 1 + rows])
            score = information @ factors
            information[0, 0] += DOUBT**-2 - deviations[0] ** -2
            score[0] += 1.0 / DOUBT**2 - expected[0] / deviations[0] ** 2
            rigid = np.linalg.solve(information, score)[0] < RIGID
            told = bool(np.linalg.inv(information)[0, 0] < (DOUBT / 2) ** 2)
            expected[0], deviations[0] = 0.0 if rigid else 1.0, AS_DESCRIBED
        factors = np.clip(factors, -MOST_UNEVEN, [MOST_CREEP] + [MOST_UNEVEN] * rows)
        return replace(self, factors=factors, expected=expected, deviations=deviations, told=told)


def _corrected(
    robot: RobotDescription,
    models: Sequence[LogLikelihood],
    logs: Sequence[Log],
    at: State,
    off: Sequence[Array | float],
    held: bool,
    loose: bool = True,
) -> list[Array | float]:
    """Subtract the errors of a robot's sensors at a state from the counts, in place of those subtracted before
    (`off`).

    loose: whether a reading that stands still within a backlash leaves the shaft free there. In a state by counts it
    would be lost: a single castor is then found where it never was. held: see `Channels.play`.
    """
    channels, corrections = Channels(robot), []
    for model, log, state, before in zip(models, logs, at.states, off, strict=True):
        seen = model.counts + before
        turned = _turned(robot, channels, model, log, seen, state)
        corrections.append(seen - channels.unread(robot, log, seen, turned))
        play = channels.play(robot, log, turned, held) if loose else 0.0
        model.correct(corrections[-1] - before, play, channels.latencies(robot))
    return corrections


def _plays(robot: RobotDescription, models: Sequence[LogLikelihood], at: State) -> bool:
    """Whether states hold how shafts moved within a robot's backlashes: those fitted without them follow readings."""
    channels = Channels(robot)
    return all(
        np.ptp(model.counts[:, column] - state[:, 3 + column]) * 2 * np.pi / channels.per_rev[column] > effect.value / 2
        for model, state in zip(models, at.states, strict=True)
        for column, effect in channels.backlashes(robot)
    )


def _turned(
    robot: RobotDescription, channels: Channels, model: LogLikelihood, log: Log, seen: Array, state: Array
) -> Array:
    """Return the counts (K, s + d) of a state; of a wheel whose encoder loses counts at speed, those that explain the
    counts seen (K, s + d) and are the likeliest: by the other wheels, as its own do not tell how fast it turns, or,
    where these do not tell either, by the state's poses, which follow the reference."""
    counts, lost = state[:, 3:].copy(), {}
    for effect in robot.effects:
        if isinstance(effect, TickLoss):
            column = _column(robot, channels, effect)
            read, likely, per_count = wheel_readings(robot, channels, model, state, effect, seen)
            missing = effect.turned(np.diff(log.t), read, likely, per_count) - read
            lost[column] = lost.get(column, 0.0) + missing / per_count
    for column, missing in lost.items():
        counts[1:, column] = counts[0, column] + np.cumsum(np.diff(seen[:, column]) + missing)
    return counts


def wheel_readings(
    robot: RobotDescription, channels: Channels, model: LogLikelihood, state: Array, effect: TickLoss, seen: Array
) -> tuple[Array, Array, float]:
    """Return the angles (K - 1,) that a wheel turns by its encoder, and those by the other wheels, or, where these do
    not tell, by the state's poses, rad; and the angle of one count. seen (K, s + d): counts."""
    geometry, column = channels.geometry, _column(robot, channels, effect)
    k, per_count = channels.driven[column - len(channels.sensed)], 2 * np.pi / float(channels.per_rev[column])
    as_read = np.column_stack([state[:, :3], model.counts])
    as_read[:, 3 + column] = seen[:, column]
    row = int(np.flatnonzero(model.rows == k)[0])
    slip, told = slip_of_row(model, geometry, as_read, row)
    slip = np.where(told, slip, model.residuals(geometry, as_read)[:, row])
    read = np.diff(seen[:, column]) * per_count
    return read, read + slip / geometry.radius[k], per_count


def _column(robot: RobotDescription, channels: Channels, effect: TickLoss) -> int:
    """Return the column of a wheel's encoder."""
    k = channel(robot, effect.castor, effect.wheel, effect.name)
    return len(channels.sensed) + int(np.searchsorted(channels.driven, k))
