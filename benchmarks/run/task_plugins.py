"""Tasks of others: a class in a file or a module, constructed without arguments, that follows the protocol `Task`."""

import re
import sys
import traceback
from collections.abc import Sequence
from functools import lru_cache
from typing import Any, cast

from benchmarks.results.episodes import file_name
from benchmarks.run.check import load_apart
from benchmarks.scoring.registry import BOARD_METRICS
from benchmarks.tasks.task import Case, Episode, Task
from castor_envs.cli.contained import contained
from castor_envs.errors import InputError, did_you_mean, one_line
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription
from estimators.plugins.find import PlugInKind, find

TASK = PlugInKind("task", "castor.tasks", ("cases", "record"), (), "TASKS")
DEFAULTS: dict[str, Any] = {"group": "plugged-in", "standard": False, "missing": None}
"""What a task of others may leave out."""

_NEEDED = sorted(name for name in dir(Task) if not name.startswith("_") and name not in DEFAULTS)
_NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")


class PluggedTask:
    """A task of others: what its class says, under a name that changes with its source. spec: what commands take.

    Pickles as its spec and source, so that a worker process loads it by itself.
    """

    def __init__(self, spec: str, source_hash: str, task: Any) -> None:
        self.spec, self._source_hash, self._task = spec, source_hash, task
        self.name = f"{task.name}[{source_hash}]"

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        if name in DEFAULTS:
            return getattr(self._task, name, DEFAULTS[name])
        return getattr(self._task, name)

    def cases(self, n: int | None = None) -> Sequence[Case]:
        """Return the first n cases, None: all; raises InputError for what is no case or has a name that no file has."""
        with contained():
            cases = self._task.cases() if n is None else self._task.cases(n)
        for case in cases:
            try:
                if not (isinstance(case, str) or (type(case) is int and case >= 0)):
                    raise ValueError(f"case {case!r}: give an int from 0 on, or a name")
                file_name(case)
            except ValueError as error:
                raise InputError(f"task {self.spec!r}: {error}") from None
        return cases

    def record(self, case: Case) -> Episode:
        """Return the episode of a case; raises InputError for whatever the task raises, and for what is no episode."""
        place = f"task {self.spec!r}, case {case!r}"
        try:
            with contained():
                episode = self._task.record(case)
        except InputError:
            raise
        except Exception as error:
            file = getattr(sys.modules.get(type(self._task).__module__), "__file__", None)
            lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
            where = f", line {lines[-1]} of {file}" if lines else ""
            raise InputError(f"{place}: record raises {one_line(error)}{where}") from None
        if not isinstance(episode, Episode):
            raise InputError(f"{place}: record returns {type(episode).__name__} instead of an Episode")
        return episode

    def source_digest(self, case: Case) -> str | None:
        """Return what the task says of a case's data, None where it says nothing; raises InputError as `record`."""
        offered = getattr(self._task, "source_digest", None)
        try:
            digest = None if offered is None else offered(case)
        except InputError:
            raise
        except Exception as error:
            raise InputError(f"task {self.spec!r}, case {case!r}: source_digest raises {one_line(error)}") from None
        if offered is not None and (not isinstance(digest, str) or not digest):
            raise InputError(f"task {self.spec!r}, case {case!r}: source_digest returns {digest!r} instead of a text")
        return digest

    def __reduce__(self) -> tuple[Any, tuple[str, str]]:
        return _again, (self.spec, self._source_hash)


def is_plugged(name: str) -> bool:
    """Return whether the name of a task is that of a class of others, ``file.py[:Class]`` or ``module:Class``."""
    return name.endswith(".py") or ":" in name


def given_as(task: Task) -> str:
    """Return what names a task in a command: its spec or its name."""
    return task.spec if isinstance(task, PluggedTask) else task.name


def load_task(spec: str) -> PluggedTask:
    """Return the task that ``file.py[:Class]`` or ``module:Class`` names; raises InputError with what to do."""
    with contained():
        return _loaded(spec)


def _loaded(spec: str) -> PluggedTask:
    found, place = find(spec, TASK), f"task {spec!r}"
    try:
        task = found.kind()
        lacking = [name for name in _NEEDED if not hasattr(task, name)]
        if lacking:
            without = f"class {found.kind.__name__} has no {' and no '.join(lacking)}"
            raise InputError(f"{place}: {without} (`help(benchmarks.tasks.task.Task)` says what each is)")
        _check(task, place)
        plugged = PluggedTask(spec, found.source_hash, task)
        plugged.cases()
    except InputError:
        raise
    except Exception as error:
        failed = f"class {found.kind.__name__} cannot be made without arguments, or asked what it is"
        raise InputError(f"{place}: {failed} ({one_line(error)})") from None
    return plugged


def with_plugged(tasks: Sequence[Task], names: Sequence[str], timeout: float) -> tuple[tuple[Task, ...], list[str]]:
    """Return tasks with those of others that `names` holds, and the names with theirs in place of their specs.

    A task of others is first loaded in a separate process, with `timeout` (s): one that hangs or ends its process is
    refused by an InputError.
    """
    known, chosen = list(tasks), []
    official = {task.name for task in tasks}
    for name in names:
        if is_plugged(name):
            load_apart(name, timeout, load_task)
            task = load_task(name)
            if task.name.partition("[")[0] in official:
                raise InputError(f"task {name!r}: an official task is named {task.name.partition('[')[0]!r}; rename it")
            known.append(cast(Task, task))
            chosen.append(task.name)
        else:
            chosen.append(name)
    return tuple(known), chosen


def _check(task: Any, place: str) -> None:
    """Raise InputError for what of a task would fail later."""
    if not isinstance(task.name, str) or not _NAME.fullmatch(task.name):
        raise InputError(f"{place}: its name is {task.name!r}; use lower-case words joined by hyphens")
    if type(task.version) is not int or task.version < 1:
        raise InputError(f"{place}: its version is {task.version!r}; count from 1")
    if task.metric not in BOARD_METRICS:
        raise InputError(f"{place}: unknown metric {task.metric!r}{did_you_mean(str(task.metric), BOARD_METRICS)}")
    if not BOARD_METRICS[task.metric].ranks:
        raise InputError(f"{place}: {task.metric!r} is no error, and cannot rank")
    if not isinstance(task.robot, RobotDescription | TrainDescription):
        raise InputError(f"{place}: its robot is of type {type(task.robot).__name__}; give a robot or a train")
    if len(task.cases(1)) != 1 or not task.cases():
        raise InputError(
            f"{place}: cases(1) returns {task.cases(1)!r}; return the first case, and all without a number"
        )


@lru_cache(maxsize=8)
def _again(spec: str, source_hash: str) -> PluggedTask:
    """Return a task in another process; raises InputError if its source has changed since it was sent."""
    task = load_task(spec)
    if task._source_hash != source_hash:
        raise InputError(f"task {spec!r}: its source changed while the benchmark ran; run again")
    return task
