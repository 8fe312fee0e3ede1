"""Worker processes that run strangers' code: one job each at a time, killed when late, replaced when they end.

A plug-in may hang, crash or end its process (with exit code 0 too); what is lost is its own job. Workers are spawned,
so they start without the parent's memory, and with a safe path, so that nothing in the current folder shadows a
package.
"""

import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

_READY = "ready"


@dataclass(frozen=True, eq=False)
class Job:
    """A function of a module and its arguments, for a worker.

    subject: the caller's own note, never sent. owner: whose code it runs; a worker serves one owner only, since code
    can change the process that it runs in.
    """

    function: Callable[..., Any]
    arguments: tuple
    subject: Any = None
    timeout: float | None = None
    owner: Any = None


@dataclass(frozen=True)
class Done:
    """The function returned `value`."""

    value: Any


@dataclass(frozen=True)
class Raised:
    """The function raised; `text` is the traceback."""

    text: str


@dataclass(frozen=True)
class TimedOut:
    """The job was not done within its timeout, and its process was killed."""


@dataclass(frozen=True)
class Died:
    """The process ended before the job was done, with an exit code; negative is the number of a signal."""

    exit_code: int | None


Outcome = Done | Raised | TimedOut | Died


class Agenda(Protocol):
    """Where jobs come from. It is asked when a worker is free, so outcomes may lead to further jobs or to fewer."""

    def next_job(self) -> Job | None:
        """Return the next job, None if there is none at present."""
        ...


def run_jobs(agenda: Agenda, processes: int) -> Generator[tuple[Job, Outcome], None, None]:
    """Run the jobs of an agenda in worker processes; yield each with its outcome as it ends, until none is left.

    Close the generator to stop early: it kills its workers.
    """
    workers: list[_Worker] = []
    try:
        job = None
        while True:
            idle = [worker for worker in workers if worker.ready and worker.job is None]
            while idle or len(workers) < processes:
                job = job or agenda.next_job()
                if job is None:
                    break
                if not idle:
                    workers.append(_Worker())
                    continue
                own = [worker for worker in idle if worker.owner in (None, job.owner)]
                worker = own[-1] if own else idle[-1]
                idle.remove(worker)
                if own and worker.give(job):
                    job = None
                else:
                    worker.kill()
                    workers.remove(worker)
            if job is None and not any(worker.job for worker in workers):
                return
            for worker, outcome in _news(workers):
                if isinstance(outcome, TimedOut | Died):
                    workers.remove(worker)
                if worker.job is not None:
                    done, worker.job = worker.job, None
                    yield done, outcome
                elif not worker.ready:
                    raise RuntimeError(
                        "a worker process could not start; a script that starts a run needs "
                        "an `if __name__ == '__main__':` line around it"
                    )
    finally:
        for worker in workers:
            worker.kill()


class _Worker:
    """The parent's side of one worker process."""

    def __init__(self):
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process = context.Process(target=_serve, args=(theirs,), daemon=True)
        with _safe_path(), _sigint_blocked():
            self.process.start()
        theirs.close()
        self.ready = False
        self.owner: Any = None
        self.job: Job | None = None
        self.deadline = float("inf")

    def give(self, job: Job) -> bool:
        """Send a job; False if the process has ended."""
        try:
            self.connection.send((job.function, job.arguments))
        except OSError:
            self.kill()
            return False
        self.job = job
        self.owner = job.owner
        self.deadline = float("inf") if job.timeout is None else time.monotonic() + job.timeout
        return True

    def news(self) -> Outcome | None:
        """Return the outcome of the job if there is one by now."""
        try:
            if self.connection.poll():
                message = self.connection.recv()
                if message != _READY:
                    return message
                self.ready = True
                return None
        except (EOFError, OSError):
            return self._died()
        if not self.process.is_alive():
            return self._died()
        if self.job is not None and time.monotonic() > self.deadline:
            self.kill()
            return TimedOut()
        return None

    def _died(self) -> Died:
        self.process.join(1.0)
        exit_code = self.process.exitcode
        self.kill()
        return Died(exit_code)

    def kill(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


def _news(workers: list[_Worker]) -> Iterator[tuple[_Worker, Outcome]]:
    """Wait until something happens and yield the workers with an outcome."""
    first = min(worker.deadline for worker in workers if worker.job) if any(w.job for w in workers) else float("inf")
    patience = None if first == float("inf") else max(0.0, first - time.monotonic()) + 0.01
    wait([source for worker in workers for source in (worker.connection, worker.process.sentinel)], patience)
    for worker in list(workers):
        outcome = worker.news()
        if outcome is not None:
            yield worker, outcome


@contextmanager
def _safe_path() -> Iterator[None]:
    """Let Python processes started within put nothing of the current folder ahead of the installed packages."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before


@contextmanager
def _sigint_blocked() -> Iterator[None]:
    """Let processes started within never see Ctrl-C, not even while they start: the parent ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # multiprocessing's own helper, which unblocks the signal when it is started
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _serve(connection: Connection) -> None:
    """Run jobs until the parent goes away."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    warnings.simplefilter("ignore")
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - for the life of the process
    connection.send(_READY)
    while True:
        try:
            function, arguments = connection.recv()
            answer: Outcome = Done(function(*arguments))
        except EOFError:
            return
        except BaseException:
            answer = Raised(traceback.format_exc())
        try:
            connection.send(answer)
        except (ValueError, TypeError, AttributeError) as error:
            connection.send(Raised(f"the result cannot be sent: {error}"))


def _end_with_parent() -> None:
    """End this process when the parent is gone, even in the middle of a plug-in's endless loop."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
