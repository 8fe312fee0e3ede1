"""What whole processes cost before anything is computed: help, the import, the first step; and a run with nothing to
do."""

import tempfile
from collections.abc import Iterator

from benchmarks.speed.figures import Effort, Figure, Group, process_cpu

FIRST_STEP = """
import castor_envs, gymnasium
env = gymnasium.make("castor/ASOC-v1")
env.reset(seed=0)
env.step(env.action_space.sample())
"""
PROCESSES = {
    "castor-bench --help": ["-m", "benchmarks", "--help"],
    "castor-diagnose --help": ["-m", "discrepancy", "--help"],
    "import castor_envs": ["-c", "import castor_envs"],
    "import gymnasium, for comparison": ["-c", "import gymnasium"],
    "first step of a second process": ["-c", FIRST_STEP],
}

RUN = ["-m", "benchmarks", "run", "--task", "configuration-static"]


def figures(effort: Effort) -> Iterator[Figure]:
    """Yield the CPU time of each process; the first of a kind, which may compile, does not count."""
    for name, arguments in PROCESSES.items():
        yield Figure(name, process_cpu(arguments, effort.processes), "s")
    with tempfile.TemporaryDirectory() as folder:
        yield Figure("second run of one small task", process_cpu([*RUN, "--results", folder], effort.processes), "s")


GROUP = Group("The first second", figures)
