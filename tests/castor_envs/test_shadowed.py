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


def test_nothing_is_said_to_those_who_do_not_import_it(tmp_path):
    (tmp_path / "benchmarks.py").write_text("mine = 1\n")
    assert said(tmp_path, "import castor_envs\nimport estimators\n") == ""
