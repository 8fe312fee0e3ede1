"""castor-diagnose inspect: what it prints, and that every mistake is one line and exit code 2."""

import dataclasses
import json
import os
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from castor_envs.cli import command_line
from castor_envs.logs.csv import write_log
from castor_envs.logs.log import Log
from castor_envs.logs.reference import FARTHEST
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import umbmark
from castor_envs.vehicles.presets import cfmmr, preset
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel
from discrepancy import cli


@pytest.fixture
def log(tmp_path):
    """A differential robot's log: the left wheel turns, the right one stands."""
    n = 11
    wheel = np.column_stack([np.arange(n) * 20.0, np.zeros(n)])
    reference = np.full((n, 3), np.nan)
    reference[::5] = 0.0
    note = {"note": ["x"] * n}
    made = Log(np.arange(n) * 0.1, wheel, np.empty((n, 0)), reference=reference, extra=note)
    write_log(tmp_path / "log.csv", made, preset("differential"))
    return tmp_path / "log.csv"


def diagnose(capsys, monkeypatch, *arguments):
    """Run the command; return exit code, stdout, stderr."""
    monkeypatch.setattr(sys, "argv", ["castor-diagnose", *map(str, arguments)])
    with pytest.raises(SystemExit) as left:
        command_line.run(cli.app)
    return left.value.code, *capsys.readouterr()


def test_inspect_prints_json_with_what_the_log_shows(capsys, monkeypatch, log):
    code, out, err = diagnose(capsys, monkeypatch, "inspect", log, log, "--robot", "differential", "--json")
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert found["format"] == "castor-inspect/1"
    assert found["robot"]["hash"] == preset("differential").hash()
    (entry,) = found["logs"]
    assert entry["path"] == str(log)
    assert (entry["rows"], entry["reference_rows"], entry["commands"]) == (11, 3, False)
    assert entry["duration"] == pytest.approx(1.0)
    assert entry["sample_period"]["median"] == pytest.approx(0.1)
    assert entry["sample_period"]["declared"] == 0.05
    assert (entry["constant"], entry["unknown_columns"]) == (["wheel_1r"], ["note"])
    left = entry["channels"][0]
    assert (left["name"], left["smallest"], left["largest"], left["largest_step"]) == ("wheel_1l", 0, 200, 20)
    assert left["at_most"] == pytest.approx(15.0 * 0.1 * 2000 / (2 * np.pi))
    assert entry["parity"]["redundancy"] == 0
    assert "nothing is observable without reference poses" in entry["parity"]["note"]


def test_inspect_shows_how_long_an_encoder_stands_while_another_turns(capsys, monkeypatch, tmp_path):
    """One wheel stops for 0.3 s, and goes on, then the robot stands for a second, which is no fault."""
    right = np.concatenate([np.arange(5), np.full(3, 4), np.arange(8, 12), np.full(10, 11)])
    left = np.concatenate([np.arange(12), np.full(10, 11)])
    wheel = 20.0 * np.column_stack([left, right])
    write_log(tmp_path / "log.csv", Log(np.arange(22) * 0.1, wheel, np.empty((22, 0))), preset("differential"))
    code, out, _ = diagnose(capsys, monkeypatch, "inspect", tmp_path / "log.csv", "--robot", "differential", "--json")
    assert code == 0
    (entry,) = json.loads(out)["logs"]
    assert [channel["still"] for channel in entry["channels"]] == pytest.approx([0.0, 0.3])


def test_inspect_says_so_where_nothing_can_be_seen(capsys, monkeypatch, log):
    code, out, _ = diagnose(capsys, monkeypatch, "inspect", log, "--robot", "differential")
    assert code == 0
    assert "11 rows, 1 s" in out
    assert "never change: wheel_1r" in out
    assert "nothing is observable without reference poses" in out


def test_inspect_shows_the_residual_of_a_robot_with_redundancy(capsys, monkeypatch, tmp_path):
    """All castors abreast and straight ahead; one wheel rolls further than any rigid body lets it."""
    robot, n = preset("asoc-prototype"), 21
    wheel = np.outer(np.arange(n) * 60.0, [1, 1, 1, 1, 1, 1.1])
    write_log(tmp_path / "log.csv", Log(np.arange(n) * 0.05, wheel, np.zeros((n, 3))), robot)
    robot.save(tmp_path / "robot.json")
    arguments = ("inspect", tmp_path / "log.csv", "--robot", tmp_path / "robot.json")
    code, out, _ = diagnose(capsys, monkeypatch, *arguments, "--json")
    assert code == 0
    (entry,) = json.loads(out)["logs"]
    ratio = {row["name"]: row["rms_mm"] / row["rounding_mm"] for row in entry["parity"]["rolling"]}
    assert max(ratio, key=lambda name: ratio[name]) == "wheel_3r"
    assert ratio["wheel_3r"] > 5
    assert all(row["ratio"] == pytest.approx(ratio[row["name"]], rel=1e-2) for row in entry["parity"]["rolling"])
    assert entry["parity"]["verdict"].startswith("castor 3 contradicts this robot file (up to ")
    assert {row["name"] for row in entry["parity"]["side_slip"]} == {"castor_1", "castor_2", "castor_3"}
    assert entry["parity"]["note"] is None
    code, out, _ = diagnose(capsys, monkeypatch, *arguments)
    assert code == 0
    assert "wheel_3r rolling" in out
    assert "castor_3 side slip" in out
    assert f"verdict: {entry['parity']['verdict']}\n" in out


