"""Worker processes: every job has an outcome, whatever its function does."""

import os
import signal
import sys
import time
from collections import deque

import pytest

from benchmarks.run.processes import Died, Done, Job, Raised, TimedOut, run_jobs


class Jobs:
    def __init__(self, *jobs):
        self.jobs = deque(jobs)

    def next_job(self):
        return self.jobs.popleft() if self.jobs else None


def outcomes(*jobs, processes=2):
    return {job.subject: outcome for job, outcome in run_jobs(Jobs(*jobs), processes)}


def test_every_job_has_its_outcome():
    """Functions of the standard library, so that nothing of the tests has to be imported by the workers."""
    found = outcomes(
        *(Job(pow, (k, 2), k) for k in range(5)),
        Job(divmod, (1, 0), "raises"),
        Job(sys.exit, (0,), "exits"),
        Job(os._exit, (0,), "dies well"),
        Job(os._exit, (7,), "dies"),
        Job(time.sleep, (100,), "hangs", timeout=0.2),
        Job(open, (os.devnull,), "cannot be sent"),
    )
    assert [found[k] for k in range(5)] == [Done(k**2) for k in range(5)]
    raised = {key: outcome.text for key, outcome in found.items() if isinstance(outcome, Raised)}
    assert raised.keys() == {"raises", "exits", "cannot be sent"}
    assert "ZeroDivisionError" in raised["raises"]
    assert "cannot be sent" in raised["cannot be sent"]
    assert found["dies well"] == Died(0)
    assert found["dies"] == Died(7)
    assert found["hangs"] == TimedOut()


def test_no_jobs_no_outcomes():
    assert outcomes() == {}


def test_outcomes_may_lead_to_further_jobs():
    agenda = Jobs(Job(pow, (2, 2), "first"))
    found = []
    for job, outcome in run_jobs(agenda, 2):
        found.append((job.subject, outcome))
        if job.subject == "first":
            agenda.jobs.append(Job(pow, (3, 2), "second"))
    assert found == [("first", Done(4)), ("second", Done(9))]


def test_large_arguments_and_results_pass():
    data = bytes(3_000_000)
    assert outcomes(Job(bytes, (data,), "large"), processes=1) == {"large": Done(data)}


def test_workers_put_nothing_of_the_current_folder_first(tmp_path, monkeypatch):
    """A `benchmarks` in the current folder does not shadow the installed one."""
    (tmp_path / "benchmarks").mkdir()
    (tmp_path / "benchmarks" / "__init__.py").write_text("raise RuntimeError('shadowed')")
    (tmp_path / "random.py").write_text("raise RuntimeError('shadowed')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [place for place in sys.path if place])
    (outcome,) = outcomes(Job(__import__, ("benchmarks.scoring.square_metrics",), "import")).values()
    assert isinstance(outcome, Raised)
    assert "cannot pickle 'module'" in outcome.text


@pytest.mark.parametrize("value", ["1", None])
def test_the_environment_is_left_as_it_was(monkeypatch, value):
    monkeypatch.delenv("PYTHONSAFEPATH", raising=False)
    if value:
        monkeypatch.setenv("PYTHONSAFEPATH", value)
    outcomes(Job(pow, (1, 1), "any"), processes=1)
    assert os.environ.get("PYTHONSAFEPATH") == value


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="needs signal masks")
def test_workers_are_deaf_to_ctrl_c_from_the_start():
    """The parent alone says that it stops; it is not made deaf itself."""
    (outcome,) = outcomes(Job(signal.pthread_sigmask, (signal.SIG_BLOCK, ()), "mask"), processes=1).values()
    assert isinstance(outcome, Done)
    assert signal.SIGINT in outcome.value
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
