"""What docs/adding.md says: each thing is added in one file. Its files are put into a copy, its checks are run."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import castor_envs
import estimators

ROOT = Path(__file__).parents[1]
BLOCKS = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "adding.md").read_text(encoding="utf-8"), flags=re.S)
PACKAGES = ("castor_envs", "estimators", "benchmarks")


def test_every_file_of_the_page_is_found_without_a_change_elsewhere(tmp_path):
    copy = tmp_path / "copy"
    for package in PACKAGES:
        shutil.copytree(ROOT / package, copy / package, ignore=shutil.ignore_patterns("__pycache__"))
    checks, added = [], 0
    for block in BLOCKS:
        first, body = block.split("\n", 1)
        if first == "# then":
            checks.append(body)
            continue
        label, _, name = first.rpartition(" ")
        path = copy / name
        if label == "# file:":
            assert not path.exists()
            path.write_text(body, encoding="utf-8")
        else:
            assert label == "# at the end of"
            with path.open("a", encoding="utf-8") as file:
                file.write("\n\n" + body)
        added += 1
    assert added == len(checks) == 12
    cache = tmp_path / "cache"  # what is compiled already need not be compiled again
    cache.mkdir()
    for package in (castor_envs, estimators):
        for code in Path(package.__path__[0]).rglob("__pycache__/*.o"):
            shutil.copy(code, cache)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", f"import sys; sys.path.insert(0, {str(copy)!r})\n" + "\n".join(checks)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ | {"CASTOR_CACHE": str(cache)},
        check=False,
    )
    assert done.returncode == 0, done.stderr