MISTAKES = [
    (["inspect", "gone.csv", "--robot", "differential"], "gone.csv: cannot be read (No such file or directory)"),
    (["inspect", "log.csv", "gone.csv", "--robot", "differential"], "gone.csv: cannot be read"),
    (
        ["inspect", "log.csv", "--robot", "diferential"],
        "unknown robot or train 'diferential'; did you mean 'differential'?",
    ),
    (["inspect", "log.csv", "--robot", "gone.json"], "gone.json: cannot be read"),
    (["inspect", "log.csv", "--robot", "asoc-prototype"], "log.csv:1: column 'wheel_2l': is missing"),
    (["inspect", "log.csv"], "log.csv: has no robot.json beside it; name the robot with --robot"),
    (["inspect", "gone.csv"], "gone.csv: cannot be read (No such file or directory)"),
    (["inspect", "empty"], "empty: is a folder without logs (*.csv)"),
    (["inspect", "bag", "--robot", "differential"], "bag: is a recording, ROS bag"),
    (["inspect", "bag/run.mcap", "--robot", "differential"], "not a log; castor-bench import makes a log of it"),
    (["inspect", "--robot", "differential"], "logs"),
    (["inspekt", "log.csv"], "inspekt"),
    (
        ["log.csv", "--robot", "differential", "--holdout", "./log.csv"],
        "log.csv: is given twice, as a log and as --holdout; give it once",
    ),
    (["find", "log.csv", ".", "--robot", "differential"], "log.csv: is given twice, as a log and as a log"),
    (["inspect", "log.csv", "--robot", "differential", "--jason"], "--jason"),
]


@pytest.mark.parametrize(("arguments", "message"), MISTAKES)
def test_a_mistake_is_one_line_on_stderr_and_exit_code_2(capsys, monkeypatch, log, arguments, message):
    monkeypatch.chdir(log.parent)
    Path("empty").mkdir()
    Path("bag").mkdir()
    Path("bag/run.mcap").touch()
    code, out, err = diagnose(capsys, monkeypatch, *arguments)
    assert code == 2
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("error: ")
    assert message in err
    assert sorted(path.name for path in log.parent.iterdir()) == ["bag", "empty", "log.csv"]


def test_a_folder_that_holds_its_own_discrepancy_does_not_shadow_ours(log):
    (log.parent / "discrepancy").mkdir()
    (log.parent / "discrepancy" / "__init__.py").write_text("raise SystemExit('shadowed')")
    command = [sys.executable, "-P", "-c", "from discrepancy.cli import main; main()", "inspect", "log.csv"]
    path = os.pathsep.join(sys.path)
    done = subprocess.run(
        [*command, "--robot", "differential"],
        cwd=log.parent,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )
    assert done.returncode == 0, done.stderr


def test_no_arguments_show_the_help_and_nothing_else(capsys, monkeypatch):
    code, out, err = diagnose(capsys, monkeypatch)
    assert (code, err) == (2, "")
    assert out.count("Usage: ") == 1
    assert "inspect" in out
    _, help_text, _ = diagnose(capsys, monkeypatch, "--help")
    assert out.split() == str(help_text).split()


def test_version(capsys, monkeypatch):
    assert diagnose(capsys, monkeypatch, "--version")[:2] == (0, f"castor-envs {version('castor-envs')}\n")


def test_a_folder_means_its_logs_and_the_robot_beside_them(capsys, monkeypatch, log):
    (log.parent / "second.csv").write_bytes(log.read_bytes())
    robot = dataclasses.replace(preset("differential"), name="mine")
    robot.save(log.parent / "robot.json")
    code, out, err = diagnose(capsys, monkeypatch, "inspect", log.parent, "--json")
    assert (code, err) == (0, "")
    found = json.loads(out)
    assert found["robot"]["name"] == "mine"
    assert [entry["path"] for entry in found["logs"]] == [str(log), str(log.parent / "second.csv")]
    monkeypatch.chdir(log.parent)
    assert json.loads(str(diagnose(capsys, monkeypatch, "inspect", "log.csv", "--json")[1]))["robot"] == found["robot"]


