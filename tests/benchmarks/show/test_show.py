"""`castor-bench show`: the scores are those of a run, the page stands alone, pictures are what was asked for."""

import dataclasses
import html
import importlib
import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageSequence

from benchmarks import cli
from benchmarks.commands import results, show
from benchmarks.results.rows import ResultsStore
from benchmarks.run import choose
from benchmarks.run.plan import Assignment, run
from benchmarks.show import picture
from benchmarks.show.command import Following, show_case
from benchmarks.show.drives import drives_of
from benchmarks.show.page import page_of
from benchmarks.tasks import official_tasks, select_tasks
from castor_envs.cli import command_line
from castor_envs.cli.commands import imported
from castor_envs.floor import FLOORS, Cable, Floor, Patch
from castor_envs.logs.csv import write_log
from castor_envs.rendering.drawing import palette
from castor_envs.vehicles.presets import differential
from estimators.plugins.registry import load_estimator


@pytest.fixture
def castor_bench(monkeypatch, capsys, tmp_path, fake_tasks, jobs_here):
    """Return a function that runs the command on the fake task, in an empty folder; it returns code, out and err."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    for module in (results, show, choose):
        monkeypatch.setattr(module, "official_tasks", lambda measured=None: (fake_tasks.Arcs(),))

    def call(*arguments):
        with pytest.raises(SystemExit) as leaving:
            command_line.run(cli.app, [str(argument) for argument in arguments])
        read = capsys.readouterr()
        return leaving.value.code, read.out, read.err

    return call


@pytest.mark.parametrize("name", ["followers:Follower", "unsure:Unsure"])
def test_scores_are_those_of_a_run(fake_tasks, plugin, jobs_here, tmp_path, name):
    task, spec = fake_tasks.Arcs(), plugin(name)
    run([Assignment(task, (3,), (load_estimator(spec),))], tmp_path)
    (row,) = ResultsStore(tmp_path).rows(task.name, task.version)
    shown = show_case(task, 3, Following([spec]))
    assert shown.scores == {name: pytest.approx(row.scores, rel=1e-12)}
    page = page_of(shown)
    told = {"NEES / 3", "inside 95 %", "with status"}
    assert {title for title in told if title in page} == (told if name == "unsure:Unsure" else set())
    assert shown.origin["episode"] == row.episode


@pytest.mark.parametrize("name", ["started:Started", "started:Straightens"])
def test_scores_of_snapshots_are_those_of_a_run(plugin, jobs_here, tmp_path, name):
    """Estimators are told there how exact their start is said to be, as in a run."""
    (task,), spec = select_tasks(official_tasks(), ["configuration-one-of-three"]), plugin(name)
    run([Assignment(task, (0,), (load_estimator(spec),))], tmp_path)
    (row,) = ResultsStore(tmp_path).rows(task.name, task.version)
    assert row.failure is None
    assert show_case(task, 0, Following([spec])).scores == {name: pytest.approx(row.scores, rel=1e-12)}


def test_a_case_becomes_a_page_that_repeats_itself(castor_bench, plugin, tmp_path):
    spec = plugin("followers:Follower")
    code, out, err = castor_bench("show", "--task", "arcs", "--case", 2, "--estimator", spec)
    assert (code, out, err) == (0, "castor-show.html\n", "")
    page = (tmp_path / "here" / "castor-show.html").read_text(encoding="utf-8")
    assert f"castor-bench show --task arcs --case 2 --estimator {spec}" in page
    assert ("run 1, cw" in page, "run 2, ccw" in page) == (True, True)
    assert not re.search(r"""(?:src|href)=["'](?!#)""", page)  # nothing is fetched, nothing beside it needed
    assert castor_bench("show", "--task", "arcs", "--estimator", spec)[0] == 0  # a page of this command is replaced


def repeats(page):
    """Return the arguments of the command that a page names."""
    (block,) = re.findall(r"<pre>(castor-bench .*?)</pre>", page.read_text(encoding="utf-8"), flags=re.S)
    script, *arguments = shlex.split(html.unescape(block))
    assert script == "castor-bench"
    return arguments


