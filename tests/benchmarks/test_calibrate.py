"""castor-bench calibrate: logs in, a calibrated robot file out; every mistake is one line."""

import json
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest

from benchmarks import cli
from castor_envs.cli import command_line
from castor_envs.effects.dimensions import PivotBias, WheelRadius
from castor_envs.logs.csv import read_log, write_log
from castor_envs.logs.log import Log
from castor_envs.logs.recorder import RecordLog
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import pivoting, umbmark
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.axle import with_axle
from castor_envs.vehicles.load import load_robot
from castor_envs.vehicles.presets import differential, preset
from castor_envs.vehicles.robot import Gyro, RobotDescription
from estimators.calibration import likelihood_method

EFFECTS = (PivotBias(castor=2, value=0.05), WheelRadius(castor=3, wheel=1, value=0.03))


def call(capsys, *arguments):
    with pytest.raises(SystemExit) as ended:
        command_line.run(cli.app, ["calibrate", *map(str, arguments)])
    out, err = capsys.readouterr()
    return ended.value.code, out, err


@pytest.fixture(scope="module")
def logs(tmp_path_factory):
    """Logs of a base with two hidden effects that turns about castor 1, and about castor 2, both ways."""
    folder = tmp_path_factory.mktemp("turns")
    robot = preset("asoc-prototype").with_effects(*EFFECTS)
    paths = []
    for held in (1, 2):
        for way in ("cw", "ccw"):
            trajectory = pivoting(robot.castors[held - 1].pivot, way, angle=2.6 * np.pi, speed=0.5, acceleration=0.3)
            made = gym.make(
                "castor_envs:castor/ASOC-v1", robot=robot, trajectory=trajectory, control="voltage", held=held
            )
            env = RecordLog(made, folder / f"{held}-{way}")
            env.reset(seed=held)
            done = False
            while not done:
                _, _, terminated, truncated, _ = env.step(np.full(6, 0.15, dtype=np.float32))
                done = terminated or truncated
            paths.append(folder / f"{held}-{way}" / "episode-0000.csv")
    return paths


@pytest.mark.parametrize(("method", "tolerance"), [("pivoting", 0.007), ("maximum-likelihood", 0.002)])
def test_hidden_effects_are_found_and_the_file_is_written(method, tolerance, logs, tmp_path, capsys):
    """Wheels of a castor at one voltage work against each other: their slip costs eqs. 1-9 up to 0.7 % of a radius."""
    out = tmp_path / "calibrated.json"
    code, text, err = call(capsys, *logs, "--robot", "asoc-prototype", "--out", out, "--method", method, "--json")
    assert code == 0, err
    data = json.loads(text)
    assert data["format"] == "castor-calibration/1"
    found, described = RobotDescription.load(out), preset("asoc-prototype")
    assert found.effects == ()
    assert data["calibrated_hash"] == found.hash() != data["robot_hash"] == described.hash()
    true = described.with_effects(*EFFECTS).as_built()
    assert found.castors[1].pivot_zero == pytest.approx(0.05, abs=0.003)
    for castor, expected in zip(found.castors, true.castors, strict=True):
        assert castor.offset == pytest.approx(expected.offset, rel=0.005)
        for wheel, expected_wheel in zip(castor.wheels, expected.wheels, strict=True):
            assert wheel.radius == pytest.approx(expected_wheel.radius, rel=tolerance)
    rows = {row["name"]: row for row in data["parameters"]}
    assert rows["castor 3 left radius"]["after_m"] == found.castors[2].wheels[0].radius
    assert rows["castor 3 left radius"]["before_m"] == described.castors[2].wheels[0].radius
    assert 0 < rows["castor 2 pivot_zero"]["standard_error_rad"] < 0.001


def test_people_read_before_and_after(logs, tmp_path, capsys):
    code, text, _ = call(capsys, *logs, "--robot", "asoc-prototype", "--out", tmp_path / "new.json")
    assert code == 0
    assert "castor 2 pivot_zero" in text
    assert "72.0000" in text  # the offset before, mm
    assert "new.json: the calibrated robot" in text