def test_logs_beside_different_robots_are_refused(capsys, monkeypatch, log):
    other = log.parent / "other"
    other.mkdir()
    (other / "log.csv").write_bytes(log.read_bytes())
    preset("differential").save(log.parent / "robot.json")
    preset("differential").save(other / "robot.json")
    assert diagnose(capsys, monkeypatch, "inspect", log, other)[0] == 0
    dataclasses.replace(preset("differential"), sample_period=0.1).save(other / "robot.json")
    code, out, err = diagnose(capsys, monkeypatch, "inspect", log, other)
    assert (code, out) == (2, "")
    assert "are different robots" in err


def test_a_robot_file_is_no_log(capsys, monkeypatch, log):
    preset("differential").save(log.parent / "robot.json")
    code, out, err = diagnose(capsys, monkeypatch, "inspect", log.parent / "robot.json")
    assert (code, out) == (2, "")
    assert "robot.json: is a robot file, not a log" in err


def test_times_are_rounded(capsys, monkeypatch, log):
    """Eleven samples of a tenth of a second, from a start that no float holds."""
    lines = log.read_text().splitlines()
    moved = [lines[0], *(f"{32.1 + k / 10!r},{line.partition(',')[2]}" for k, line in enumerate(lines[1:]))]
    log.write_text("\n".join(moved))
    _, out, _ = diagnose(capsys, monkeypatch, "inspect", log, "--robot", "differential", "--json")
    (entry,) = json.loads(out)["logs"]
    assert entry["duration"] == 1.0
    assert {entry["sample_period"][key] for key in ("median", "smallest", "largest")} == {0.1}


def test_pivots_without_a_limit_show_a_dash(capsys, monkeypatch, tmp_path):
    robot, n = preset("asoc-prototype"), 21
    wheel = np.outer(np.arange(n) * 60.0, np.ones(6))
    write_log(tmp_path / "log.csv", Log(np.arange(n) * 0.05, wheel, np.zeros((n, 3))), robot)
    _, out, _ = diagnose(capsys, monkeypatch, "inspect", tmp_path / "log.csv", "--robot", "asoc-prototype")
    (line,) = (line for line in out.splitlines() if line.startswith("pivot_1") or line.startswith(" pivot_1"))
    assert line.split()[-2] == "-"
    assert "verdict: consistent with rounding" in out


def test_trains_are_refused_by_name(tmp_path, capsys):
    log = tmp_path / "log.csv"
    log.write_text("t,wheel_1l\n0,0\n1,1\n")
    train = tmp_path / "train.json"
    cfmmr(2).save(train)
    for arguments in ([str(log), "--robot", str(train)], [str(log), "--robot", "cfmmr-3"], [str(log)]):
        with pytest.raises(SystemExit) as ended:
            command_line.run(cli.app, ["inspect", *arguments])
        assert ended.value.code == 2
        assert "is a train; castor-diagnose inspect serves single robots" in capsys.readouterr().err


ONE_WHEEL = RobotDescription(
    name="one wheel", castors=(Castor(pivot=(0.0, 0.0), offset=0.05, wheels=(Wheel(radius=0.05),)),)
)


@pytest.mark.parametrize("taken", [False, True])
def test_a_robot_without_any_redundancy_is_inspected_for_what_there_is(capsys, monkeypatch, tmp_path, taken):
    """One driven wheel on one castor whose angle nobody knows: no row of rolling can be used."""
    n = 50
    reference = np.column_stack([np.arange(n) * 0.01, np.zeros(n), np.zeros(n)]) if taken else None
    log = Log(np.arange(n) * 0.05, np.arange(n)[:, None] * 20.0, np.empty((n, 0)), reference=reference)
    write_log(tmp_path / "log.csv", log, ONE_WHEEL)
    ONE_WHEEL.save(tmp_path / "robot.json")
    code, out, err = diagnose(capsys, monkeypatch, "inspect", tmp_path / "log.csv", "--json")
    assert (code, err) == (0, "")
    (entry,) = json.loads(out)["logs"]
    assert entry["parity"]["redundancy"] == 0
    assert "cannot contradict each other (no redundancy)" in entry["parity"]["note"]
    assert (entry["reference"] is not None) == taken
    if taken:
        assert entry["reference"][0] | {"whole": None} == {
            **{"name": "ref_x", "unit": "m", "smallest": 0.0, "largest": 0.49, "largest_step": 0.01},
            **{"at_most": None, "still": None, "whole": None},
        }
    code, out, _ = diagnose(capsys, monkeypatch, "inspect", tmp_path / "log.csv")
    assert code == 0
    assert ("ref_psi" in out) == taken
    code, out, err = diagnose(capsys, monkeypatch, tmp_path / "log.csv")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "the encoders of robot 'one wheel' do not determine its motion" in err


