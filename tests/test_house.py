"""The house rules: which package may import which, and that importing the world stays light."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
MAY_IMPORT = {
    "castor_envs": set(),
    "estimators": {"castor_envs"},
    "benchmarks": {"castor_envs", "estimators"},
    "discrepancy": {"castor_envs", "estimators"},
}


def imported(path):
    """Return the top-level packages that a module imports, wherever in it the import stands."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name.split(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None and node.level == 0:
            yield node.module.split(".")[0]


@pytest.mark.parametrize("package", MAY_IMPORT)
def test_imports_run_one_way(package):
    modules = list((ROOT / package).rglob("*.py"))
    assert modules
    for module in modules:
        foreign = {name for name in imported(module) if name in MAY_IMPORT} - {package}
        assert foreign <= MAY_IMPORT[package], f"{module.relative_to(ROOT)} imports {foreign - MAY_IMPORT[package]}"


def test_importing_the_world_compiles_and_draws_nothing():
    code = "import castor_envs, sys; print([m for m in ('numba', 'pygame', 'matplotlib', 'scipy') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
