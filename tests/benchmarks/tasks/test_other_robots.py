"""Tasks on robots of the user's: the same squares, on boards that never mix with the official ones."""

import dataclasses
import json
import shlex

import numpy as np
import pytest

from benchmarks.leaderboard.board import build
from benchmarks.results.archives import CorruptFileError
from benchmarks.results.robots import save_robot, tasks_on_stored_robots, with_stored_robots
from benchmarks.results.rows import ResultsStore, Row
from benchmarks.run.choose import builtin_entries, choose
from benchmarks.show.repeat import run_command, show_command
from benchmarks.tasks import official_tasks, select_tasks, tasks_on
from benchmarks.tasks.other_robots import OtherRobot
from benchmarks.tasks.physics import innermost_wheel, ten_cables
from benchmarks.tasks.task import odometry_of
from castor_envs.effects.dimensions import WheelRadius
from castor_envs.errors import InputError
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Gyro, RobotDescription


def task_on(spec, name):
    (task,) = select_tasks(tasks_on(OtherRobot.load(spec)), [name])
    return task


@pytest.fixture
def files(tmp_path):
    """Return two files of one name, the second robot with wheels 1 mm larger."""
    robot = preset("differential")
    (axle,) = robot.castors
    wheels = tuple(dataclasses.replace(wheel, radius=wheel.radius + 1e-3) for wheel in axle.wheels)
    edited = dataclasses.replace(robot, castors=(dataclasses.replace(axle, wheels=wheels),))
    paths = []
    for folder, described in (("a", robot), ("b", edited)):
        described.save(tmp_path / folder / "mine.json")
        paths.append(str(tmp_path / folder / "mine.json"))
    return paths


def test_the_official_robot_drives_the_official_episodes():
    """The twin of an official task on the official robot records the same, bit for bit."""
    name = "umbmark-kinematic-calibrated"
    (official,) = select_tasks(official_tasks(), [name])
    twin = task_on("asoc-prototype", name)
    assert twin.record(3).digest == official.record(3).digest
    assert twin.name != official.name


@pytest.mark.parametrize("tolerance", [None, 0.002])
def test_estimators_are_not_told_the_bias_of_a_gyro(tmp_path, tolerance):
    """A file whose gyro is simulated with its bias: what is told is off by what the file states, or 0."""
    gyro = Gyro(noise=1e-4, bias=0.05, bias_tolerance=tolerance)
    dataclasses.replace(preset("differential"), gyro=gyro).save(tmp_path / "biased.json")
    task = task_on(str(tmp_path / "biased.json"), "umbmark-physics-clean")
    told = []
    for case in range(3):
        episode = task.record(case)
        readings = episode.runs[0].log.gyro
        assert readings is not None
        assert readings[:10].mean() == pytest.approx(0.05, abs=5e-3)
        assert isinstance(episode.robot, RobotDescription)
        assert episode.robot.gyro is not None
        told.append(episode.robot.gyro.bias)
    if tolerance is None:
        assert told == [0.0] * 3
    else:
        assert len({0.05, *told}) == 4
        assert np.allclose(told, 0.05, atol=5 * tolerance)


def test_cables_lie_under_the_innermost_wheel():
    prototype, differential = preset("asoc-prototype"), preset("differential")
    assert [innermost_wheel(prototype, side) for side in (1.0, -1.0)] == [0.266, 0.266]
    assert innermost_wheel(differential, 1.0) == 0.17
    floor = ten_cables(differential, "cw", np.random.default_rng(0))
    assert {cable.center[1] for cable in floor.cables} == {-0.17}


def test_an_edited_file_is_another_board(files):
    names = [task_on(path, "umbmark-physics-clean").name for path in files]
    assert names == [f"umbmark-physics-clean[mine@{OtherRobot.load(path).robot.hash()}]" for path in files]
    assert names[0] != names[1]


def test_estimators_fit_the_robot():
    served = ["dead-reckoning-1", "filter", "holmberg-khatib", "tidybot", "wheel-odometry"]
    assert [e.name for e in builtin_entries(task_on("differential", "umbmark-physics-clean"))] == served
    assert "cast-0" in [e.name for e in builtin_entries(task_on("omnimate", "umbmark-physics-clean"))]


def test_calibration_is_of_the_robots_that_a_method_serves():
    def judged(spec):
        return [t.name.partition("[")[0] for t in tasks_on(OtherRobot.load(spec)) if odometry_of(t) and not t.missing]

    assert judged("differential") == ["calibration-umbmark"]
    assert judged("omnimate") == ["calibration-pivoting"]
    assert judged("swerve") == []


@pytest.mark.parametrize("name", ["asoc-full-scale", "tricycle", "powered-caster", "omni3"])
def test_any_robot_that_can_roll_round_the_square_has_the_task(name):
    assert task_on(name, "umbmark-kinematic-calibrated").missing is None


