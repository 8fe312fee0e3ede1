"""Worker processes that run plug-ins' code: one job at a time each, killed when late, replaced when they end.

A plug-in may hang, crash or end its process (with exit code 0 too), start processes, fill the memory or print without
end; only its own job is lost. Workers are spawned, so they start without the parent's memory, with a safe path, so that
nothing in the current folder shadows a package, and with one thread of linear algebra each.

Where there are sessions (not on Windows) each worker leads a new session: it ends together with all processes that the
plug-in started, also when the parent is killed. What a plug-in prints to stdout is dropped, to stderr it is shown.
"""

import contextlib
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from typing import Any, Protocol

from castor_envs.errors import InputError

try:
    import resource
except ImportError:  # Windows
    resource = None

MOST_MEMORY = 4 * 2**30 + 64 * 2**20 * (os.cpu_count() or 1)
"""Bytes that a worker, and every process that it starts, may take (the kernel's count of data): over ten times what
built-in jobs take (0.15 GB of packages and up to 0.2 GB of data), and little enough that one plug-in does not drive a
common machine out of memory. Linear algebra reserves stack and buffers for each core. Where the system does not count
(macOS, Windows) there is no limit."""

MOST_CHILDREN = 64
"""Processes that a plug-in may have at a time, those that ended unawaited included: enough for one a core and a helper
each, and far from what troubles a machine. Counted where there is /proc."""

MOST_PRINTED = 100_000
"""Bytes that a job may print to stderr: a thousand lines, more than anyone reads."""

LOOK = 0.5
"""s between two looks at the workers' processes: a look costs about a millisecond."""

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Variables that say how many threads NumPy's linear algebra uses."""

_READY, _BEGUN = "ready", "begun"

_starting = threading.Lock()
"""Held while a worker is started, which needs the environment for itself."""


@dataclass(frozen=True, eq=False)
class Job:
    """A function of a module and its arguments, for a worker.

    timeout: s, from when the function is called; to import its module is not counted.
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
    """The function raised; `text` is the traceback, `error` what was raised if the parent may raise it again."""

    text: str
    error: InputError | OSError | None = None

    def again(self, doing: str) -> Exception:
        """Return what the parent should raise: `error`, or a RuntimeError in one line, the traceback as its note."""
        if self.error is not None:
            return self.error
        failed = RuntimeError(f"{doing}: {self.text.strip().splitlines()[-1]}")
        failed.add_note(self.text)
        return failed


@dataclass(frozen=True)
class TimedOut:
    """The job was not done within its timeout, and its process was killed."""


@dataclass(frozen=True)
class Died:
    """The process ended before the job was done, with an exit code; negative is the number of a signal."""

    exit_code: int | None


@dataclass(frozen=True)
class Exceeded:
    """The job went beyond a limit, such as "started over 64 processes", and its process was killed."""

    what: str


Outcome = Done | Raised | TimedOut | Died | Exceeded


class Agenda(Protocol):
    """Where jobs come from. It is asked when a worker is free, so outcomes may lead to further jobs or to fewer."""

    def next_job(self) -> Job | None:
        """Return the next job, None if there is none at present."""
        ...


class InOrder:
    """Jobs known from the start, one after another."""

    def __init__(self, jobs: Iterable[Job]):
        self._jobs = iter(jobs)

    def next_job(self) -> Job | None:
        """Return the next job, None after the last."""
        return next(self._jobs, None)


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
                matching = [worker for worker in idle if worker.owner in (None, job.owner)]
                worker = matching[-1] if matching else idle[-1]
                idle.remove(worker)
                if matching and worker.give(job):
                    job = None
                else:
                    worker.kill()
                    workers.remove(worker)
            if job is None and not any(worker.job for worker in workers):
                return
            for worker, outcome in _news(workers):
                if isinstance(outcome, TimedOut | Died | Exceeded):
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


class OneWorker:
    """A worker process that runs one job after another as they are given; a new one takes its place when it ends."""

    def __init__(self):
        self._next: Job | None = None
        self._outcomes = run_jobs(self, 1)

    def next_job(self) -> Job | None:
        """Return the job that was given, once."""
        job, self._next = self._next, None
        return job

    def outcome(self, job: Job) -> Outcome:
        """Run a job; return its outcome."""
        self._next = job
        return next(self._outcomes)[1]

    def close(self) -> None:
        """End the process."""
        self._outcomes.close()


def end_if_forked() -> None:
    """End this process if a plug-in made it by a fork in a worker: it must not go on with the worker's work.

    To be called wherever a plug-in's code returns. Does nothing outside of workers.
    """
    if _worker is not None and os.getpid() != _worker:
        os._exit(0)


def what_plug_ins_raise() -> tuple[type[BaseException], ...]:
    """Return the exceptions that count as a plug-in's own: in a worker, which Ctrl-C does not reach, any whatever."""
    return (Exception, SystemExit) if _worker is None else (BaseException,)


