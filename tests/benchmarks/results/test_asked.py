"""A run keeps what it asked for, also where it computes nothing, and boards and comparisons show that."""

from pathlib import Path

import pytest

from benchmarks.leaderboard.board import build
from benchmarks.results.asked import asked, shown_spec
from benchmarks.results.rows import ResultsStore
from benchmarks.run.plan import Assignment, run
from benchmarks.site.compare import compare, rows_by_task, side_of
from estimators.plugins.registry import load_estimator

MINE = """
class Mine:
    def reset(self, robot, pose):
        self.pose = pose.copy()

    def update(self, observation):
        return self.pose + {}
"""


def test_a_run_that_finds_all_its_rows_is_what_boards_show(tmp_path, fake_tasks, jobs_here, monkeypatch):
    monkeypatch.chdir(tmp_path)
    task, results, hashes = fake_tasks.Arcs(), tmp_path / "results", {}
    other = load_estimator("wheel-odometry")
    for folder, off in (("f1", 0.1), ("f2", 0.2), ("f1", 0.1)):
        Path(folder).mkdir(exist_ok=True)
        Path(folder, "e.py").write_text(MINE.format(off))
        entry = load_estimator(f"{folder}/e.py")
        run([Assignment(task, (0, 1), (entry, other))], results)
        hashes[folder] = entry.source_hash
        (board,) = build([task], results).boards
        (mine,) = (shown for shown in board.entries if shown.estimator == "e:Mine")
        assert (mine.source_hash, mine.spec) == (entry.source_hash, f"{folder}/e.py")
        rows = rows_by_task([task], results)
        first, second = (side_of(name, rows, results, 60.0) for name in ("e:Mine", "wheel-odometry"))
        (found,) = compare(first, second, rows, [task], results)
        assert {row.source_hash for row in found.rows[0].values()} == {entry.source_hash}
        assert found.specs == (f"{folder}/e.py", "wheel-odometry")
    assert hashes["f1"] != hashes["f2"]
    kept = asked(ResultsStore(results).of_task(task.name, task.version))
    assert {name: one.spec for name, one in kept.items()} == {"e:Mine": "f1/e.py", "wheel-odometry": "wheel-odometry"}


@pytest.mark.parametrize(
    ("spec", "shown"),
    [
        ("f1/e.py", "f1/e.py"),
        ("../e.py:Mine?a=1", "../e.py:Mine?a=1"),
        ("cast-0?step=euler", "cast-0?step=euler"),
        ("pkg.rel:Mine", "pkg.rel:Mine"),
        ("{here}/my.pys/e.py:Mine?a=x.py", "my.pys/e.py:Mine?a=x.py"),
        ("{here}/e.py", "e.py"),
        ("{above}/e.py", None),
    ],
)
def test_a_page_tells_no_path_of_a_machine(tmp_path, monkeypatch, spec, shown):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    assert shown_spec(spec.format(here=Path.cwd(), above=tmp_path)) == shown
