"""Worker processes: every job has an outcome, whatever its function does."""

import os
import signal
import subprocess
import sys
import time
from collections import deque
from pathlib import Path

import pytest

from castor_envs.processes import (
    MOST_CHILDREN,
    MOST_MEMORY,
    THREADS,
    Died,
    Done,
    Exceeded,
    Job,
    Raised,
    TimedOut,
    run_jobs,
)


class Jobs:
    def __init__(self, *jobs):
        self.jobs = deque(jobs)

    def next_job(self):
        return self.jobs.popleft() if self.jobs else None


def outcomes(*jobs, processes=2):
    return {job.subject: outcome for job, outcome in run_jobs(Jobs(*jobs), processes)}


def code(text, subject: object = "job", **options):
    """Return a job that runs Python code and returns what it leaves as `answer`."""
    return Job(eval, (f"(found := {{}}, exec({text!r}, found), found.get('answer'))[2]",), subject, **options)


def alive_in(group):
    """Return the processes of a group that have not ended."""
    alive = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, number = stat.read_text().rpartition(")")[2].split()[:3]
        except OSError:
            continue
        if int(number) == group and state != "Z":
            alive.append(stat.parent.name)
    return alive


def wait_until(condition):
    for _ in range(6000):
        if condition():
            return
        time.sleep(0.01)
    raise AssertionError("waited for a minute")


needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")


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


def test_linear_algebra_of_workers_has_one_thread_where_the_user_says_nothing(monkeypatch):
    for name in THREADS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    said = f"import os; answer = [os.environ[name] for name in {THREADS}]"
    assert outcomes(code(said)) == {"job": Done([{"OMP_NUM_THREADS": "3"}.get(name, "1") for name in THREADS])}
    assert [os.environ.get(name) for name in THREADS] == [{"OMP_NUM_THREADS": "3"}.get(name) for name in THREADS]


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="needs signal masks")
def test_workers_are_deaf_to_ctrl_c_from_the_start():
    """The parent alone says that it stops; it is not made deaf itself."""
    (outcome,) = outcomes(Job(signal.pthread_sigmask, (signal.SIG_BLOCK, ()), "mask"), processes=1).values()
    assert isinstance(outcome, Done)
    assert signal.SIGINT in outcome.value
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


FORKS = "import os; os.fork(); answer = os.getpgid(0)"
LINGERS = "import os, time\nif os.fork() == 0: time.sleep(1000)\nanswer = os.getpgid(0)"
LEAVES = "import os, time\nif os.fork() == 0: time.sleep(1000)\nos._exit(5)"


@needs_fork
@needs_proc
def test_a_forked_process_takes_no_work_and_does_not_outlive_the_run():
    """Neither the one that returns from the job, nor the one that stays in it; each job has one outcome."""
    jobs = [*(code(FORKS, k) for k in range(3)), code(LINGERS, 3), code(LINGERS, 4)]
    found = [(job.subject, outcome) for job, outcome in run_jobs(Jobs(*jobs), 1)]
    assert [subject for subject, _ in found] == list(range(5))
    groups = {outcome.value for _, outcome in found if isinstance(outcome, Done)}
    assert len(groups) == 1
    assert os.getpgid(0) not in groups
    wait_until(lambda: not any(alive_in(group) for group in groups))


@needs_fork
def test_the_end_of_a_worker_is_seen_while_a_process_that_it_forked_lives():
    """Which holds the worker's pipes open."""
    assert outcomes(code(LEAVES, timeout=60.0), processes=1) == {"job": Died(5)}


@needs_fork
@needs_proc
@pytest.mark.parametrize("work", ["time.sleep(1000)", "sum(range(10**12))"])
def test_all_processes_of_a_worker_end_when_the_parent_is_killed(tmp_path, work):
    """Also while the worker computes without ever letting another of its threads run."""
    begun = tmp_path / "group"
    write = (
        f"open({str(begun)!r} + '~', 'w').write(str(os.getpgid(0))); os.rename({str(begun)!r} + '~', {str(begun)!r})"
    )
    task = f"import os, time\nif os.fork() == 0: time.sleep(1000)\n{write}\n{work}"
    script = tmp_path / "script.py"
    script.write_text(
        "from castor_envs.processes import Job, run_jobs\n"
        "class Jobs:\n"
        f"    jobs = [Job(exec, ({task!r}, {{}}))]\n"
        "    def next_job(self): return self.jobs.pop() if self.jobs else None\n"
        "if __name__ == '__main__': list(run_jobs(Jobs(), 1))\n"
    )
    process = subprocess.Popen([sys.executable, script])
    wait_until(begun.exists)
    group = int(begun.read_text())
    assert alive_in(group)
    process.kill()
    process.wait()
    wait_until(lambda: not alive_in(group))


@needs_fork
@needs_proc
def test_too_many_processes_end_the_job():
    forks = (
        f"import os, time\nfor _ in range({MOST_CHILDREN + 1}):\n if os.fork() == 0: time.sleep(1000)\ntime.sleep(1000)"
    )
    found = outcomes(code(forks), code("answer = 7", "next"), processes=1)
    assert found == {"job": Exceeded(f"started over {MOST_CHILDREN} processes"), "next": Done(7)}


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere the system does not count memory")
def test_too_much_memory_is_refused_to_the_job_alone():
    found = outcomes(code(f"answer = len(bytearray({MOST_MEMORY}))"), code("answer = 7", "next"), processes=1)
    assert isinstance(found["job"], Raised)
    assert "MemoryError" in found["job"].text
    assert found["next"] == Done(7)


def test_what_is_printed_is_shown_up_to_a_limit_and_stdout_is_dropped(capfd):
    endless = "import os\nwhile True: os.write(2, b'endless ' * 100)"
    prints = "import os, sys\nprint('to stdout', flush=True)\nos.write(1, b'to stdout')\nprint('seen', file=sys.stderr)"
    found = outcomes(code(prints, "prints"), code(endless, timeout=60.0), processes=1)
    assert found == {"prints": Done(None), "job": Exceeded("printed over 100 kB to stderr")}
    out, err = capfd.readouterr()
    assert out == ""
    assert "seen\n" in err
    assert len(err) <= 101_000


def test_what_a_user_can_mend_is_raised_again_and_anything_else_is_one_line(tmp_path):
    mend = "from castor_envs.errors import InputError\nraise InputError('mend it')"
    found = outcomes(code(mend, "input"), Job(open, (str(tmp_path / "none"),), "file"), Job(divmod, (1, 0), "bug"))
    assert all(isinstance(outcome, Raised) for outcome in found.values())
    raised = {subject: outcome.again("the work") for subject, outcome in found.items() if isinstance(outcome, Raised)}
    assert {subject: type(error).__name__ for subject, error in raised.items()} == {
        "input": "InputError",
        "file": "FileNotFoundError",
        "bug": "RuntimeError",
    }
    assert str(raised["input"]) == "mend it"
    assert str(raised["bug"]).startswith("the work: ZeroDivisionError: ")
    assert "Traceback" in raised["bug"].__notes__[0]
