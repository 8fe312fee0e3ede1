"""To add a metric, a task or a paper's table is to add one file: nothing else knows of it."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import benchmarks

METRIC = '''
"""How far the estimate is off where it is worst."""

import numpy as np

from benchmarks.scoring.metric import MM, Column, Judged, Metric


def _worst(judged: Judged) -> float | None:
    if judged.of_train:
        return None
    return max(np.hypot(*(path.estimate - path.true)[:, :2].T).max() for path in judged.scored)


METRICS = (
    Metric(
        "worst_position", _worst, key="worst_position_m", title="worst position", short="worst",
        description="largest position error on any run", place=75, column=Column(place=55, keep=55), **MM,
    ),
)
'''  # fmt: skip

TASK = '''
"""A square that is driven in perfect rolling by a robot without errors."""

from benchmarks.tasks.kinematic import KinematicUMBmark, ParameterErrors

EXACT = ParameterErrors(offset=0.0, radius=0.0, lateral=0.0, pivot_zero=0.0)


def tasks(measured):
    return (KinematicUMBmark("umbmark-exact", "UMBmark, exact robot files", "Rounding of counts alone.", EXACT),)
'''

TABLE = '''
"""A paper's table, recomputed."""

from benchmarks.papers.comparison import Comparison, PaperTable, TableSource


def _computed(effort):
    value = Comparison((("row", 1),), "pi", "value", "number", None, printed=3.14, ours=3.14159, digits=2)
    return PaperTable("archimedes-1", "Archimedes, Table 1", (value,))


def tables():
    return (TableSource("archimedes-1", _computed),)
'''

PROGRAM = """
import numpy as np
from benchmarks.papers import select_tables
from benchmarks.papers.comparison import Effort, compute_tables
from benchmarks.scoring.registry import BOARD_METRICS, score
from benchmarks.tasks import official_tasks
from benchmarks.tasks.task import Episode, Run
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import differential

poses = np.array([[0.0, 0, 0], [1, 0, 0]])
log = Log(np.array([0.0, 1.0]), np.zeros((2, 2)), np.empty((2, 0)), reference=poses)
scores = score(Episode(differential(), (Run(log),)), [poses + [0, 0.25, 0]])
print("worst_position" in BOARD_METRICS, scores["worst_position"])
print([task.robot.name for task in official_tasks() if task.name == "umbmark-exact"])
(table,) = compute_tables(select_tables(["archimedes-1"]), Effort())
print(table.comparisons[0].agrees)
"""


@pytest.fixture
def copied(tmp_path):
    """Return a folder with a copy of the package that these files were added to."""
    package = tmp_path / "benchmarks"
    shutil.copytree(Path(benchmarks.__path__[0]), package, ignore=shutil.ignore_patterns("__pycache__"))
    files = {"scoring/worst.py": METRIC, "tasks/exact.py": TASK, "papers/archimedes.py": TABLE}
    for name, source in files.items():
        assert not (package / name).exists()
        (package / name).write_text(source.lstrip())
    return tmp_path


def test_a_metric_a_task_and_a_table_are_found_in_one_file_each(copied):
    ran = subprocess.run(
        [sys.executable, "-c", PROGRAM], cwd=copied, capture_output=True, text=True, timeout=120, check=False
    )
    assert ran.stderr == ""
    assert ran.stdout.splitlines() == ["True 0.25", "['ASOC prototype, one-third scale']", "True"]
