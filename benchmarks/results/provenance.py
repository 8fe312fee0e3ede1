"""Where a result comes from: versions and kind of machine. No host name, no paths, no user."""

import hashlib
import importlib.metadata
import os
import platform
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

import benchmarks.tasks
import castor_envs

_PACKAGES = ("castor-envs", "numpy", "pymunk", "numba")


@cache
def _fixed() -> dict[str, Any]:
    versions = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "versions": versions,
        "world": world_digest(),
        "machine": {"platform": platform.platform(), "cpu_count": os.cpu_count()},
    }


@cache
def world_digest() -> str:
    """Return a hash of the source that records episodes: the world (but for its pictures), the tasks."""
    seen = hashlib.sha256()
    for package in (castor_envs, benchmarks.tasks):
        folder = Path(package.__path__[0])
        for path in sorted(folder.rglob("*.py")):
            if "rendering" not in path.parts:
                seen.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    return seen.hexdigest()[:16]


def provenance() -> dict[str, Any]:
    """Return the time (UTC), package versions and machine, for the metadata of a file written now."""
    return {"created": datetime.now(UTC).isoformat(timespec="microseconds"), **_fixed()}
