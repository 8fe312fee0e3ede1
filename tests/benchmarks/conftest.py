"""The fake tasks and plug-ins; worker processes find the tasks by the path that is set here."""

import importlib
import sys
from pathlib import Path

import pytest

FAKES = Path(__file__).parent / "fakes"
sys.path.append(str(FAKES))


@pytest.fixture(scope="session")
def fake_tasks():
    return importlib.import_module("fake_tasks")


@pytest.fixture(scope="session")
def fake_trains():
    return importlib.import_module("fake_trains")


@pytest.fixture(scope="session")
def plugin():
    """Return the spec of a fake plug-in, given as file:Class."""

    def spec(name):
        file, kind = name.split(":")
        return f"{FAKES / file}.py:{kind}"

    return spec
