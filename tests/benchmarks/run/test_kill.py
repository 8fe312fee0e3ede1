"""A run that is killed loses nothing: the next one goes on where it stopped."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks.results.rows import ResultsStore
from benchmarks.run.plan import Assignment, run
from estimators.plugins.registry import load_estimator

SCRIPT = """
import sys
from pathlib import Path

sys.path.append({fakes!r})
from fake_tasks import Arcs

from benchmarks.run.plan import Assignment, run
from estimators.plugins.registry import load_estimator

if __name__ == "__main__":
    task = Arcs(pause=0.05)
    run([Assignment(task, tuple(range(24)), (load_estimator({spec!r}),))], Path(sys.argv[1]), processes=2)
"""

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs process groups")


def start(tmp_path, plugin, name, **environment):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT.format(fakes=str(Path(__file__).parents[1] / "fakes"), spec=plugin(name)))
    return subprocess.Popen(
        [sys.executable, str(script), str(tmp_path / "results")],
        start_new_session=True,
        env={**os.environ, **environment},
    )


def wait_until(condition, process=None):
    for _ in range(6000):
        if condition():
            return
        assert process is None or process.poll() is None, "the run ended by itself"
        time.sleep(0.01)
    raise AssertionError("waited for a minute")


@pytest.mark.slow
def test_a_killed_run_is_continued(tmp_path, plugin, fake_tasks, in_this_process):
    """Kill -9 of all its processes, once while episodes are recorded, once while an estimator runs."""
    results, uninterrupted = tmp_path / "results", tmp_path / "whole"
    for pattern in ("episodes/*/[0-9]*.npz", "rows/*/*/[0-9]*.npz"):
        process = start(tmp_path, plugin, "followers:Slow")
        wait_until(lambda pattern=pattern: len(list(results.glob(pattern))) >= 4, process)
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        assert len(list(results.glob(pattern))) < 24
    task, entry = fake_tasks.Arcs(), load_estimator(plugin("followers:Slow"))
    survived = {row.case: row.origin for row in ResultsStore(results).rows("arcs", 1)}
    assert len(survived) >= 4

    plan = [Assignment(task, tuple(range(24)), (entry,))]
    with in_this_process():
        run(plan, results)
        run(plan, uninterrupted)
    store = ResultsStore(results)
    continued = list(store.rows("arcs", 1))
    straight = {row.case: row for row in ResultsStore(uninterrupted).rows("arcs", 1)}
    assert not store.corrupt
    assert sorted(row.case for row in continued) == list(range(24))
    for row in continued:
        assert row.scores == straight[row.case].scores
        for stored, expected in zip(row.estimates, straight[row.case].estimates, strict=True):
            np.testing.assert_array_equal(stored, expected)
        assert row.case not in survived or row.origin == survived[row.case]


def test_no_worker_outlives_a_killed_parent(tmp_path, plugin):
    """The plug-in hangs and writes; once the parent alone is killed, the file stops growing."""
    heartbeat = tmp_path / "heartbeat"
    process = start(tmp_path, plugin, "faulty:Beats", HEARTBEAT=str(heartbeat))
    try:
        wait_until(lambda: heartbeat.exists() and heartbeat.stat().st_size > 5, process)
        process.kill()
        process.wait()

        def still():
            before = heartbeat.stat().st_size
            time.sleep(0.3)
            return heartbeat.stat().st_size == before

        wait_until(still)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
