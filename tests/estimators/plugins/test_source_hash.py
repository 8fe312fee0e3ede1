"""The hash of a plug-in changes with every file that it imports or is given, and with nothing that is installed."""

from pathlib import Path

import pytest

from estimators import load_estimator
from estimators.plugins.source_hash import source_files

MINE = """
class Mine:
    def reset(self, robot, pose):
        self.pose = pose.copy()

    def update(self, observation):
        return self.pose.copy()
"""

IMPORTS = {
    "by a statement": "import shared_gains\n",
    "of a package": "from shared_package.deep import gains\n",
    "of a package without a file of its own": "from shared_space.deep import gains\n",
    "within a function": "def later():\n    import shared_gains\n",
    "by import_module": "import importlib\nGAINS = importlib.import_module('shared_gains')\n",
    "by import_module alone": "from importlib import import_module\nimport_module('shared_package.deep.gains')\n",
    "by __import__": "GAINS = __import__('shared_gains')\n",
}


@pytest.fixture
def shared(tmp_path, monkeypatch):
    """Modules in a folder that Python imports from, which is not that of the plug-in."""
    folder = tmp_path / "shared"
    for name in (
        *("shared_gains.py", "shared_package/__init__.py", "shared_package/deep/__init__.py"),
        *("shared_package/deep/gains.py", "shared_space/deep/gains.py"),
    ):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("GAIN = 1\n")
    monkeypatch.syspath_prepend(str(folder))
    (tmp_path / "own").mkdir()
    monkeypatch.chdir(tmp_path / "own")
    return folder


def edited(file):
    """Return the hash of the plug-in before and after an edit of a file."""
    before = load_estimator("mine.py").source_hash
    file.write_text(file.read_text() + "# edited\n")
    return before, load_estimator("mine.py").source_hash


@pytest.mark.parametrize("how", IMPORTS)
def test_a_module_of_another_folder_counts(shared, how):
    Path("mine.py").write_text(IMPORTS[how] + MINE)
    files = {file for file in source_files(load_estimator("mine.py").kind) if file.is_relative_to(shared.resolve())}
    assert {file.name for file in files} - {"__init__.py"} <= {"shared_gains.py", "gains.py"}
    assert files
    for file in files:
        before, after = edited(file)
        assert before != after, file


def test_a_package_counts_with_what_is_imported_before_its_module(shared):
    Path("mine.py").write_text("import shared_package.deep.gains\n" + MINE)
    files = source_files(load_estimator("mine.py").kind)
    names = {file.relative_to(shared.resolve()).as_posix() for file in files if file.name != "mine.py"}
    package = "shared_package"
    assert names == {f"{package}/__init__.py", f"{package}/deep/__init__.py", f"{package}/deep/gains.py"}


def test_what_is_installed_does_not_count(shared):
    Path("mine.py").write_text("import json\nimport numpy\nimport pydantic\nimport gymnasium\n" + MINE)
    assert [file.name for file in source_files(load_estimator("mine.py").kind)] == ["mine.py"]


def test_names_that_are_no_modules_do_no_harm(shared):
    source = "from importlib import import_module\n\n\ndef never():\n"
    source += "".join(f"    import_module({name!r})\n" for name in ("", ".", "..x", "a/b", "no_such_thing", "a\0b"))
    Path("mine.py").write_text(source + MINE)
    assert [file.name for file in source_files(load_estimator("mine.py").kind)] == ["mine.py"]


WITH_FILE = """
from pathlib import Path


class Mine:
    def __init__(self, weights: Path | None = None, table: Path = Path("table.csv")):
        self.read = [path.read_text() for path in (weights, table) if path is not None and path.is_file()]

    def reset(self, robot, pose):
        self.pose = pose.copy()

    def update(self, observation):
        return self.pose.copy()
"""


def test_a_file_that_a_parameter_names_counts_by_its_content(shared):
    Path("mine.py").write_text(WITH_FILE)
    hashes = [load_estimator("mine.py").source_hash]  # the file of the default is not there
    for name in ("net.txt", "table.csv"):
        for content in ("1", "2"):
            Path(name).write_text(content)
            entry = load_estimator("mine.py?weights=net.txt")
            assert entry.name == "mine:Mine?weights=net.txt"
            hashes += [entry.source_hash, load_estimator("mine.py").source_hash]
    assert hashes[1] != hashes[3] != hashes[5] != hashes[7]  # given
    assert hashes[0] == hashes[2] == hashes[4] != hashes[6] != hashes[8]  # by default
