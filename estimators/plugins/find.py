"""Finds classes by name: built in, or plugged in by an entry point, in a module, or in a file of the user's."""

import contextlib
import hashlib
import importlib
import importlib.metadata
import inspect
import os
import re
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from castor_envs.discovery import offers
from castor_envs.errors import InputError, did_you_mean, one_line
from castor_envs.processes import what_plug_ins_raise
from estimators.plugins import parameters
from estimators.plugins.source_hash import PLUG_IN_FOLDERS, source_files, source_hash


@dataclass(frozen=True)
class PlugInKind:
    """A kind of plug-in: what people call it, its group of entry points, the methods that its class needs.

    packages: those of this project whose modules offer built-in classes by name, as the constant `constant`. numbered:
    whether ``NAME-N`` constructs the class called NAME with the number N, and ``...?parameter=value`` a class with
    keyword arguments. instead: methods that do as well as `methods`.
    """

    what: str
    group: str
    methods: tuple[str, ...]
    packages: tuple[str, ...]
    constant: str
    numbered: bool = False
    instead: tuple[str, ...] = ()

    @cached_property
    def built_in(self) -> dict[str, type]:
        """The classes of this project by their names, in alphabetical order."""
        found = [names for package in self.packages for names in offers(package, self.constant)]
        for name, kind in (entry for names in found for entry in names.items()):
            if not isinstance(kind, type):
                raise InputError(f"{self.constant} offers as {name!r} {kind!r}, which is not a class; give the class")
        return dict(sorted((name, kind) for names in found for name, kind in names.items()))

    def names(self) -> list[str]:
        """Return the names of built-in classes and of those that other installed packages declare, sorted."""
        return sorted({*self.built_in, *declared(self.group).names})


def declared(group: str) -> importlib.metadata.EntryPoints:
    """Return the entry points of a group that installed packages declare."""
    return _declared(group, tuple(sys.path))


@cache
def _declared(group: str, path: tuple[str, ...]) -> importlib.metadata.EntryPoints:
    """Return the entry points of the packages on a path: it takes a hundredth of a second to search."""
    return importlib.metadata.entry_points(group=group)


class PlugIn(NamedTuple):
    """What a spec names: the name for people and results, the hash of its source, the class, what that is made with."""

    name: str
    source_hash: str
    kind: type
    argument: int | None
    parameters: dict[str, Any]


def find(spec: str, role: PlugInKind) -> PlugIn:
    """Return what `spec` names: NAME, ``module:Class`` or ``file.py[:Class]``; of numbered roles with parameters too.

    Raises InputError with what to do.
    """
    whole, (spec, given) = spec, parameters.split(spec, role.what) if role.numbered else (spec, {})
    name, kind, argument = _found(spec, role)
    place = f"{role.what} {whole!r}"
    converted = parameters.arguments(kind, given, place, 0 if argument is None else 1)
    if kind.__module__.startswith("estimators.") and (converted or argument is not None):
        try:
            kind(*(() if argument is None else (argument,)), **converted)
        except InputError as error:
            raise InputError(f"{place}: {error}") from None
    made_with = source_hash(kind, argument, converted)
    return PlugIn(parameters.named(name, converted, place), made_with, kind, argument, converted)


def _found(spec: str, role: PlugInKind) -> tuple[str, type, int | None]:
    """Return the name, the class and the number of a spec without parameters."""
    if spec.endswith(".py") or ".py:" in spec:
        path, _, class_name = spec.partition(".py:") if ".py:" in spec else (spec[:-3], "", "")
        return _from_file(spec, Path(path + ".py"), class_name, role)
    if ":" in spec:
        return _from_module(spec, role)
    return _by_name(spec, role)


def runs_others_code(spec: str, role: PlugInKind) -> bool:
    """Return whether `find` imports code of others: any spec but that of a built-in class, or of nothing known."""
    spec = spec.partition("?")[0] if role.numbered else spec
    if ":" in spec or spec.endswith(".py"):
        return True
    names = declared(role.group).names
    return spec in names or _name_and_number(spec)[0] in names


def _name_and_number(spec: str) -> tuple[str, int | None]:
    """Return NAME and N of the spec NAME-N; of any other the spec itself and None."""
    numbered = re.fullmatch(r"(.+)-(\d+)", spec, re.ASCII)
    return (numbered[1], int(numbered[2])) if numbered else (spec, None)


def _by_name(spec: str, role: PlugInKind) -> tuple[str, type, int | None]:
    points = declared(role.group)
    names = role.names()
    if spec not in names and spec and os.path.isfile(f"{spec}.py"):
        raise InputError(f"unknown {role.what} {spec!r}; did you mean the file {spec + '.py'!r}?")
    name, argument = (spec, None) if spec in names or not role.numbered else _name_and_number(spec)
    if name not in names:
        known = names if argument is None else {f"{known}-{argument}" for known in names}
        raise InputError(f"unknown {role.what} {spec!r}{did_you_mean(spec, known)}")
    targets = {point.value: point for point in points.select(name=name)}
    if (built_in := role.built_in.get(name)) is not None:
        if targets:
            raise InputError(
                f"{role.what} {name!r} is built in, and declared again as {' and '.join(sorted(targets))}: rename one"
            )
        return _plug_in(spec, spec, built_in, role, argument)
    if len(targets) > 1:
        raise InputError(
            f"{role.what} {name!r} is declared twice, as {' and '.join(sorted(targets))}: name one of them"
        )
    (point,) = targets.values()
    module = _imported(lambda: importlib.import_module(point.module), f"{role.what} {spec!r} ({point.value})", None)
    return _plug_in(spec, spec, _class_in(module, point.attr, point.value), role, argument)


