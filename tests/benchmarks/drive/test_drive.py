"""A drive by hand, without a screen: keys, the robot, estimators, the window with events put in, and the log."""

import dataclasses
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from gymnasium.error import DependencyNotInstalled

from benchmarks import cli
from benchmarks.drive import command, window
from benchmarks.drive.command import hand_driven
from benchmarks.drive.follower import Follower
from benchmarks.drive.keys import Keyboard
from benchmarks.drive.train import DrawnPath
from benchmarks.drive.window import DriveWindow
from castor_envs.cli import command_line
from castor_envs.errors import InputError
from castor_envs.floor import Floor, Patch
from castor_envs.logs.csv import read_log
from castor_envs.logs.recorder import RecordLog
from castor_envs.rendering.drawing.canvas import import_pygame
from castor_envs.vehicles.load import load_robot, load_vehicle
from castor_envs.vehicles.presets import preset
from estimators.plugins.registry import load_estimator

SHOWING = ("DISPLAY", "WAYLAND_DISPLAY", "XDG_RUNTIME_DIR", "SDL_VIDEODRIVER")
"""Variables that name a display, or a driver that needs none."""


@pytest.fixture
def pygame(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(window, "SIZE", (300, 300))  # large pictures take long
    try:
        found = import_pygame()
    except DependencyNotInstalled:
        pytest.skip("pygame is not installed")
    found.display.quit()
    yield found
    found.display.quit()


@pytest.fixture
def scripted(pygame):
    """Return a function that makes a source of events from {picture: ["+w", "-w", "quit", "away"]}."""

    def event(word):
        if word == "quit":
            return pygame.event.Event(pygame.QUIT)
        if word == "away":
            return pygame.event.Event(pygame.WINDOWFOCUSLOST)
        kind = pygame.KEYDOWN if word[0] == "+" else pygame.KEYUP
        return pygame.event.Event(kind, key=pygame.key.key_code(word[1:]))

    def make(script):
        pictures = iter(range(10**6))
        return lambda: [event(word) for word in script.get(next(pictures), [])]

    return make


def held(sideways, *keys):
    keyboard = Keyboard(sideways)
    for key in keys:
        keyboard.press(key)
    return keyboard.wish.tolist()


def reference_of(log):
    assert log.reference is not None
    return log.reference


def test_keys_say_where_to_go():
    assert held(True, "w") == held(True, "up") == [1, 0, 0]
    assert held(True, "s", "a", "e") == [-1, 1, -1]
    assert held(True, "w", "s", "q", "left") == [0, 0, 1]
    assert held(True, "x", "space") == [0, 0, 0]


def test_a_robot_that_cannot_move_sideways_turns_instead():
    assert held(False, "a") == held(False, "left") == held(False, "q", "a") == [0, 0, 1]
    assert held(False, "d", "w") == [1, 0, -1]
    assert "sideways" in Keyboard(True).legend
    assert "sideways" not in Keyboard(False).legend


def test_keys_that_come_up_are_up():
    keyboard = Keyboard(True)
    keyboard.press("w")
    keyboard.press("q")
    keyboard.release("w")
    assert keyboard.wish.tolist() == [0, 0, 1]
    keyboard.release_all()
    assert keyboard.wish.tolist() == [0, 0, 0]


def driven(robot, wish, seconds=2.0):
    env = hand_driven(load_vehicle(robot))
    _, info = env.reset(seed=0)
    for _ in range(round(seconds / env.vehicle.sample_period)):
        *_, info = env.step(wish)
    return env, info


@pytest.mark.parametrize("robot", ["asoc-prototype", "differential", "tricycle", "swerve", "omni3"])
def test_robots_go_where_they_are_wished(robot):
    env, info = driven(robot, (1, 0, 0))
    x, y, psi = env.pose
    # With a ramp of half a second, a quarter of a second's way is missing.
    assert x == pytest.approx(1.75 * env.limits[0], rel=0.05)
    assert (y, psi) == pytest.approx((0, 0), abs=0.03)
    assert np.all(np.abs(info["command"]) <= load_robot(robot).max_wheel_speed)
    _, _, turned = driven(robot, (0, 0, 1))[0].pose
    assert turned > 0.5 * 1.75 * env.limits[2]


def test_sideways_moves_those_that_can():
    assert driven("asoc-prototype", (0, 1, 0))[0].pose[1] > 0.5
    np.testing.assert_allclose(driven("differential", (0, 1, 0))[0].pose, 0, atol=1e-6)


def test_a_stop_is_at_once():
    env, _ = driven("omni3", (1, 0, 0))
    before = env.pose[0]
    env.stop()
    for _ in range(40):
        env.step((0, 0, 0))
    assert 0 <= env.pose[0] - before < 0.5 * 0.6 * 0.5  # less than half of what the ramp would take


def test_a_robot_that_cannot_move_is_refused():
    robot = preset("differential")
    axles = [((0.3, 0.0), 0.0), ((-0.3, 0.3), 1.0), ((-0.3, -0.3), 2.0)]
    castors = [dataclasses.replace(robot.castors[0], pivot=pivot, angle=angle) for pivot, angle in axles]
    with pytest.raises(InputError, match="its fixed wheels hold it"):
        hand_driven(dataclasses.replace(robot, castors=tuple(castors)))


def test_a_train_is_drawn_along_the_path_of_the_axle_that_leads():
    env, _ = driven("cfmmr-3", (1, 0, 1), seconds=6.0)
    speed, _, curvature = env.limits
    # The front axle has turned by its way times the curvature, less what the ramps of half a second take.
    assert env.pose[0, 2] == pytest.approx(5.5 * speed * curvature, rel=0.05)
    assert np.all(np.diff(env.pose[:, 2]) < 0)  # those behind turn later
    bend = np.abs(np.diff(env.pose[:, 2]))
    np.testing.assert_allclose(bend, curvature * 0.35, atol=0.05)  # on a circle by now, 0.35 m from axle to axle


def test_a_train_backs_with_its_last_axle_ahead_and_turns_the_other_way():
    env, _ = driven("cfmmr-3", (-1, 0, 1), seconds=4.0)
    assert env.pose[-1, 0] < -0.7 - 0.5  # where it stood, and on
    assert env.pose[-1, 2] < -0.5
    assert np.all(np.diff(env.pose[:, 2]) < 0)  # the last has turned most
    straight, _ = driven("cfmmr-2", (-1, 0, 0), seconds=3.0)
    np.testing.assert_allclose(straight.pose[:, 1:], 0, atol=0.03)  # sensors are noisy


def test_a_train_at_rest_does_not_turn():
    env, _ = driven("cfmmr-2", (0, 0, 1))
    np.testing.assert_allclose(env.pose, [[0, 0, 0], [-0.35, 0, 0]], atol=1e-4)


def test_a_drawn_path_is_the_arcs_that_were_driven():
    path = DrawnPath(0.7)
    for _ in range(40):
        path.go(0.025, 2.0)
    front, middle, last = path.behind_front(np.array([0.0, 0.3, 0.7]))
    for pose, turned in ((front, 2.0), (middle, 1.4), (last, 0.6)):  # arcs of radius 0.5 from the origin
        expected = [0.5 * np.sin(turned), 0.5 * (1 - np.cos(turned)), turned]
        np.testing.assert_allclose(pose, expected, atol=2e-4)


def test_a_drawn_path_is_left_as_it_was_by_going_forth_and_back():
    path = DrawnPath(0.5)
    for _ in range(30):
        path.go(0.02, 1.0)
    before = path.behind_front(np.linspace(0, 0.5, 11))
    for curvature in (1.0, 1.0):  # the arc goes on at both ends
        path.go(0.1, curvature)
        path.go(-0.1, curvature)
    np.testing.assert_allclose(path.behind_front(np.linspace(0, 0.5, 11)), before, atol=2e-3)


@pytest.fixture
def ride(scripted, tmp_path, monkeypatch):
    """Return a function that drives by a script, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def run(script, robot="asoc-prototype", estimators=("cast-0",), floor=None, record=None, seed=1):
        command.drive(robot, floor, estimators, record, seed, 100.0, scripted(script), real_time=False)

    return run


def test_a_drive_becomes_a_log_and_scores(ride, tmp_path, capsys):
    floor = Floor(patches=(Patch(center=(0.6, 0.0), size=(0.2, 0.2), friction=0.3),))
    floor.save("wet.json")
    ride({0: ["+w"], 20: ["+q"], 40: ["-w"], 60: ["quit"]}, floor="wet.json", record=tmp_path / "runs" / "mine.csv")
    robot = load_vehicle("runs/robot.json")
    log = read_log("runs/mine.csv", robot)
    assert robot == preset("asoc-prototype")
    assert Floor.load("runs/mine-floor.json") == floor
    assert len(log) == 61
    assert reference_of(log)[-1, 0] > 0.5
    assert reference_of(log)[-1, 2] > 0.5
    assert log.command is not None
    assert np.all(log.command[0] != 0)
    told = capsys.readouterr().out
    assert "m in 3.0 s" in told
    names = ("mine.csv", "robot.json", "mine-floor.json")
    assert f"written: {', '.join(str(tmp_path / 'runs' / name) for name in names)}\n" in told
    # What the estimator said during the drive is what it says of the log.
    estimator = load_estimator("cast-0").factory()
    estimator.reset(robot, reference_of(log)[0])
    poses = np.array([estimator.update(sample) for sample in log.observations()])
    off = 1e3 * np.hypot(*(poses[-1] - reference_of(log)[-1])[:2])
    assert f"cast-0: end point {off:#.4g} mm" in told


def test_a_train_can_be_driven_and_recorded(ride, tmp_path, capsys):
    ride({0: ["+w"], 20: ["+q"], 60: ["quit"]}, robot="cfmmr-2", estimators=(), record=tmp_path / "log.csv")
    train = load_vehicle("train.json")
    log = read_log("log.csv", train)
    assert reference_of(log).shape == (61, 6)
    assert reference_of(log)[-1, 0] > 0.5
    told = capsys.readouterr().out
    off = np.zeros((2, 3))
    estimator = load_estimator("train-odometry").factory()
    estimator.reset(train, reference_of(log)[0].reshape(2, 3))
    for sample, reference in zip(log.observations(), reference_of(log), strict=True):
        off = estimator.update(sample) - reference.reshape(2, 3)
    assert "m in 3.0 s" in told
    assert f"train-odometry: final axle position {1e3 * np.mean(np.hypot(*off[:, :2].T)):.4g} mm" in told


def test_the_same_keys_and_seed_make_the_same_drive(ride, tmp_path):
    for name in ("a", "b"):
        ride({0: ["+w"], 10: ["+d"], 20: ["quit"]}, record=tmp_path / name / "log.csv")
    assert (tmp_path / "a" / "log.csv").read_bytes() == (tmp_path / "b" / "log.csv").read_bytes()


def test_a_lost_keyboard_stops_the_robot(ride, tmp_path):
    ride({0: ["+w"], 10: ["away"], 60: ["quit"]}, record=tmp_path / "log.csv")
    x = reference_of(read_log("log.csv", preset("asoc-prototype")))[:, 0]
    assert x[10] < x[20]
    assert x[-1] == pytest.approx(x[-10], abs=1e-4)


def test_an_estimator_that_fails_ends_alone(ride, tmp_path, capsys):
    (tmp_path / "lost.py").write_text(
        "import numpy as np\n\n\nclass Lost:\n    def reset(self, robot, pose):\n        self.left = 3\n\n"
        "    def update(self, observation):\n        self.left -= 1\n        if self.left < 0:\n"
        "            raise RuntimeError('no idea')\n        return np.zeros(3)\n"
    )
    ride({0: ["+w"], 10: ["quit"]}, estimators=("lost.py", "dead-reckoning-1"))
    told = capsys.readouterr().out
    assert "lost:Lost: failed (RuntimeError: no idea)" in told
    assert "dead-reckoning-1: end point" in told


@pytest.mark.parametrize(
    ("answer", "problem"),
    [
        ("None", "update returns None"),
        ("np.zeros(2)", "what update returns must have shape"),
        ("exit(3)", "SystemExit"),
    ],
)
def test_an_estimator_that_misbehaves_ends_alone(ride, tmp_path, capsys, answer, problem):
    (tmp_path / "bad.py").write_text(
        "import numpy as np\n\n\nclass Bad:\n    def reset(self, robot, pose):\n        pass\n\n"
        f"    def update(self, observation):\n        return {answer}\n"
    )
    ride({0: ["+w"], 5: ["quit"]}, estimators=("bad.py",))
    told = capsys.readouterr().out
    assert "bad:Bad: failed (" in told
    assert problem in told


def test_the_window_shows_truth_and_estimates_and_zooms_out(pygame, scripted, monkeypatch):
    monkeypatch.setattr(window, "SHOWN", 0.5)
    env = hand_driven(preset("differential"))
    recorder = RecordLog(env)
    observation, info = recorder.reset(seed=0)
    followers = [
        Follower(load_estimator(spec), env.vehicle, info["pose"], observation)
        for spec in ("wheel-odometry", "dead-reckoning-1")
    ]
    pictures = []

    class Watched(DriveWindow):
        def _draw(self):
            super()._draw()
            pictures.append(self.picture())

    shown = Watched(env, recorder, followers, "test")
    before = shown._arena()
    shown.run(1.5, scripted({0: ["+w"]}), real_time=False)
    first, last = pictures[0], pictures[-1]
    assert first.shape == (*window.SIZE[::-1], 3)
    assert np.any(first != last)
    assert shown._arena()[1] == 2 * before[1]
    assert env.pose[0] < shown._arena()[1]
    # Where the robot stands now something is drawn, in the place that the view says.
    column, row = np.rint(shown._renderer.view.pixel(env.pose[:2])).astype(int)
    around = last[row - 5 : row + 6, column - 5 : column + 6].astype(int)
    assert np.ptp(around) > 100


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"record": "log.txt"}, "logs end in .csv"),
        ({"record": "here.csv"}, "is there already; name a new file"),
        ({"record": "other/log.csv"}, "is another robot; name a new folder"),
        ({"robot": "cfmmr-3", "estimators": ("cast-0",)}, "does not serve"),
        ({"estimators": ("grpec-xy",)}, "does not serve"),
        ({"estimators": ("nothing",)}, "unknown estimator 'nothing'"),
        ({"floor": "none.json"}, "none.json: cannot be read"),
    ],
)
def test_mistakes_are_told_before_the_drive(ride, tmp_path, arguments, message):
    (tmp_path / "here.csv").write_text("")
    preset("swerve").save(tmp_path / "other" / "robot.json")
    if "record" in arguments:
        arguments = {"record": tmp_path / arguments["record"]}
    with pytest.raises(InputError, match=message):
        ride({0: ["quit"]}, **arguments)


WET = Floor(patches=(Patch(center=(0.0, 0.0), size=(1.0, 1.0), friction=0.1),))


@pytest.mark.parametrize("floor", ["slippery", None])
def test_a_floor_file_that_is_there_is_no_other_floor_than_that_of_the_log(ride, tmp_path, floor):
    """It is the user's own; and beside a log on an even floor it would say what was not driven on."""
    WET.save("trip-floor.json")
    before = Path("trip-floor.json").read_bytes()
    with pytest.raises(InputError, match=r"trip-floor\.json is another floor; name a new file"):
        ride({0: ["+w"], 10: ["quit"]}, floor=floor, record=tmp_path / "trip.csv")
    assert Path("trip-floor.json").read_bytes() == before
    assert not Path("trip.csv").exists()


def test_the_floor_file_that_was_driven_on_may_be_that_of_the_log(ride, tmp_path):
    Path("trip-floor.json").write_text(json.dumps(WET.to_dict()))
    before = Path("trip-floor.json").read_bytes()
    ride({0: ["+w"], 10: ["quit"]}, floor="trip-floor.json", record=tmp_path / "trip.csv")
    assert Path("trip-floor.json").read_bytes() == before
    assert Path("trip.csv").exists()


def test_nothing_driven_writes_nothing(ride, tmp_path, capsys):
    ride({0: ["quit"]}, record=tmp_path / "log.csv")
    assert "nothing was driven" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []


def test_the_command_ends_by_itself(pygame, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as leaving:
        command_line.run(cli.app, ["drive", "--robot", "omni3", "--duration", "0.2", "--record", "log.csv"])
    assert leaving.value.code in (0, None)
    assert "written: log.csv, robot.json" in capsys.readouterr().out
    assert len(read_log("log.csv", load_vehicle("robot.json"))) == 5


@pytest.mark.skipif(sys.platform != "linux", reason="other systems need no variable for a window")
def test_without_a_display_the_drive_does_not_begin():
    pytest.importorskip("pygame")
    kept = {name: value for name, value in os.environ.items() if name not in SHOWING}
    command = [sys.executable, "-m", "benchmarks", "drive", "--robot", "omni3", "--duration", "0.2"]
    done = subprocess.run(command, capture_output=True, text=True, env=kept, timeout=300)
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1].startswith("error: castor-bench drive found no display for its window")
    assert done.stdout == ""
