"""What memory a long benchmark takes, by its number of cases."""

import tempfile
from collections.abc import Iterator

from benchmarks.speed.figures import Effort
from benchmarks.speed.growth.curve import Curve, cost_of, in_megabytes

CASES = (50, 200, 800)

RUN = """
import resource, sys
from pathlib import Path
from benchmarks.run.plan import Assignment, run
from benchmarks.tasks import official_tasks
from estimators.plugins.registry import load_estimator
if __name__ == "__main__":
    task = next(task for task in official_tasks() if task.name == "configuration-small")
    entries = tuple(map(load_estimator, ("grpec-xy", "train-odometry")))
    plan = [Assignment(task, tuple(task.cases(int(sys.argv[2]))), entries)]
    run(plan, Path(sys.argv[1]))
    print(*(resource.getrusage(of).ru_maxrss for of in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)))
"""


def curves(effort: Effort) -> Iterator[Curve]:
    """Yield the most memory that one process of a run had, its parent or a worker, MB."""
    most = []
    for cases in CASES:
        with tempfile.TemporaryDirectory() as folder:
            said = cost_of(["-c", RUN, folder, f"{cases}"]).said
            most.append(max(in_megabytes(float(text)) for text in said.split()))
    yield Curve("a long run, its largest process", "cases", "MB", list(map(float, CASES)), most)