_worker: int | None = None
"""The process number of this worker; None in any other process."""


class _Worker:
    """The parent's side of one worker process."""

    def __init__(self):
        context = multiprocessing.get_context("spawn")
        self.connection, worker_end = context.Pipe()
        self.errors, worker_errors = context.Pipe(duplex=False)
        self.process = context.Process(target=_serve, args=(worker_end, worker_errors), daemon=True)
        with _starting, _environment(), _sigint_deferred():
            if multiprocessing.current_process().daemon:  # as a Dask worker is: it may start none, lest they outlive it
                multiprocessing.current_process().daemon = False  # ours end with it by themselves
            self.process.start()
        worker_end.close()
        worker_errors.close()
        self.ready = False
        self.owner: Any = None
        self.job: Job | None = None
        self.deadline = float("inf")
        self.printed = 0

    @property
    def sources(self) -> list[Any]:
        """What has something to read when there is news."""
        return [source for source in (self.connection, self.errors, self.process.sentinel) if source is not None]

    def give(self, job: Job) -> bool:
        """Send a job; False if the process has ended."""
        try:
            self.connection.send((job.function, job.arguments))
        except OSError:
            self.kill()
            return False
        self.job = job
        self.owner = job.owner
        self.deadline = float("inf")
        self.printed = 0
        return True

    def news(self, processes: int) -> Outcome | None:
        """Return the outcome of the job if it has ended. processes: in the worker's session."""
        self._show_printed()
        try:
            if self.connection.poll():
                match self.connection.recv():
                    case str(note):
                        self.ready = True
                        if note == _BEGUN and self.job is not None and self.job.timeout is not None:
                            self.deadline = time.monotonic() + self.job.timeout
                    case outcome:
                        return outcome
        except (EOFError, OSError):
            return self._died()
        if not self.process.is_alive():
            return self._died()
        if self.printed > MOST_PRINTED:
            self.kill()
            return Exceeded(f"printed over {MOST_PRINTED // 1000} kB to stderr")
        if processes - 2 > MOST_CHILDREN:  # without the worker and its watcher, which the plug-in did not start
            self.kill()
            return Exceeded(f"started over {MOST_CHILDREN} processes")
        if self.job is not None and time.monotonic() > self.deadline:
            self.kill()
            return TimedOut()
        return None

    def _show_printed(self) -> None:
        """Pass on what the worker printed, up to the limit."""
        try:
            while self.errors is not None and self.printed <= MOST_PRINTED and self.errors.poll():
                text = os.read(self.errors.fileno(), 65536)
                if not text:
                    raise EOFError
                self.printed += len(text)
                if self.printed <= MOST_PRINTED:
                    sys.stderr.write(text.decode(errors="replace"))
        except (EOFError, OSError):
            self.errors = None

    def _died(self) -> Died:
        self.process.join(1.0)
        exit_code = self.process.exitcode
        self.kill()
        return Died(exit_code)

    def kill(self) -> None:
        """End the process and all that it started."""
        if hasattr(os, "killpg") and self.process.pid is not None:
            # The session has the worker's number; before the worker has made it, there is none.
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self.process.pid, signal.SIGKILL)
        self.process.kill()
        self.process.join()
        self._show_printed()
        self.connection.close()


