"""Where the machine code of kernels is kept, and how it is known to be current.

Code is looked for, in this order, in the folder that the variable CASTOR_CACHE names, or else in ``__pycache__`` beside
the kernel's module (where an installation is shared, whoever may write there compiles for all; not beside a plug-in's
file) and in the user's own cache. It is kept in the first of these that can be written; where none can be, each process
compiles for itself.

A file's name has a digest of all that the code depends on: the sources of the kernel's module, of the compiler, and of
every module of the package that these import, directly or not, how it is called, the versions of numba and llvmlite,
and the processor. So an edited source, another version or another machine is another file, and code is never taken for
another one's.
"""

import contextlib
import hashlib
import importlib.metadata
import importlib.util
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import llvmlite
import llvmlite.binding as llvm

from castor_envs.discovery import imported_names
from castor_envs.files import write_atomically

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

VARIABLE = "CASTOR_CACHE"
COMPILER = "castor_envs.kernels.compiler"
CALLED = ("castor_envs", "estimators")
"""Packages whose functions a kernel in a file of its own may call."""
_DIGEST = 32
"""Bytes of SHA-256 before the code in a file: LLVM would not survive a damaged one."""


def cached_code(module: str, call: str, compiled: Callable[[], bytes]) -> bytes:
    """Return the machine code of a kernel from a cache, or from `compiled`, which is then kept in one.

    call: how the kernel is called, as text. Of several processes that need it at once, one compiles.
    """
    sources = kernel_sources(module)
    name = f"{module.rpartition('.')[2]}-{_digest([*sources, *kernel_sources(COMPILER)], call)}.o"
    places = _places(sources[0].parent if "." in module else None)
    for place in places:
        if (code := _read(place / name)) is not None:
            return code
    for place in places:
        with contextlib.suppress(OSError), _alone(place / f"{name}.lock"):
            code = _read(place / name) or compiled()
            with contextlib.suppress(OSError):
                write_atomically(place / name, hashlib.sha256(code).digest() + code)
            return code
    return compiled()


def kernel_sources(module: str) -> list[Path]:
    """Return the file of a module and those of all modules of its package that it imports, directly or not.

    Of a module in no package, as a plug-in's file is one, these are the modules beside it and those of `CALLED`.
    """
    package, _, within = module.partition(".")
    single = None if within else getattr(sys.modules.get(module), "__file__", None)
    found = {} if single is None else {Path(single): None}
    roots = {name: _root_of(name) for name in ((package,) if single is None else CALLED)}
    waiting = [module] if single is None else sorted(imported_names(Path(single).read_bytes(), ""))
    while waiting:
        name = waiting.pop(0)
        root = roots.get(name.partition(".")[0]) or (Path(single).parent if single else None)
        if root is not None and (file := _file_of(root, name)) and file not in found:
            found[file] = None
            waiting += sorted(imported_names(file.read_bytes(), name.rpartition(".")[0]))
    return list(found)


def _root_of(package: str) -> Path:
    """Return the folder that holds a package."""
    spec = importlib.util.find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).parent.parent


def _file_of(root: Path, module: str) -> Path | None:
    """Return the file of a module, None for what is no module: a package's own file defines nothing for kernels."""
    file = root.joinpath(*module.split(".")).with_suffix(".py")
    return file if file.is_file() else None


def _digest(sources: list[Path], call: str) -> str:
    seen = hashlib.sha256(call.encode())
    for file in sources:
        seen.update(file.name.encode() + b"\0" + hashlib.sha256(file.read_bytes()).digest())
    processor = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten(), llvm.get_process_triple()
    versions = importlib.metadata.version("numba"), llvmlite.__version__
    seen.update(repr((processor, versions)).encode())
    return seen.hexdigest()[:32]


def _places(beside: Path | None) -> list[Path]:
    """Return the folders that may hold code; beside: the folder of the kernel's source, None for one of a plug-in's
    user."""
    if named := os.environ.get(VARIABLE):
        return [Path(named)]
    own = _user_cache()
    return [*([] if beside is None else [beside / "__pycache__"]), *([] if own is None else [own / "castor-envs"])]


def _user_cache() -> Path | None:
    """Return the folder of this user's caches, None for a user without a home."""
    try:
        if sys.platform == "win32":
            return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
        if sys.platform == "darwin":
            return Path.home() / "Library" / "Caches"
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:
        return None


def _read(path: Path) -> bytes | None:
    """Return the code in a file, None if it is not there, cannot be read, or is damaged."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    code = data[_DIGEST:]
    return code if code and hashlib.sha256(code).digest() == data[:_DIGEST] else None


@contextlib.contextmanager
def _alone(lock: Path) -> Iterator[None]:
    """Wait until no other process is in this context; raises OSError where the folder cannot be written."""
    lock.parent.mkdir(parents=True, exist_ok=True)
    with lock.open("wb") as file:
        if fcntl is not None:
            with contextlib.suppress(OSError):  # of a file system without locks
                fcntl.flock(file, fcntl.LOCK_EX)
        yield
