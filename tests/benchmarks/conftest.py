"""The fake tasks and plug-ins; worker processes find the tasks by the path that is set here."""

import contextlib
import functools
import importlib
import pickle
import sys
import traceback
from pathlib import Path

import pytest

from benchmarks.results.episodes import EpisodeStore
from benchmarks.run import evaluate, plan, record
from benchmarks.show import follow as show_follow
from castor_envs import processes
from castor_envs.errors import InputError
from castor_envs.processes import Done, Raised

FAKES = Path(__file__).parent / "fakes"
sys.path.append(str(FAKES))


@pytest.fixture(scope="session")
def fake_tasks():
    return importlib.import_module("fake_tasks")


@pytest.fixture(scope="session")
def fake_trains():
    return importlib.import_module("fake_trains")


@pytest.fixture(scope="session")
def recorded():
    """Return a function of a task and a case that gives its episode, recorded once for all tests."""
    return functools.cache(lambda task, case: task.record(case))


@pytest.fixture(scope="session")
def prepared(recorded):
    """Return a function that puts the episodes of some of a task's cases into a results folder, for a run to find."""

    def prepare(results, task, *cases):
        for case in cases:
            EpisodeStore(results).save(task, case, recorded(task, case))

    return prepare


def _run_jobs_here(agenda, processes):
    while (job := agenda.next_job()) is not None:
        try:
            function, arguments = pickle.loads(pickle.dumps((job.function, job.arguments)))
            outcome = Done(pickle.loads(pickle.dumps(function(*arguments))))
        except (Exception, SystemExit) as error:
            outcome = Raised(traceback.format_exc(), error if isinstance(error, InputError | OSError) else None)
        yield job, outcome


@contextlib.contextmanager
def _patched(modules, name, value):
    with pytest.MonkeyPatch.context() as patch:
        for module in modules:
            patch.setattr(module, name, value)
        yield


@pytest.fixture(scope="session")
def in_this_process():
    """Return a context in which jobs run in this process, one after another, sent and answered as if to a worker.

    For what does not hang on processes, which take longer to start than most jobs do.
    """
    return functools.partial(_patched, (processes, evaluate, plan, record, show_follow), "run_jobs", _run_jobs_here)


@pytest.fixture
def jobs_here(in_this_process):
    """Run a whole test's jobs in this process."""
    with in_this_process():
        yield


@pytest.fixture(scope="session")
def one_owner():
    """Return a context in which all plug-ins share worker processes, as those of one owner."""
    return functools.partial(_patched, (evaluate, plan), "owner_of", lambda *_: "everybody")


@pytest.fixture(scope="session")
def plugin():
    """Return the spec of a fake plug-in, given as file:Class."""

    def spec(name):
        file, kind = name.split(":")
        return f"{FAKES / file}.py:{kind}"

    return spec