def driven(n=60, **changes):
    """A log of a differential robot on an arc, with reference poses; parts replaced."""
    t = np.arange(n) * 0.05
    wheel = np.round(np.outer(np.arange(n), [40.0, 60.0]))
    reference = np.column_stack([0.3 * t, 0.02 * t, 0.1 * t])
    return dataclasses.replace(Log(t, wheel, np.empty((n, 0)), reference=reference), **changes)


def once(values, value):
    """An array with its entry half-way, in the first column, replaced."""
    values = np.array(values)
    values[len(values) // 2, 0] = value
    return values


ARC = driven()
REFUSED = {
    "still": (driven(wheel=np.zeros((60, 2)), reference=np.zeros((60, 3))), "shows no motion: no encoder count"),
    "still, pushed": (driven(wheel=np.zeros((60, 2))), "its encoders are not connected"),
    "two rows": (driven(2), "has 2 rows; a diagnosis needs at least 10"),
    "nanoseconds apart": (driven(t=ARC.t * 1e-9), "samples are 5e-11 s apart, and the robot file says 0.05 s"),
    "years apart": (driven(t=ARC.t * 1e5), "samples are 5000 s apart"),
    "a gap of months": (driven(t=ARC.t + 1e7 * (ARC.t > 1.0)), "nothing for 1e+07 s after row 21"),
    "blank reference": (
        driven(reference=np.full((60, 3), np.nan)),
        "give logs with ref_x, ref_y and, if there is one, ref_psi",
    ),
    "far away": (driven(reference=ARC.reference + np.array([5e6, 0.0, 0.0])), "ref_x is 5e+06 m in row"),
    "a huge count": (driven(wheel=once(ARC.wheel, 2.0**53)), "cannot be made to fit"),
    "huge counts": (driven(wheel=ARC.wheel * 2.0**40), "cannot be made to fit"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_log_that_tells_nothing_is_refused_in_one_line_that_says_why(capsys, monkeypatch, tmp_path, name):
    log, said = REFUSED[name]
    write_log(tmp_path / "log.csv", log, preset("differential"))
    assert diagnose(capsys, monkeypatch, "inspect", tmp_path / "log.csv", "--robot", "differential")[0] == 0
    code, out, err = diagnose(capsys, monkeypatch, tmp_path / "log.csv", "--robot", "differential")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("error: ")
    assert said in err
    if "fit" not in said and "give logs" not in said:
        assert f"{tmp_path / 'log.csv'}: " in err


def test_millimetres_are_told_however_far_they_seem_to_go(capsys, monkeypatch, tmp_path):
    """Beyond where positions are refused as too far from the origin, too."""
    robot, n = preset("differential"), 400
    rolled = roll(robot, umbmark("ccw", side=2.0))
    wheel = rolled.wheel_angle[:n] * (robot.wheels[0].counts_per_rev or np.nan) / (2 * np.pi)
    log = Log(rolled.t[:n], np.round(wheel), np.empty((n, 0)), reference=rolled.pose[:n] * [1000, 1000, 1])
    assert log.reference is not None
    assert np.max(log.reference) > FARTHEST
    write_log(tmp_path / "log.csv", log, robot)
    code, out, err = diagnose(capsys, monkeypatch, tmp_path / "log.csv", "--robot", "differential")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith("error: ref_x and ref_y are in millimetres: ")


def test_the_log_that_shows_no_motion_is_named_among_others(capsys, monkeypatch, tmp_path):
    robot = preset("differential")
    write_log(tmp_path / "good.csv", driven(), robot)
    write_log(tmp_path / "still.csv", driven(wheel=np.zeros((60, 2)), reference=np.zeros((60, 3))), robot)
    for option in ((), ("--holdout",), ("--clean",)):
        arguments = (tmp_path / "good.csv", *option, tmp_path / "still.csv", "--robot", "differential")
        code, out, err = diagnose(capsys, monkeypatch, *arguments)
        assert (code, out) == (2, "")
        assert f"{tmp_path / 'still.csv'}: shows no motion" in err


def test_a_trains_log_in_which_nothing_changes_is_refused_by_name(capsys, monkeypatch, tmp_path):
    train, n = cfmmr(2), 40
    log = Log(np.arange(n) * 0.05, np.zeros((n, 4)), np.empty((n, 0)), rps=np.tile([0.35, 0.0, 0.0], (n, 1)))
    write_log(tmp_path / "log.csv", log, train)
    code, out, err = diagnose(capsys, monkeypatch, tmp_path / "log.csv", "--robot", "cfmmr-2")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert f"{tmp_path / 'log.csv'}: shows no motion" in err
