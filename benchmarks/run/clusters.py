"""Jobs on other machines: a run sends them to Dask, Ray or joblib's loky, and gets their outcomes as they end.

On a worker of the cluster each job runs in a process of its own, under the same limits as on this machine (see
`castor_envs.processes`): a plug-in that hangs is killed there. What a job needs goes there and what it returns comes
back; the parent alone stores, so no folder is shared. A job whose worker is lost is sent again.
"""

import importlib
import multiprocessing
import os
import pickle
import threading
from collections.abc import Callable, Generator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from dataclasses import dataclass
from functools import cache
from multiprocessing import connection
from typing import Any

from benchmarks.results.provenance import world_digest
from castor_envs.errors import InputError, did_you_mean, with_extra
from castor_envs.processes import Agenda, Died, Job, OneWorker, Outcome, Raised

MOST_LOST = 5
"""A job that lost so many workers is given up as one that ended its process."""

IN_FLIGHT = 2
"""Jobs sent for each that can run at a time, so that a worker finds the next one when it has finished one."""

Submit = Callable[..., Future[Any]]


@dataclass(frozen=True)
class Cluster:
    """Where jobs go.

    slots: how many run at a time. submit: sends a function and its arguments. lost: what a future raises whose worker
    has gone. close: ends what was started here, and takes back what is not done.
    """

    slots: int
    submit: Submit
    lost: tuple[type[BaseException], ...]
    close: Callable[[], None]

    def run_jobs(self, agenda: Agenda) -> Generator[tuple[Job, Outcome], None, None]:
        """Run the jobs of an agenda; yield each with its outcome as it ends, once, until none is left."""
        world = world_digest()
        pending: dict[Future[Outcome], tuple[Job, int]] = {}

        def send(job: Job, sent: int) -> None:
            sealed = pickle.dumps((job.function, job.arguments))
            pending[self.submit(contained, world, sealed, job.timeout, job.owner)] = job, sent

        try:
            while True:
                while len(pending) < IN_FLIGHT * self.slots and (job := agenda.next_job()) is not None:
                    send(job, 1)
                if not pending:
                    return
                for future in wait(pending, return_when=FIRST_COMPLETED).done:
                    job, sent = pending.pop(future)
                    try:
                        outcome = future.result()
                    except self.lost:
                        if sent < MOST_LOST:
                            send(job, sent + 1)
                            continue
                        outcome = Died(None)
                    except CancelledError:
                        gone = "the cluster gave up a job, as when its scheduler ends; the same command continues"
                        raise RuntimeError(gone) from None
                    except ImportError as error:
                        raise InputError(f"a worker of the cluster: {error}; install castor-envs there too") from None
                    yield job, outcome
        finally:
            for future in pending:
                future.cancel()


def contained(world: str, sealed: bytes, timeout: float | None, owner: Any) -> Outcome:
    """Return the outcome of a job, on a worker of the cluster: it runs in a process of its own, kept for the next.

    sealed: the job's function and arguments, pickled; only that process opens them, since they may load plug-ins.
    """
    if world != world_digest():
        problem = "a worker of the cluster has another version of castor-envs; install the one of this machine there"
        return Raised(problem, InputError(problem))
    worker = getattr(_of_thread, "worker", None) or OneWorker()
    _of_thread.worker = None  # unless it answers
    outcome = worker.outcome(Job(_opened, (_Sealed(sealed),), timeout=timeout, owner=owner))
    _of_thread.worker = worker
    return outcome


_of_thread = threading.local()
"""The process that a thread of a cluster's worker runs jobs in, as `worker`."""


class _Sealed:
    """Something pickled, which is opened where this is unpickled."""

    def __init__(self, content: bytes):
        self._content = content

    def __reduce__(self) -> tuple[Any, ...]:
        return pickle.loads, (self._content,)


def _opened(call: tuple[Callable[..., Any], tuple]) -> Any:
    function, arguments = call
    return function(*arguments)


def loky(address: str | None, processes: int | None) -> Cluster:
    """Return worker processes of this machine, by joblib's loky."""
    if address is not None:
        raise InputError("--address: loky has workers on this machine only; leave it out, or choose dask or ray")
    executor = _needed("joblib.externals.loky", "joblib")
    broken = executor.process_executor.BrokenProcessPool
    processes = processes or os.cpu_count() or 1

    def pool() -> Any:  # a new one after a lost worker
        return executor.get_reusable_executor(processes, context="spawn", initializer=_end_with_parent)

    return Cluster(processes, lambda *call: pool().submit(*call), (broken,), lambda: pool().shutdown(kill_workers=True))


def _end_with_parent() -> None:
    """Let this process, one of loky's, end when its parent has gone, however that was ended; by itself it would not."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=lambda: (connection.wait([parent.sentinel]), os._exit(1)), daemon=True).start()


def dask(address: str | None, processes: int | None) -> Cluster:
    """Return the workers of a Dask scheduler, such as tcp://host:8786, or new ones on this machine."""
    distributed = _needed("distributed", "dask")
    _needed("dask", "dask").config.set({"distributed.admin.large-graph-warning-threshold": "1 GB"})
    try:
        if address is None:
            client = distributed.Client(n_workers=processes, threads_per_worker=1, dashboard_address=None)
        else:
            client = distributed.Client(address, timeout="20 s")
    except (OSError, ValueError) as error:
        raise InputError(f"--address {address}: no Dask scheduler answers there ({error})") from None
    slots = processes or sum(client.nthreads().values())
    if not slots:
        client.close()
        raise InputError(f"--address {address}: the Dask scheduler has no workers; start some (dask worker {address})")
    return Cluster(slots, client.get_executor(pure=False).submit, (distributed.KilledWorker,), client.close)


def ray(address: str | None, processes: int | None) -> Cluster:
    """Return the workers of a Ray cluster, such as ray://host:10001 or auto, or new ones on this machine."""
    ray = _needed("ray", "ray")
    try:
        given = {"num_cpus": processes} if address is None else {"address": address}
        ray.init(log_to_driver=False, include_dashboard=False if address is None else None, **given)
    except (ConnectionError, ValueError) as error:
        raise InputError(f"--address {address}: no Ray cluster answers there ({error})") from None
    remote = cache(ray.remote)
    lost = ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError
    slots = processes or int(ray.cluster_resources().get("CPU", 1))
    return Cluster(slots, lambda function, *arguments: remote(function).remote(*arguments).future(), lost, ray.shutdown)


BACKENDS: dict[str, Callable[..., Cluster]] = {"loky": loky, "dask": dask, "ray": ray}


def connect(backend: str, address: str | None, processes: int | None) -> Cluster:
    """Return the cluster of a backend; processes: at most so many jobs at a time, None for as many as it has.

    Raises InputError where its package is missing or nothing answers.
    """
    if backend not in BACKENDS:
        raise InputError(f"--backend: unknown backend {backend!r}{did_you_mean(backend, BACKENDS)}")
    return BACKENDS[backend](address, processes)


def _needed(module: str, extra: str) -> Any:
    """Return an imported module of an optional package; raises InputError that names the extra where it is missing."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        missing = f"needs {error.name or module}; {with_extra(extra)}"
        raise InputError(f"--backend {'loky' if extra == 'joblib' else extra}: {missing}") from None
