"""A user's file that hides a package of this project is named in one line, and only where it matters."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = {
    page: next(
        code
        for code in re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), flags=re.S)
        if "import castor_envs" in code
    )
    for page in ("README.md", "docs/tutorials/trains.md")
}


def said(folder, code):
    """Return what a script in a folder writes to stderr."""
    (folder / "script.py").write_text(code)
    done = subprocess.run([sys.executable, "script.py"], cwd=folder, capture_output=True, text=True, timeout=120)
    return done.stderr


@pytest.mark.parametrize("page", EXAMPLES)
@pytest.mark.parametrize("file", ["estimators.py", "estimators/__init__.py"])
def test_examples_of_the_docs_name_the_file_that_hides_the_package(tmp_path, page, file):
    (tmp_path / file).parent.mkdir(exist_ok=True)
    (tmp_path / file).write_text("mine = 1\n")
    lines = said(tmp_path, EXAMPLES[page]).splitlines()
    hides = f"{tmp_path / file} hides the package 'estimators' of castor-envs; rename it, or run from another folder"
    assert lines[0] == f"castor-envs: {hides}"
    assert sum("hides the package" in line for line in lines) == 1


HIDES = "hides the package 'estimators' of castor-envs; rename it, or run from another folder"


@pytest.mark.parametrize(
    "code",
    [
        "import castor_envs\nfrom estimators import CAST\n",
        "import castor_envs\nfrom estimators.robots.cast import CAST\n",
        "import gymnasium as gym\nimport castor_envs\n"
        "gym.make('castor/ASOC-v1', estimator='estimators.robots.cast:CAST')\n",
    ],
    ids=["name", "module", "environment"],
)
def test_no_traceback_follows(tmp_path, code):
    (tmp_path / "estimators.py").write_text("mine = 1\n")
    assert said(tmp_path, code) == f"castor-envs: {tmp_path / 'estimators.py'} {HIDES}\n"


def test_a_script_that_means_its_own_file_goes_on_and_has_its_own_errors(tmp_path):
    (tmp_path / "estimators.py").write_text("mine = 1\n")
    lines = said(tmp_path, "import castor_envs\nimport estimators\nprint(1 / (estimators.mine - 1))\n").splitlines()
    assert lines[0].endswith(HIDES)
    assert lines[1].startswith("Traceback")
    assert lines[-1] == "ZeroDivisionError: division by zero"


@pytest.mark.parametrize("command", [("benchmarks", "list"), ("discrepancy", "inspect", "log.csv")])
def test_commands_end_with_the_line_alone(tmp_path, command):
    (tmp_path / "estimators.py").write_text("mine = 1\n")
    done = subprocess.run([sys.executable, "-m", *command], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    line = f"castor-envs: {tmp_path / 'estimators.py'} {HIDES}\n"
    assert (done.returncode, done.stdout, done.stderr) == (2, "", line)


def test_nothing_is_said_to_those_who_do_not_import_it(tmp_path):
    (tmp_path / "benchmarks.py").write_text("mine = 1\n")
    assert said(tmp_path, "import castor_envs\nimport estimators\n") == ""
