"""A measured curve: what something costs, by its size."""

import importlib.util
import subprocess
import sys
from typing import NamedTuple

from castor_envs.errors import InputError

MB = 2.0**20

MEASURED = """
import resource, subprocess, sys
done = subprocess.run([sys.executable, *sys.argv[1:]])
used = resource.getrusage(resource.RUSAGE_CHILDREN)
print(used.ru_utime + used.ru_stime, used.ru_maxrss, file=sys.stderr)
sys.exit(done.returncode)
"""
"""A small process between: Linux counts what a process held before it became another program as that one's memory."""


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
    if importlib.util.find_spec("resource") is None:
        raise InputError("the memory of other processes cannot be measured on this system")
    done = subprocess.run([sys.executable, "-c", MEASURED, *arguments], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{' '.join(arguments)}: {(done.stderr.strip().splitlines()[:-1] or ['failed'])[-1]}")
    cpu, resident = done.stderr.splitlines()[-1].split()
    return Cost(float(cpu), in_megabytes(float(resident)), done.stdout)


def in_megabytes(resident: float) -> float:
    """Return the system's count of resident memory in MB: it counts bytes on macOS, else kB."""
    return resident / MB if sys.platform == "darwin" else resident / 1024