def test_mistakes_are_one_line_and_nothing_is_written(logs, tmp_path, capsys):
    out, existing = tmp_path / "new.json", tmp_path / "there.json"
    existing.write_text("{}")
    robot_and_out = ["--robot", "asoc-prototype", "--out"]
    for arguments, said in (
        ([logs[0], *robot_and_out, out, "--method", "pivoting"], "record one counter-clockwise too"),
        ([logs[0], *robot_and_out, out, "--method", "pivotting"], "did you mean"),
        ([logs[0], *robot_and_out, out, "--method", "umbmark-correction"], "needs the --side"),
        ([logs[0], *robot_and_out, out, "--method", "pivoting", "--pivots"], "--pivots is for maximum likelihood"),
        ([logs[0], *robot_and_out, existing], "is there already"),
        ([logs[0], "--robot", "cfmmr-3", "--out", out], "is a train"),
        ([logs[0], "--robot", "differential", "--out", out], "has no castor 2; give the robot that made the log"),
        ([tmp_path / "gone.csv", *robot_and_out, out], "gone.csv: cannot be read"),
        ([*logs, *robot_and_out, tmp_path / "there.json" / "new.json"], "there.json"),
    ):
        code, _, err = call(capsys, *arguments)
        assert code == 2, err
        assert err.count("\n") == 1
        assert said in err
    assert not out.exists()
    assert existing.read_text() == "{}"


def test_times_in_milliseconds_are_refused(logs, tmp_path, capsys):
    """What castor-diagnose says of them."""
    robot = preset("asoc-prototype")
    log = read_log(logs[0], robot)
    write_log(tmp_path / "ms.csv", replace(log, t=1000 * log.t), robot)
    code, _, err = call(capsys, tmp_path / "ms.csv", "--robot", "asoc-prototype", "--out", tmp_path / "new.json")
    assert code == 2
    assert err.startswith(f"error: {tmp_path / 'ms.csv'}: t is in milliseconds, not in s: samples are ")
    assert not (tmp_path / "new.json").exists()


@pytest.fixture(scope="module")
def squares(tmp_path_factory):
    """Logs of a differential robot that drives squares, two each way; its wheel base is 1 % wider than described."""
    folder = tmp_path_factory.mktemp("squares")
    described = differential(counts_per_rev=20000.0)
    true = with_axle(described, 0.34 * 1.01, 0.15, 0.15)
    described.save(folder / "robot.json")
    paths = []
    for way in ("cw", "ccw"):
        rolled = roll(true, umbmark(way))
        for run in range(2):
            encoders = Encoders(Geometry.of(true), np.array([0.3, 0.7]) * run)
            path = folder / f"{way}-{run}.csv"
            write_log(
                path,
                Log(rolled.t, encoders.wheel(rolled.wheel_angle), np.empty((len(rolled.t), 0)), reference=rolled.pose),
                described,
            )
            paths.append(path)
    return folder / "robot.json", paths


def test_squares_tell_a_differential_robots_wheel_base(squares, tmp_path, capsys):
    robot, paths = squares
    out, picture = tmp_path / "new.json", tmp_path / "scatter.png"
    code, text, err = call(
        capsys, *paths, "--robot", robot, "--side", 1.5, "--out", out, "--scatter", picture, "--json"
    )
    assert code == 0, err
    rows = {row["name"]: row for row in json.loads(text)["parameters"]}
    assert rows["wheel base"]["before_m"] == pytest.approx(0.34)
    assert rows["wheel base"]["after_m"] == pytest.approx(0.34 * 1.01, rel=1e-3)
    assert rows["left diameter"]["after_m"] == pytest.approx(0.15, rel=1e-3)
    left, right = RobotDescription.load(out).castors[0].wheels
    assert left.lateral - right.lateral == rows["wheel base"]["after_m"]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_squares_that_cannot_be_used_are_refused(squares, logs, tmp_path, capsys):
    robot, paths = squares
    out = tmp_path / "new.json"
    for arguments, said in (
        ([*paths[:2], "--robot", robot, "--side", 1.5], "counter-clockwise"),
        ([paths[0], paths[2], "--robot", robot, "--side", 1.5], "at least 2 runs in each direction"),
        ([*paths, "--robot", robot, "--side", 0], "side"),
        ([*paths, "--robot", robot, "--method", "pivoting"], "one castor"),
        ([*paths, "--robot", robot, "--scatter", tmp_path / "a.png"], "give their --side"),
        ([*logs, "--robot", "asoc-prototype", "--side", 1.5], "not a differential robot"),
    ):
        code, _, err = call(capsys, *arguments, "--out", out)
        assert code == 2, err
        assert said in err
        assert not out.exists()


