"""What a calibration method is: anything with `calibrate` as below. No base class is needed."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, get_args, runtime_checkable

from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription


@dataclass(frozen=True, eq=False)
class Recording:
    """One log for calibration, with what is known about its recording.

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


def names_of(recordings: Sequence[Recording]) -> list[str]:
    """Return what messages call recordings: by their names, or "log 1", "log 2" and so on."""
    return [recording.name or f"log {number}" for number, recording in enumerate(recordings, start=1)]


@runtime_checkable
class CalibrationMethod(Protocol):
    """Finds a robot's parameters from its logs. The class is constructed without arguments."""

    def calibrate(self, robot: RobotDescription, recordings: Sequence[Recording], /) -> RobotDescription:
        """Return the robot with the parameters estimated from the recordings, its layout unchanged.

        robot: as its user describes it. Raises `Declined` (`castor_envs.errors`) where the method does not serve this
        robot or such recordings; whatever else it raises is a fault, of its own or in the recordings.
        """
        ...


UNITS = ("m", "rad", "1")
"""Of a robot's numbers."""
Seen = Literal["yes", "partly", "no"]
SEEN: tuple[Seen, ...] = get_args(Seen)


@dataclass(frozen=True)
class Result:
    """One number of the robot file: before, after, and its standard error (None where no method gives it), in `unit`.

    unit: one of `UNITS`. seen: "no": it keeps the file's number; "partly": the error holds only if unseen changes
    that move this number by more are right in the file. rests_on: names of these changes.
    """

    name: str
    unit: str
    before: float
    after: float
    standard_error: float | None
    seen: Seen = "yes"
    rests_on: tuple[str, ...] = ()


@dataclass(frozen=True)
class Report:
    """The result of a method, for people and programs.

    unseen: changes that the logs do not show, by their name in `Result.rests_on`, each with a sentence about it.
    remarks: further sentences. more: further plain data for programs.
    """

    results: tuple[Result, ...]
    calibrated: RobotDescription
    unseen: dict[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()
    more: dict[str, Any] = field(default_factory=dict)


@runtime_checkable
class ReportingMethod(CalibrationMethod, Protocol):
    """A method that reports more than the calibrated robot; ``castor-bench calibrate`` shows the report.

    title: its principle, in a line. Attributes of its class: takes_squares, whether it needs `Recording.side`;
    finds_pivots, whether its constructor takes ``pivots=True`` to find the places of free castors' pivots too.
    """

    title: str
    takes_squares: bool
    finds_pivots: bool

    def report(self, robot: RobotDescription, recordings: Sequence[Recording], /) -> Report:
        """Return the calibrated robot with the report; raises as `calibrate` does."""
        ...
