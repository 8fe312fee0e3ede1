"""Importers: published measurements of other people's robots, read as logs of robots that this package describes.

Each module of this folder is an importer and is found automatically: it defines an `IMPORTER`.
"""

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Protocol

from castor_envs.discovery import offers
from castor_envs.errors import InputError, did_you_mean
from castor_envs.files import check_new_folder, new_folder
from castor_envs.logs.csv import write_log
from castor_envs.logs.log import Log
from castor_envs.logs.reference import ReferenceNoise, TimedPoses
from castor_envs.vehicles.load import Vehicle, file_name


class Session(Protocol):
    """Runs of one vehicle, as an importer reads them."""

    @property
    def vehicle(self) -> Vehicle:
        """The vehicle as its makers describe it."""
        ...

    @property
    def runs(self) -> Sequence[Log]:
        """The recorded runs, in order."""
        ...

    @property
    def tracked(self) -> Sequence[TimedPoses]:
        """The reference of each run at its own times; none where the data have it at the times of counts."""
        ...


@dataclass(frozen=True)
class Importer:
    """How published data become logs.

    name: of the data set. recognises: whether a folder holds such data. find: the sessions in such a folder, by name;
    it raises InputError where there are none. read: a session found there; it raises InputError for anything missing
    or garbled. reference_noise: of the tracker; None where the reference is to count as exact.
    """

    name: str
    recognises: Callable[[Path], bool]
    find: Callable[[Path], Mapping[str, Path]]
    read: Callable[[Path], Session]
    reference_noise: ReferenceNoise | None = None


def importers() -> dict[str, Importer]:
    """Return all importers by name."""
    return {importer.name: importer for importer in offers(__name__, "IMPORTER")}


def importer(name: str) -> Importer:
    """Return an importer by name; raises InputError for an unknown one."""
    known = importers()
    if name not in known:
        raise InputError(f"unknown importer {name!r}{did_you_mean(name, known)}")
    return known[name]


def importer_of(source: str | os.PathLike[str]) -> Importer:
    """Return the importer that recognises a folder; raises InputError if there is none."""
    source, known = Path(source), importers()
    if not source.is_dir():
        problem = "is a file" if source.exists() else "no such folder"
        raise InputError(f"{source}: {problem}; give the folder that holds the data")
    for candidate in known.values():
        if candidate.recognises(source):
            return candidate
    raise InputError(f"{source}: no importer recognises what is in it; there are importers of {', '.join(known)}")


def import_sessions(
    source: str | os.PathLike[str], out: str | os.PathLike[str], name: str | None = None
) -> Iterator[tuple[Path, Session]]:
    """Write the sessions in `source` as logs; yield, as each is done, its folder below `out` and the session.

    A folder holds ``robot.json`` or ``train.json`` and ``run-1.csv``, ... name: of the importer; None takes the one
    that recognises the data. A session is there as a whole or not at all. Raises InputError for data that cannot be
    read, and, before anything is written, for a session whose folder is there already.
    """
    chosen = importer_of(source) if name is None else importer(name)
    found = {Path(out) / session: path for session, path in chosen.find(Path(source)).items()}
    for folder in found:
        check_new_folder(folder)
    for folder, path in found.items():
        session = chosen.read(path)
        with new_folder(folder) as partial:
            session.vehicle.save(partial / file_name(session.vehicle))
            for number, (run, tracked) in enumerate(zip_longest(session.runs, session.tracked), start=1):
                write_log(partial / f"run-{number}.csv", run, session.vehicle, tracked)
        yield folder, session
