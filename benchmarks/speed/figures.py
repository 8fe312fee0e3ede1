"""What is measured, and how: CPU time, variants by turns in one process, medians over rounds.

What else a machine does slows the variants of a round much alike, so ratios are medians of each round's ratio.
"""

import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from castor_envs.errors import InputError

try:
    import resource
except ImportError:  # Windows
    resource = None

Work = Callable[[], object]


class Figure(NamedTuple):
    """A measured number; name: what of, unit: "us", "ms", "s", "steps/s" or "x" for a ratio as the name says, A / B."""

    name: str
    value: float
    unit: str

    @property
    def text(self) -> str:
        """The number in three digits with its unit, as in "12.3 us" or "7,760 steps/s"."""
        rounded = f"{self.value:.3g}"
        return f"{rounded if self.value < 999.5 else f'{float(rounded):,.0f}'} {self.unit}"


@dataclass(frozen=True)
class Effort:
    """How much is measured. rounds: of variants by turns; processes: started for each figure of a whole process;
    sides: of the squares whose logs are diagnosed, m; jobs: that are sent to worker processes and clusters."""

    rounds: int = 30
    processes: int = 5
    sides: tuple[float, ...] = (1.0, 4.0)
    jobs: int = 200


@dataclass(frozen=True)
class Group:
    """Figures that belong together, in the order in which the table shows them."""

    title: str
    figures: Callable[[Effort], Iterator[Figure]]


def steps_of(env: Any, count: int) -> Work:
    """Return work that takes `count` steps in an environment, or a vector of them, by the same small random actions."""
    env.action_space.seed(0)
    actions = [0.3 * env.action_space.sample() for _ in range(count)]

    def steps() -> None:
        for action in actions:
            env.step(action)

    return steps


def by_turns(variants: Mapping[str, Work], rounds: int, prepare: Work = lambda: None) -> dict[str, list[float]]:
    """Return the CPU times (s) of each variant, a round at a time; two rounds before do not count.

    prepare: called before each round, not timed.
    """
    times: dict[str, list[float]] = {name: [] for name in variants}
    for turn in range(rounds + 2):
        prepare()
        for name in list(variants)[:: 1 if turn % 2 else -1]:
            began = time.process_time()
            variants[name]()
            times[name].append(time.process_time() - began)
    return {name: of[2:] for name, of in times.items()}


def ratio(times: Mapping[str, list[float]], name: str, than: str) -> float:
    """Return the median of a variant's times as multiples of another's in the same round."""
    return statistics.median(a / b for a, b in zip(times[name], times[than], strict=True))


def process_cpu(arguments: list[str], processes: int) -> float:
    """Return the CPU time (s) of a Python process with these arguments: the median, after one that does not count.

    Raises RuntimeError with its last line of errors if it fails, InputError where the system does not tell.
    """
    if resource is None:
        raise InputError("the CPU time of other processes cannot be measured on this system")
    spent = []
    for _ in range(processes + 1):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode:
            raise RuntimeError(f"{' '.join(arguments)}: {(done.stderr.strip().splitlines() or ['failed'])[-1]}")
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    return statistics.median(spent[1:])
