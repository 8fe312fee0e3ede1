"""The console script: what it prints, and one clear line for each mistake."""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import cli
from castor_envs import command_line
from castor_envs.logs import read_log
from castor_envs.robot import RobotDescription

SCRIPT = Path(sys.executable).with_name("castor-bench")


@pytest.fixture
def castor_bench(monkeypatch, capsys, tmp_path, fake_tasks):
    """Return a function that runs the command on the fake tasks, in an empty folder; it returns code, out and err."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    monkeypatch.delenv("CASTOR_DATA", raising=False)

    def official(measured=None):
        lacking = None if measured and (measured / "square.csv").exists() else "no square.csv there"
        return (fake_tasks.Arcs(), fake_tasks.Arcs(name="measured-arcs", missing=lacking))

    monkeypatch.setattr(cli, "official_tasks", official)

    def call(*arguments):
        with pytest.raises(SystemExit) as leaving:
            command_line.run(cli.app, [str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return leaving.value.code, out, err

    return call


def test_a_run_ends_with_the_leaderboard(castor_bench, plugin):
    code, out, err = castor_bench("run", "--cases", 2, "--jobs", 1, "--estimator", plugin("followers:Follower"))
    assert code == 0, err
    assert "E_max,syst, mm" in out
    assert "followers:Follower" in out
    assert "not run: no square.csv there" in out
    code, out, _ = castor_bench("leaderboard", "--json")
    board = json.loads(out)
    assert code == 0
    assert [task["missing"] for task in board["tasks"]] == [None, "no square.csv there"]
    assert board["tasks"][0]["entries"][0]["cases_done"] == 2
    code, out, _ = castor_bench("leaderboard", "--markdown", "--task", "arcs")
    assert code == 0
    assert out.startswith("## Arcs")


def test_measured_data_are_found(castor_bench, plugin, tmp_path, monkeypatch):
    (tmp_path / "square.csv").write_text("")
    monkeypatch.setenv("CASTOR_DATA", str(tmp_path))
    code, out, err = castor_bench("run", "--cases", 1, "--jobs", 1, "--estimator", plugin("followers:Follower"))
    assert code == 0, err
    assert "not run" not in out


def test_check_passes_and_fails(castor_bench, plugin):
    code, out, _ = castor_bench("check", "cast-0")
    assert code == 0
    assert "WRONG" not in out
    code, out, _ = castor_bench("check", plugin("faulty:WrongShape"), "--robot", "differential")
    assert code == 1
    assert "WRONG" in out


def test_list_and_version(castor_bench):
    _, out, _ = castor_bench("list")
    for name in ("arcs", "cast", "asoc-prototype"):
        assert name in out
    assert castor_bench("--version")[:2] == (0, "castor-bench 0.1.0\n")


MISTAKES = {
    "task": (("run", "--task", "arks"), "unknown task 'arks'; did you mean 'arcs'?"),
    "task of the board": (("leaderboard", "--task", "arks"), "unknown task 'arks'; did you mean 'arcs'?"),
    "estimator": (("run", "--estimator", "kast-0"), "did you mean 'cast-0'?"),
    "two of one name": (
        ("run", "--estimator", "whole.py", "--estimator", "other/whole.py"),
        "two estimators are named 'whole:Whole'",
    ),
    "plug-in without update": (("run", "--estimator", "half.py"), "has no method update"),
    "plug-in that is not there": (("run", "--estimator", "nowhere.py:Mine"), "nowhere.py"),
    "cases": (("run", "--cases", "0"), "--cases must be at least 1, got 0"),
    "cases of the board": (("leaderboard", "--cases", "0"), "--cases must be at least 1, got 0"),
    "cases, no number": (("run", "--cases", "many"), "--cases"),
    "jobs": (("run", "--jobs", "0"), "--jobs must be at least 1, got 0"),
    "timeout": (("run", "--timeout", "0"), "--timeout must be above 0, got 0"),
    "timeout, no number": (("run", "--timeout", "nan"), "--timeout must be above 0, got nan"),
    "results in a file": (("run", "--results", "half.py"), "half.py is a file"),
    "no results": (("leaderboard",), "no results in castor-results"),
    "measured folder": (("run", "--measured", "nowhere"), "nowhere"),
    "measured folder without data": (("run", "--measured", "."), "no square.csv there"),
    "two forms": (("leaderboard", "--json", "--markdown"), "choose one"),
    "option": (("run", "--robots"), "--robots"),
    "command": (("rum",), "rum"),
    "robot": (("check", "cast-0", "--robot", "asoc-prototyp"), "did you mean 'asoc-prototype'?"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_and_writes_nothing(castor_bench, mistake):
    arguments, said = MISTAKES[mistake]
    half = "class Half:\n    def reset(self, robot, pose): ...\n"
    files = {
        "half.py": half,
        "whole.py": half + "    update = reset\n",
        "other/whole.py": half + "    update = reset  # another\n",
    }
    Path("other").mkdir()
    for name, source in files.items():
        Path(name).write_text(source.replace("Half", Path(name).stem.title()))
    code, out, err = castor_bench(*arguments)
    assert code == 2
    assert said in err
    assert len(err.splitlines()) == 1
    assert out == ""
    assert sorted(str(path) for path in Path().rglob("*") if path.is_file()) == sorted(files)


def test_damaged_results_are_named(castor_bench, plugin):
    arguments = ("run", "--task", "arcs", "--cases", 1, "--jobs", 1, "--estimator", plugin("followers:Follower"))
    castor_bench(*arguments)
    (row,) = Path().glob("castor-results/rows/*/*/0.npz")
    row.write_bytes(b"PK")
    code, out, err = castor_bench("leaderboard")
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert str(row) in err
    code, out, err = castor_bench(*arguments)
    assert code == 0
    assert str(row) in err
    assert castor_bench("leaderboard")[0] == 0


MINE = """
from mine_too import CAST

