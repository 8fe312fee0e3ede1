"""The conformance check in a worker process, which also detects a plug-in that hangs or ends its process."""

from collections import deque
from collections.abc import Callable
from typing import Any

from castor_envs.errors import InputError
from castor_envs.processes import Died, Done, Exceeded, Job, Raised, TimedOut, run_jobs
from castor_envs.vehicles.load import Vehicle, load_vehicle
from estimators.plugins import conformance
from estimators.plugins.conformance import Finding
from estimators.plugins.registry import CalibrationEntry, EstimatorEntry, load_estimator

Load = Callable[[str], EstimatorEntry] | Callable[[str], CalibrationEntry]
"""`load_estimator` or `load_calibration`."""


def check_apart(spec: str, robot: Vehicle | None, timeout: float, say: Callable[[str], None]) -> list[Finding]:
    """Check an estimator in a separate process; returns what was found.

    robot: what to check on; None takes the first preset that the estimator serves. timeout: s, for each of loading the
    estimator, asking it whether it serves a robot, and the check. say: called first with what is checked, and on which
    robot.

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
        declined: dict[str, list[str]] = {}
        for candidate in conformance.candidates():
            try:
                reason = worker.call(_refusal, spec, load_vehicle(candidate))
            except _LostError as lost:
                say(_header(name, candidate, declined))
                return [lost.finding]
            if reason is None:
                say(_header(name, candidate, declined))
                return _findings(worker, spec, load_vehicle(candidate))
            declined.setdefault(reason, []).append(candidate)
        first = conformance.candidates()[0]
        say(f"checking {name} on preset {first!r} (it declines every preset)")
        return _findings(worker, spec, load_vehicle(first))
    finally:
        worker.close()


def load_apart(spec: str, timeout: float, load: Load = load_estimator) -> None:
    """Load a plug-in in a separate process; raises InputError if it cannot be, hangs or ends its process."""
    worker = _Worker(timeout)
    kind = "estimator" if load is load_estimator else "calibration method"
    try:
        worker.call(conformance.candidates, limited=False)
        worker.call(_name, spec, load)
    except _LostError as lost:
        raise InputError(f"{kind} {spec!r} cannot be loaded: {lost.finding.message}") from None
    except RuntimeError as error:
        raise InputError(f"{kind} {spec!r} cannot be loaded: {error}") from None
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
        self._jobs: deque[Job] = deque()
        self._outcomes = run_jobs(self, 1)

    def next_job(self) -> Job | None:
        return self._jobs.popleft() if self._jobs else None

    def call(self, function: Callable[..., Any], *arguments: Any, limited: bool = True) -> Any:
        """Return what the function returns; raises _LostError, RuntimeError, or an InputError that it returns."""
        self._jobs.append(Job(function, arguments, timeout=self._timeout if limited else None))
        match next(self._outcomes)[1]:
            case Done(InputError() as error):
                raise error
            case Done(value):
                return value
            case TimedOut():
                raise _LostError("answers in time", f"took over {self._timeout:g} s; --timeout gives it more")
            case Died(exit_code):
                raise _LostError("stays alive", f"ended its process (exit code {exit_code})")
            case Exceeded(excess):
                raise _LostError("stays within its limits", excess)
            case Raised() as raised:
                raise raised.again("a worker process failed")

    def close(self) -> None:
        self._outcomes.close()


def _findings(worker: _Worker, spec: str, robot: Vehicle) -> list[Finding]:
    try:
        return worker.call(_check, spec, robot)
    except _LostError as lost:
        return [lost.finding]


def _header(name: str, robot: str, declined: dict[str, list[str]]) -> str:
    """Return the line that names the robot, and why presets before it were declined."""
    reasons = "; ".join(f"{', '.join(robots)}: {reason}" for reason, robots in declined.items())
    return f"checking {name} on preset {robot!r}" + (f" (declined: {reasons})" if reasons else "")


# The functions below run in the worker process. They return the InputError of a wrong spec: what they raise comes
# back as text.


def _ready() -> None:
    import scipy.integrate  # noqa: F401


def _name(spec: str, load: Load = load_estimator) -> str | InputError:
    try:
        return load(spec).name
    except InputError as error:
        return error


def _refusal(spec: str, robot: Vehicle) -> str | None:
    return conformance.refusal(load_estimator(spec), robot)


def _check(spec: str, robot: Vehicle) -> list[Finding] | InputError:
    try:
        return conformance.check(load_estimator(spec), robot)
    except InputError as error:
        return error
