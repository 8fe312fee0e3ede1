"""The conformance check in a worker process, which also detects a plug-in that hangs or ends its process."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from castor_envs.errors import InputError
from castor_envs.processes import Died, Done, Exceeded, Job, OneWorker, Raised, TimedOut
from castor_envs.vehicles.load import Vehicle, load_vehicle
from castor_envs.vehicles.presets import preset_names, train_names
from estimators.plugins.conformance import check as conformance
from estimators.plugins.conformance.check import Finding
from estimators.plugins.registry import CalibrationEntry, EstimatorEntry, load_calibration, load_estimator

Load = Callable[[str], EstimatorEntry] | Callable[[str], CalibrationEntry]
"""`load_estimator` or `load_calibration`."""

HANGS, ENDS, EXCEEDS = LOST = ("answers in time", "stays alive", "stays within its limits")
"""Names of the findings of a worker process that had to be given up."""


def check_apart(spec: str, robot: Vehicle | None, timeout: float, say: Callable[[str], None]) -> list[Finding]:
    """Check an estimator in a separate process; returns what was found.

    robot: what to check on; None takes all presets that the estimator serves: the first robot and the first train for
    all checks, the others for the brief ones, until a step hangs or ends the process. timeout: s, for each of loading
    the estimator, asking it whether it serves a preset, and the checks on one. say: called first with what is checked,
    on which robot, and which presets are declined.

    Raises InputError if the spec is wrong, or the robot cannot be checked on.
    """
    worker = _Worker(timeout)
    try:
        worker.call(_ready, limited=False)  # the time to import this project and what checks need is not the plug-in's
        try:
            name = worker.call(_name, spec)
        except _LostError as lost:
            say(f"checking {spec}")
            return [lost.finding]
        if robot is not None:
            say(f"checking {name} on robot {robot.name!r}")
            return _findings(worker, spec, robot)
        return _findings_on_presets(worker, spec, name, say)
    finally:
        worker.close()


def load_apart(spec: str, timeout: float, load: Callable[[str], Any] = load_estimator) -> None:
    """Load a plug-in in a separate process; raises InputError if it cannot be, hangs or ends its process."""
    worker = _Worker(timeout)
    kind = {load_estimator: "estimator", load_calibration: "calibration method"}.get(load, "task")
    try:
        worker.call(conformance.candidates, limited=False)
        worker.call(_name, spec, load)
    except _LostError as lost:
        raise InputError(f"{kind} {spec!r} cannot be loaded: {lost.finding.message}") from None
    except RuntimeError as error:
        raise InputError(f"{kind} {spec!r} cannot be loaded: {error}") from None
    finally:
        worker.close()


def refusals_apart(spec: str, vehicles: Sequence[Vehicle], timeout: float) -> list[str | None]:
    """Return why a plug-in declines each robot or train, None where it does not, asked in a separate process.

    timeout: s, for each. Where it hangs or ends its process, None: the run will find out.
    """
    worker, reasons = _Worker(timeout), []
    try:
        worker.call(_ready, limited=False)
        for vehicle in vehicles:
            try:
                reasons.append(worker.call(_refusal, spec, vehicle))
            except (_LostError, RuntimeError):
                return [*reasons, *[None] * (len(vehicles) - len(reasons))]
        return reasons
    finally:
        worker.close()


class _LostError(Exception):
    """The worker process hung or ended; `finding` says so."""

    def __init__(self, name: str, message: str):
        super().__init__(message)
        self.finding = Finding(name, False, message)


class _Worker:
    """Calls one function after another in a worker process, each with a time limit."""

    def __init__(self, timeout: float):
        self._timeout = timeout
        self._process = OneWorker()

    def call(self, function: Callable[..., Any], *arguments: Any, limited: bool = True) -> Any:
        """Return what the function returns; raises _LostError, RuntimeError, or an InputError that it returns."""
        match self._process.outcome(Job(function, arguments, timeout=self._timeout if limited else None)):
            case Done(InputError() as error):
                raise error
            case Done(value):
                return value
            case TimedOut():
                raise _LostError(HANGS, f"took over {self._timeout:g} s; --timeout gives it more")
            case Died(exit_code):
                raise _LostError(ENDS, f"ended its process (exit code {exit_code})")
            case Exceeded(excess):
                raise _LostError(EXCEEDS, excess)
            case Raised() as raised:
                raise raised.again("a worker process failed")

    def close(self) -> None:
        self._process.close()


def _findings(worker: _Worker, spec: str, robot: Vehicle, brief: bool = False) -> list[Finding]:
    try:
        return worker.call(_check, spec, robot, brief)
    except _LostError as lost:
        return [lost.finding]


def _findings_on_presets(worker: _Worker, spec: str, name: str, say: Callable[[str], None]) -> list[Finding]:
    """Return the findings on all presets that an estimator serves, those on further ones one a preset at most."""
    served: list[str] = []
    declined: dict[str, list[str]] = {}
    for preset in conformance.candidates():
        vehicle = load_vehicle(preset)
        try:
            reason = worker.call(_refusal, spec, vehicle)
        except _LostError as lost:
            say(f"checking {name} on preset {preset!r}")
            return [lost.finding]
        if reason is None:
            served.append(preset)
        else:
            declined.setdefault(reason.replace(repr(vehicle.name), "'...'"), []).append(preset)
    if not served:
        first = conformance.candidates()[0]
        say(f"checking {name} on preset {first!r} (it declines every preset)")
        return _findings(worker, spec, load_vehicle(first))
    wholly = [of[0] for kind in (preset_names, train_names) if (of := [one for one in served if one in kind()])]
    further = [preset for preset in served if preset not in wholly]
    briefly = f", briefly on {', '.join(further)}" if further else ""
    say(f"checking {name} on preset {' and '.join(map(repr, wholly))}{briefly}")
    for reason, presets in declined.items():
        say(f"declined: {', '.join(presets)}: {reason}")
    findings = []
    for preset in wholly:
        on = f" (on {preset})" if len(wholly) > 1 else ""
        found = _findings(worker, spec, load_vehicle(preset))
        findings += [replace(finding, name=f"{finding.name}{on}") for finding in found]
        if _lost(found):
            return findings
    passed: list[str] = []
    failed: dict[str, dict[str, str]] = {}
    for preset in further:
        vehicle = load_vehicle(preset)
        found = _findings(worker, spec, vehicle, brief=True)
        wrong = next((finding for finding in found if not finding.passed), None)
        if wrong is None:
            passed.append(preset)
        else:
            failed.setdefault(wrong.name, {})[preset] = wrong.message.replace(repr(vehicle.name), "'...'")
        if _lost(found):
            break
    if passed:
        findings.append(Finding(f"stays near the truth on {', '.join(passed)}", True))
    return [*findings, *(_on_all(name, messages) for name, messages in failed.items())]


def _on_all(name: str, messages: dict[str, str]) -> Finding:
    """Return one finding for what is wrong alike on presets, with the first of its messages, by preset."""
    first, message = next(iter(messages.items()))
    where = "" if len(set(messages.values())) == 1 else f"on {first}, "
    return Finding(f"{name} (on {', '.join(messages)})", False, where + message)


def _lost(findings: list[Finding]) -> bool:
    """Return whether the worker hung or ended during a check, so that it may do so during the next."""
    return [finding.name for finding in findings if not finding.passed] in ([name] for name in LOST)


# The functions below run in the worker process. They return the InputError of a wrong spec: what they raise comes
# back as text.


def _ready() -> None:
    import scipy.integrate  # noqa: F401


def _name(spec: str, load: Callable[[str], Any] = load_estimator) -> str | InputError:
    try:
        return load(spec).name
    except InputError as error:
        return error


def _refusal(spec: str, robot: Vehicle) -> str | None:
    return conformance.refusal(load_estimator(spec), robot)


def _check(spec: str, robot: Vehicle, brief: bool) -> list[Finding] | InputError:
    try:
        return conformance.check(load_estimator(spec), robot, brief)
    except InputError as error:
        return error
