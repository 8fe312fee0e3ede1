"""The house rules: which package may import which, no circles, few modules a folder, and a world light to import."""

import ast
import graphlib
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

MOST = 10
"""Modules in a folder, beside `__init__`."""


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


HEAVY = ("numba", "llvmlite", "scipy", "pygame", "matplotlib", "pymunk", "pydantic", "jinja2")
"""Packages that take long to import."""


def loaded_by(code):
    """Return the packages that a process has imported after this code."""
    after = f"{code}\nimport sys; print('\\n' + ' '.join({{name.partition('.')[0] for name in sys.modules}}))"
    done = subprocess.run([sys.executable, "-c", after], capture_output=True, text=True, check=True, cwd=ROOT)
    return set(done.stdout.splitlines()[-1].split())


def test_importing_the_world_imports_nothing_heavy():
    assert loaded_by("import castor_envs").isdisjoint(HEAVY)


@pytest.mark.parametrize("command", ["benchmarks", "discrepancy"])
def test_help_imports_nothing_heavy_and_no_command(command):
    code = f"from {command}.cli import app\nfrom castor_envs.cli.command_line import run\n"
    code += "try:\n    run(app, ['--help'])\nexcept SystemExit:\n    pass\n"
    assert loaded_by(code).isdisjoint({*HEAVY, "rich", "estimators"})


def test_the_first_step_draws_nothing():
    code = "import castor_envs, gymnasium\nenv = gymnasium.make('castor/ASOC-v1')\nenv.reset(seed=0)\n"
    code += "env.step(env.action_space.sample())"
    assert loaded_by(code).isdisjoint({"pygame", "matplotlib", "jinja2"})


def module_name(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@pytest.fixture(scope="module")
def imports():
    """For each module of the packages, those of them that it names in imports, anywhere in it: in functions too, and
    under TYPE_CHECKING. A package's own __init__, which Python runs first, does not count unless it is named."""
    paths = {module_name(path): path for package in MAY_IMPORT for path in (ROOT / package).rglob("*.py")}
    found = {name: set() for name in paths}
    for name, path in paths.items():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found[name] |= {alias.name for alias in node.names} & set(paths)
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{name} has a relative import"
                below = {f"{node.module}.{alias.name}": node.module for alias in node.names}
                found[name] |= {full if full in paths else module for full, module in below.items()} & set(paths)
    return found


def circle_in(imports):
    """Return the modules of a circle of imports, None where there is none."""
    try:
        graphlib.TopologicalSorter(imports).prepare()
    except graphlib.CycleError as error:
        return error.args[1]
    return None


def test_no_module_imports_itself_by_way_of_others(imports):
    assert circle_in(imports) is None


def test_rooms_of_the_world_have_an_order(imports):
    """Folders of castor_envs import each other one way, too, not only their modules."""
    rooms = {}
    for name, named in imports.items():
        package, *room = name.split(".")
        if package == "castor_envs" and room:
            below = {module.split(".")[1] for module in named if module.startswith("castor_envs.")}
            rooms[room[0]] = rooms.get(room[0], set()) | below - {room[0]}
    assert {"effects", "vehicles", "physics"} <= set(rooms)
    assert circle_in(rooms) is None


def test_a_circle_would_be_found():
    assert circle_in({"a": {"b"}, "b": {"c"}, "c": {"a"}})
    assert circle_in({"a": {"b", "c"}, "b": {"c"}, "c": set()}) is None


def test_no_folder_is_crowded():
    folders = {path.parent for package in MAY_IMPORT for path in (ROOT / package).rglob("*.py")}
    counts = {folder: sum(path.name != "__init__.py" for path in folder.glob("*.py")) for folder in folders}
    crowded = {folder.relative_to(ROOT).as_posix(): count for folder, count in counts.items() if count > MOST}
    assert not crowded


def test_the_picture_of_the_architecture_is_up_to_date(script_called):
    drawn = script_called("make_architecture")
    assert drawn.picture() == drawn.PICTURE.read_text(encoding="utf-8"), "run make_architecture.py"
