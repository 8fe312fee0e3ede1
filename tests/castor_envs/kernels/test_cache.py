"""Machine code is current, shared, compiled once, and not needed."""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

import castor_envs
from castor_envs.kernels.arguments import INTEGER, REAL, array
from castor_envs.kernels.cache import cached_code, kernel_sources
from castor_envs.kernels.kernel import Kernel

ROOT = Path(castor_envs.__file__).parents[1]
LOOP = "castor_envs.physics.compiled_loop"
STEP = """
import sys, castor_envs, gymnasium as gym
env = gym.make("castor/ASOC-v1")
env.reset(seed=0)
print(repr(env.step(env.action_space.sample() * 0)[1]), sorted({"numba", "scipy"} & set(sys.modules)))
"""
OTHERS = ("CASTOR_CACHE", "XDG_CACHE_HOME", "HOME", "LOCALAPPDATA", "PYTHONPATH")


def run(code, path, **variables):
    kept = {name: value for name, value in os.environ.items() if name not in OTHERS}
    command = [sys.executable, "-B", "-c", code]
    done = subprocess.run(
        command, env={**kept, "PYTHONPATH": str(path), **variables}, capture_output=True, text=True, cwd=path
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.fixture
def installed(tmp_path):
    """The package alone, as installed."""
    shutil.copytree(
        ROOT / "castor_envs", tmp_path / "lib" / "castor_envs", ignore=shutil.ignore_patterns("__pycache__")
    )
    return tmp_path / "lib"


def test_the_second_process_needs_no_compiler(tmp_path):
    first, second = (run(STEP, ROOT, CASTOR_CACHE=str(tmp_path)) for _ in range(2))
    assert second.endswith("[]")
    assert first.split(" [")[0] == second.split(" [")[0]


def test_code_is_kept_beside_its_source(installed):
    run(STEP, installed, HOME=str(installed))
    assert list((installed / "castor_envs" / "physics" / "__pycache__").glob("compiled_loop-*.o"))
    assert not (installed / ".cache").exists()


def test_an_installation_that_cannot_be_written_leaves_code_in_the_users_cache(installed, tmp_path):
    blocked = installed / "castor_envs" / "physics" / "__pycache__"
    blocked.write_text("a file where a folder should be, which stops an administrator too")
    run(STEP, installed, HOME=str(tmp_path / "home"))
    assert list((tmp_path / "home" / ".cache" / "castor-envs").glob("compiled_loop-*.o"))


def test_where_nothing_can_be_written_environments_work_uncached(installed, tmp_path):
    blocked = installed / "castor_envs" / "physics" / "__pycache__"
    blocked.write_text("")
    assert "numba" in run(STEP, installed, HOME=str(blocked))


def test_sources_are_all_modules_that_the_kernel_imports():
    names = {path.relative_to(ROOT).as_posix() for path in kernel_sources(LOOP)}
    assert {"castor_envs/physics/compiled_loop.py", "castor_envs/physics/tyre.py"} <= names


def test_of_a_file_of_its_own_sources_are_the_modules_beside_it_and_those_of_these_packages(tmp_path, monkeypatch):
    module = ModuleType("castor_plugin_mine")
    module.__file__ = str(tmp_path / "mine.py")
    (tmp_path / "mine.py").write_text("import json\nimport helper\nfrom castor_envs.physics import tyre\n")
    (tmp_path / "helper.py").write_text("")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    first, *others = kernel_sources(module.__name__)
    assert first == tmp_path / "mine.py"
    assert {tmp_path / "helper.py", ROOT / "castor_envs/physics/tyre.py"} <= set(others)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    for other in ("CASTOR_CACHE", "LOCALAPPDATA"):
        monkeypatch.delenv(other, raising=False)
    assert cached_code(module.__name__, "call", lambda: b"code") == b"code"
    assert not (tmp_path / "__pycache__").exists()


@pytest.mark.parametrize("edited", ["compiled_loop.py", "tyre.py", "further.py"])
def test_an_edited_source_is_compiled_again(tmp_path, monkeypatch, edited):
    folder = tmp_path / "pack"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "compiled_loop.py").write_text("from pack import tyre\n")
    (folder / "tyre.py").write_text("from pack.further import LIMIT\n")
    (folder / "further.py").write_text("LIMIT = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("CASTOR_CACHE", str(tmp_path / "cache"))
    compiled = []

    def compile_now():
        compiled.append(1)
        return b"code"

    for _ in range(2):
        assert cached_code("pack.compiled_loop", "call", compile_now) == b"code"
    assert len(compiled) == 1
    (folder / edited).write_text((folder / edited).read_text() + "# edited\n")
    cached_code("pack.compiled_loop", "call", compile_now)
    assert len(compiled) == 2


def test_damaged_code_is_compiled_again(tmp_path, monkeypatch):
    monkeypatch.setenv("CASTOR_CACHE", str(tmp_path))
    assert cached_code(LOOP, "call", lambda: b"code") == b"code"
    (path,) = tmp_path.glob("*.o")
    for damaged in (b"", path.read_bytes()[:-1], hashlib.sha256(b"").digest()):
        path.write_bytes(damaged)
        assert cached_code(LOOP, "call", lambda: b"code") == b"code"
        assert path.read_bytes() == hashlib.sha256(b"code").digest() + b"code"


COMPILE = """
import sys, time
from pathlib import Path
from castor_envs.kernels.cache import cached_code

def compiled():
    with Path(sys.argv[1], "log").open("a") as log:
        log.write("compiled\\n")
    time.sleep(0.3)
    return b"code"

print(cached_code("castor_envs.physics.compiled_loop", "call", compiled))
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no locks there: both compile")
def test_of_processes_at_once_one_compiles(tmp_path):
    env = {**os.environ, "CASTOR_CACHE": str(tmp_path / "cache"), "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", COMPILE, str(tmp_path)]
    started = [subprocess.Popen(command, env=env, stdout=subprocess.PIPE, text=True) for _ in range(3)]
    assert [process.communicate()[0].strip() for process in started] == ["b'code'"] * 3
    assert (tmp_path / "log").read_text() == "compiled\n"


def test_a_kernel_computes_what_its_python_does(tmp_path, monkeypatch):
    folder = tmp_path / "pack"
    folder.mkdir()
    (folder / "__init__.py").write_text("")
    (folder / "sums.py").write_text(
        "def add(there, factor, row, out):\n"
        "    for k in range(there.shape[1]):\n"
        "        out[k] += factor * there[row, k]\n"
    )
    (folder / "wrong.py").write_text("def add(there, factor, row, out):\n    raise ValueError('no')\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("CASTOR_CACHE", str(tmp_path / "cache"))
    takes = (array(float, 2), REAL, INTEGER, array(np.float32, 1))
    there, out = np.arange(12.0).reshape(3, 4), np.zeros(4, dtype=np.float32)
    kernel = Kernel("pack.sums", "add", takes)
    add = kernel.bind(there, 0.5, 2, out)
    add()
    np.testing.assert_array_equal(out, 0.5 * there[2])
    there[2] = 2.0
    add()
    np.testing.assert_array_equal(out, [5.0, 5.5, 6.0, 6.5])
    for wrong in (there.astype(np.float32), there[0], there.T, [1.0]):
        with pytest.raises(TypeError, match=r"expected an array of float64, 2 dimensions"):
            kernel.bind(wrong, 0.5, 2, out)
    failing = Kernel("pack.wrong", "add", takes).bind(there, 0.5, 2, out)
    with pytest.raises(RuntimeError, match="kernel add failed"):
        failing()
