"""UMBmark as measured: OptiOdom's squares of a real differential robot, against its motion-capture truth.

R. B. Sousa, M. R. Petry, P. G. Costa, A. P. Moreira, *OptiOdom* (data under the MIT licence). The data are not part
of this project: they are looked for below a folder that holds them as ``optiodom/``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.tasks.task import Calibration, Case, Episode, Run, Task
from castor_envs.files import digest_of
from castor_envs.logs.importers.optiodom import (
    REFERENCE_NOISE,
    find_sessions,
    published_correction,
    published_sessions,
    read_session,
)
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.protocol import Recording


@dataclass(frozen=True)
class MeasuredUMBmark:
    """The measured squares; every case is a session, whose runs went round three times each way.

    data: the folder that holds ``optiodom/``, or None. corrected: whether estimators get the robot with the
    parameters that the authors published after their UMBmark calibration (of the same runs), or with the nominal
    ones.
    """

    name: str
    title: str
    description: str
    corrected: bool
    data: Path | None
    version: int = 1
    metric: str = "E_max_syst"
    group: str = "umbmark-measured"
    standard: bool = True

    @property
    def robot(self) -> RobotDescription:
        """A robot of the layout that drove."""
        return preset("differential")

    @property
    def missing(self) -> str | None:
        """Say what is missing and how to give it, or None."""
        return _missing(self.data)

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the names of the first n sessions."""
        return published_sessions()[:n]

    def record(self, case: Case) -> Episode:
        """Return a session's runs."""
        if self.data is None:
            raise ValueError(self.missing)
        session = read_session(find_sessions(self.data)[str(case)])
        robot = published_correction(session.name).apply(session.robot) if self.corrected else session.robot
        driven = zip(session.runs, session.directions, strict=True)
        return Episode(robot, tuple(Run(log, way, reference_noise=REFERENCE_NOISE) for log, way in driven))

    def source_digest(self, case: Case) -> str:
        """Return a hash of a session's files."""
        if self.data is None:
            raise ValueError(self.missing)
        return digest_of(find_sessions(self.data)[str(case)])


@dataclass(frozen=True)
class MeasuredCalibration:
    """OptiOdom's measured squares: in each direction, the odd runs are for calibration, the even ones for the test.

    A case is a session with three runs each way: first and third are recordings, with motion-capture poses in every
    row; the second is a test run. The nominal robot is the robot file; nobody knows the true parameters. Dead reckoning
    follows the test runs.

    data: the folder that holds ``optiodom/``, or None.
    """

    data: Path | None
    name: str = "calibration-measured"
    title: str = "Calibration by measured squares, differential robot"
    description: str = (
        "OptiOdom sessions 230620202042 and 230620202144: the first and third run each way calibrate, the second tests."
    )
    version: int = 1
    metric: str = "E_max_syst"
    group: str = "calibration"
    standard: bool = True
    followed_by: str = "dead-reckoning-1"

    @property
    def robot(self) -> RobotDescription:
        """A robot of the layout that drove."""
        return preset("differential")

    @property
    def missing(self) -> str | None:
        """Say what is missing and how to give it, or None."""
        return _missing(self.data)

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the names of the first n sessions."""
        return published_sessions()[:n]

    def record(self, case: Case) -> Episode:
        """Return a session's runs, divided into recordings and test runs."""
        if self.data is None:
            raise ValueError(self.missing)
        session = read_session(find_sessions(self.data)[str(case)])
        recordings, runs = [], []
        for way in ("cw", "ccw"):
            logs = [log for log, gone in zip(session.runs, session.directions, strict=True) if gone == way]
            recordings += [Recording(log, side=session.side) for log in logs[::2]]
            runs += [Run(log, way) for log in logs[1::2]]
        return Episode(session.robot, tuple(runs), Calibration.by(self.followed_by, recordings))

    def source_digest(self, case: Case) -> str:
        """Return a hash of a session's files."""
        if self.data is None:
            raise ValueError(self.missing)
        return digest_of(find_sessions(self.data)[str(case)])


def _missing(data: Path | None) -> str | None:
    if data is None:
        return "measured data not given: pass --measured DIR or set CASTOR_DATA (DIR holds the data as optiodom/)"
    absent = [name for name in published_sessions() if name not in find_sessions(data)]
    return f"measured sessions missing below {data}: {', '.join(absent)}" if absent else None


def tasks(measured: Path | None) -> tuple[Task, ...]:
    """Return the measured tasks of estimators (`calibration` has that of methods); they say where data are missing."""
    return (
        MeasuredUMBmark(
            name="umbmark-measured-nominal",
            title="UMBmark measured on a differential robot, nominal parameters",
            description="OptiOdom sessions 230620202042 and 230620202144, nominal wheel base and diameters.",
            corrected=False,
            data=measured,
        ),
        MeasuredUMBmark(
            name="umbmark-measured-corrected",
            title="UMBmark measured on a differential robot, published corrections",
            description="The same runs, wheel base and diameters as the authors published after calibration.",
            corrected=True,
            data=measured,
        ),
    )
