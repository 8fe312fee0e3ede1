"""The pipeline: undo wiring, find the posterior, confirm it, replay with what is named, and propose a drive."""

from threadpoolctl import threadpool_limits

from castor_envs.effects.clocks import ClockSkew, SampleJitter
from castor_envs.errors import InputError
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.discriminating_drive import separating_drives
from discrepancy.hypotheses.candidates import without
from discrepancy.posterior.finder import RobotDiagnosis, diagnose, unexamined
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.reference import KINDS
from discrepancy.posterior.verdicts import MATERIAL, Material
from discrepancy.preflight.undo import Logs, Undone
from discrepancy.report.examined import Examined, Fit, Replays
from discrepancy.validation.replay import Replay, joined, replay


@threadpool_limits.wrap(limits=1)  # of linear algebra: small matrices, for which more threads wait for each other
def examine(
    robot: RobotDescription, logs: Logs, held_out: Logs, clean: Logs, material: Material = MATERIAL
) -> Examined:
    """Return the diagnosis of a robot by logs with their names, as `diagnosed`, with all that its report holds.

    Residuals with the named effects are those of the robot file that is written, linearised afresh from the logs.
    """
    undone = Undone(robot, logs, held_out, clean)
    return examined(undone, diagnosed(undone, material))


def examined(undone: Undone, diagnosis: RobotDiagnosis) -> Examined:
    """Return a diagnosis with all that its report holds."""
    seen = {"these logs": _fit(diagnosis, undone.logs, diagnosis.before)}
    if diagnosis.held_out is not None:
        held_out = dict(zip(undone.held_out, diagnosis.in_phase, strict=True))
        seen["held-out logs"] = _fit(diagnosis, held_out, diagnosis.held_out[0])
    drives = separating_drives(diagnosis.robot, diagnosis.answers, diagnosis.after)
    return Examined.of(undone, diagnosis, seen, drives)


def diagnosed(undone: Undone, material: Material = MATERIAL) -> RobotDiagnosis:
    """Return what logs without gross mistakes say."""
    logs, held_out, clean = (list(log_set.values()) for log_set in (undone.logs, undone.held_out, undone.clean))
    if undone.checked.slid:
        return unexamined(undone.robot, logs)
    return diagnose(undone.robot, logs, held_out, clean, undone.good, material)


def _fit(diagnosis: RobotDiagnosis, logs: Logs, before: Linearised) -> Fit:
    """Return what logs show without and with the effects named. before: the logs linearised without these."""
    explained, after = without(diagnosis.found, SampleJitter), None
    if diagnosis.found.effects[len(diagnosis.robot.effects) :]:
        after = linearise(explained, list(logs.values()), creep=diagnosis.creep, among=())
    nominal, explained = (without(vehicle, ClockSkew, *KINDS) for vehicle in (diagnosis.robot, explained))
    try:
        first = _replay(nominal, logs, before)
        replays: Replays | None = first, None if after is None else _replay(explained, logs, after)
    except InputError:  # where castors without an encoder point is not measured
        replays = None
    return Fit(logs, nominal, before, explained, after, replays)


def _replay(robot: RobotDescription, logs: Logs, seen: Linearised) -> Replay:
    mount, fitted = seen.state.mount, zip(logs.values(), seen.state.clocks, seen.state.states, strict=True)
    return joined([replay(robot, log, clock=clock, mount=mount, path=path) for log, clock, path in fitted])