def test_the_log_that_is_wrong_is_named(squares, tmp_path, capsys):
    """A square that was not closed, and a gyro that turns the wrong way."""
    robot, paths = squares
    bad, turning = tmp_path / "bad.csv", tmp_path / "gyro.json"
    described = load_robot(str(robot))
    good = read_log(paths[-1], described)
    assert good.reference is not None
    poses = good.reference.copy()
    poses[-1, 0] += 1.0
    write_log(bad, replace(good, reference=poses), described)
    code, _, err = call(capsys, *paths[:3], bad, "--robot", robot, "--side", 1.5, "--out", tmp_path / "new.json")
    assert (code, err.startswith(f"error: {bad}: the square was not closed")) == (2, True)

    with_gyro = replace(described, gyro=Gyro(noise=0.002))
    with_gyro.save(turning)
    named = []
    for path, way in zip(paths, (1, 1, 1, -1), strict=True):
        log = read_log(path, described)
        assert log.reference is not None
        rate = way * np.diff(log.reference[:, 2], prepend=log.reference[0, 2]) / described.sample_period
        named.append(tmp_path / f"gyro-{path.name}")
        write_log(named[-1], replace(log, gyro=rate), with_gyro)
    code, _, err = call(capsys, *named, "--robot", turning, "--out", tmp_path / "new.json")
    assert (code, err) == (2, f"error: {named[-1]}: gyro_z turns against the wheels: change its sign\n")


def test_an_interval_names_the_unseen_change_that_it_rests_on(tmp_path, capsys):
    """Closed squares do not show the scale, nor where the tracked point is; both stand beside the intervals."""
    described = replace(differential(), sample_period=0.1)
    paths, random = [], np.random.default_rng(1)
    for way in ("cw", "ccw"):
        rolled = roll(with_axle(described, 0.34 * 1.01, 0.15, 0.1495), umbmark(way, side=1.0))
        ends = np.full_like(rolled.pose, np.nan)
        ends[[0, -1]] = rolled.pose[[0, -1]] + random.normal(size=(2, 3)) * [1e-3, 1e-3, 2e-3]
        counts = Encoders(Geometry.of(described), np.zeros(2)).wheel(rolled.wheel_angle)
        paths.append(tmp_path / f"{way}.csv")
        write_log(paths[-1], Log(rolled.t, counts, np.empty((len(rolled.t), 0)), reference=ends), described)
    described.save(tmp_path / "robot.json")
    code, text, err = call(capsys, *paths, "--robot", tmp_path / "robot.json", "--out", tmp_path / "new.json")
    assert code == 0, err
    lines = text.splitlines()
    (scale,) = [line for line in lines if "not seen: the scale (all lengths together)" in line]
    assert scale.startswith("(a) ")
    radii = [line for line in lines if " radius " in line]
    assert len(radii) == 2
    assert all("(a)" in line for line in radii)
    assert any("with a letter: if what it stands for is right in the robot file" in line for line in lines)
    assert any(line.startswith("reference: tracked point at x ") and " ± " in line for line in lines)


def test_what_rounds_to_zero_has_no_sign(squares, tmp_path, capsys, monkeypatch):
    robot, paths = squares
    fit = likelihood_method.calibrate

    def barely_off(*given, **named):
        found = fit(*given, **named)
        return replace(found, mount=np.full(3, -1e-7), clocks=np.full_like(found.clocks, -1e-7))

    monkeypatch.setattr(likelihood_method, "calibrate", barely_off)
    code, text, err = call(capsys, *paths, "--robot", robot, "--out", tmp_path / "new.json")
    assert code == 0, err
    assert "tracked point at x 0.0 ± " in text
    assert "y 0.0 ± " in text
    assert "turned by 0.00 ± " in text
    assert text.count("gains 0.0 ms/s") == len(paths)


