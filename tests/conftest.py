"""What all tests share: plug-ins that a test wrote are forgotten after it, hypothesis keeps no clock, and linear
algebra uses one thread a process, as tests run in several."""

import importlib.util
import os
import sys
from pathlib import Path

import pytest
from hypothesis import settings

os.environ.setdefault("OMP_NUM_THREADS", "1")
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")


SCRIPTS = Path(__file__).parents[1] / "scripts"


@pytest.fixture(scope="session")
def script_called():
    """Return a function that imports a script of the project by its name."""

    def imported(name):
        (path,) = SCRIPTS.rglob(f"{name}.py")
        spec = importlib.util.spec_from_file_location(name, path)
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return imported


@pytest.fixture(autouse=True)
def _forget_plugins(request, monkeypatch):
    """Take modules that a test wrote to its folder, and import paths that it added, back again."""
    monkeypatch.setattr(sys, "path", list(sys.path))
    tmp_path = request.getfixturevalue("tmp_path") if "tmp_path" in request.fixturenames else None
    yield
    if tmp_path is None:
        return
    for name, module in list(sys.modules.items()):
        if str(getattr(module, "__file__", None) or "").startswith(str(tmp_path)):
            del sys.modules[name]
