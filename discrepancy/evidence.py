"""What logs say for and against every candidate, all else eliminated: one linear problem."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from castor_envs.kinematics import Array, Geometry
from castor_envs.logs import Log
from castor_envs.robot import RobotDescription
from discrepancy.candidates import Candidate, correction_of, signatures_of
from estimators.calibration.log_likelihood import LogLikelihood, Noise
from estimators.calibration.maximum_likelihood import MOUNT, State, fitted

BURST = 0.05
"""Part of a log's steps in which slip that comes in bursts is looked for."""

PARAMETERS = ("pivot", "offset", "pivot_zero", "angle", "lateral", "radius", "roller")


@dataclass(frozen=True)
class Burst:
    """Where most slip is: share of its squares in the worst `BURST` of all steps, and the worst step's log (from 0),
    time (s) and place (m, in the reference's frame)."""

    share: float
    log: int
    t: float
    x: float
    y: float


@dataclass(frozen=True, eq=False)
class Evidence:
    """Of P candidates: information (P, P) and pull (P,), the slope of the log-likelihood, in units of each candidate.

    left: rms of what odometry is off the reference, m and rad; None without one.
    """

    candidates: tuple[Candidate, ...]
    information: Array
    pull: Array
    noise: Noise
    state: State
    left: tuple[float, float] | None
    burst: Burst

    def best(self, chosen: Sequence[int]) -> tuple[Array, Array]:
        """Return the best amplitudes of some candidates together (c,), and their covariance (c, c)."""
        covariance = np.linalg.pinv(self.information[np.ix_(chosen, chosen)], rcond=1e-9, hermitian=True)
        return covariance @ self.pull[list(chosen)], np.asarray(covariance, dtype=float)

    def gain(self, chosen: Sequence[int]) -> float:
        """Return the deviance that some candidates take away together: twice the log-likelihood that they add."""
        if not chosen:
            return 0.0
        amplitudes, _ = self.best(chosen)
        return float(amplitudes @ self.pull[list(chosen)])


def evidence_of(robot: RobotDescription, logs: Sequence[Log], noise: Noise | None = None) -> Evidence:
    """Return what logs say of all candidates beyond the effects that the robot's file has.

    noise: sizes to hold to; None: found. Raises InputError for logs that the robot cannot have made.
    """
    geometry = Geometry.of(robot.as_built())
    models = [LogLikelihood(geometry, log) for log in logs]
    at, sizes, _ = fitted(models, geometry, (), np.zeros(0), noise)
    if robot.effects:  # What its sensors make of angles is known: take it off the counts, and settle again.
        for model, log, state in zip(models, logs, at.states, strict=True):
            model.correct(correction_of(robot, log, state))
        at, sizes, _ = fitted(models, geometry, (), np.zeros(0), noise)
    information, gradient, names = np.zeros(()), np.zeros(()), ()
    for model, log, state, clock in zip(models, logs, at.states, at.clocks, strict=True):
        found = signatures_of(robot, log, state)
        changed = _stacked(found.geometries)
        reduced = model.reduce(geometry, changed, found.steps, state, clock, at.mount, sizes, 0, found.readings)
        information, gradient, names = (
            information + reduced.information,
            gradient + reduced.gradient[:, 0],
            found.candidates,
        )
    n = len(names)
    information[n:, n:] += np.diag(MOUNT**-2.0)
    gradient[n:] += at.mount / MOUNT**2
    both = np.linalg.solve(information[n:, n:], np.column_stack([information[n:, :n], gradient[n:]]))
    told = information[:n, :n] - information[:n, n:] @ both[:, :n]
    pull = -(gradient[:n] - information[:n, n:] @ both[:, n])
    return Evidence(
        names, (told + told.T) / 2, pull, sizes, at, _left(models, geometry, at), _burst(models, logs, geometry, at)
    )


def _left(models: Sequence[LogLikelihood], geometry: Geometry, at: State) -> tuple[float, float] | None:
    tracked = [one for one in zip(models, at.states, at.clocks, strict=True) if one[0].poses]
    if not tracked:
        return None
    off = np.concatenate([model.errors(geometry, state, clock, at.mount) for model, state, clock in tracked])
    return float(np.sqrt(np.mean(np.sum(off[:, :2] ** 2, axis=1)))), float(np.sqrt(np.mean(off[:, 2] ** 2)))


def _burst(models: Sequence[LogLikelihood], logs: Sequence[Log], geometry: Geometry, at: State) -> Burst:
    slips = [np.sum(model.missed(geometry, state) ** 2, axis=1) for model, state in zip(models, at.states, strict=True)]
    ordered = np.sort(np.concatenate(slips))[::-1]
    share = float(ordered[: max(1, round(BURST * len(ordered)))].sum() / max(ordered.sum(), 1e-30))
    worst = int(np.argmax([slip.max() for slip in slips]))
    k = int(np.argmax(slips[worst]))
    x, y, _ = at.states[worst][k, :3].tolist()
    return Burst(share, worst, float(logs[worst].t[k]), x, y)


def _stacked(geometries: Sequence[Geometry]) -> Geometry:
    """Return several geometries of one layout as one, with a leading axis."""
    return replace(geometries[0], **{name: np.stack([getattr(one, name) for one in geometries]) for name in PARAMETERS})