def _news(workers: list[_Worker]) -> Iterator[tuple[_Worker, Outcome]]:
    """Wait until something happens and yield the workers with an outcome."""
    first = min((worker.deadline for worker in workers if worker.job), default=float("inf"))
    # A process that a plug-in forked keeps a dead worker's pipes open, so the end of a worker has to be looked for.
    wait([source for worker in workers for source in worker.sources], min(max(0.0, first - time.monotonic()), LOOK))
    processes = _group_sizes()
    for worker in list(workers):
        outcome = worker.news(processes[worker.process.pid])
        if outcome is not None:
            yield worker, outcome


def _group_sizes() -> Counter[int | None]:
    """Return the number of processes of every process group; of none where there is no /proc."""
    sizes: Counter[int | None] = Counter()
    with contextlib.suppress(OSError):
        for name in os.listdir("/proc"):
            if name.isdigit():
                with contextlib.suppress(OSError):
                    sizes[os.getpgid(int(name))] += 1
    return sizes


@contextmanager
def _environment() -> Iterator[None]:
    """Let processes started within have a safe path and one thread of linear algebra each, where the user says nothing.

    A safe path: Python puts nothing of the current folder ahead of the installed packages. There is a worker for each
    core, so more threads would wait for each other: a filter of a train of five axles took four times the CPU time.
    """
    wanted = {"PYTHONSAFEPATH": "1", **{name: os.environ.get(name, "1") for name in THREADS}}
    before = {name: os.environ.get(name) for name in wanted}
    os.environ.update(wanted)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _sigint_deferred() -> Iterator[None]:
    """Let processes started within never see Ctrl-C, not even while they start: the parent ends them.

    In the parent it acts afterwards, so that no process is left half started.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # multiprocessing's own helper, which unblocks the signal when it is started
    came: list[int] = []
    # Another thread may take the signal in spite of the mask; then the handler runs in the main thread all the same.
    main = threading.current_thread() is threading.main_thread()
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number)) if main else None
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if main:
            signal.signal(signal.SIGINT, handler or signal.SIG_DFL)
        if came:
            signal.raise_signal(signal.SIGINT)


def _serve(connection: Connection, errors: Connection) -> None:
    """Run jobs until the parent goes away."""
    global _worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    warnings.simplefilter("ignore")
    _worker = os.getpid()
    _end_with_parent()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    os.dup2(errors.fileno(), 2)
    errors.close()
    if resource is not None:
        hardest = resource.getrlimit(resource.RLIMIT_DATA)[1]
        limit = MOST_MEMORY if hardest == resource.RLIM_INFINITY else min(MOST_MEMORY, hardest)
        resource.setrlimit(resource.RLIMIT_DATA, (limit, hardest))
    try:
        connection.send(_READY)
        while True:
            answer = _answer(connection)
            end_if_forked()
            try:
                connection.send(answer)
            except (ValueError, TypeError, AttributeError, pickle.PicklingError) as error:
                connection.send(Raised(f"the result cannot be sent: {error}"))
    except (EOFError, OSError):  # the parent has gone
        return


def _answer(connection: Connection) -> Outcome:
    """Run the next job; raises EOFError or OSError if there is none because the parent has gone."""
    received = connection.recv_bytes()
    try:
        function, arguments = pickle.loads(received)  # imports what the function needs
        connection.send(_BEGUN)
        return Done(function(*arguments))
    except BaseException as error:
        # Errors of plug-ins' own types stay here: the parent would have to load their code.
        known = type(error).__module__ in ("builtins", InputError.__module__)
        raised = error if known and isinstance(error, InputError | OSError) else None
        return Raised(traceback.format_exc(), raised)


def _end_with_parent() -> None:
    """Make this process, and all that it starts, end when the parent is gone, whatever a plug-in does."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    if not hasattr(os, "fork"):
        threading.Thread(target=lambda: (wait([parent.sentinel]), os._exit(1)), daemon=True).start()
        return
    os.setsid()
    if os.fork() == 0:
        # In a separate process, since a plug-in may keep all threads of this one waiting.
        try:
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM, signal.SIGHUP})
            os.closerange(0, parent.sentinel)
            os.closerange(parent.sentinel + 1, os.sysconf("SC_OPEN_MAX"))
            wait([parent.sentinel])
            os.killpg(0, signal.SIGKILL)
        finally:
            os._exit(1)
