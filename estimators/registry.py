"""Finds estimators by name: built in, installed with other packages, or in a file of the user's.

A spec is one of

- ``NAME`` or ``NAME-N``: an entry point in the group ``castor.estimators``, its class constructed without argument or
  with the number N. For the estimators of this package N is a castor, counted from 1: the one used
  (``dead-reckoning-2``) or the one left out (``ipec-3``, ``cast-1``, ``cast-arc-1``; 0 leaves none out: ``cast-0``).
  For those of trains it is the interval between corrections, in samples (``grpec-xy-1``).
- ``module:Class``, where the module is installed or lies in the current folder
- ``path/to/file.py`` or ``path/to/file.py:Class``
"""

import hashlib
import importlib
import importlib.metadata
import inspect
import os
import re
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from castor_envs.errors import InputError, did_you_mean
from castor_envs.robot import RobotDescription
from castor_envs.train import TrainDescription
from castor_envs.vehicles import Vehicle
from estimators.protocol import Estimator
from estimators.source_files import source_files, source_hash

GROUP = "castor.estimators"
TRAIN_ESTIMATORS = (
    "train-odometry",
    "two-truck-ipec",
    "rmspec",
    "train-least-squares",
    "grpec-phi",
    "grpec-dev",
    "grpec-xy",
    "inlier-least-squares",
)
_FOLDERS: set[Path] = set()  # of plug-in files, which may import their neighbours


@dataclass(frozen=True)
class EstimatorEntry:
    """An estimator that a spec names, ready to be made.

    name: for people and results. source_hash: 16 hex digits that change with the code (see `source_files`), the class
    and its argument. argument: the number in ``NAME-N``. Pickles as its spec, so that another process loads a plug-in
    by itself.
    """

    name: str
    spec: str
    source_hash: str
    kind: type
    argument: int | None = None

    @property
    def batched(self) -> bool:
        """Whether the estimator's arithmetic broadcasts over leading axes."""
        return bool(getattr(self.kind, "batched", False))

    @property
    def builtin(self) -> bool:
        """Whether the estimator belongs to this package."""
        return self.kind.__module__.startswith("estimators.")

    def factory(self) -> Estimator:
        """Make a new estimator."""
        return self.kind() if self.argument is None else self.kind(self.argument)

    def applicable(self, vehicle: Vehicle) -> str | None:
        """Return None if the estimator serves this robot or train, else the reason why not.

        Asks built-in estimators alone: a plug-in's code is never run here, lest it hangs. Its `reset` says so later,
        with a ValueError.
        """
        if self.builtin:
            try:
                reset_at_origin(self.factory(), vehicle)
            except ValueError as error:
                return str(error)
        return None

    def __reduce__(self) -> tuple[Callable[[str], "EstimatorEntry"], tuple[str]]:
        return load_estimator, (self.spec,)


def load_estimator(spec: str) -> EstimatorEntry:
    """Return the estimator that `spec` names (see the module's text); raises InputError with what to do."""
    if spec.endswith(".py") or ".py:" in spec:
        path, _, class_name = spec.partition(".py:") if ".py:" in spec else (spec[:-3], "", "")
        return _from_file(spec, Path(path + ".py"), class_name)
    if ":" in spec:
        return _from_module(spec)
    return _from_entry_point(spec)


def reset_at_origin(estimator: Estimator, vehicle: Vehicle) -> None:
    """Reset an estimator on a robot or a train, all poses 0: raises what its `reset` does where it declines."""
    shape = (vehicle.n_axles, 3) if isinstance(vehicle, TrainDescription) else (3,)
    estimator.reset(vehicle, np.zeros(shape))


def declines(error: BaseException, vehicle: Any) -> str | None:
    """Return the reason if what a `reset` raised says that it does not serve a vehicle, else None.

    A ValueError (InputError is one) does; so does asking a train for what only robots have, and the reverse: the
    estimator was written for the other kind.
    """
    if isinstance(error, ValueError):
        return " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, AttributeError) and error.obj is vehicle:
        is_train = isinstance(vehicle, TrainDescription)
        other = RobotDescription if is_train else TrainDescription
        name = error.name or ""
        if hasattr(other, name) or name in {field.name for field in fields(other)}:
            return f"is written for {'robots' if is_train else 'trains'}: it asks for {name!r}"
    return None


def builtin_names(vehicle: Vehicle) -> list[str]:
    """Return the names of this package's estimators that serve a robot or a train, from simple to complete.

    Of a robot: dead reckoning by the first castor that allows it, IPEC and CAST without each castor in turn, CAST with
    all. Of a train: `TRAIN_ESTIMATORS` at their own intervals.
    """
    if isinstance(vehicle, TrainDescription):
        return [name for name in TRAIN_ESTIMATORS if load_estimator(name).applicable(vehicle) is None]
    numbers = range(1, len(vehicle.castors) + 1)

    def serving(name: str, arguments: "range | list[int]") -> list[str]:
        specs = [f"{name}-{argument}" for argument in arguments]
        return [spec for spec in specs if load_estimator(spec).applicable(vehicle) is None]

    return [
        *serving("dead-reckoning", numbers)[:1],
        *serving("ipec", [0, *numbers]),
        *serving("cast", [*numbers, 0]),
        *serving("cast-arc", [0]),
    ]


