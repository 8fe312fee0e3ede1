"""A measured curve: what something costs, by its size."""

import os
import subprocess
import sys
import tempfile
from typing import NamedTuple

from castor_envs.errors import InputError

MB = 2.0**20


class Curve(NamedTuple):
    """What something costs by its size. over: what the sizes count; unit: of the costs, such as "s" or "MB"."""

    title: str
    over: str
    unit: str
    sizes: list[float]
    costs: list[float]


class Cost(NamedTuple):
    """What a process took: CPU time, s, and the most memory that it had, MB; and what it printed."""

    cpu: float
    memory: float
    said: str


def cost_of(arguments: list[str]) -> Cost:
    """Return what a Python process with these arguments takes; its helpers count where it waits for them.

    Raises RuntimeError with its last line if it fails, InputError where the system does not tell.
    """
    if not hasattr(os, "wait4"):
        raise InputError("the memory of other processes cannot be measured on this system")
    with tempfile.TemporaryFile() as output:
        process = subprocess.Popen([sys.executable, *arguments], stdout=output, stderr=subprocess.STDOUT)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        output.seek(0)
        said = output.read().decode()
    if process.returncode:
        raise RuntimeError(f"{' '.join(arguments)}: {(said.strip().splitlines() or ['failed'])[-1]}")
    return Cost(usage.ru_utime + usage.ru_stime, in_megabytes(usage.ru_maxrss), said)


def in_megabytes(resident: float) -> float:
    """Return the system's count of resident memory in MB: it counts bytes on macOS, else kB."""
    return resident / MB if sys.platform == "darwin" else resident / 1024
