"""Design matrix of one log about a state: columns of candidates and of creep."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, astuple, dataclass

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate, Signatures, signatures_of, stacked
from estimators.calibration.maximum_likelihood.noise import resized
from estimators.calibration.maximum_likelihood.tracker import MOUNT
from estimators.likelihood.creep_prediction import Slipping
from estimators.likelihood.log_likelihood import ExtraColumns, LogLikelihood, Noise
from estimators.likelihood.reduction import Reduced
from estimators.likelihood.rolling import Changes
from estimators.likelihood.sparse_columns import SparseColumns
from estimators.likelihood.statistics import least_squares

PROBES = 16
"""Draws of residuals by which noise is estimated. Four leave it 10 to 25 % off where few poses determine it (slip of a
tricycle in 10 s: 0.0087 to 0.011 m after 1 m, by 256 draws 0.010)."""

NOISE_ROUNDS, SAME = 20, 0.02
"""Most rounds in which noise beside given candidates is estimated, and the change at which they end."""

CREEP = 7e-5
"""Standard deviation of constant creep in a log, as a part of the way: along for each wheel, sideways for each castor.
Real contacts are not as rigid as ideal rolling."""


class DesignMatrix:
    """The columns of one log's linear problem about a state, which are made when they are asked for, and kept until
    `forget`. candidates: with the columns of their amplitudes in sequence, the first of `geometries`. rates (R,): rate
    of the reference's clock, s/s; sways (R,): by how much its poses are off in proportion to acceleration, s2;
    gyro_scales (R,): part by which the gyro reads too much; rate: of that clock, if it is known, s/s.
    creep (K - 1, rows, 1 + rows): known up to factors (`SharedNuisances`)."""

    def __init__(
        self,
        robot: RobotDescription,
        model: LogLikelihood,
        log: Log,
        state: Array,
        clock: Array,
        rate: float | None,
        slipping: Slipping,
        among: Sequence[Candidate] | None,
        places: Sequence[Candidate],
        of: str,
        creep: float,
    ) -> None:
        """among, places, of, creep: as for `signatures_of`."""
        self.model, self.geometry, self.state = model, Geometry.of(robot.as_built()), state
        self.clock, self.rate, self.creep = clock, rate, SparseColumns.of(slipping.columns())

        def signatures() -> Signatures:
            return signatures_of(robot, log, state, model, among, of, places, creep)

        found, self._signatures = signatures(), signatures
        self.candidates, self.geometries, self.steps = found.candidates, found.geometries, found.steps
        self.rates, self.sways, self.gyro_scales = found.rates, found.sways, found.gyro_scales
        self._columns: tuple[SparseColumns, SparseColumns] | None = self._columns_of(found)

    @property
    def columns(self) -> tuple[SparseColumns, SparseColumns]:
        """Readings and slips (`Changes`) per unit of the R amplitudes that do not change the geometry."""
        if self._columns is None:
            self._columns = self._columns_of(self._signatures())
        return self._columns

    @property
    def changes(self) -> Changes:
        """What all amplitudes change."""
        return Changes(self.geometry, stacked(self.geometry, self.geometries), self.steps, self.state, *self.columns)

    def forget(self) -> None:
        """Let the columns go, which hold many times the memory of the log."""
        self._columns = None

    def reduce(self, mount: Array, noise: Noise, only: Sequence[Candidate] | None = None, probes: int = 0) -> Reduced:
        """Return the log's statistics of amplitudes, factors of creep, and constant creep of every wheel and castor;
        with `only`: of these candidates, without constant creep."""
        (readings, slips), geometries, steps, always = self.columns, self.geometries, self.steps, []
        numbers = self.rates, self.sways, self.gyro_scales
        if only is None:
            always = [SparseColumns.diagonal(self.model.rolled(self.geometry, self.state))]
        else:
            chosen = [candidate in only for candidate in self.candidates for _ in range(candidate.columns)]
            columns, built = np.flatnonzero(chosen), len(steps)
            of_geometry, of_readings = columns[columns < built], columns[columns >= built] - built
            geometries, steps = [geometries[k] for k in of_geometry.tolist()], steps[of_geometry]
            readings, slips = (part.only(of_readings.tolist()) for part in (readings, slips))
            numbers = tuple(of_effects[of_readings] for of_effects in numbers)
        parts = (slips, self.creep, *always)
        others = sum(part.shape[-1] for part in parts) - len(numbers[0])
        extra = ExtraColumns(readings, parts, *(np.pad(of_effects, (0, others)) for of_effects in numbers))
        at = self.geometry, stacked(self.geometry, geometries), steps, self.state, self.clock
        return self.model.reduce(*at, mount, noise, probes, extra, self.rate)

    def _columns_of(self, found: Signatures) -> tuple[SparseColumns, SparseColumns]:
        return found.readings, found.slips.in_rows(self.model.slip_rows)

    @property
    def redundant(self) -> bool:
        """Whether encoders can contradict each other: they determine more than the three directions of motion."""
        return len(self.model.rows) > 3

    def score_by_volume(self, mount: Array, noise: Noise) -> tuple[Array, Array]:
        """Return what the volume of likely states adds to the score of the amplitudes and of the mount (see
        `LogLikelihood`). Where encoders contradict each other, they tell so much more that it is left out: 0."""
        found = np.zeros(sum(candidate.columns for candidate in self.candidates))
        if self.redundant:
            return found, np.zeros(3)
        at = self.geometry, self.geometries, self.steps, self.state, self.clock
        found[: len(self.steps)], of_mount = self.model.score_by_volume(*at, mount, noise)
        return found, of_mount


def columns_of(candidates: Iterable[Candidate]) -> dict[Candidate, NDArray[np.intp]]:
    """Return the column numbers of each of several candidates in sequence; one that comes again has the same."""
    columns: dict[Candidate, NDArray[np.intp]] = {}
    end = 0
    for candidate in dict.fromkeys(candidates):
        columns[candidate] = np.arange(end, end + candidate.columns)
        end += candidate.columns
    return columns


def numbers_of(candidates: Sequence[Candidate], columns: Mapping[Candidate, NDArray[np.intp]]) -> NDArray[np.intp]:
    """Return the column numbers of candidates, one after another, given those of each."""
    return np.concatenate([np.zeros(0, dtype=np.intp), *(columns[candidate] for candidate in candidates)])


@dataclass(frozen=True, eq=False)
class SharedNuisances:
    """Nuisances that all logs share, with their priors.

    creep (1 + rows,): factors of predicted creep (`Slipping.columns`): that under forces, and by how much more than
    predicted each row creeps where wheels disagree; expected, doubt (1 + rows,): their prior means and standard
    deviations. mount (3,): place of the tracked point. told: whether logs tell how much contacts creep under forces;
    always false where clean logs did.
    """

    creep: Array
    expected: Array
    doubt: Array
    mount: Array
    told: bool

    def add_priors(self, information: Array, gradient: Array, first: int) -> None:
        """Add the priors of the numbers from `first` on: of the factors of creep; of each row's constant creep, if it
        is among the numbers; and of the tracked point."""
        constant, mount = first + len(self.creep), len(information) - len(self.mount)
        creep, at, mount = range(first, constant), range(constant, mount), range(mount, len(information))
        information[creep, creep] += self.doubt**-2.0
        information[at, at] += CREEP**-2
        information[mount, mount] += MOUNT**-2.0
        gradient[creep, 0] += (self.creep - self.expected) / self.doubt**2
        gradient[mount, 0] += self.mount / MOUNT**2


def joint(
    reductions: Sequence[tuple[Sequence[Candidate], Reduced]],
) -> tuple[int, Array, Array, list[NDArray[np.intp]]]:
    """Return the number of amplitudes of all candidates of several logs, and the joint information and gradient of
    these, then of the numbers that all logs share; and the places of each log's numbers among these."""
    columns = columns_of(candidate for log_candidates, _ in reductions for candidate in log_candidates)
    count = sum(map(len, columns.values()))
    size = count + len(reductions[0][1].information) - sum(candidate.columns for candidate in reductions[0][0])
    information, gradient = np.zeros((size, size)), np.zeros((size, reductions[0][1].gradient.shape[1]))
    numbers = []
    for log_candidates, reduced in reductions:
        at = np.concatenate([numbers_of(log_candidates, columns), np.arange(count, size)])
        information[np.ix_(at, at)] += reduced.information
        gradient[at] += reduced.gradient
        numbers.append(at)
    return count, information, gradient, numbers