@pytest.mark.parametrize("robot", ["differential", "own robot.json"])
def test_a_page_of_a_users_robot_is_repeated_by_the_command_that_it_names(castor_bench, robot):
    """On the robot as it was given: a preset's name, or a file."""
    differential().save("own robot.json")
    first = ("show", "--task", "umbmark-kinematic-calibrated", "--robot", robot, "--estimator", "wheel-odometry")
    assert castor_bench(*first)[0] == 0
    page = Path("castor-show.html")
    arguments = repeats(page)
    (digest,) = re.findall(r"<dt>episode</dt><dd>(\w+)", page.read_text(encoding="utf-8"))
    page.unlink()
    assert castor_bench(*arguments)[0] == 0
    assert repeats(page) == arguments
    assert f"<dd>{digest}</dd>" in page.read_text(encoding="utf-8")


def test_a_page_of_a_users_task_is_repeated_by_the_command_that_it_names(castor_bench, fake_tasks):
    Path("my_arcs.py").write_text(
        f"import sys\nsys.path.append({str(Path(fake_tasks.__file__).parent)!r})\n"
        "from fake_tasks import Arcs\n\n\n"
        "class Mine(Arcs):\n    def __init__(self):\n        super().__init__('mine')\n"
    )
    assert castor_bench("show", "--task", "my_arcs.py:Mine", "--estimator", "wheel-odometry")[::2] == (0, "")
    page = Path("castor-show.html")
    arguments = repeats(page)
    assert arguments[:3] == ["show", "--task", "my_arcs.py:Mine"]
    page.unlink()
    assert castor_bench(*arguments)[0] == 0
    assert repeats(page) == arguments


@pytest.mark.parametrize(
    ("name", "reason"),
    [("faulty:Raises", "raised ValueError: no idea where I am in update"), ("faulty:Refuses", "declined: needs six l")],
)
def test_whoever_gives_no_poses_makes_the_command_fail_after_its_page(castor_bench, plugin, fake_tasks, name, reason):
    write_log(Path("drive.csv"), fake_tasks.Arcs(samples=21).record(0).runs[0].log, differential())
    on_log = ("drive.csv", "--robot", "differential")
    for arguments in (
        ("show", "--task", "arcs", "--estimator", plugin(name)),
        ("show", *on_log, "--estimator", "wheel-odometry", "--estimator", plugin(name)),
        ("export", *on_log, "--format", "tum", "--out", "poses", "--estimator", plugin(name)),
    ):
        code, out, err = castor_bench(*arguments)
        told, made = out.splitlines()
        assert (code, told[: len(name) + 16 + len(reason)]) == (1, f"{name} gave no poses: {reason}")
        assert Path(made.partition(":")[0]).exists()
        assert err == f"not all succeeded: {name} gave no poses; the reasons are above\n"


def test_poses_of_a_log_are_exported_where_the_reference_is_known(castor_bench, fake_tasks, tmp_path):
    """An estimate that starts on the reference is compared with it row by row; a log without one is refused."""
    log, here = fake_tasks.Arcs(samples=21).record(0).runs[0].log, tmp_path / "here"
    reference = log.reference.copy()
    reference[[0, 5]] = np.nan
    write_log(here / "drive.csv", dataclasses.replace(log, reference=reference), differential())
    arguments = ("--robot", "differential", "--format", "tum", "--estimator", "wheel-odometry")
    assert castor_bench("export", "drive.csv", *arguments, "--out", "poses") == (0, "poses: poses of drive.csv\n", "")
    folder = here / "poses" / "drive"
    names = ["run-01-wheel-odometry.tum", "run-01.tum"]
    assert sorted(path.name for path in folder.iterdir()) == names
    estimate, known = (np.loadtxt(folder / name) for name in names)
    rows = np.searchsorted(log.t, known[:, 0])
    assert (rows[0], rows[-1], 5 in rows) == (1, 20, False)
    np.testing.assert_array_equal(estimate[:, 0], known[:, 0])
    np.testing.assert_array_equal(known[:, :3], np.column_stack([log.t, log.reference[:, :2]])[rows])
    np.testing.assert_allclose(estimate[0, 1:], known[0, 1:], atol=1e-12)
    shutil.copy(here / "drive.csv", here / "drive.txt")
    assert castor_bench("export", "drive.txt", *arguments, "--out", "same") == (0, "same: poses of drive.txt\n", "")
    write_log(here / "blind.csv", dataclasses.replace(log, reference=None), differential())
    code, _, err = castor_bench("export", "blind.csv", *arguments, "--out", "none")
    assert (code, "blind.csv: has no reference" in err, (here / "none").exists()) == (2, True, False)


