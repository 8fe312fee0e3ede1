"""Where a result comes from: versions and kind of machine. No host name, no paths, no user."""

import hashlib
import importlib.metadata
import os
import platform
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from pydantic import AwareDatetime, NonNegativeInt
from pydantic.dataclasses import dataclass

import benchmarks.tasks
import castor_envs
import estimators
from castor_envs.description import CONFIG

_PACKAGES = ("castor-envs", "numpy", "pymunk", "numba", "robotpy-wpimath")


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Machine:
    """A kind of machine: its platform and how many processors it has, where that is known."""

    platform: str
    cpu_count: NonNegativeInt | None

    def __str__(self) -> str:
        return f"{self.platform}, {self.cpu_count or 'unknown number of'} processors"


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Origin:
    """Where a stored file comes from: when it was made (with time zone), by which packages and world, on which machine.

    rescored: when its scores were computed again from stored trajectories, or None.
    """

    created: AwareDatetime
    versions: dict[str, str]
    world: str
    machine: Machine
    rescored: AwareDatetime | None = None


@cache
def _versions() -> dict[str, str]:
    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return versions


@cache
def world_digest() -> str:
    """Return a hash of the source code that records episodes."""
    seen = hashlib.sha256()
    for path, name in world_files().items():
        seen.update(name.encode() + b"\0" + path.read_bytes())
    return seen.hexdigest()[:16]


def world_files() -> dict[Path, str]:
    """Return the files that say what an episode is, with their places in their packages.

    They are `castor_envs` without rendering, the tasks, and `estimators`, from which tasks have true shapes,
    references, oracles and calibrated robots: an edit of one that changes no episode costs a recording, and no row.
    """
    found = {}
    for package in (castor_envs, benchmarks.tasks, estimators):
        folder = Path(package.__path__[0])
        for path in sorted(folder.rglob("*.py")):
            if "rendering" not in path.parts:
                found[path] = path.relative_to(folder).as_posix()
    return found


def provenance() -> Origin:
    """Return the time (UTC), package versions and machine, for the metadata of a file written now."""
    return Origin(
        created=datetime.now(UTC),
        versions=_versions(),
        world=world_digest(),
        machine=Machine(platform=platform.platform(), cpu_count=os.cpu_count()),
    )
