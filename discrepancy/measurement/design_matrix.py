"""Design matrix of one log about a state: columns of candidates, of the amounts that creep masks of them, and of
creep."""

from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, rate_of, signatures_of, stacked
from discrepancy.measurement.creep_prediction import Slipping
from estimators.calibration.maximum_likelihood import MOUNT, PROBES, resized
from estimators.likelihood.log_likelihood import TIMED, ExtraColumns, LogLikelihood, Noise, Reduced

NOISE_ROUNDS, SAME = 20, 0.02
"""Most rounds in which noise beside given candidates is estimated, and the change at which they end."""

UNEVEN = 0.3
"""Relative standard deviation of each contact's creep about the prediction, where wheels disagree."""


@dataclass(frozen=True, eq=False)
class Columns:
    """The columns of one log's linear problem about a state. Of C amplitudes the first G change the geometry
    (`geometries`, changed by `steps` (G,)), the other R change readings (K, s + d, R) and slips (K - 1, rows, R).
    masked (K - 1, rows, C): slips that mask each amplitude; for the robot's effects, as predicted. known_slips (K - 1,
    rows, e): slips known up to a factor. rates (R,): rate of the reference's clock, s/s; rate: its rate by the robot's
    effects, None where no poses determine it."""

    model: LogLikelihood
    geometry: Geometry
    state: Array
    clock: Array
    candidates: tuple[Candidate, ...]
    geometries: tuple[Geometry, ...]
    steps: Array
    readings: Array
    slips: Array
    masked: Array
    known_slips: Array
    rates: Array
    rate: float | None

    @classmethod
    def of(
        cls,
        robot: RobotDescription,
        model: LogLikelihood,
        log: Log,
        state: Array,
        clock: Array,
        slipping: Slipping,
        known_slips: Array,
        parts: Array,
        among: Sequence[Candidate] | None,
        places: Sequence[Candidate],
        of: str,
    ) -> "Columns":
        """Return the columns of candidates, from `signatures_of`. known_slips: `Slipping.known()`; parts: their
        factors."""
        geometry = Geometry.of(robot.as_built())
        found = signatures_of(robot, log, state, model.score_by_counts(state), among, of, places)
        changed = stacked(geometry, found.geometries)
        masked = model.masked_by_creep(geometry, changed, found.steps, state, found.readings, slipping.yields)
        for candidate, columns in zip(found.candidates, columns_of(found.candidates), strict=True):
            for effect in robot.effects:
                if candidate.is_of(effect) and not effect.binary and np.any(candidate.amplitudes(effect)):
                    masked[..., columns] = parts[0] * slipping.masking(effect, candidate)
        slips = np.zeros((*known_slips.shape[:2], len(found.slips)))
        for k, slip in enumerate(found.slips):
            slips[..., k] = model.rows_of(slip.rolling, slip.side)
        for k in found.places:  # the state took this disagreement for creep, while no cable was in the model
            slips[..., k] -= parts[0] * slipping.seen_as_creep(found.slips[k])
        return cls(
            model=model,
            geometry=geometry,
            state=state,
            clock=clock,
            candidates=found.candidates,
            geometries=found.geometries,
            steps=found.steps,
            readings=found.readings,
            slips=slips,
            masked=masked,
            known_slips=known_slips,
            rates=found.rates,
            rate=rate_of(robot.effects) if model.poses_used >= TIMED else None,
        )

    def reduce(self, mount: Array, noise: Noise, only: Sequence[Candidate] | None = None, probes: int = 0) -> Reduced:
        """Return the log's statistics of amplitudes, masked amounts, factors of known slips, and constant creep of
        every wheel and castor; with `only`: of these candidates, without constant creep."""
        chosen = [only is None or candidate in only for candidate in self.candidates for _ in range(candidate.columns)]
        columns, always = np.flatnonzero(chosen), self.known_slips[..., :0]
        if only is None:
            always = self.model.rolled(self.geometry, self.state)[..., None] * np.eye(len(self.model.rows))
        built, of_readings = columns[columns < len(self.steps)], columns[columns >= len(self.steps)] - len(self.steps)
        changed = stacked(self.geometry, [self.geometries[k] for k in built.tolist()])
        readings, slips, masked = (
            part if only is None else part[..., kept]
            for part, kept in ((self.readings, of_readings), (self.slips, of_readings), (self.masked, columns))
        )
        parts = (slips, masked, self.known_slips, always)
        rates = np.pad(self.rates[of_readings], (0, sum(part.shape[-1] for part in parts) - len(of_readings)))
        extra = ExtraColumns(readings, parts, rates)
        return self.model.reduce(
            self.geometry, changed, self.steps[built], self.state, self.clock, mount, noise, probes, extra, self.rate
        )

    def alone(self) -> tuple[Geometry, Geometry, Array, Array, Array, Array]:
        """Return the arguments of `LogLikelihood.missing` for all candidates."""
        changed = stacked(self.geometry, self.geometries)
        return self.geometry, changed, self.steps, self.state, self.readings, self.slips


