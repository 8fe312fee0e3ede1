"""What a leaderboard of stored rows costs, by their number."""

import hashlib
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.results.episodes import EpisodeStore
from benchmarks.results.provenance import provenance
from benchmarks.results.rows import ResultsStore, Row
from benchmarks.scoring.registry import score
from benchmarks.speed.figures import Effort
from benchmarks.speed.growth.curve import Curve, cost_of
from benchmarks.tasks import official_tasks

ROWS = (1000, 10_000, 100_000)
TASKS = (
    "umbmark-kinematic-calibrated",
    "umbmark-kinematic-uncalibrated",
    "umbmark-physics-clean",
    "umbmark-physics-cables",
    "umbmark-physics-slippery",
)
ESTIMATORS = 20


def curves(effort: Effort) -> Iterator[Curve]:
    """Yield the CPU time and memory of `castor-bench leaderboard` over rows of five tasks and twenty estimators; the
    first time, which summarises them, does not count."""
    costs = []
    for rows in ROWS:
        with tempfile.TemporaryDirectory() as folder:
            store_rows(Path(folder), rows)
            command = ["-m", "benchmarks", "leaderboard", "--results", folder]
            cost_of(command)
            costs.append(min(cost_of(command) for _ in range(3)))
    sizes = list(map(float, ROWS))
    yield Curve("leaderboard", "stored rows", "s", sizes, [cost.cpu for cost in costs])
    yield Curve("leaderboard", "stored rows", "MB", sizes, [cost.memory for cost in costs])


def store_rows(results: Path, rows: int) -> None:
    """Store so many rows and their episodes: scores of an episode of each task, times what is drawn."""
    known, random, origin = {task.name: task for task in official_tasks()}, np.random.default_rng(0), provenance()
    for name in TASKS:
        task = known[name]
        episode = task.record(task.cases(1)[0])
        scores = score(episode, [run.truth + 0.01 for run in episode.runs])
        for case in range(max(1, rows // (len(TASKS) * ESTIMATORS))):
            EpisodeStore(results).save(task, case, episode)
            for k in range(ESTIMATORS):
                factor = (1 + k / 10) * random.lognormal(0.0, 0.3)
                estimator = f"estimator-{k}"
                row = Row(
                    task=name,
                    version=task.version,
                    estimator=estimator,
                    source_hash=hashlib.sha256(estimator.encode()).hexdigest()[:16],
                    case=case,
                    episode=episode.digest,
                    robot_hash=episode.robot.hash(),
                    scores={metric: factor * value for metric, value in scores.items()},
                    origin=origin,
                )
                ResultsStore(results).save(row)