def schur_complement(information: Array, gradient: Array, n: int) -> tuple[Array, Array]:
    """Return information (n, n) and score (n,) of the first n numbers, the others eliminated by a Schur complement."""
    solved = np.linalg.solve(information[n:, n:], np.column_stack([information[n:, :n], gradient[n:]]))
    eliminated = information[:n, :n] - information[:n, n:] @ solved[:, :n]
    return (eliminated + eliminated.T) / 2, -(gradient[:n] - information[:n, n:] @ solved[:, n])


def reestimated_noise(
    logs: Sequence[DesignMatrix], chosen: Sequence[Candidate], shared: SharedNuisances, noise: Noise
) -> Noise:
    """Return the noise re-estimated beside candidates of maximum-likelihood sizes; no size becomes larger."""
    found = noise
    for _ in range(NOISE_ROUNDS):
        reductions = [log.reduce(shared.mount, found, chosen, PROBES) for log in logs]
        log_candidates = [[candidate for candidate in log.candidates if candidate in chosen] for log in logs]
        count, information, gradient, numbers = joint(list(zip(log_candidates, reductions, strict=True)))
        shared.add_priors(information, gradient, count)
        scale = np.sqrt(np.maximum(np.diag(information), 1e-30))
        moved = -least_squares(information / np.outer(scale, scale), gradient / scale[:, None]) / scale[:, None]
        left = [reduced.finish(moved[at])[2] for reduced, at in zip(reductions, numbers, strict=True)]
        del reductions  # 6 KB a sample, which the next round would hold twice
        last, found = found, resized(found, left)
        changes = [new / old - 1 for new, old in zip(astuple(found), astuple(last), strict=True)]
        if max(abs(change) for change in changes) < SAME:
            break
    return Noise(**{name: min(size, getattr(noise, name)) for name, size in asdict(found).items()})
