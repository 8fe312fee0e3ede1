"""The command for tables; whatever it is asked for twice it computes once."""

import pytest

from benchmarks import cli
from benchmarks.commands import tables
from benchmarks.papers.comparison import compute_tables
from castor_envs.cli import command_line


@pytest.fixture(scope="session")
def computed():
    """Return a function like `compute_tables`, for which the same tables are computed once."""
    known = {}

    def compute(sources, effort):
        key = (tuple(source.name for source in sources), effort.sets, effort.assumptions)
        if key not in known:
            known[key] = compute_tables(sources, effort)
        return known[key]

    return compute


@pytest.fixture
def castor_bench(monkeypatch, capsys, computed):
    """Return a function that runs the command; it returns code, out and err."""
    monkeypatch.setattr(tables, "compute_tables", computed)

    def call(*arguments):
        with pytest.raises(SystemExit) as leaving:
            command_line.run(cli.app, [str(argument) for argument in arguments])
        return (leaving.value.code, *capsys.readouterr())

    return call
