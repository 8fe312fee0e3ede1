"""Shows the author of an estimator what is wrong with it before a benchmark does.

Runs the estimator on short noise-free drives of one robot or train, in this process and without a time limit: an
estimator that hangs hangs the check. ``castor-bench check`` runs it in a separate process, with a time limit.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from castor_envs.errors import one_line
from castor_envs.processes import end_if_forked, what_plug_ins_raise
from castor_envs.sensors.observation import Observations as SampledObservations
from castor_envs.vehicles.load import Vehicle, load_vehicle
from castor_envs.vehicles.presets import preset_names, train_names
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription
from estimators.plugins.conformance import conduct, poses
from estimators.plugins.conformance.subject import Subject, Wrong, drives_of, place
from estimators.plugins.registry import EstimatorEntry, declines, reset_at_origin


@dataclass(frozen=True)
class Finding:
    """One thing checked: its name, whether it is right, and otherwise what is wrong and what to do."""

    name: str
    passed: bool
    message: str = ""


def check(entry: EstimatorEntry, vehicle: Vehicle | None = None, brief: bool = False) -> list[Finding]:
    """Return what was checked of an estimator, in the order of the checks.

    vehicle: robot or train to check on; None takes the first preset, in the order of `candidates`, that the estimator
    serves. brief: only whether it gives poses, starts at the start and stays near the truth, for further layouts of an
    estimator that has passed the rest. What the estimator raises becomes a finding. If it does not return poses at all,
    nothing further is checked.
    """
    findings = [_finding(entry, "is constructed without arguments", entry.factory)]
    if findings[-1].passed:
        subject = Subject(entry, vehicle or load_vehicle(_served_preset(entry)))
        for name, run in _FIRST.items():
            findings.append(_finding(entry, name, lambda run=run: run(subject)))
            if not findings[-1].passed:
                return findings
        is_train = isinstance(subject.vehicle, TrainDescription)
        checks = _BRIEF if brief else _CHECKS | (_OF_TRAINS if is_train else _OF_ROBOTS)
        findings += [_finding(entry, name, lambda run=run: run(subject)) for name, run in checks.items()]
        if entry.batched and not brief and isinstance(subject.vehicle, RobotDescription):
            findings.append(
                _finding(entry, "gives in a batch what it gives alone", lambda: conduct.batch(subject), conduct.BATCHED)
            )
    return findings


def candidates() -> list[str]:
    """Return the presets in the order in which they are tried until an estimator serves one."""
    return list(dict.fromkeys(["asoc-prototype", "differential", *preset_names(), "cfmmr-3", *train_names()]))


def refusal(entry: EstimatorEntry, vehicle: Vehicle) -> str | None:
    """Return why the estimator's `reset`, or a smoother's `estimate`, declines a robot or a train; None if it does not.

    Other failures are left for `check` to find.
    """
    try:
        estimator = entry.factory()
    except what_plug_ins_raise():
        return None
    try:
        if entry.smoother:
            shape = (vehicle.n_axles, 3) if isinstance(vehicle, TrainDescription) else (3,)
            seen = SampledObservations.of(drives_of(vehicle)[0].observations)
            estimator.estimate(vehicle, np.zeros(shape), seen)
        else:
            reset_at_origin(estimator, vehicle)
    except what_plug_ins_raise() as error:
        return declines(error, vehicle)
    return None


def _served_preset(entry: EstimatorEntry) -> str:
    served = (name for name in candidates() if refusal(entry, load_vehicle(name)) is None)
    return next(served, candidates()[0])


def _finding(entry: EstimatorEntry, name: str, run: Callable[[], object], advice: str = "") -> Finding:
    """Run one check; an exception becomes the finding."""
    try:
        run()
    except Wrong as wrong:
        return Finding(name, False, str(wrong))
    except what_plug_ins_raise() as error:
        end_if_forked()
        return Finding(name, False, f"raises {one_line(error)} {place(entry, error)}{advice and ': ' + advice}")
    return Finding(name, True)


_FIRST: dict[str, Callable[[Subject], None]] = {
    "serves the robot": conduct.serves,
    "returns three finite numbers": conduct.returns_poses,
}

_CHECKS: dict[str, Callable[[Subject], None]] = {
    "returns the start pose first": poses.starts_at_start,
    "drives straight where the robot does": poses.drives_straight,
    "turns as the robot does": poses.turns_as_the_vehicle,
    "keeps psi unwrapped": poses.keeps_psi_unwrapped,
    "moves and turns with the start pose": poses.moves_with_start,
    "is deterministic": conduct.is_deterministic,
    "forgets all at reset": conduct.is_reset,
    "leaves its input alone": conduct.leaves_input_alone,
    "says how sure it is, if it does": conduct.says_how_sure_it_is,
    "takes the start's covariance, if it wants it": conduct.takes_start_covariance,
}

_BRIEF: dict[str, Callable[[Subject], None]] = {
    "returns the start pose first": poses.starts_at_start,
    "drives straight where the robot does": poses.drives_straight,
    "stays near the truth in bends": poses.stays_near,
}

_OF_ROBOTS: dict[str, Callable[[Subject], None]] = {
    "stays near the truth in bends": poses.stays_near,
    "reads pivot counts that wrap": poses.reads_wrapped_pivots,
}

_OF_TRAINS: dict[str, Callable[[Subject], None]] = {
    "drives round where the train does": poses.drives_round,
    "survives missing relative poses": poses.survives_silence,
}
