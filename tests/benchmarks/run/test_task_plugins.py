"""Tasks of others: found by file, checked before they run, recorded by other processes, on boards of their own."""

import json
import pickle
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.cli import app
from benchmarks.run import task_plugins
from benchmarks.run.task_plugins import load_task, with_plugged
from benchmarks.tasks import official_tasks
from castor_envs.cli import command_line
from castor_envs.errors import InputError

ADDING = (Path(__file__).parents[3] / "docs" / "adding.md").read_text(encoding="utf-8")
(CORRIDOR,) = re.findall(r"```python\n# file: my_task.py\n(.*?)```", ADDING, flags=re.S)


@pytest.fixture(autouse=True)
def _own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    Path("my_task.py").write_text(CORRIDOR)


@pytest.fixture
def call(capsys):
    """Return a function that runs castor-bench; it returns code, out and err."""

    def run(*arguments):
        with pytest.raises(SystemExit) as leaving:
            command_line.run(app, [str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return leaving.value.code, out, err

    return run


def test_the_example_is_run_and_has_a_board_of_its_own(call):
    run = ("run", "--task", "my_task.py", "--estimator", "dead-reckoning", "--cases", 2, "--jobs", 1)
    code, out, err = call(*run)
    assert code == 0, (out, err)
    assert "A corridor of 4 m" in out
    shown = call("leaderboard", "--task", "my_task.py:Corridor", "--json")[1]
    (board,) = json.loads(shown)["tasks"]
    assert board["task"] == load_task("my_task.py").name
    assert re.fullmatch(r"corridor\[[0-9a-f]{16}\]", board["task"])
    (entry,) = board["entries"]
    # The robot turns away from the side of the wheel that is taken for too large: y = (0.01 / 2b) x^2 and its rms.
    bend = 0.01 / (2 * load_task("my_task.py").true.castors[0].wheels[0].lateral)
    assert entry["scores"]["ate_m"]["mean"] == pytest.approx(bend * 16 / 2 / 5**0.5, rel=0.1)


def test_pages_and_overviews_name_it_as_commands_take_it(call):
    """It stands in an overview of its own; no hash passes for a robot, and the page's command is taken."""
    run = ("run", "--task", "my_task.py:Corridor", "--estimator", "dead-reckoning", "--cases", 2, "--jobs", 1)
    assert call(*run)[0] == 0
    shown = json.loads(call("leaderboard", "--task", "my_task.py", "--json")[1])
    assert [(table["of"], table["robot"]) for table in shown["overview"]] == [("robots", None)]
    page = call("leaderboard", "--task", "my_task.py", "--html")[1]
    assert "Estimators of robots on tasks of others (not official)" in page
    assert call("page", "--task", "my_task.py:Corridor", "--out", "site")[0] == 0
    (task_page,) = Path("site/tasks").glob("*.html")
    assert re.findall(r"castor-bench run --task ([^\s<]+)", task_page.read_text(encoding="utf-8")) == [
        "my_task.py:Corridor"
    ]


def test_what_fails_in_a_run_of_it_is_named_by_its_file(call):
    Path("fails.py").write_text(
        "class Fails:\n    def reset(self, robot, pose):\n        raise OSError('no')\n\n    update = reset\n"
    )
    code, _, err = call("run", "--task", "my_task.py", "--estimator", "fails.py", "--cases", 2, "--jobs", 1)
    assert code == 1
    assert "fails:Fails failed 2 of 2 cases of my_task.py;" in err


def test_what_is_shown_again_is_of_the_cases_that_were_run(call):
    run = ("run", "--task", "my_task.py", "--estimator", "dead-reckoning", "--jobs", 1)
    assert call(*run, "--cases", 3)[0] == 0
    out = call(*run, "--cases", 2)[1]
    advised = out.splitlines()[-1].partition("show them again: castor-bench ")[2]
    assert "mean over 2 cases" in call(*shlex.split(advised))[1]


def test_cases_that_cannot_be_recorded_are_told_and_the_others_are_scored(call):
    Path("my_task.py").write_text(CORRIDOR.replace("        t = 0.05 *", "        t = 0.05 / (case != 1) *"))
    code, out, err = call("run", "--task", "my_task.py", "--estimator", "dead-reckoning", "--cases", 3, "--jobs", 1)
    assert code == 1, (out, err)
    assert "not run: 1 of 3 cases: task 'my_task.py', case 1: record raises ZeroDivisionError" in out
    assert "mean over 2 cases" in out
    assert "cases of my_task.py were not recorded" in err.splitlines()[-1]
    advised = out.splitlines()[-1].partition("show them again: castor-bench ")[2]
    code, again, _ = call(*shlex.split(advised))
    assert code == 0
    assert "mean over 2 cases" in again


def test_a_task_of_which_no_case_can_be_recorded_has_no_results_to_show(call):
    Path("my_task.py").write_text(CORRIDOR.replace("        t = 0.05 *", "        t = 1 / 0 *"))
    code, out, err = call("run", "--task", "my_task.py", "--estimator", "dead-reckoning", "--cases", 2, "--jobs", 1)
    assert code == 1, (out, err)
    assert "not run: task 'my_task.py', case 0: record raises ZeroDivisionError" in out
    assert "cases of my_task.py were not recorded" in err
    assert "show them again" not in out


def test_an_edited_task_has_another_board_and_is_not_believed_in_a_run():
    before = load_task("my_task.py")
    sent = pickle.dumps(before)
    assert pickle.loads(sent).record(1).digest == before.record(1).digest
    Path("my_task.py").write_text(CORRIDOR.replace("0.5 * t", "0.4 * t"))
    assert load_task("my_task.py").name != before.name
    task_plugins._again.cache_clear()
    with pytest.raises(InputError, match="its source changed while the benchmark ran"):
        pickle.loads(sent)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"corridor", 1, "ate"', '"corridor", 1, "speed"', "unknown metric 'speed'"),
        ('"corridor", 1, "ate"', '"corridor", 1, "inside_95"', "'inside_95' is no error"),
        ('"corridor", 1, "ate"', '"My Corridor", 1, "ate"', "lower-case words joined by hyphens"),
        ('"corridor", 1, "ate"', '"corridor", 0, "ate"', "its version is 0"),
        ('"corridor", 1, "ate"', '"umbmark-physics-clean", 1, "ate"', "an official task is named"),
        ('    title = "A corridor of 4 m"\n', "", "class Corridor has no title"),
        ("    def record", "    def recall", "has no method record"),
        ("def __init__(self):", "def __init__(self, length):", "cannot be made without arguments"),
        ("self.true, self.robot =", "self.true, self.robots =", "has no robot"),
        ("range(8 if n is None else n)", "range(0)", r"cases\(1\) returns"),
        ("range(8 if n is None else n)", '["1", "c d"][:n]', "case 'c d': use letters, digits and _ . - only"),
        ("range(8 if n is None else n)", "[1.5, 2.5][:n]", r"case 1\.5: give an int from 0 on, or a name"),
        ("range(8 if n is None else n)", "[3, -1][:n]", "case -1: give an int from 0 on, or a name"),
        ("import dataclasses", "import dataclass", "cannot be imported, line 3"),
    ],
)
def test_what_is_missing_in_the_protocol_is_named(jobs_here, old, new, words):
    assert old in CORRIDOR
    Path("my_task.py").write_text(CORRIDOR.replace(old, new))
    with pytest.raises(InputError, match=words):
        with_plugged(official_tasks(), ["my_task.py"], 60.0)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("t = 0.05 *", "t = 1 / 0 *", "case 3: record raises ZeroDivisionError: .*, line 3[0-9] of .*my_task.py"),
        ("return Episode(", "return (", "record returns tuple instead of"),
    ],
)
def test_what_fails_in_record_is_named(old, new, words):
    Path("my_task.py").write_text(CORRIDOR.replace(old, new))
    with pytest.raises(InputError, match=words):
        load_task("my_task.py").record(3)