def _from_module(spec: str, role: PlugInKind) -> tuple[str, type, int | None]:
    module_name, _, class_name = spec.partition(":")
    if not module_name or not class_name:
        raise InputError(f"{role.what} {spec!r}: expected module:Class")
    if os.getcwd() not in sys.path and "" not in sys.path:
        sys.path.append(os.getcwd())
    importlib.invalidate_caches()
    module = _imported(lambda: importlib.import_module(module_name), f"{role.what} {spec!r}", None)
    return _plug_in(spec, spec, _class_in(module, class_name, module_name), role)


def _from_file(spec: str, path: Path, class_name: str, role: PlugInKind) -> tuple[str, type, int | None]:
    try:
        source = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    folder = path.resolve().parent
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    PLUG_IN_FOLDERS.add(folder)
    module = ModuleType(f"castor_plugin_{path.stem}_{hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:8]}")
    module.__file__, module.__package__ = str(path.resolve()), ""

    def run() -> ModuleType:
        # Compiled here, not by an import: no stale bytecode after an edit, no __pycache__ in the user's folder.
        sys.modules[module.__name__] = module
        exec(compile(source, module.__file__ or "", "exec", dont_inherit=True), module.__dict__)
        return module

    _imported(run, str(path), module.__file__, _as_module(path.resolve(), class_name or "Class"))
    kind = _class_in(module, class_name, str(path)) if class_name else _only_class(module, path, role)
    for file, name in source_files(kind).items():
        loaded = getattr(sys.modules.get(name), "__file__", None) or file
        if Path(loaded).resolve() != file and Path(loaded).parent.resolve() in PLUG_IN_FOLDERS:
            raise InputError(f"{path}: imports {name!r}, and another plug-in has loaded {loaded} as that; rename one")
    return _plug_in(f"{path.stem}:{kind.__name__}", spec, kind, role)


def _as_module(file: Path, class_name: str) -> str:
    """Return how a class of a file in a package is named as a module, from which folder."""
    top = next(folder for folder in file.parent.parents if not (folder / "__init__.py").is_file())
    module = ".".join(file.relative_to(top).with_suffix("").parts)
    return f"{module}:{class_name}, in the folder that holds {module.partition('.')[0]}"


def _imported(run: Callable[[], ModuleType], origin: str, file: str | None, as_module: str = "") -> ModuleType:
    """Return what `run` imports; turns whatever the user's code raises into one line, with the line in `file`.

    as_module: how to name a file that imports relatively to its package. The current folder stays what it is: the names
    of files are relative to it.
    """
    try:
        with contextlib.chdir(os.curdir):
            return run()
    except what_plug_ins_raise() as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == file]
        if isinstance(error, SyntaxError) and error.filename == file:
            lines.append(error.lineno)
        place = f", line {lines[-1]}" if lines else ""
        text = f"{type(error).__name__}: {error.msg}" if isinstance(error, SyntaxError) else one_line(error)
        relative = as_module and isinstance(error, ImportError) and "no known parent package" in text
        advice = f"; relative imports need the package: name it as {as_module}" if relative else ""
        raise InputError(f"{origin}: cannot be imported{place} ({text}){advice}") from None


def _class_in(module: ModuleType, name: str, source: str) -> type:
    kind = getattr(module, name, None)
    if isinstance(kind, type):
        return kind
    if kind is not None:
        raise InputError(f"{source}: {name!r} is not a class")
    classes = _own_classes(module)
    raise InputError(f"{source}: there is no class {name!r}{did_you_mean(name, classes) if classes else ''}")


def _only_class(module: ModuleType, path: Path, role: PlugInKind) -> type:
    """Return the one class of a file that can play a role."""
    classes = _own_classes(module)
    lacking = {name: _missing(kind, role) for name, kind in classes.items()}
    complete = [name for name in classes if not lacking[name]]
    candidates = complete or [name for name in classes if len(lacking[name]) < len(role.methods)] or list(classes)
    if not candidates:
        methods = " and ".join(role.methods)
        raise InputError(f"{path}: there is no class in it; {_with_article(role.what)} is a class with {methods}")
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


def _missing(kind: type, role: PlugInKind) -> list[str]:
    """Return the methods that a class lacks to play a role."""
    if role.instead and all(callable(getattr(kind, name, None)) for name in role.instead):
        return []
    return [name for name in role.methods if not callable(getattr(kind, name, None))]


def _with_article(noun: str) -> str:
    return f"an {noun}" if noun[0] in "aeiou" else f"a {noun}"


def _plug_in(
    name: str, spec: str, kind: type, role: PlugInKind, argument: int | None = None
) -> tuple[str, type, int | None]:
    if missing := _missing(kind, role):
        raise InputError(f"{role.what} {spec!r}: class {kind.__name__} has no method {' and no '.join(missing)}")
    if argument is not None:
        try:
            inspect.signature(kind).bind(argument)
        except (TypeError, ValueError):
            text = f"{role.what} {spec!r}: {kind.__name__} takes no number; leave out '-{argument}'"
            raise InputError(text) from None
    return name, kind, argument