def test_a_log_is_shown_on_its_floor_and_with_pictures(castor_bench, fake_tasks, tmp_path):
    log, here = fake_tasks.Arcs(samples=21).record(0).runs[0].log, tmp_path / "here"
    robot = differential()
    write_log(here / "drive.csv", log, robot)
    patch = Patch(center=(0.5, 0.0), size=(0.3, 0.2), friction=0.05)
    Floor(patches=(patch,), cables=(Cable(center=(1, 0), direction=1.5, length=0.1, diameter=0.01),)).save("floor.json")
    arguments = ("--robot", "differential", "--floor", "floor.json", "--png", "end.png", "--gif", "drive.gif")
    code, out, err = castor_bench("show", "drive.csv", *arguments, "--estimator", "wheel-odometry")
    assert (code, out, err) == (0, "castor-show.html, end.png, drive.gif (of wheel-odometry)\n", "")
    page = (here / "castor-show.html").read_text(encoding="utf-8")
    assert "1 patch and 1 cable." in page.replace("\n", " ")
    assert page.count('class="slippery"') == page.count('class="cable"') == 1
    with Image.open(here / "end.png") as end, Image.open(here / "drive.gif") as moving:
        assert (end.format, moving.format) == ("PNG", "GIF")
        assert getattr(moving, "n_frames", 1) == 21
        first = np.asarray(moving.convert("RGB"), dtype=int)
        moving.seek(20)
        last = np.asarray(moving.convert("RGB"), dtype=int)
        assert np.abs(last - first).max() > 50  # it moves
        assert np.abs(last - np.asarray(end, dtype=int)).mean() < 3  # and ends as the picture of the end


def test_a_picture_that_moves_takes_eight_seconds(fake_tasks, tmp_path, monkeypatch):
    monkeypatch.setattr(picture, "SIZE", 160)
    drive = drives_of(fake_tasks.Arcs(samples=201).record(0))[0]
    picture.write_gif(tmp_path / "drive.gif", drive, None)
    with Image.open(tmp_path / "drive.gif") as moving:
        shown = [frame.info["duration"] for frame in ImageSequence.Iterator(moving)]
    assert sum(shown) == pytest.approx(8000)


def test_a_floor_may_be_named_as_in_other_commands(castor_bench, fake_tasks, tmp_path):
    write_log(tmp_path / "here" / "drive.csv", fake_tasks.Arcs(samples=21).record(0).runs[0].log, differential())
    arguments = ("drive.csv", "--robot", "differential", "--floor", "slippery", "--estimator", "wheel-odometry")
    assert castor_bench("show", *arguments)[::2] == (0, "")
    page = (tmp_path / "here" / "castor-show.html").read_text(encoding="utf-8")
    assert page.count('class="slippery"') == 1
    assert "--floor slippery" in page


def test_every_named_floor_is_in_the_help_of_commands():
    commands = imported(cli.app)
    for command in ("drive", "show"):
        (floor,) = (option for option in commands[command].params if option.name == "floor")
        assert all(name in floor.help for name in FLOORS)


def test_a_log_without_reference_has_no_scores_and_is_drawn_where_the_estimate_has_it(
    castor_bench, fake_tasks, tmp_path
):
    log = fake_tasks.Arcs().record(0).runs[0].log
    write_log(tmp_path / "here" / "blind.csv", type(log)(log.t, log.wheel, log.pivot), differential())
    arguments = ("show", "blind.csv", "--robot", "differential", "--estimator", "wheel-odometry")
    assert castor_bench(*arguments)[0] == 0
    page = (tmp_path / "here" / "castor-show.html").read_text(encoding="utf-8")
    assert "nobody knows how far estimates are off" in page
    assert "position error" not in page.partition("</style>")[2].partition("<script>")[0]
    (tmp_path / "here" / "castor-show.html").unlink()
    for _ in range(2):  # pictures of this command are replaced
        code, out, err = castor_bench(*arguments, "--gif", "blind.gif", "--png", "blind.png")
        assert (code, out, err) == (0, "castor-show.html, blind.png, blind.gif (of wheel-odometry)\n", "")
    with Image.open("blind.png") as end, Image.open("blind.gif") as moving:
        last = np.asarray(end.convert("RGB"), dtype=int)
        assert (last == palette.ESTIMATE[:3]).all(axis=2).any()
        assert not (last == palette.TRUE_PATH[:3]).all(axis=2).any()  # of which nothing is known
        moving.seek(getattr(moving, "n_frames", 1) - 1)
        assert np.abs(last - np.asarray(moving.convert("RGB"), dtype=int)).mean() < 3
        moving.seek(0)
        assert np.abs(last - np.asarray(moving.convert("RGB"), dtype=int)).max() > 50


