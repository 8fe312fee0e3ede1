"""Information and score of every candidate in each log, linearised about the fitted states, nuisances integrated out.

The most likely states of all logs are found first, with the robot's effects in place (`fit_states`); about these every
candidate acts linearly (`design_matrix`). Wheels that are driven against each other creep until their speeds agree, and
so mask a part of an effect: each candidate has two sizes, its amplitude, and how much of it the wheels' disagreement
does not show.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from numpy.typing import NDArray

from castor_envs.effects.encoders import PivotBacklash
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.cables import with_cables
from discrepancy.hypotheses.candidates import Candidate, gyro_scale_of, rate_of
from discrepancy.hypotheses.wheel_tracks import slips_of
from discrepancy.measurement.design_matrix import (
    DesignMatrix,
    SharedNuisances,
    columns_of,
    numbers_of,
    reestimated_noise,
    schur_complement,
)
from discrepancy.measurement.fit_states import fit_states
from discrepancy.measurement.servo_work import Pull, pull_of
from discrepancy.posterior.answers import Seen
from discrepancy.posterior.random_effects import Statistics
from discrepancy.validation.cost import WAY, cost_of_sizes, gap_of
from estimators.calibration.maximum_likelihood.fit import State
from estimators.calibration.maximum_likelihood.tracker import MOUNT
from estimators.likelihood.channels import Channels
from estimators.likelihood.creep_prediction import LEAST_NOISE
from estimators.likelihood.disagreement import Disagreement
from estimators.likelihood.elimination import blocks
from estimators.likelihood.log_likelihood import LogLikelihood, Noise
from estimators.likelihood.measurements.poses import TIMED
from estimators.likelihood.sparse_columns import SparseColumns

COUNTS, SLIP = 0.2, 3e-5
"""Size of unnamed alternatives in a robot in good order: rms reading error in counts, or rms slip as a part of the
way."""

ROUNDED = 12**-0.5
"""Backlash, in counts, that an encoder in good order seems to have: a rounded reading stands still, too, while its
shaft turns within a count."""

ROUNDING = 1e-9
"""A candidate that changes readings and slips by less than this part of `COUNTS` or `SLIP` per unit, rms, shows nothing
but rounding, as one that depends on speed does at constant speed."""

SWAY = 2e-4
"""s2: how much a reference in good order is off in proportion to acceleration: as a mast of 11 Hz."""


@dataclass(frozen=True, eq=False)
class Linearised(Seen):
    """Statistics of a robot's logs, linearised about their most likely states.

    usual: of the gyro's scale as the robot's file states it, of backlashes as rounding makes them, too. cost: by
    `cost_of_sizes`, or apparent error for the rate of a clock. masked: as logs show it; as much as predicted, if wheels
    that disagree do not tell. creep: factor of predicted creep under forces. errors: of each log, the difference
    between odometry, with predicted creep, and reference at every reference pose (poses, 3), m and rad. slips (K - 1,
    w): slips of wheels beyond the predicted ones, m; caused (K - 1, rows): creep that the robot's effects cause, as
    wheels are driven against each other, m. pulls: what commands say, in each log. designs, disagreements: of each log;
    empty after `without_designs`."""

    state: State
    noise: Noise
    creep: float
    errors: tuple[Array, ...]
    designs: tuple[DesignMatrix, ...]
    shared: SharedNuisances
    disagreements: tuple[Disagreement, ...]
    pulls: tuple[Pull, ...]
    slips: tuple[Array, ...]
    caused: tuple[Array, ...]

    @property
    def gap(self) -> tuple[float, float] | None:
        """See `Seen`."""
        return gap_of(self.errors)

    def cost_of_slips(self, slips: Sequence[Array]) -> Array:
        """Return the odometry error (2,) that slips (K - 1, rows, draws) of each log cause, rms over draws: m after 10
        m, rad after a turn."""
        costs = []
        for design, slipped in zip(self.designs, slips, strict=True):
            error = design.model.as_motion(design.geometry, design.state, slipped)
            costs.append(cost_of_sizes([error], design.state[:, :3]))
        return np.sqrt(np.mean(np.square(costs), axis=(0, 2)))

    def forget(self) -> None:
        """Let the columns go, which hold most of the memory; they are made again if they are asked for."""
        for design in self.designs:
            design.forget()

    def without_designs(self) -> "Linearised":
        """Return the statistics for a report, of which no noise can be estimated anew."""
        return replace(self, designs=(), disagreements=())

    def reestimate_noise(self, effects: Sequence[Candidate]) -> "Linearised":
        """See `Seen`."""
        found = reestimated_noise(self.designs, effects, self.shared, self.noise)
        noise = Noise(**{name: max(size, getattr(LEAST_NOISE, name)) for name, size in asdict(found).items()})
        return self if noise == self.noise else self.at_noise(noise)

    def at_noise(self, noise: Noise) -> "Linearised":
        """Return the statistics at a given noise: in each log 0 of candidates without a column in it."""
        count, logs, log_evidence, of_disagreement = len(self.usual), [], 0.0, 0.0
        for design, disagreement, pull in zip(self.designs, self.disagreements, self.pulls, strict=True):
            indices = numbers_of(design.candidates, self.columns)
            disagreeing = disagreement.statistics()
            statistics, log_likelihood = _of_sizes(design, disagreeing, pull, self.shared, noise)
            at = np.append(indices, indices + count)
            information, score = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
            information[np.ix_(at, at)], score[at] = statistics
            logs.append(Statistics(information, score))
            log_evidence += log_likelihood
            of_disagreement += disagreeing[2]
        of_motion = log_evidence - of_disagreement
        evidences = {"log_evidence": log_evidence, "log_evidence_of_motion": of_motion}
        return replace(self, noise=noise, logs=tuple(logs), **evidences)


def linearise(
    robot: RobotDescription,
    logs: Sequence[Log],
    *,
    start: Linearised | None = None,
    creep: float | None = None,
    among: Sequence[Candidate] | None = None,
    places: Sequence[Candidate] = (),
    released: Sequence[NDArray[np.bool_]] = (),
    jitter: float = 0.0,
    own_clocks: bool = False,
) -> Linearised:
    """Return information and score of candidates in logs, linearised about the most likely states.

    start: an earlier result for the same logs, as starting point. creep: factor of predicted creep under forces in
    clean logs of the robot. among: candidates to consider; None: all of the catalogue and all unnamed alternatives.
    places: further candidates, at places of the floor. released: steps of every log as `LogLikelihood.release` takes
    them; empty: none. jitter: standard deviation of the times at which all encoders were read, s. own_clocks: whether
    the clocks of the reference have other rates than in the logs that the robot's effects come from (`_rates`).
    Raises InputError for logs that the robot cannot have made.
    """
    geometry = Geometry.of(robot.as_built())
    models = [LogLikelihood(geometry, log, k) for k, log in enumerate(logs)]
    for model in models:
        model.scale_gyro(gyro_scale_of(robot.effects))
    released = released or [np.zeros((len(model.counts) - 1, len(model.rows)), dtype=bool) for model in models]
    for model, steps in zip(models, released, strict=True):
        model.release(steps)
        model.jitter(jitter)
    begin = None if start is None else (start.state, start.noise, start.shared)
    at, noise, shared, slips = fit_states(robot, models, logs, begin, creep, LEAST_NOISE)
    predicted = [slipping.sure() + shared.creep[0] * slipping.forced for slipping in slips]
    beyond = tuple(
        slips_of(robot, model, log, state, log_predicted + slipping.by_effects)
        for model, log, state, log_predicted, slipping in zip(models, logs, at.states, predicted, slips, strict=True)
    )
    if among is None:
        places = with_cables(places, robot, logs, at, beyond)
    names = [f" of log {k + 1}" for k in range(len(logs))] if len(logs) > 1 else [""]
    creeping = max(float(shared.creep[0]), 0.0)
    designs = [
        DesignMatrix(robot, model, log, state, clock, rate, slipping, among, places, name, creeping)
        for model, log, state, clock, rate, slipping, name in zip(
            models, logs, at.states, at.clocks, _rates(robot, models, at, own_clocks), slips, names, strict=True
        )
    ]
    columns = columns_of(candidate for design in designs for candidate in design.candidates)
    count = sum(map(len, columns.values()))
    usual, costs, disagreements, pulls, errors = _usual(designs, columns, count), [], [], [], []
    for design, log, slipping, slipped, steps in zip(designs, logs, slips, predicted, released, strict=True):
        model, state, clock, changes = design.model, design.state, design.clock, design.changes
        indices = numbers_of(design.candidates, columns)
        of_readings = indices[len(design.steps) :]
        usual[of_readings[design.sways != 0]] = SWAY
        if robot.gyro is not None:
            usual[of_readings[design.gyro_scales != 0]] = robot.gyro.scale_tolerance
        for candidate in design.candidates:
            if candidate.kinds and isinstance(backlash := candidate.kinds[0], PivotBacklash):
                one_count = 2 * np.pi / geometry.pivot_counts_per_rev[backlash.castor - 1]
                usual[columns[candidate]] = np.hypot(backlash.tolerance, one_count * ROUNDED)
        cost = np.zeros((2, count))
        cost[:, indices] = cost_of_sizes((model.missing(changes, of) for of in blocks(len(state) - 1)), state[:, :3])
        cost[:, of_readings] += np.outer((WAY, 2 * np.pi), np.abs(design.rates))
        if np.any(design.sways):
            cost[0, of_readings] += model.acceleration(state, clock, at.mount) * design.sways
        cost[1, of_readings] += 2 * np.pi * np.abs(design.gyro_scales)  # of a heading by the gyro
        costs.append(cost)
        disagreements.append(Disagreement.of(model, changes, log.t, slipping.disagreement, steps))
        pulls.append(pull_of(robot, log, Channels(robot).motion(log, state), design.candidates))
        errors.append(model.errors(geometry, clock, at.mount, slipped) if model.poses else np.zeros((0, 3)))
    shares = [disagreement.share for disagreement in disagreements if not np.isnan(disagreement.share)]
    built = {candidate for design in designs for candidate in design.candidates[: len(design.steps)]}
    return Linearised(
        columns=columns,
        logs=(),
        usual=usual,
        cost=np.sqrt(np.mean(np.square(costs), axis=0)),
        state=at,
        noise=noise,
        creep=float(shared.creep[0]),
        log_evidence=0.0,
        log_evidence_of_motion=0.0,
        redundant=any(design.redundant for design in designs),
        masked=float(np.mean(shares)) if shares else 1.0,
        errors=tuple(errors),
        poses=sum(model.poses_used for model in models),
        designs=tuple(designs),
        shared=shared,
        disagreements=tuple(disagreements),
        pulls=tuple(pulls),
        slips=beyond,
        caused=tuple(slipping.by_effects for slipping in slips),
        lasting=np.sort(np.array([columns[candidate][0] for candidate in built], dtype=np.intp)),
    ).at_noise(noise)


def _rates(robot: RobotDescription, models: Sequence[LogLikelihood], at: State, own_clocks: bool) -> list[float | None]:
    """Return the rate of the reference's clock in each log, s/s; None where too few poses determine it.

    It is 0 unless the robot's effects say that clocks do not agree. Such clocks are as wrong in each log, but not by
    the same: their rates differ from log to log as they are fitted. Those of `own_clocks` have no mean that is known.
    """
    skew = rate_of(robot.effects)
    timed = [model.poses_used >= TIMED for model in models]
    mean = skew if own_clocks else float(np.mean(at.clocks[timed, 1])) if any(timed) else 0.0
    rates = skew + (at.clocks[:, 1] - mean if skew else np.zeros(len(models)))
    return [rate if known else None for rate, known in zip(rates.tolist(), timed, strict=True)]


def _of_sizes(
    design: DesignMatrix, disagreement: tuple[Array, Array, float], pull: Pull, shared: SharedNuisances, noise: Noise
) -> tuple[Statistics, float]:
    """Return information and score of a log's candidate sizes, with the nuisances (creep and the tracked point)
    integrated out by a Schur complement; and the log evidence with all sizes 0. disagreement: from
    `Disagreement.statistics`."""
    reduced = design.reduce(shared.mount, noise)
    information, gradient = reduced.information.copy(), reduced.gradient.copy()
    n = sum(candidate.columns for candidate in design.candidates)
    by_volume, of_mount = design.score_by_volume(shared.mount, noise)
    gradient[:n, 0] -= by_volume
    gradient[-len(of_mount) :, 0] -= of_mount
    shared.add_priors(information, gradient, n)
    shown, score = schur_complement(information, gradient[:, 0], n)
    nuisances = information[n:, n:]
    likely = reduced.log_evidence() + disagreement[2] + pull.log_likelihood - float(np.linalg.slogdet(nuisances)[1]) / 2
    likely += float(gradient[n:, 0] @ np.linalg.solve(nuisances, gradient[n:, 0])) / 2
    likely -= float(np.sum(((shared.creep - shared.expected) / shared.doubt) ** 2)) / 2 + float(
        np.sum(np.log(shared.doubt))
    )
    likely -= float(np.sum((shared.mount / MOUNT) ** 2)) / 2
    information, both = disagreement[0].copy(), disagreement[1].copy()
    information[:n, :n] += shown + pull.information
    both[:n] += score + pull.score
    return Statistics(information, both), likely


def _usual(designs: Sequence[DesignMatrix], place: Mapping[Candidate, NDArray[np.intp]], count: int) -> Array:
    """Return sizes (count,) at which unnamed alternatives change readings by `COUNTS`, or slips by `SLIP`: rms over the
    logs in which they are considered; NaN for other candidates. place: the numbers of their sizes."""
    squares, logs = np.zeros((2, count))
    for design in designs:
        unnamed = np.array([not cause.kinds for cause in design.candidates for _ in range(cause.columns)], dtype=bool)
        indices = numbers_of(design.candidates, place)[unnamed]
        squares[indices] += _shown(design)[unnamed] ** 2
        logs[indices] += 1
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.sqrt(logs / squares)


def _shown(design: DesignMatrix) -> Array:
    """Return by how much sizes of 1 (columns,) change readings, in `COUNTS`, or slips, in `SLIP`, rms; 1 of those that
    hardly do."""
    rolled = np.sqrt(np.mean(design.model.rolled(design.geometry, design.state) ** 2))
    read, slipped = (np.sqrt(_mean_of_largest_squares(columns)) for columns in design.columns)
    shown = np.maximum(read / COUNTS, slipped / (SLIP * rolled + 1e-12))
    return np.concatenate([np.full(len(design.steps), np.nan), np.where(shown > ROUNDING, shown, 1.0)])


def _mean_of_largest_squares(columns: SparseColumns) -> Array:
    """Return the mean over samples or steps of the largest square in any row (C,)."""
    sums = [np.max(columns[block] ** 2, axis=1).sum(axis=0) for block in blocks(columns.shape[0])]
    return np.sum(sums, axis=0) / columns.shape[0]