def columns_of(candidates: Sequence[Candidate]) -> tuple[NDArray[np.intp], ...]:
    """Return the column numbers of each of several candidates in sequence."""
    ends = np.cumsum([candidate.columns for candidate in candidates])
    return tuple(np.arange(end - candidate.columns, end) for candidate, end in zip(candidates, ends, strict=True))


@dataclass(frozen=True, eq=False)
class Shared:
    """Nuisances that all logs share, with their priors.

    parts (e,): factors of known slips; expected, doubt (e,): their prior means and standard deviations. mount (3,):
    place of the tracked point.
    """

    parts: Array
    expected: Array
    doubt: Array
    mount: Array

    def add_priors(self, information: Array, gradient: Array, first: int) -> None:
        """Add the priors: of the factors of known slips, from number `first` on; of each contact's deviation from
        predicted creep, if it is among the numbers; and of the tracked point, the last numbers."""
        end, mount = first + len(self.parts), slice(-len(self.mount), None)
        parts, uneven = slice(first, end), np.arange(end, len(information) - len(self.mount))
        information[parts, parts] += np.diag(self.doubt**-2.0)
        information[uneven, uneven] += UNEVEN**-2
        information[mount, mount] += np.eye(len(self.mount)) / MOUNT**2
        gradient[parts, 0] += (self.parts - self.expected) / self.doubt**2
        gradient[mount, 0] += self.mount / MOUNT**2


def joint(
    reductions: Sequence[tuple[Sequence[Candidate], Reduced]],
) -> tuple[tuple[Candidate, ...], Array, Array, list[NDArray[np.intp]]]:
    """Return all candidates of several logs, and the joint information and gradient of their amplitudes, then of the
    masked amounts, then of the numbers that all logs share; and the places of each log's numbers among these."""
    candidates = tuple(dict.fromkeys(candidate for log_candidates, _ in reductions for candidate in log_candidates))
    columns = dict(zip(candidates, columns_of(candidates), strict=True))
    half = sum(candidate.columns for candidate in candidates)
    shared = len(reductions[0][1].information) - 2 * sum(candidate.columns for candidate in reductions[0][0])
    size = 2 * half + shared
    information, gradient = np.zeros((size, size)), np.zeros((size, reductions[0][1].gradient.shape[1]))
    numbers = []
    for log_candidates, reduced in reductions:
        amplitudes = np.concatenate([np.zeros(0, dtype=np.intp), *(columns[candidate] for candidate in log_candidates)])
        at = np.concatenate([amplitudes, amplitudes + half, np.arange(2 * half, size)])
        information[np.ix_(at, at)] += reduced.information
        gradient[at] += reduced.gradient
        numbers.append(at)
    return candidates, information, gradient, numbers


def schur_complement(information: Array, gradient: Array, n: int) -> tuple[Array, Array]:
    """Return information (n, n) and score (n,) of the first n numbers, the others eliminated by a Schur complement."""
    solved = np.linalg.solve(information[n:, n:], np.column_stack([information[n:, :n], gradient[n:]]))
    eliminated = information[:n, :n] - information[:n, n:] @ solved[:, :n]
    return (eliminated + eliminated.T) / 2, -(gradient[:n] - information[:n, n:] @ solved[:, n])


def reestimated_noise(logs: Sequence[Columns], chosen: Sequence[Candidate], shared: Shared, noise: Noise) -> Noise:
    """Return the noise re-estimated beside candidates of maximum-likelihood sizes; no size becomes larger."""
    found = noise
    for _ in range(NOISE_ROUNDS):
        reductions = [log.reduce(shared.mount, found, chosen, PROBES) for log in logs]
        log_candidates = [[candidate for candidate in log.candidates if candidate in chosen] for log in logs]
        candidates, information, gradient, numbers = joint(list(zip(log_candidates, reductions, strict=True)))
        shared.add_priors(information, gradient, 2 * sum(candidate.columns for candidate in candidates))
        scale = np.sqrt(np.maximum(np.diag(information), 1e-30))
        best, *_ = np.linalg.lstsq(information / np.outer(scale, scale), gradient / scale[:, None], rcond=1e-9)
        moved: Array = (-best / scale[:, None]).astype(np.float64)
        left = [reduced.finish(moved[at])[2] for reduced, at in zip(reductions, numbers, strict=True)]
        last, found = found, resized(found, left)
        changes = [new / old - 1 for new, old in zip(astuple(found), astuple(last), strict=True)]
        if max(abs(change) for change in changes) < SAME:
            break
    return Noise(**{name: min(size, getattr(noise, name)) for name, size in asdict(found).items()})