def _from_entry_point(spec: str) -> EstimatorEntry:
    points = importlib.metadata.entry_points(group=GROUP)
    if spec not in points.names and spec and os.path.isfile(f"{spec}.py"):
        raise InputError(f"unknown estimator {spec!r}; did you mean the file {spec + '.py'!r}?")
    if not points.names:
        raise InputError(f"unknown estimator {spec!r}: none is registered; is castor-envs installed with pip?")
    name, argument = spec, None
    if spec not in points.names and (numbered := re.fullmatch(r"(.+)-(\d+)", spec, re.ASCII)):
        name, argument = numbered[1], int(numbered[2])
    if name not in points.names:
        known = points.names if argument is None else {f"{known}-{argument}" for known in points.names}
        raise InputError(f"unknown estimator {spec!r}{did_you_mean(spec, known)}")
    targets = {point.value: point for point in points.select(name=name)}
    if len(targets) > 1:
        raise InputError(f"estimator {name!r} is declared twice, as {' and '.join(sorted(targets))}: name one of them")
    (point,) = targets.values()
    module = _imported(lambda: importlib.import_module(point.module), f"estimator {spec!r} ({point.value})", None)
    return _entry(spec, spec, _class_in(module, point.attr, point.value), argument)


def _from_module(spec: str) -> EstimatorEntry:
    module_name, _, class_name = spec.partition(":")
    if not module_name or not class_name:
        raise InputError(f"estimator {spec!r}: expected module:Class")
    if os.getcwd() not in sys.path and "" not in sys.path:
        sys.path.append(os.getcwd())
    importlib.invalidate_caches()
    module = _imported(lambda: importlib.import_module(module_name), f"estimator {spec!r}", None)
    return _entry(spec, spec, _class_in(module, class_name, module_name))


def _from_file(spec: str, path: Path, class_name: str) -> EstimatorEntry:
    try:
        source = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    folder = path.resolve().parent
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    _FOLDERS.add(folder)
    module = ModuleType(f"castor_plugin_{path.stem}_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:8]}")
    module.__file__ = str(path.resolve())

    def run() -> ModuleType:
        # Compiled here, not by an import: no stale bytecode after an edit, no __pycache__ in the user's folder.
        sys.modules[module.__name__] = module
        exec(compile(source, module.__file__ or "", "exec", dont_inherit=True), module.__dict__)
        return module

    _imported(run, str(path), module.__file__)
    kind = _class_in(module, class_name, str(path)) if class_name else _only_class(module, path)
    for file, name in source_files(kind).items():
        loaded = getattr(sys.modules.get(name), "__file__", None) or file
        if Path(loaded).resolve() != file and Path(loaded).parent.resolve() in _FOLDERS:
            raise InputError(f"{path}: imports {name!r}, and another plug-in has loaded {loaded} as that; rename one")
    return _entry(f"{path.stem}:{kind.__name__}", spec, kind)


def _imported(run: Callable[[], ModuleType], what: str, file: str | None) -> ModuleType:
    """Return what `run` imports; turns whatever the user's code raises into one line, with the line in `file`."""
    try:
        return run()
    except (Exception, SystemExit) as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
        if isinstance(error, SyntaxError) and error.filename == file:
            lines.append(error.lineno)
        where = f", line {lines[-1]}" if lines else ""
        text = error.msg if isinstance(error, SyntaxError) else " ".join(str(error).split())
        raise InputError(f"{what}: cannot be imported{where} ({type(error).__name__}: {text})") from None


def _class_in(module: ModuleType, name: str, where: str) -> type:
    kind = getattr(module, name, None)
    if isinstance(kind, type):
        return kind
    if kind is not None:
        raise InputError(f"{where}: {name!r} is not a class")
    classes = _own_classes(module)
    raise InputError(f"{where}: there is no class {name!r}{did_you_mean(name, classes) if classes else ''}")


def _only_class(module: ModuleType, path: Path) -> type:
    """Return the one class of a file that can be an estimator."""
    classes = _own_classes(module)
    whole = [name for name in classes if not _missing(classes[name])]
    candidates = whole or [name for name in classes if len(_missing(classes[name])) == 1] or list(classes)
    if not candidates:
        raise InputError(f"{path}: there is no class in it; an estimator is a class with reset and update")
    if len(candidates) > 1:
        raise InputError(f"{path}: say which class, as {path}:{candidates[0]}; there are {', '.join(candidates)}")
    return classes[candidates[0]]


def _own_classes(module: ModuleType) -> dict[str, type]:
    """Return the classes that a module defines itself, in its order."""
    return {
        name: value
        for name, value in vars(module).items()
        if isinstance(value, type) and value.__module__ == module.__name__ and not name.startswith("_")
    }


def _missing(kind: type) -> list[str]:
    return [name for name in ("reset", "update") if not callable(getattr(kind, name, None))]


def _entry(name: str, spec: str, kind: type, argument: int | None = None) -> EstimatorEntry:
    if missing := _missing(kind):
        raise InputError(f"estimator {spec!r}: class {kind.__name__} has no method {' and no '.join(missing)}")
    if argument is not None:
        try:
            inspect.signature(kind).bind(argument)
        except (TypeError, ValueError):
            raise InputError(f"estimator {spec!r}: {kind.__name__} takes no number; leave out '-{argument}'") from None
        if kind.__module__.startswith("estimators."):
            try:
                kind(argument)
            except InputError as error:
                raise InputError(f"estimator {spec!r}: {error}") from None
    return EstimatorEntry(name, spec, source_hash(kind, argument), kind, argument)
