"""The README does what it says: its code runs, its commands work, its links lead somewhere."""

import json
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest

import castor_envs

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
TUTORIALS = {path.stem: path.read_text(encoding="utf-8") for path in (ROOT / "docs" / "tutorials").glob("*.md")}
BENCH = Path(sys.executable).with_name("castor-bench")


def block(start, text=README):
    """Return the Python block of a text that holds a line."""
    (found,) = [code for code in re.findall(r"```python\n(.*?)```", text, flags=re.S) if start in code]
    return found


def call(*command, folder):
    return subprocess.run([str(part) for part in command], cwd=folder, capture_output=True, text=True, timeout=300)


def test_the_two_lines_are_there_and_the_check_uses_one():
    lines = [line for line in README.splitlines() if line.startswith("python3 -m venv ")]
    assert [line.split("&&")[-1].split()[0] for line in lines] == [".venv/bin/castor-bench", ".venv/bin/pytest"]
    assert "grep -E '^python3 -m venv .*pytest' README.md" in (ROOT / ".ci" / "run").read_text()


def test_the_readme_is_short_and_the_tutorial_has_the_same_ten_lines():
    assert len(README.splitlines()) <= 120
    start = "from estimators.robots.cast import CAST"
    assert block(start) == block(start, TUTORIALS["first_environment"])


def test_the_ten_lines_run(tmp_path):
    code = block("from estimators.robots.cast import CAST")
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    done = call(sys.executable, "-c", code, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert 0 < float(done.stdout.split(" mm")[0]) < 20


@pytest.mark.slow
def test_the_plug_in_is_checked_and_judged(tmp_path):
    (tmp_path / "mean_castor.py").write_text(block("class MeanCastor", TUTORIALS["own_estimator"]))
    checked = call(BENCH, "check", "mean_castor.py", folder=tmp_path)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    task = ("--task", "umbmark-kinematic-calibrated", "--cases", "1")
    estimators = ("--estimator", "mean_castor.py", "--estimator", "dead-reckoning")
    ran = call(BENCH, "run", "--jobs", "1", *estimators, *task, folder=tmp_path)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    board = json.loads(call(BENCH, "leaderboard", "--json", *task, folder=tmp_path).stdout)
    errors = {entry["estimator"]: entry["scores"]["ate_m"]["mean"] for entry in board["tasks"][0]["entries"]}
    assert 0 < errors["mean_castor:MeanCastor"] < 0.1
    assert set(errors) == {"mean_castor:MeanCastor", "dead-reckoning"}


def test_the_train_blocks_run(tmp_path):
    done = call(sys.executable, "-c", block("castor/Configuration-v0", TUTORIALS["trains"]), folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert 0 < float(done.stdout.split(" mm")[0]) < 200
    done = call(
        sys.executable, "-c", block("from estimators.trains.grpec import", TUTORIALS["trains"]), folder=tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("axle 3, CON1 0.622, CON2 0.022;")  # as Table 1 prints


@pytest.mark.slow
def test_robots_floors_logs_and_videos(tmp_path):
    pytest.importorskip("moviepy")
    short = block("RecordLog", TUTORIALS["first_environment"]).replace(
        "render_mode=", "side=0.05, corners='fixed', render_mode="
    )
    done = call(sys.executable, "-c", short, folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert list((tmp_path / "videos").glob("*.mp4"))
    diagnose = BENCH.with_name("castor-diagnose")
    seen = call(diagnose, "inspect", "logs/episode-0000.csv", "--robot", "logs/robot.json", folder=tmp_path)
    assert seen.returncode == 0, seen.stderr


def test_citations_agree():
    (entry,) = re.findall(r"```bibtex\n(.*?)```", README, flags=re.S)
    cited = dict(re.findall(r"^  (\w+) += \{+(.*?)\}+,?$", entry, flags=re.M))
    file = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    stated = dict(re.findall(r"^(?:  - )?(\w+): (.+)$", file.partition("references:")[0], flags=re.M))
    assert cited["version"] == stated["version"] == castor_envs.__version__ == version("castor-envs")
    assert (cited["title"], cited["author"]) == (stated["title"], stated["name"])
    assert f"{cited['note']}." == stated["abstract"]
    assert cited["license"] == stated["license"]


@pytest.mark.parametrize(
    "document", ["README.md", *(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md"))]
)
def test_links_lead_to_files_and_headings_have_text(document):
    path = ROOT / document
    text = path.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)", re.sub(r"```.*?```", "", text, flags=re.S)):
        assert target.startswith("https://") or (path.parent / target).exists(), target
    sections = re.split(r"^#+ .*$", text, flags=re.M)[1:]
    assert all(section.strip() for section in sections[1:])
