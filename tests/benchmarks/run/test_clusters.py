"""A run on a cluster gives what one on this machine gives, bit for bit, also when a worker is killed in the middle."""

import contextlib
import os
import pickle
import signal
import sys
from concurrent.futures import Future

import numpy as np
import pytest

from benchmarks.cli import app
from benchmarks.progress import SilentProgress
from benchmarks.results.rows import ResultsStore
from benchmarks.run.clusters import MOST_LOST, Cluster, connect, contained
from benchmarks.run.plan import Assignment, run
from castor_envs.cli.command_line import run as run_app
from castor_envs.errors import InputError
from castor_envs.processes import Died, Done, InOrder, Job, Raised
from estimators.plugins.registry import load_estimator

CASES = tuple(range(12))
BUILT_IN = ("wheel-odometry", "dead-reckoning-1")

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="needs process groups")


class Counting(SilentProgress):
    """Counts steps, and calls something after some of them."""

    def __init__(self, after=-1, then=lambda: None):
        self.steps, self.after, self.then = {}, after, then

    def start(self, stage, total):
        self.stage = stage

    def advance(self, steps=1):
        self.steps[self.stage] = self.steps.get(self.stage, 0) + steps
        if self.steps[self.stage] == self.after and self.stage == "running estimators":
            self.then()


@pytest.fixture(scope="module")
def plan(fake_tasks, plugin):
    entries = tuple(map(load_estimator, (*BUILT_IN, plugin("followers:Slow"))))
    return [Assignment(fake_tasks.Arcs(), CASES, entries)]


@pytest.fixture(scope="module")
def straight(plan, tmp_path_factory, in_this_process):
    """The results folder of a run in this process."""
    folder = tmp_path_factory.mktemp("straight")
    with in_this_process():
        run(plan, folder)
    return folder


def assert_same(results, expected):
    rows, others = (
        {(row.estimator, row.case): row for row in ResultsStore(of).rows("arcs", 1)} for of in (results, expected)
    )
    assert rows.keys() == others.keys()
    assert len(rows) == 3 * len(CASES)
    for key, row in rows.items():
        assert (row.scores, row.failure, row.episode) == (others[key].scores, None, others[key].episode)
        for estimate, other in zip(row.estimates, others[key].estimates, strict=True):
            np.testing.assert_array_equal(estimate, other)


@contextlib.contextmanager
def running(backend, address=None):
    cluster = connect(backend, address, 2)
    try:
        yield cluster
    finally:
        cluster.close()


@pytest.fixture(scope="module")
def dask_cluster():
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=50) as local:
        yield local


def test_dask_gives_the_same_bit_for_bit_though_a_worker_is_killed(plan, straight, tmp_path, dask_cluster):
    pids = [worker.pid for worker in dask_cluster.workers.values()]
    progress = Counting(5, lambda: os.kill(pids[0], signal.SIGKILL))
    with running("dask", dask_cluster.scheduler_address) as cluster:
        run(plan, tmp_path, progress=progress, cluster=cluster)
    assert pids[0] not in [worker.pid for worker in dask_cluster.workers.values()]
    assert progress.steps["recording episodes"] == len(CASES)
    assert progress.steps["running estimators"] == 3 * len(CASES)
    assert_same(tmp_path, straight)


def test_a_plug_in_that_hangs_is_killed_on_the_cluster_too(fake_tasks, plugin, tmp_path, dask_cluster):
    entry = load_estimator(plugin("faulty:Hangs"))
    with running("dask", dask_cluster.scheduler_address) as cluster:
        run([Assignment(fake_tasks.Arcs(), CASES[:1], (entry,))], tmp_path, timeout=0.5, cluster=cluster)
    (row,) = ResultsStore(tmp_path).rows("arcs", 1)
    assert row.failure == "took over 0.5 s"


