"""What a calibration method is: anything with `calibrate` as below. No base class is needed."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, runtime_checkable

from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription


@dataclass(frozen=True, eq=False)
class Recording:
    """One log for calibration, with what its maker knows of it.

    log: its reference, where there is one, may be known in some rows only (the first and the last). held: the castor
    (from 1) whose wheels were blocked, or None. side: of the UMBmark square that was driven, m, or None. name: of the
    log's file, for messages.
    """

    log: Log
    held: int | None = None
    side: float | None = None
    name: str = ""


def in_recording(error: InputError, recording: Recording) -> InputError:
    """Return an error that says in which recording it is, if that has a name."""
    return type(error)(f"{recording.name}: {error}") if recording.name else error


@runtime_checkable
class CalibrationMethod(Protocol):
    """Finds a robot's parameters in logs of its own. The class is constructed without arguments."""

    def calibrate(self, robot: RobotDescription, recordings: Sequence[Recording], /) -> RobotDescription:
        """Return the robot with the parameters that the recordings tell, its layout unchanged.

        robot: as its user describes it. Raises `Declined` (`castor_envs.errors`) where the method does not serve this
        robot or such recordings; whatever else it raises is a fault, of its own or in the recordings.
        """
        ...


@dataclass(frozen=True)
class Result:
    """One number of the robot file: before, after, and its standard error (None where no method tells it), in `unit`.

    unit: "m", "rad" or "1". seen: "no": it keeps the file's number; "partly": the error holds only if what is not seen,
    and moves this number by more, is right in the file. rests_on: what that is.
    """

    name: str
    unit: str
    before: float
    after: float
    standard_error: float | None
    seen: Literal["yes", "partly", "no"] = "yes"
    rests_on: tuple[str, ...] = ()


@dataclass(frozen=True)
class Report:
    """What a method found, for people and programs.

    unseen: what the logs do not show, by what it is called in `Result.rests_on`, with a sentence about it. remarks:
    further sentences. more: plain data for programs, beside the results.
    """

    results: tuple[Result, ...]
    calibrated: RobotDescription
    unseen: dict[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    more: dict[str, Any] = field(default_factory=dict)


@runtime_checkable
class ReportingMethod(CalibrationMethod, Protocol):
    """A method that says more than its robot; ``castor-bench calibrate`` shows it.

    title: what it does, in a line. Of its class: takes_squares, whether it needs `Recording.side`; finds_pivots,
    whether it is made with ``pivots=True`` to find the places of free castors' pivots too.
    """

    title: str
    takes_squares: bool
    finds_pivots: bool

    def report(self, robot: RobotDescription, recordings: Sequence[Recording], /) -> Report:
        """Return what the recordings tell; raises as `calibrate` does."""
        ...