def test_what_cannot_be_written_is_told_before_logs_are_read(tmp_path, capsys):
    (tmp_path / "file").write_text("")
    at, beside = tmp_path / "file" / "new.json", tmp_path / "new.json"
    for options in (("--out", at), ("--out", beside, "--scatter", tmp_path / "file" / "new.png", "--side", 1.5)):
        code, _, err = call(capsys, "gone.csv", "--robot", "differential", *options)
        assert (code, "cannot be written to" in err, "gone.csv" in err) == (2, True, False)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


METHODS = """
import os, sys, time
from castor_envs.errors import Declined
from castor_envs.vehicles.presets import preset
from estimators.calibration.protocol import Report, Result
print("loaded")

class Same:
    def calibrate(self, robot, recordings):
        print("calibrating")
        return robot

class Other(Same):
    def calibrate(self, robot, recordings):
        return preset("asoc-prototype")

class Nothing(Same):
    def calibrate(self, robot, recordings):
        return None

class Raises(Same):
    def calibrate(self, robot, recordings):
        return 1 / 0

class Refuses(Same):
    def calibrate(self, robot, recordings):
        raise Declined("needs six legs")

class Exits(Same):
    def calibrate(self, robot, recordings):
        raise SystemExit(0)

class Dies(Same):
    def calibrate(self, robot, recordings):
        os._exit(0)

class Spoils(Same):
    def calibrate(self, robot, recordings):
        object.__setattr__(robot, "sample_period", 7.0)
        return robot

class Reports(Same):
    title, takes_squares, finds_pivots = "a report", False, False
    unit = "m"

    def report(self, robot, recordings):
        class Mine(str): ...
        return Report((Result("wheel base", self.unit, 0.34, 0.35, 0.001),), robot, remarks=(Mine("so it is"),))

class Unshowable(Reports):
    unit = "furlong"
"""


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("Other", "returned a robot of another layout: wheels of its castors"),
        ("Nothing", "returned NoneType instead of a RobotDescription"),
        ("Raises", "raised ZeroDivisionError: division by zero in calibrate"),
        ("Refuses", "declined: needs six legs"),
        ("Exits", "raised SystemExit: 0 in calibrate"),
        ("Dies", "ended its process (exit code 0)"),
        ("Spoils", "returned a robot of another layout: sample_period is 7.0"),
        ("Unshowable", "returned a report that cannot be shown: ValueError: wheel base: unit 'furlong'"),
    ],
)
def test_what_is_wrong_with_a_method_of_others_is_one_line(squares, tmp_path, capsys, name, said):
    robot, paths = squares
    (tmp_path / "mine.py").write_text(METHODS)
    method, out = f"{tmp_path / 'mine.py'}:{name}", tmp_path / "new.json"
    code, text, err = call(capsys, *paths, "--robot", robot, "--method", method, "--out", out)
    assert (code, text, out.exists()) == (2, "", False)
    assert err.startswith(f"error: calibration method 'mine:{name}' {said}"), err
    assert err.count("\n") == 1


@pytest.mark.parametrize(("name", "rows"), [("Same", 3), ("Reports", 1)])
def test_a_method_of_others_prints_nothing_into_the_report(squares, tmp_path, capfd, name, rows):
    robot, paths = squares
    (tmp_path / "mine.py").write_text(METHODS)
    method, out = f"{tmp_path / 'mine.py'}:{name}", tmp_path / "new.json"
    code, text, err = call(capfd, *paths, "--robot", robot, "--method", method, "--out", out, "--json")
    assert (code, err) == (0, "")
    assert len(json.loads(text)["parameters"]) >= rows
    assert RobotDescription.load(out).hash() == load_robot(str(robot)).hash()