def test_loky_gives_the_same_bit_for_bit_though_a_worker_is_killed(plan, straight, tmp_path):
    pytest.importorskip("joblib")
    with running("loky") as cluster:
        progress = Counting(5, lambda: os.kill(cluster.submit(os.getpid).result(), signal.SIGKILL))
        run(plan, tmp_path, progress=progress, cluster=cluster)
    assert progress.steps["running estimators"] == 3 * len(CASES)
    assert_same(tmp_path, straight)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_ray_gives_the_same_bit_for_bit(plan, straight, tmp_path, monkeypatch):
    pytest.importorskip("ray")
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(sys.path))  # where the fake task is
    with running("ray") as cluster:
        run(plan, tmp_path, cluster=cluster)
    assert_same(tmp_path, straight)


class LostError(Exception):
    pass


class Unreliable:
    """Answers at once, or loses the worker so many times first."""

    def __init__(self, losses):
        self.losses, self.sent = losses, 0

    def __call__(self, function, world, sealed, timeout, owner):
        self.sent += 1
        future = Future()
        number = pickle.loads(sealed)[1][0]
        if self.losses.get(number, 0) > 0:
            self.losses[number] -= 1
            future.set_exception(LostError())
        else:
            future.set_result(Done(-number))
        return future


def test_a_job_is_sent_again_when_its_worker_is_lost_and_given_up_in_the_end():
    submit = Unreliable({3: MOST_LOST - 1, 4: MOST_LOST})
    cluster = Cluster(2, submit, (LostError,), lambda: None)
    outcomes = [
        (job.subject, outcome) for job, outcome in cluster.run_jobs(InOrder(Job(abs, (k,), k) for k in range(6)))
    ]
    assert sorted(subject for subject, _ in outcomes) == list(range(6))
    assert {subject: outcome for subject, outcome in outcomes if subject != 4} == {k: Done(-k) for k in (0, 1, 2, 3, 5)}
    assert dict(outcomes)[4] == Died(None)
    assert submit.sent == 6 + 2 * (MOST_LOST - 1)


def test_outcomes_may_lead_to_further_jobs():
    """As where a stack that failed is tried again case by case."""

    class Doubling:
        def __init__(self):
            self.jobs = [Job(abs, (1,))]

        def next_job(self):
            return self.jobs.pop() if self.jobs else None

    agenda, done = Doubling(), 0
    for job, outcome in Cluster(3, Unreliable({}), (LostError,), lambda: None).run_jobs(agenda):
        done += 1
        assert outcome == Done(-job.arguments[0])
        agenda.jobs += [Job(abs, (job.arguments[0] + 1,))] * 2 if job.arguments[0] < 4 else []
    assert done == 1 + 2 + 4 + 8


def test_a_worker_with_another_version_is_refused():
    refused = contained("0" * 16, b"", None, None)
    assert isinstance(refused, Raised)
    assert "another version of castor-envs" in str(refused.error)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--backend", "daks"], "unknown backend 'daks'; did you mean 'dask'"),
        (["--backend", "loky", "--address", "tcp://1.2.3.4:1"], "loky has workers on this machine only"),
        (["--address", "tcp://1.2.3.4:1"], "name its kind too"),
    ],
)
def test_mistakes_are_named(arguments, says, tmp_path, capsys):
    with pytest.raises(SystemExit) as stopped:
        run_app(app, ["run", "--task", "configuration-static", "--cases", "1", "--results", str(tmp_path), *arguments])
    assert stopped.value.code == 2
    assert says in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("backend", "module", "extra"),
    [("loky", "joblib", "joblib"), ("dask", "distributed", "dask"), ("ray", "ray", "ray")],
)
def test_a_missing_package_is_named_with_its_extra(backend, module, extra, monkeypatch):
    for name in [name for name in sys.modules if name.partition(".")[0] == module]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(
        InputError, match=rf"--backend {backend}: needs {module}.*; pip install '\.\[{extra}\]' in the project's folder"
    ):
        connect(backend, None, 2)
