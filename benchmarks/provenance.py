"""Where a result comes from: versions and kind of machine. No host name, no paths, no user."""

import importlib.metadata
import os
import platform
from datetime import UTC, datetime
from functools import cache
from typing import Any

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
        "machine": {"platform": platform.platform(), "cpu_count": os.cpu_count()},
    }


def provenance() -> dict[str, Any]:
    """Return the time (UTC), package versions and machine, for the metadata of a file written now."""
    return {"created": datetime.now(UTC).isoformat(timespec="microseconds"), **_fixed()}