class Mine(CAST):
    pass
"""


@pytest.mark.skipif(not SCRIPT.exists(), reason="castor-bench is not installed")
def test_the_script_works_in_a_folder_with_a_benchmarks_of_its_own(tmp_path):
    """Workers too: nothing there shadows the installed packages, and a plug-in's own modules are found."""
    for name in ("benchmarks", "estimators", "castor_envs"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('shadowed')")
    (tmp_path / "random.py").write_text("raise RuntimeError('shadowed')")
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "mine_too.py").write_text("from estimators import CAST")
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "CASTOR_DATA")}

    def call(*arguments):
        return subprocess.run(
            [SCRIPT, *arguments], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=300, check=True
        ).stdout

    task = ("--task", "umbmark-kinematic-calibrated")
    call("run", *task, "--cases", "1", "--estimator", "mine.py", "--estimator", "mine:Mine", "--estimator", "cast-0")
    (board,) = json.loads(call("leaderboard", "--json", *task))["tasks"]
    assert [(entry["estimator"], entry["failed"]) for entry in board["entries"]] == [("cast-0", []), ("mine:Mine", [])]
    for entry in board["entries"]:
        assert 0 < entry["scores"]["E_max_syst_m"]["mean"] < 0.05
        assert entry["time_per_update_us"] > 0


def test_the_official_tasks_are_in_order():
    tasks = importlib.import_module("benchmarks.tasks").official_tasks()
    assert len({task.name for task in tasks}) == len(tasks) >= 1


def test_exported_episodes_are_what_estimators_get(castor_bench, fake_tasks, tmp_path):
    out = tmp_path / "episodes"
    code, _, err = castor_bench("export", "arcs", "--cases", 2, "--out", out)
    assert code == 0, err
    episode = fake_tasks.Arcs().record(1)
    robot = RobotDescription.load(out / "case-1" / "robot.json")
    assert robot == episode.robot
    logs = sorted((out / "case-1").glob("*.csv"))
    assert [path.name for path in logs] == ["run-01-cw.csv", "run-02-ccw.csv"]
    for path, run in zip(logs, episode.runs, strict=True):
        log = read_log(path, robot)
        np.testing.assert_array_equal(log.wheel, run.log.wheel)
        np.testing.assert_array_equal(log.reference, run.log.reference)
    code, _, err = castor_bench("export", "arcs", "--out", out)
    assert (code, err.count("\n")) == (2, 1)
    assert "is there already" in err
