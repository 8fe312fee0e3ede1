"""Results that pages and comparisons are made of."""

import importlib

import pytest


@pytest.fixture(scope="session")
def stored_results():
    return importlib.import_module("stored_results")


@pytest.fixture(scope="session")
def results(tmp_path_factory, fake_tasks, stored_results):
    """Return a folder with rows of many kinds of estimators on the fake task."""
    return stored_results.made(tmp_path_factory.mktemp("results"), fake_tasks.Arcs())