def test_a_hash_of_its_data_is_asked_for_and_no_text_is_refused():
    offered = "    def source_digest(self, case):\n        return {}\n\n    def record"
    assert load_task("my_task.py").source_digest(0) is None
    Path("my_task.py").write_text(CORRIDOR.replace("    def record", offered.format('f"measured on day {case}"')))
    assert load_task("my_task.py").source_digest(3) == "measured on day 3"
    for returned, words in (("7", "source_digest returns 7 instead of a text"), ("1 / 0", "raises ZeroDivisionError")):
        Path("my_task.py").write_text(CORRIDOR.replace("    def record", offered.format(returned)))
        with pytest.raises(InputError, match=words):
            load_task("my_task.py").source_digest(0)


def test_a_task_that_hangs_is_refused():
    Path("my_task.py").write_text("while True: pass")
    with pytest.raises(InputError, match=r"task 'my_task.py' cannot be loaded: took over 1 s"):
        with_plugged(official_tasks(), ["my_task.py"], 1.0)


def test_a_robot_of_the_users_is_refused_beside_it(call):
    code, _, err = call("run", "--task", "my_task.py", "--robot", "differential")
    assert code == 2
    assert "has a robot of its own" in err


LOUD = """
import os, sys, threading, time
print("loaded")
os.write(1, b"loaded by a library")
sys.__stdout__.write("loaded")
os.chdir("/")
sys.stdout = open(os.devnull, "w")
threading.Thread(target=time.sleep, args=(3600,)).start()
"""


def test_what_a_plug_in_does_on_import_leaves_the_command_as_it_is(tmp_path):
    """Its output is dropped, names are of the same folder, and its threads do not keep the command from ending."""
    printing = CORRIDOR.replace("        t = 0.05 *", "        print('recording')\n        t = 0.05 *")
    assert printing != CORRIDOR
    Path("my_task.py").write_text(LOUD + printing)
    Path("mine.py").write_text(LOUD + "from estimators import WheelOdometry\nclass Mine(WheelOdometry): ...\n")
    here = ["--task", "my_task.py", "--results", "there"]
    told = []
    for line in (
        ["run", *here, "--estimator", "mine.py", "--estimator", "wheel-odometry", "--cases", "1"],
        ["compare", "mine.py", "wheel-odometry", *here, "--json"],
        ["export", "my_task.py", "--out", "episodes"],
    ):
        command = [sys.executable, "-m", "benchmarks", *line]
        ended = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=600)
        assert (ended.returncode, "loaded" in ended.stdout) == (0, False), ended.stderr
        told.append(ended.stdout)
    assert json.loads(told[1])["format"] == "castor-compare/1"
    assert re.fullmatch(r"episodes: 1 case\(s\) of corridor\[[0-9a-f]{16}\]\n", told[2])
    assert {path.name for path in tmp_path.iterdir()} >= {"there", "episodes"}