def test_a_log_of_positions_is_compared_in_position_and_not_exported_as_poses(castor_bench, fake_tasks, tmp_path):
    log, here = fake_tasks.Arcs().record(0).runs[0].log, tmp_path / "here"
    positions = dataclasses.replace(log, reference=log.reference * [1.0, 1.0, np.nan])
    write_log(here / "drive.csv", positions, differential())
    arguments = ("drive.csv", "--robot", "differential", "--estimator", "wheel-odometry")
    code, out, err = castor_bench("show", *arguments, "--png", "end.png")
    assert (code, out, err) == (0, "castor-show.html, end.png (of wheel-odometry)\n", "")
    page = (here / "castor-show.html").read_text(encoding="utf-8")
    shown = page.partition("</style>")[2].partition("<script>")[0]
    assert "its reference has positions alone" in shown
    assert "position error" in shown
    assert "heading error" not in shown
    code, _, err = castor_bench("export", *arguments, "--format", "tum", "--out", "none")
    assert (code, (here / "none").exists()) == (2, False)
    assert "has no headings, and tum is of poses" in err


MISTAKES = {
    "nothing": ((), "give a log and --robot, or --task"),
    "both": (("a.csv", "--task", "arcs"), "give a log and --robot, or --task"),
    "no robot": (("a.csv",), "name the robot that made it with --robot"),
    "no log": (("a.csv", "--robot", "differential"), "a.csv: cannot be read"),
    "no floor": (("a.csv", "--robot", "differential", "--floor", "slipery"), "did you mean 'slippery'?"),
    "case of a log": (("a.csv", "--robot", "differential", "--case", "1"), "--case: is of a task"),
    "no case": (("--task", "arcs", "--case", "one"), "cases of arcs are numbers; 0 to 7 are official"),
    "floor of a task": (("--task", "arcs", "--floor", "f.json"), "a task has a floor of its own"),
    "method": (("--task", "arcs", "--method", "pivoting"), "calibration methods are shown in calibration tasks alone"),
    "ending": (("--task", "arcs", "--png", "a.gif"), "--png a.gif: its name must end in .png"),
    "run": (("--task", "arcs", "--run", "3"), "--run 3: there are 2 runs"),
    "no folder": (("--task", "arcs", "--out", "mine.html/x.html"), "--out mine.html/x.html: cannot be written to ("),
    "other picture": (("--task", "arcs", "--png", "mine.png"), "mine.png: is there already, and no picture of this"),
    "other animation": (("--task", "arcs", "--gif", "mine.gif"), "mine.gif: is there already, and no picture of this"),
    "other file": (("--task", "arcs", "--out", "mine.html"), "is there already, and no page of this command"),
    "other file, before anyone is run": (
        ("--task", "arcs", "--out", "mine.html", "--estimator", "nobody"),
        "is there already, and no page of this command",
    ),
    "no folder of a picture, before anyone is run": (
        ("--task", "arcs", "--gif", "mine.html/x.gif", "--estimator", "nobody"),
        "--gif mine.html/x.gif: cannot be written to (",
    ),
}


@pytest.mark.parametrize("name", MISTAKES)
def test_mistakes_are_one_clear_line(castor_bench, tmp_path, name):
    mine = [tmp_path / "here" / name for name in ("mine.html", "mine.png", "mine.gif")]
    for path in mine:
        path.write_text("<p>mine</p>")
    arguments, said = MISTAKES[name]
    code, _, err = castor_bench("show", *arguments)
    assert code == 2
    assert said in err
    assert err.count("\n") == 1
    assert [path.read_text() for path in mine] == 3 * ["<p>mine</p>"]


def test_a_calibration_task_shows_what_methods_return(castor_bench, monkeypatch):
    task = importlib.import_module("fake_calibrations").CalibrationByArcs()
    monkeypatch.setattr(choose, "official_tasks", lambda measured=None: (task,))
    code, out, err = castor_bench("show", "--task", task.name, "--method", "uncalibrated")
    assert (code, out, err) == (0, "castor-show.html\n", "")
