"""Drives of measured robots: every session that a folder holds is a case."""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path

from benchmarks.tasks.measured_runs.body_reference import Calibrated, calibrated, of_body
from benchmarks.tasks.measured_runs.splits import divided, grip
from benchmarks.tasks.task import Case, Episode, Run
from castor_envs.errors import Declined, InputError
from castor_envs.files import digest_of
from castor_envs.logs.importers import importer
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription


@dataclass(frozen=True)
class MeasuredDrives:
    """Test runs of measured sessions, with the nominal robot file or the one that their calibration runs give.

    data: the folder that holds the data, or None. importer: the name of their importer. layout: whether a robot is of
    this task. like: the preset of such a robot. source: where to get the data, in words. calibrated: whether estimators
    get the calibrated robot. way: least true path of a test run, m; the error over 1 m needs more than that. one_robot:
    all sessions are of one robot, on floors where it slips, and of one clock. It is then calibrated by the session in
    which it slips least, since dimensions fitted to slip are none. The reference is the body's pose at the odometry's
    times, whichever robot file estimators get (`body_reference`).
    """

    name: str
    title: str
    description: str
    data: Path | None
    importer: str
    layout: Callable[[RobotDescription], bool]
    like: str
    source: str
    calibrated: bool
    way: float = 1.2
    one_robot: bool = False
    version: int = 1
    metric: str = "rpe_translation"
    group: str = "measured-drives"
    standard: bool = True

    @property
    def robot(self) -> RobotDescription:
        """A robot of the layout that drove."""
        return preset(self.like)

    @property
    def missing(self) -> str | None:
        """Say what is missing and how to give it, or None."""
        if self.data is None:
            return f"measured data not given: pass --measured DIR or set CASTOR_DATA ({self.source})"
        try:
            found = self._sessions()
        except InputError as error:
            return str(error)
        if not found:
            return f"{self.data}: holds no session for {self.name} that is long enough to be divided ({self.source})"
        return None

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the names of the folder's first n sessions; none without a folder."""
        return () if self.missing is not None else tuple(self._sessions())[:n]

    def record(self, case: Case) -> Episode:
        """Return a session's test runs."""
        if self.data is None:
            raise ValueError(self.missing)
        path = _found(self.importer, self.data)[str(case)]
        by = max(self._sessions().values(), key=self._grip) if self.one_robot else path
        session = _session(self.importer, path, self.way)
        assert session is not None
        robot, _, tests = session
        try:
            found = _calibrated(self.importer, by, self.way, self.one_robot)
            noise = importer(self.importer).reference_noise
            runs = tuple(Run(log, reference_noise=noise) for log in of_body(found, tests, self.one_robot))
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        return Episode(found.robot if self.calibrated else robot, runs)

    def source_digest(self, case: Case) -> str:
        """Return a hash of a session's files; of one robot's sessions of all, as one calibrates for the others."""
        if self.data is None:
            raise ValueError(self.missing)
        sources = _sources(self.importer, self.data)
        if self.one_robot:
            return hashlib.sha256(repr(sources).encode()).hexdigest()[:16]
        return sources[str(case)]

    def _grip(self, path: Path) -> float:
        session = _session(self.importer, path, self.way)
        return 0.0 if session is None else grip(session[1])

    def _sessions(self) -> dict[str, Path]:
        assert self.data is not None
        found = _found(self.importer, self.data)
        return {name: path for name, path in found.items() if self._serves(_session(self.importer, path, self.way))}

    def _serves(self, session: "Divided | None") -> bool:
        return session is not None and self.layout(session[0]) and bool(session[1]) and bool(session[2])


Divided = tuple[RobotDescription, tuple, tuple]


@cache  # a run asks for each case's name, and to look for them walks all folders
def _found(name: str, data: Path) -> Mapping[str, Path]:
    """Return the sessions in a folder, by name."""
    return importer(name).find(data)


@cache
def _sources(name: str, data: Path) -> Mapping[str, str]:
    """Return a hash of the files of each session in a folder, by name."""
    return {session: digest_of(path) for session, path in _found(name, data).items()}


@cache
def _session(name: str, path: Path, way: float) -> Divided | None:
    """Return the robot of a session, its calibration runs and its test runs; None of what is no robot, or of a kind
    that the importer does not know."""
    try:
        session = importer(name).read(path)
    except Declined:
        return None
    return (session.vehicle, *divided(session.runs, way)) if isinstance(session.vehicle, RobotDescription) else None


@lru_cache(maxsize=4)  # a nominal and a calibrated task ask for the same in turn
def _calibrated(name: str, path: Path, way: float, one_clock: bool) -> Calibrated:
    """Return what the calibration runs of a session give."""
    session = _session(name, path, way)
    assert session is not None
    robot, recordings, _ = session
    return calibrated(robot, recordings, one_clock)
