"""The console script: what it prints, and one clear line for each mistake."""

import importlib
import io
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from benchmarks import cli
from benchmarks.commands import known, results, show
from benchmarks.commands import run as run_command
from benchmarks.leaderboard import board as boards
from benchmarks.run import choose
from benchmarks.tasks import official_tasks
from castor_envs.cli import command_line
from castor_envs.logs.csv import read_log
from castor_envs.vehicles.robot import RobotDescription

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

    for module in (results, known, show, choose):
        monkeypatch.setattr(module, "official_tasks", official)

    def call(*arguments):
        with pytest.raises(SystemExit) as leaving:
            command_line.run(cli.app, [str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return leaving.value.code, out, err

    return call


def test_where_no_task_has_results_each_reason_is_said_once(castor_bench, monkeypatch, fake_tasks):
    lacking = tuple(
        fake_tasks.Arcs(name=f"arcs-{k}", missing=f"{'no data' if k else 'no map'}; give DIR") for k in range(40)
    )
    monkeypatch.setattr(results, "official_tasks", lambda measured=None: lacking)
    Path("castor-results", "rows").mkdir(parents=True)
    code, out, err = castor_bench("leaderboard")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert (err.count("no data; give DIR"), err.count("no map; give DIR")) == (1, 1)
    many = tuple(fake_tasks.Arcs(name=f"arcs-{k}", missing=f"no data in folder {k}") for k in range(400))
    monkeypatch.setattr(results, "official_tasks", lambda measured=None: many)
    assert len(castor_bench("leaderboard")[2]) < 800


def test_a_run_ends_with_the_leaderboard(castor_bench, plugin):
    code, out, err = castor_bench("run", "--cases", 2, "--jobs", 1, "--estimator", plugin("followers:Follower"))
    assert code == 0, err
    assert "E_max, mm" in out
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


def test_of_many_tasks_a_run_shows_the_overview(jobs_here, castor_bench, fake_tasks, plugin, monkeypatch):
    tasks = tuple(fake_tasks.Arcs(name=f"arcs-{k}", group=f"group-{k % 2}") for k in range(4))
    for module in (results, known, show, choose):
        monkeypatch.setattr(module, "official_tasks", lambda measured=None: tasks)
    specs = ("--estimator", plugin("followers:Follower"), "--estimator", plugin("faulty:Raises"))
    code, out, err = castor_bench("run", "--cases", 1, "--jobs", 1, *specs)
    assert code == 1
    assert "Estimators of robots" in out
    assert "E_max, mm" not in out
    assert "faulty:Raises is not ranked in arcs-0 (failed 1 of 1 cases)" in out
    assert err.endswith("; the reasons are above, or shown by castor-bench leaderboard TASK\n")
    code, again, _ = castor_bench("leaderboard")
    assert code == 0
    assert [line for line in again.splitlines() if "│" in line] == [line for line in out.splitlines() if "│" in line]
    code, out, _ = castor_bench("leaderboard", "arcs-1", "--task", "arcs-3")
    assert (code, out.count("E_max, mm"), "Estimators of robots" in out) == (0, 2, False)
    assert "faulty:Raises failed 1 of 1 cases (0): raised" in out
    code, out, _ = castor_bench("leaderboard", "--group", "group-0", "--csv")
    assert (code, [line.split(",")[1] for line in out.splitlines()]) == (0, ["task", *2 * ["arcs-0"], *2 * ["arcs-2"]])
    assert isinstance(sys.stdout, io.TextIOWrapper)
    sys.stdout.reconfigure(encoding="cp1252")  # what it was is read as UTF-8
    code, out, _ = castor_bench("leaderboard", "--html")
    assert (code, out.startswith("<!DOCTYPE html>"), out.endswith("</html>\n")) == (0, True, True)
    assert "\N{MIDDLE DOT}" in out
    code, out, _ = castor_bench("leaderboard", "--markdown")
    assert (code, out.startswith("## Estimators of robots"), out.count("## Arcs")) == (0, True, 4)


def test_measured_data_are_found(jobs_here, castor_bench, plugin, tmp_path, monkeypatch):
    (tmp_path / "square.csv").write_text("")
    monkeypatch.setenv("CASTOR_DATA", str(tmp_path))
    code, out, err = castor_bench("run", "--cases", 1, "--jobs", 1, "--estimator", plugin("followers:Follower"))
    assert code == 0, err
    assert "not run" not in out


def test_a_named_task_without_its_data_makes_the_run_fail(jobs_here, castor_bench, fake_tasks, plugin, monkeypatch):
    tasks = (
        fake_tasks.Arcs(),
        fake_tasks.Arcs(name="measured-arcs", missing="no data"),
        fake_tasks.Arcs(name="far-arcs", group="far", missing="no data"),
    )
    monkeypatch.setattr(choose, "official_tasks", lambda measured=None: tasks)
    run = ("run", "--cases", 1, "--jobs", 1, "--estimator", plugin("followers:Follower"))
    for asked_for, lacking in (
        (("--task", "measured-arcs"), ["measured-arcs"]),
        (("--task", "arcs", "--task", "measured-arcs"), ["measured-arcs"]),
        (("--group", "far"), ["far-arcs"]),
        (("--group", "squares"), []),  # what of the group has its data is run
        ((), []),
    ):
        code, out, err = castor_bench(*run, *asked_for)
        assert code == bool(lacking), (asked_for, err)
        said = ", ".join(f"{name} was not run" for name in lacking)
        last = [line for line in err.splitlines() if line.startswith("not all succeeded")]
        assert last == ([f"not all succeeded: {said}; the reasons are above"] if lacking else [])
        assert out.count("not run: no data") >= len(lacking)


def test_rescore_says_where_there_is_nothing_to_score(jobs_here, castor_bench, plugin):
    castor_bench("run", "--task", "arcs", "--cases", 1, "--jobs", 1, "--estimator", plugin("followers:Follower"))
    code, out, _ = castor_bench("rescore", "--task", "arcs", "--task", "measured-arcs")
    assert (code, out) == (0, "arcs: 0 of 1 rows changed\nmeasured-arcs: no rows\n")
    code, _, err = castor_bench("rescore", "--task", "measured-arcs")
    line = "error: no results of measured-arcs in castor-results; castor-bench run --task NAME makes them\n"
    assert (code, err) == (2, line)


def test_check_passes_and_fails(jobs_here, castor_bench, plugin):
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
    assert castor_bench("--version")[:2] == (0, "castor-envs 0.1.0\n")


@pytest.fixture
def planned(castor_bench, fake_tasks, monkeypatch):
    """Return a function that gives the command tasks of two groups, one of them slow; it returns what would be run."""
    tasks = (
        fake_tasks.Arcs(),
        fake_tasks.Arcs(name="wide-arcs", group="manoeuvres"),
        fake_tasks.Arcs(name="long-arcs", group="manoeuvres", standard=False),
    )
    monkeypatch.setattr(choose, "official_tasks", lambda measured=None: tasks)
    monkeypatch.setattr(known, "official_tasks", lambda measured=None: tasks)
    plans = []

    def plan_only(plan, *_):
        plans.append([assignment.task.name for assignment in plan])
        return {}

    monkeypatch.setattr(run_command, "run_plan", plan_only)

    def call(*arguments):
        plans.clear()
        code, _, err = castor_bench("run", *arguments)
        return plans[0] if plans else (code, err)

    return call


def test_slow_tasks_run_by_name_or_group_alone(planned):
    assert planned() == ["arcs", "wide-arcs"]
    assert planned("--task", "long-arcs") == ["long-arcs"]
    assert planned("--group", "manoeuvres") == ["wide-arcs", "long-arcs"]
    assert planned("--group", "manoeuvres", "--group", "squares") == ["wide-arcs", "long-arcs", "arcs"]
    assert planned("--group", "manoeuvres", "--task", "wide-arcs", "--task", "arcs") == [
        "wide-arcs",
        "arcs",
        "long-arcs",
    ]
    assert planned("--estimator", "dead-reckoning") == ["arcs", "wide-arcs"]


def test_the_list_shows_groups_and_what_is_slow(planned, castor_bench):
    lines = castor_bench("list")[1].splitlines()
    start = lines.index("  manoeuvres")
    assert [line.split("  (")[0] for line in lines[start + 1 : start + 3]] == ["    wide-arcs", "  * long-arcs"]


MISTAKES = {
    "task": (("run", "--task", "arks"), "unknown task 'arks'; did you mean 'arcs'?"),
    "task of the board": (("leaderboard", "--task", "arks"), "unknown task 'arks'; did you mean 'arcs'?"),
    "export of a log without a robot": (("export", "log.csv"), "log.csv: name the robot that made it with --robot"),
    "export of a log as what it is": (("export", "log.csv", "--robot", "differential"), "is CSV already; choose"),
    "estimator for a task's export": (("export", "arcs", "--estimator", "cast-0"), "--estimator: is for a log"),
    "group": (("run", "--group", "square"), "unknown group of tasks 'square'; did you mean 'squares'?"),
    "estimator": (("run", "--estimator", "kast-0"), "did you mean 'cast-0'?"),
    "two of one name": (
        ("run", "--estimator", "whole.py", "--estimator", "other/whole.py"),
        "two estimators are named 'whole:Whole'",
    ),
    "plug-in without update": (("run", "--estimator", "half.py"), "has no method update"),
    "plug-in that is not there": (("run", "--estimator", "nowhere.py:Mine"), "nowhere.py"),
    "cases": (("run", "--cases", "0"), "--cases must lie between 1 and 100000, got 0"),
    "cases of the board": (("leaderboard", "--cases", "0"), "--cases must lie between 1 and 100000, got 0"),
    "cases, no number": (("run", "--cases", "many"), "--cases"),
    "jobs": (("run", "--jobs", "0"), "--jobs must lie between 1 and 256, got 0"),
    "timeout": (("run", "--timeout", "0"), "--timeout must be above 0 and at most 1e6, got 0"),
    "timeout, no number": (("run", "--timeout", "nan"), "--timeout must be above 0 and at most 1e6, got nan"),
    "results in a file": (("run", "--results", "half.py"), "half.py is a file"),
    "no results": (("leaderboard",), "no results in castor-results"),
    "measured folder": (("run", "--measured", "nowhere"), "nowhere"),
    "measured folder without data": (("run", "--measured", "."), "no square.csv there"),
    "two forms": (("leaderboard", "--json", "--markdown"), "choose one"),
    "two other forms": (("leaderboard", "--csv", "--html"), "choose one"),
    "task of the board, by argument": (("leaderboard", "arks"), "unknown task 'arks'; did you mean 'arcs'?"),
    "group of the board": (("leaderboard", "--group", "square"), "did you mean 'squares'?"),
    "option": (("run", "--robots"), "--robots"),
    "command": (("rum",), "rum"),
    "robot": (("check", "cast-0", "--robot", "asoc-prototyp"), "did you mean 'asoc-prototype'?"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_and_writes_nothing(jobs_here, castor_bench, mistake):
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


@pytest.mark.parametrize(
    "command", [("leaderboard", "arcs"), ("leaderboard", "arcs", "--json"), ("page", "--task", "arcs", "--out", "site")]
)
def test_a_task_without_results_is_said_to_have_none(castor_bench, command):
    Path("castor-results/rows").mkdir(parents=True)
    line = "error: no results of arcs in castor-results; castor-bench run --task NAME makes them\n"
    assert castor_bench(*command) == (2, "", line)
    assert not Path("site").exists()


def test_damaged_results_are_named(jobs_here, castor_bench, plugin):
    arguments = ("run", "--task", "arcs", "--cases", 1, "--jobs", 1, "--estimator", plugin("followers:Follower"))
    castor_bench(*arguments)
    (row,) = Path().glob("castor-results/rows/*/*/0.npz")
    row.write_bytes(b"PK")
    code, out, err = castor_bench("leaderboard")
    assert code == 0
    assert f"rows refused: {row}: is damaged or incomplete; " in out
    assert err == ""
    code, out, err = castor_bench(*arguments)
    assert code == 0
    assert str(row) in err
    assert castor_bench("leaderboard")[0] == 0


MINE = """
from mine_too import TrainOdometry

class Mine(TrainOdometry):
    pass
"""


@pytest.mark.slow
@pytest.mark.skipif(not SCRIPT.exists(), reason="castor-bench is not installed")
def test_the_script_works_in_a_folder_with_a_benchmarks_of_its_own(tmp_path):
    """Workers too: nothing there shadows the installed packages, and a plug-in's own modules are found."""
    for name in ("benchmarks", "estimators", "castor_envs"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text("raise RuntimeError('shadowed')")
    (tmp_path / "random.py").write_text("raise RuntimeError('shadowed')")
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "mine_too.py").write_text("from estimators import TrainOdometry")
    environment = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "CASTOR_DATA")}
    (task,) = (task for task in official_tasks() if task.name == "configuration-small")
    estimators = [f"--estimator={name}" for name in ("mine.py", "mine:Mine", "train-odometry")]
    arguments = [SCRIPT, "run", "--task", task.name, "--cases", "1", "--jobs", "1", *estimators]
    subprocess.run(arguments, cwd=tmp_path, env=environment, capture_output=True, timeout=300, check=True)
    (board,) = boards.build([task], tmp_path / "castor-results").boards
    assert [(entry.estimator, entry.failed) for entry in board.entries] == [("mine:Mine", ()), ("train-odometry", ())]
    for entry in board.entries:
        assert 0 < entry.scores[task.metric].mean < 0.05
        assert entry.cost is not None
        assert 0 < entry.cost.mean <= entry.cost.worst


def test_the_official_tasks_are_in_order():
    tasks = official_tasks()
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


CHOOSY = """
import numpy as np
from estimators import Declined

class Choosy:
    def reset(self, robot, pose):
        raise Declined("needs\\n six legs")

    def update(self, observation):
        return np.zeros(3)
"""


def test_a_plug_in_that_declines_every_robot_is_told_after_the_board_of_the_others(jobs_here, castor_bench, plugin):
    Path("choosy.py").write_text(CHOOSY)
    arguments = ("run", "--task", "arcs", "--cases", 1, "--jobs", 1, "--estimator")
    code, out, err = castor_bench(*arguments, plugin("followers:Follower"), "--estimator", "choosy.py")
    assert code == 1
    assert "│    1 │ followers:Follower" in out
    assert "choosy:Choosy declines this robot: needs six legs" in out
    assert "not all succeeded: choosy:Choosy declined every task: needs six legs; " in err.splitlines()[-1]
    assert castor_bench(*arguments, plugin("followers:Follower"))[0] == 0


def test_a_row_that_failed_makes_the_run_fail_after_the_board(jobs_here, castor_bench, plugin):
    """Whether it failed in this run or in one before; the last line says which."""
    arguments = ("run", "--task", "arcs", "--cases", 2, "--jobs", 1, "--estimator")
    code, out, err = castor_bench(*arguments, plugin("faulty:Raises"))
    assert code == 1
    assert err.endswith("not all succeeded: faulty:Raises failed 2 of 2 cases of arcs; the reasons are above\n")
    assert "failed 2 of 2 cases" in out
    assert out.endswith("castor-bench leaderboard arcs --cases 2 --results castor-results\n")
    for _ in range(2):
        code, _, err = castor_bench(*arguments, plugin("fails_on_some:FailsOnSome"), "--cases", 4)
        assert code == 1
        assert err.endswith("fails_on_some:FailsOnSome failed 1 of 4 cases of arcs; the reasons are above\n")
    code, _, err = castor_bench(*arguments, plugin("fails_on_some:FailsOnSome"))
    assert code == 0, err


def test_where_nobody_serves_a_chosen_task_nothing_is_run(castor_bench):
    code, out, err = castor_bench("run", "--task", "arcs", "--estimator", "cast-9")
    assert code == 1
    assert "cast-9 declines this robot: " in out
    assert "show them again" not in out
    assert "not all succeeded: cast-9 declined every task: " in err
    assert not list(Path().iterdir())


def test_a_built_in_is_left_out_of_the_tasks_that_it_does_not_serve(castor_bench, fake_tasks, monkeypatch):
    three = importlib.import_module("castor_envs.vehicles.presets").preset("3-castor")
    three_castor_task = type("Other", (fake_tasks.Arcs,), {"robot": three, "record": None})(name="other")
    monkeypatch.setattr(choose, "official_tasks", lambda measured=None: (fake_tasks.Arcs(), three_castor_task))
    heard = {}

    def plan_only(plan, *_):
        heard.update({a.task.name: [entry.name for entry in a.estimators] for a in plan})
        return {}

    monkeypatch.setattr(run_command, "run_plan", plan_only)
    _, out, _ = castor_bench("run", "--estimator", "cast-3", "--estimator", "dead-reckoning-1")  # nothing is run
    assert heard == {"arcs": ["dead-reckoning-1"], "other": ["cast-3", "dead-reckoning-1"]}
    assert "cast-3 declines this robot: " in out


def test_a_full_disk_is_one_line_and_the_same_command_goes_on(castor_bench, plugin, in_this_process):
    """In place of a full disk the system refuses files over 2 kB, in worker processes too."""
    resource = pytest.importorskip("resource")
    arguments = ("run", "--task", "arcs", "--cases", 1, "--jobs", 1, "--estimator", plugin("followers:Follower"))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    try:
        code, out, err = castor_bench(*arguments)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert (code, out) == (1, "")
    assert err.splitlines()[-1] == (
        "error: castor-results/episodes/arcs@1/0.npz: File too large; make room; "
        "what is done is kept in castor-results: the same command continues"
    )
    assert not [path for path in Path("castor-results").rglob("*") if path.is_file()]
    with in_this_process():
        assert castor_bench(*arguments)[0] == 0


def test_an_error_that_nobody_foresaw_is_one_line(castor_bench, monkeypatch):
    def broken(*_):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(run_command, "run_plan", broken)
    code, out, err = castor_bench("run", "--task", "arcs")
    assert (code, out) == (1, "")
    assert err.strip().startswith("error: unforeseen ZeroDivisionError: a bug; what is done is kept in castor-results")
    assert "Traceback (most" in castor_bench("run", "--task", "arcs", "--traceback")[2]


def test_ctrl_c_says_what_is_kept(castor_bench, monkeypatch):
    def stopped(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(run_command, "run_plan", stopped)
    code, out, err = castor_bench("run", "--task", "arcs", "--results", "kept")
    assert (code, out) == (130, "")
    assert err.strip() == "stopped; what is done is kept in kept: the same command continues"


@pytest.mark.parametrize("command", [("run", "--estimator"), ("check",)])
def test_a_file_named_without_its_ending_is_suggested(jobs_here, castor_bench, command):
    Path("choosy.py").write_text(CHOOSY)
    code, _, err = castor_bench(*command, "choosy")
    assert code == 2
    assert err == "error: unknown estimator 'choosy'; did you mean the file 'choosy.py'?\n"


ODOMETRY = """
from estimators import Declined, DeadReckoning

class MyOdometry(DeadReckoning):
    def reset(self, robot, pose):
        if len(robot.castors) != 1 or robot.castors[0].steering != "fixed":
            raise Declined("needs a differential robot: one fixed castor")
        super().reset(robot, pose)
    batched = False
"""


def test_check_names_the_robot_and_who_was_declined(jobs_here, castor_bench):
    Path("my_odometry.py").write_text(ODOMETRY)
    code, out, err = castor_bench("check", "my_odometry.py")
    assert code == 0, (out, err)
    first, declined, trains = out.splitlines()[:3]
    assert first == "checking my_odometry:MyOdometry on preset 'differential'"
    assert declined.startswith("declined: asoc-prototype, asoc-full-scale, ")
    assert declined.endswith("omni3: needs a differential robot: one fixed castor")
    assert trains.endswith("cfmmr-10: is written for robots: it asks for 'castors'")
    Path("choosy.py").write_text(CHOOSY)
    code, out, _ = castor_bench("check", "choosy.py")
    assert code == 1
    assert out.splitlines()[0].endswith("(it declines every preset)")
    assert (
        "WRONG  serves the robot: reset declines robot 'ASOC prototype, one-third scale': needs six legs; check with"
        in out
    )


@pytest.mark.parametrize(
    ("body", "line"),
    [
        ("def update(self, observation): os._exit(3)", "WRONG  stays alive: ended its process (exit code 3)"),
        ("def update(self, observation): time.sleep(99)", "WRONG  answers in time: took over 1 s"),
        ("def update(self, observation): ...\n    reset = lambda *_: time.sleep(99)", "WRONG  answers in time: "),
        ("def update(self, observation): ...\nos._exit(4)", "WRONG  stays alive: ended its process (exit code 4)"),
    ],
)
def test_check_survives_what_it_checks(castor_bench, body, line):
    Path("bad.py").write_text(f"import os, time\nclass Bad:\n    def reset(self, *_): ...\n    {body}\n")
    code, out, err = castor_bench("check", "bad.py", "--timeout", 1)
    assert (code, err) == (1, "")
    first, wrong = out.splitlines()
    assert first.startswith("checking bad")
    assert wrong.replace(" (on asoc-prototype)", "").startswith(line)


DIVERGES = """
from estimators import Declined, TrainOdometry, WheelOdometry

class Drifts:
    def reset(self, vehicle, pose):
        is_train = hasattr(vehicle, "modules")
        wheels = len(vehicle.modules if is_train else vehicle.castors)
        if wheels in (1, 5, 6):
            raise Declined(f"{vehicle.name!r} is odd")
        self.inner, self.k = (TrainOdometry if is_train else WheelOdometry)(), 0
        self.inner.reset(vehicle, pose)
        steered = not is_train and all(castor.steering == "driven" for castor in vehicle.castors)
        self.wrong = wheels == 10 or (steered and wheels == 4)

    def update(self, observation):
        self.k += 1
        pose = self.inner.update(observation)
        return pose + (0.3 * (self.k / 240) ** 12 if self.wrong else 0)
"""


def test_check_finds_an_estimator_that_diverges_on_some_layouts(jobs_here, castor_bench):
    Path("drifts.py").write_text(DIVERGES)
    code, out, _ = castor_bench("check", "drifts.py")
    assert code == 1
    assert out.startswith("checking drifts:Drifts on preset 'asoc-prototype' and 'cfmmr-3', briefly on ")
    assert "declined: differential, 1-castor, 5-castor, 6-castor, cfmmr-5, cfmmr-6: '...' is odd" in out
    (wrong,) = [line for line in out.splitlines() if line.startswith("WRONG")]
    assert wrong.startswith("WRONG  stays near the truth in bends (on powered-caster, swerve, cfmmr-10): driven")
    assert "it diverges on this layout" in wrong


def test_check_refuses_a_robot_that_it_cannot_drive(castor_bench):
    code, _, err = castor_bench("check", "cast-0", "--timeout", 0)
    assert (code, err) == (2, "error: --timeout must be above 0 and at most 1e6, got 0\n")


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("import time; time.sleep(99)", "took over 1 s"),
        ("import os; os._exit(0)", "ended its process"),
        ("raise BaseException('no')", "cannot be imported, line 1 (BaseException: no)"),
    ],
)
def test_a_plug_in_that_fails_on_import_is_refused(castor_bench, tmp_path, source, said):
    (tmp_path / "bad.py").write_text(source)
    code, out, err = castor_bench("run", "--timeout", 1, "--estimator", tmp_path / "bad.py")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert said in err


@pytest.mark.parametrize("option", [("--cases", 10**23), ("--jobs", 10**6), ("--timeout", 1e308), ("--timeout", "nan")])
def test_absurd_numbers_are_refused(castor_bench, option):
    code, out, err = castor_bench("run", *option)
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert option[0] in err


def test_a_run_on_another_robot_has_boards_of_its_own(jobs_here, castor_bench):
    arguments = ("--task", "umbmark-kinematic-calibrated", "--cases", 1, "--jobs", 1)
    code, out, err = castor_bench("run", "--robot", "differential", *arguments)
    assert code == 0, err
    assert "differential (not official)" in out
    code, out, _ = castor_bench("leaderboard", "--json")
    assert code == 0
    official, _, users_board = json.loads(out)["tasks"]
    assert official["entries"] == []
    assert users_board["task"].startswith("umbmark-kinematic-calibrated[differential@")
    served = {"dead-reckoning-1", "filter", "holmberg-khatib", "tidybot", "wheel-odometry"}
    assert {entry["estimator"] for entry in users_board["entries"]} == served
    code, out, _ = castor_bench("rescore")
    assert (code, out) == (0, f"{users_board['task']}: 0 of 5 rows changed\n")
    for dry_run, said in ((["--dry-run"], "would be removed"), ([], "removed")):
        code, out, _ = castor_bench("forget", "tidybot", *dry_run)
        assert (code, out) == (0, f"{users_board['task']}: 1 row {said}\n")
    code, out, err = castor_bench("forget", "tidybot")
    assert (code, out) == (2, "")
    assert "'tidybot' has no rows in castor-results; known: dead-reckoning-1, filter, holmberg-khatib" in err
    _, out, _ = castor_bench("leaderboard", "--json")
    assert {entry["estimator"] for entry in json.loads(out)["tasks"][-1]["entries"]} == served - {"tidybot"}


@pytest.mark.parametrize(
    ("robot", "said"),
    [("cfmmr-3", "is a train"), ("differentail", "did you mean 'differential'?"), ("1-castor", "robot")],
)
def test_a_robot_that_cannot_run_the_squares_is_refused(castor_bench, robot, said):
    code, out, err = castor_bench("run", "--robot", robot, "--task", "calibration-pivoting")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert said in err
    assert not list(Path().iterdir())