def test_robots_that_cannot_drive_the_square_are_refused(tmp_path):
    with pytest.raises(InputError, match="is a train"):
        OtherRobot.load("cfmmr-3")
    robot = preset("differential")
    (axle,) = robot.castors
    skewed = dataclasses.replace(robot, castors=(dataclasses.replace(axle, pivot=(0.3, 0.0)),))
    skewed.save(tmp_path / "skewed.json")
    with pytest.raises(InputError, match="fixed wheels would slip sideways"):
        choose(["umbmark-physics-clean"], [], [], 1, 60.0, None, OtherRobot.load(str(tmp_path / "skewed.json")))
    with pytest.raises(InputError, match=r"'1-castor base' cannot drive the UMBmark square, .* cannot turn it"):
        choose([], [], [], 1, 60.0, None, OtherRobot.load("1-castor"))
    slow = dataclasses.replace(robot, max_wheel_speed=0.5)
    slow.save(tmp_path / "slow.json")
    with pytest.raises(InputError, match="is too slow"):
        choose([], [], [], 1, 60.0, None, OtherRobot.load(str(tmp_path / "slow.json")))


def test_effects_drive_in_physics_and_estimators_do_not_hear_of_them():
    users_robot = OtherRobot("mine", preset("differential").with_effects(WheelRadius(castor=1, wheel=1, value=0.001)))
    tasks = {task.name.partition("[")[0]: task for task in tasks_on(users_robot)}
    assert "effects" in (tasks["umbmark-kinematic-calibrated"].missing or "")
    assert tasks["umbmark-physics-clean"].missing is None
    assert tasks["umbmark-physics-clean"].robot.effects


def put_row(results, task, error):
    ResultsStore(results).save(
        Row(
            task=task.name,
            version=task.version,
            estimator="mine",
            source_hash="0" * 16,
            case=0,
            episode="e" * 16,
            robot_hash="a" * 16,
            scores={"E_max_syst": error, "ate": error / 2},
        )
    )


@pytest.mark.parametrize(("name", "label"), [(".hid.json", "hid"), ("...json", "robot"), ("a.b.json", "a.b")])
def test_a_file_whose_name_begins_with_a_dot_has_boards_that_are_found_again(tmp_path, name, label):
    preset("differential").save(tmp_path / name)
    users_robot = OtherRobot.load(str(tmp_path / name))
    assert users_robot.label == label
    save_robot(tmp_path / "results", users_robot)
    task = task_on(str(tmp_path / name), "umbmark-physics-clean")
    put_row(tmp_path / "results", task, 0.1)
    assert [found.name for found in with_stored_robots((), tmp_path / "results")] == [task.name]


def test_pages_name_a_robot_so_that_commands_find_it(tmp_path, monkeypatch):
    """A label that is a preset's, of the same robot, is that preset; else it is taken for a file's."""
    monkeypatch.chdir(tmp_path)
    dataclasses.replace(preset("tricycle"), mass=99.0).save("tricycle.json")
    preset("swerve").save("mine.json")
    name = "umbmark-physics-clean"
    for robot in ("tricycle", "tricycle.json", "mine.json"):
        board = task_on(robot, name).name
        for line in (run_command(board, "wheel-odometry"), show_command(board, 0, {"wheel-odometry": None})):
            words = shlex.split(line)
            assert words[words.index("--task") + 1] == name
            assert task_on(words[words.index("--robot") + 1], name).name == board


@pytest.mark.parametrize(
    ("name", "option"),
    [
        ("umbmark-measured-nominal", ["--measured", "DIR"]),
        ("measured-raw-omni-nominal", ["--measured", "DIR"]),
        ("umbmark-physics-clean", []),
    ],
)
def test_pages_say_that_a_task_needs_measured_data(name, option):
    for line in (run_command(name, "filter"), show_command(name, 0, {"filter": None})):
        words = shlex.split(line)
        at = words.index("--task")
        assert words[at + 1] == name
        assert words[at + 2 : at + 2 + len(option)] == option
        assert ("--measured" in words) == bool(option)


def test_rows_on_another_robot_are_on_no_official_board(tmp_path, files):
    robots = [OtherRobot.load(path) for path in files]
    name = "umbmark-physics-clean"
    (official,) = select_tasks(official_tasks(), [name])
    put_row(tmp_path, official, 0.5)
    for k, users_robot in enumerate(robots):
        save_robot(tmp_path, users_robot)
        put_row(tmp_path, select_tasks(tasks_on(users_robot), [name])[0], 0.1 * (1 + k))
    tasks = [task for task in with_stored_robots(official_tasks(), tmp_path) if task.name.startswith(name)]
    boards = build(tasks, tmp_path).boards
    means = [[entry.scores["E_max_syst"].mean for entry in board.entries] for board in boards]
    assert means[0] == [0.5]
    assert sorted(means[1:]) == [[0.1], [0.2]]
    assert ["not official" in board.title for board in boards] == [False, True, True]
    assert select_tasks(tasks, [name]) == (official,)
    assert not build(official_tasks(), tmp_path).other_versions


def test_a_robot_file_that_was_edited_in_the_results_is_named(tmp_path, files):
    users_robot, edited = (OtherRobot.load(path) for path in files)
    save_robot(tmp_path, users_robot)
    path = tmp_path / "robots" / f"{users_robot.key}.json"
    path.write_text(json.dumps(edited.robot.to_dict()))
    tasks, (error,) = tasks_on_stored_robots(tmp_path)
    assert tasks == ()
    assert isinstance(error, CorruptFileError)
    with pytest.raises(InputError, match="does not hold the robot"):
        with_stored_robots((), tmp_path)
