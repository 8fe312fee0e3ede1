"""The command that makes logs of published measurements, and of recordings of one's own robot."""

import dataclasses
import json
import shlex
from pathlib import Path

import numpy as np
import pytest

from benchmarks import cli
from castor_envs.cli import command_line
from castor_envs.logs.csv import read_log
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.load import load_robot
from castor_envs.vehicles.presets import preset, train_names

METADATA = "type,diff\nngear,12\nencRes,16\nLi,0.2\nDi,0.08,0.08\nN,1\nL,1.0\n"
RUN = "0,0,0,0,9,9\n0.05,0.1,0,0,4,6\n0.1,0.2,0,0,1,1\n"


def call(capsys, *arguments):
    """Return exit code, output and errors of the command."""
    with pytest.raises(SystemExit) as leaving:
        command_line.run(cli.app, [str(argument) for argument in arguments])
    out, err = capsys.readouterr()
    return leaving.value.code, out, err


def test_sessions_become_folders_of_a_robot_and_its_logs(tmp_path, capsys):
    folder = tmp_path / "data" / "optiodom" / "diff" / "7"
    folder.mkdir(parents=True)
    (folder / "7_metadata.csv").write_text(METADATA)
    (folder / "7_run-01.csv").write_text(RUN)
    out = tmp_path / "measured"
    code, printed, _ = call(capsys, "import", tmp_path / "data", "--out", out)
    assert code == 0
    assert printed.splitlines() == [f"{out / '7'}: OptiOdom differential drive, 1 runs"]
    assert len(read_log(out / "7" / "run-1.csv", load_robot(str(out / "7" / "robot.json")))) == 3


def test_sessions_that_are_there_are_left_alone(tmp_path, capsys):
    """Robot files may have been edited since; nothing else is written then."""
    folder = tmp_path / "data" / "optiodom" / "diff"
    for name in ("7", "8"):
        (folder / name).mkdir(parents=True)
        (folder / name / f"{name}_metadata.csv").write_text(METADATA)
        (folder / name / f"{name}_run-01.csv").write_text(RUN)
    edited = tmp_path / "measured" / "8" / "robot.json"
    edited.parent.mkdir(parents=True)
    edited.write_text("edited")
    code, printed, said = call(capsys, "import", tmp_path / "data", "--out", tmp_path / "measured")
    assert (code, printed) == (2, "")
    assert said == f"error: --out {edited.parent}: is there already; name a new folder\n"
    assert edited.read_text() == "edited"
    assert [path.name for path in edited.parents[1].rglob("*")] == ["8", "robot.json"]


def test_what_no_importer_knows_is_refused_in_one_line(tmp_path, capsys):
    code, printed, said = call(capsys, "import", tmp_path, "--out", tmp_path / "out")
    assert (code, printed) == (2, "")
    assert len(said.splitlines()) == 1
    assert "no importer recognises" in said
    assert not (tmp_path / "out").exists()


def test_of_a_folder_of_recordings_one_is_to_be_named(tmp_path, capsys):
    for name in ("b.csv", "a.csv"):
        (tmp_path / name).write_text("t,left,right\n0,0,0\n1,1,1\n")
    code, printed, said = call(capsys, "import", tmp_path, "--robot", "differential")
    assert (code, printed) == (2, "")
    assert said == f"error: {tmp_path}: is a folder; name a recording in it, such as {tmp_path / 'a.csv'}\n"


def test_what_is_read_is_never_replaced_and_what_cannot_be_written_says_so(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = "t,wheel_1l,wheel_1r\n0,0,0\n1,1,1\n2,2,2\n"
    Path("run.csv").write_text(text)
    assert call(capsys, "import", "run.csv", "--robot", "differential")[0] == 0
    command = ("import", "run.csv", "--robot", "differential", "--map", "map.json", "--out")
    for out in ("run.csv", tmp_path / "map.json"):
        code, _, said = call(capsys, *command, out)
        assert (code, said) == (2, f"error: --out {out}: is what is read, which would be lost; name another file\n")
    code, _, said = call(capsys, *command, "run.csv/log.csv")
    assert (code, said.startswith("error: --out run.csv/log.csv: cannot be written to (")) == (2, True)
    assert Path("run.csv").read_text() == text
    Path("run.csv").write_text(text.replace("2,2,2", "2,1e99,2"))
    code, _, said = call(capsys, *command, "log.csv")
    assert code == 2
    assert said.startswith("error: no log is written, for it would be refused: log.csv:4: column 'wheel_1l'")
    assert not Path("log.csv").exists()


def test_a_log_that_is_there_is_left_alone(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("t,left_ticks,right_ticks\n0,0,0\n1,1,1\n2,2,2\n")
    Path("log.csv").write_text("measured long ago")
    assert call(capsys, "import", "run.csv", "--robot", "differential")[0] == 0
    code, _, said = call(capsys, "import", "run.csv", "--robot", "differential", "--map", "map.json")
    assert (code, said) == (2, "error: --out log.csv: is there already; remove it or name another file\n")
    assert Path("log.csv").read_text() == "measured long ago"


def test_a_train_is_told_that_its_log_is_written_in_the_logs_own_format(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("t,left_ticks,right_ticks\n0,0,0\n1,1,1\n2,2,2\n")
    Path("map.json").write_text("{}")
    for more in ((), ("--map", "map.json")):
        code, _, said = call(capsys, "import", "run.csv", "--robot", train_names()[0], *more)
        assert code == 2
        assert "is a train, and recordings are imported for robots alone" in said
        assert "docs/formats.md" in said


def test_a_recording_is_no_task_to_export(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.wpilog").write_bytes(b"WPILOG")
    code, _, said = call(capsys, "export", "run.wpilog", "--robot", "differential")
    assert code == 2
    assert "run.wpilog: is a recording, WPILib data log (.wpilog), not a log; castor-bench import makes a log" in said


def test_a_reference_is_told_as_one_beside_the_map_of_its_recording(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("map.json").write_text("{}")
    Path("seen.tum").write_text("".join(f"{k} {k} 0 0 0 0 0 1\n" for k in range(5)))
    code, printed, _ = call(capsys, "import", "seen.tum", "--robot", "differential")
    assert code == 0
    assert "this is the reference of another recording; add to the map of that one" in printed
    assert "--map map.json" not in printed


def test_ranges_are_shown_with_the_digits_in_which_lowest_and_highest_differ(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{k},{5411000.2 + k},{0.125 * k},7,{1e9 + 1e-6 * k}\n" for k in range(3))
    Path("run.csv").write_text("t,north,left,flat,odd\n" + rows)
    code, printed, _ = call(capsys, "import", "run.csv")
    assert code == 0
    shown = {line.split()[0]: line.split()[-2:] for line in printed.splitlines()[2:6]}
    assert shown == {
        "flat": ["7", "7"],
        "left": ["0", "0.25"],
        "north": ["5411000.2", "5411002.2"],
        "odd": ["1000000000", "1000000000"],
    }


def test_rows_without_times_are_no_log_before_somebody_says_their_period(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("left_ticks,right_ticks\n0,0\n1,2\n2,4\n")
    code, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential")
    assert code == 0
    last = printed.splitlines()[-1]
    assert last.startswith("next: edit map.json: give the time between rows, 's', as 'period', or a column as 'time'")
    code, _, problem = call(capsys, "import", "run.csv", "--robot", "differential", "--map", "map.json")
    assert code == 2
    assert "map.json: sources.main.period: is still '?'; give the time between rows, s, or" in problem
    made = Path("map.json").read_text()
    Path("map.json").write_text(made.replace('"period": "?"', '"period": 0.02'))
    code, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential", "--map", "map.json")
    assert code == 0
    assert "3 rows in 0.0 s" in printed


def test_names_in_a_recording_do_not_reach_the_terminal_as_they_are(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("t,left_ticks\x1b[2J,right_ticks\n0,0,0\n1,1,1\n2,2,2\n")
    code, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential")
    assert code == 0
    assert "\x1b" not in printed
    assert "left_ticks?[2J" in printed


def test_a_recording_is_shown_and_a_map_is_made_then_a_log(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rows = [f"{20 * k},{10 * k},{12 * k},{k / 100},0,0" for k in range(50)]
    Path("run.csv").write_text("\n".join(["stamp_ms,left_ticks,right_ticks,x,y,yaw", *rows]) + "\n")
    code, printed, _ = call(capsys, "import", "run.csv")
    assert code == 0
    assert "run.csv: CSV file, 1.0 s, by the clock 'stamp_ms'" in printed
    assert any(line.split() == ["left_ticks", "50", "50", "0", "490"] for line in printed.splitlines())
    assert not Path("map.json").exists()
    code, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential")
    assert code == 0
    assert "wheel_1l: left_ticks (counts)" in printed
    assert printed.splitlines()[-1] == (
        "next: castor-bench import run.csv --robot differential --map map.json --out log.csv"
    )
    code, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential", "--map", "map.json")
    assert code == 0
    assert printed.splitlines()[0] == "log.csv: 50 rows in 1.0 s, 50 reference poses"
    assert "note: rows come every 0.02 s" in printed
    log = read_log("log.csv", preset("differential"))
    assert log.wheel[:, 1].tolist() == [12 * k for k in range(50)]


@pytest.mark.parametrize(
    ("first", "said"),
    [(first, [f"its t 0 is {first} s of the recording"]) for first in (1715680000.25, -30, 0.5)] + [(0, [])],
)
def test_the_time_at_which_a_log_begins_is_said(tmp_path, capsys, monkeypatch, first, said):
    """Reference poses may come earlier."""
    monkeypatch.chdir(tmp_path)
    rows = [f"{first + 0.02 * k:.2f},{10 * k},{12 * k},," for k in range(50)]
    rows.insert(0, f"{first - 1:.2f},,,0,0")
    Path("run.csv").write_text("\n".join(["time_s,left_ticks,right_ticks,x,y", *rows]) + "\n")
    assert call(capsys, "import", "run.csv", "--robot", "differential")[0] == 0
    code, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential", "--map", "map.json")
    assert code == 0
    assert read_log("log.csv", preset("differential")).t[0] == 0
    assert [line for line in printed.splitlines() if "t 0 is" in line] == said


def test_commands_that_are_printed_can_be_typed_whatever_files_are_called(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("my run.csv").write_text("t,left_ticks,right_ticks\n0,0,0\n1,1,1\n2,2,2\n")
    Path("my robot.json").write_text(json.dumps(preset("differential").to_dict()))
    _, printed, _ = call(capsys, "import", "my run.csv", "--robot", "my robot.json", "--out", "my log.csv")
    program, *arguments = shlex.split(printed.splitlines()[-1].removeprefix("next: "))
    assert (program, arguments[1]) == ("castor-bench", "my run.csv")
    code, printed, _ = call(capsys, *arguments)
    assert code == 0
    assert shlex.split(printed.splitlines()[-1]) == [
        "next:", "castor-diagnose", "inspect", "my log.csv", "--robot", "my robot.json",
    ]  # fmt: skip


def test_mistakes_in_an_import_are_one_line_and_leave_no_file(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("t,left,right\n0,1,2\n1,2,3\n")
    Path("odd.bin").write_bytes(b"\x00\x01")
    columns = {"wheel_1l": {"channel": "left", "unit": "counts"}, "wheel_1r": {"channel": "right", "unit": "s"}}
    Path("wrong.json").write_text(json.dumps({"format": "castor-map/1", "columns": columns}))
    for arguments, words in (
        (["run.csv", "--map", "map.json"], "--map needs --robot"),
        (["run.csv", "--map", "map.json", "--robot", "differential"], "--map map.json: no such file; without --map"),
        (["run.csv", "--map", "wrong.json", "--robot", "differential"], "wrong.json: columns.wheel_1r.unit: 's'"),
        (["run.csv", "--robot", "no-such-robot"], "no-such-robot"),
        (["none.csv", "--robot", "differential"], "none.csv: no such file"),
        (["odd.bin", "--robot", "differential"], "odd.bin: is no known kind of recording"),
    ):
        code, printed, said = call(capsys, "import", *arguments)
        assert (code, printed) == (2, ""), arguments
        assert len(said.splitlines()) == 1
        assert words in said
    assert not Path("log.csv").exists()


def test_a_map_that_is_there_is_left_alone_and_the_recording_is_shown(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("t,left,right\n0,1,2\n1,2,3\n")
    Path("map.json").write_text("{}")
    code, printed, said = call(capsys, "import", "run.csv", "--robot", "differential")
    assert (code, said) == (0, "")
    assert any(line.split() == ["right", "2", "1", "2", "3"] for line in printed.splitlines())
    assert "map.json: is there already, and is left alone" in printed
    assert "note: map.json: 'format' must be" in printed
    assert "next:" not in printed
    assert Path("map.json").read_text() == "{}"
    Path("map.json").unlink()
    first = call(capsys, "import", "run.csv", "--robot", "differential")[1].splitlines()
    again = call(capsys, "import", "run.csv", "--robot", "differential")[1].splitlines()
    assert again[-1] == first[-1]
    assert again[-1].startswith("next: castor-bench import run.csv")


def test_a_map_of_another_recording_is_said_not_to_fit_beside_what_is_guessed(tmp_path, capsys, monkeypatch):
    """Channels of another file are none of this recording's, and are not asked for."""
    monkeypatch.chdir(tmp_path)
    Path("old.csv").write_text("t,left,right\n0,1,2\n1,2,3\n")
    Path("new.csv").write_text("t,left_ticks,right\n0,1,2\n1,2,3\n")
    assert call(capsys, "import", "old.csv", "--robot", "differential")[0] == 0
    by = json.loads(Path("map.json").read_text())
    by["sources"]["tracker"] = {"file": "seen.tum"}
    for key, name in (("ref_x", "x"), ("ref_y", "y"), ("ref_psi", "heading")):
        by["columns"][key] = {"channel": name, "unit": "rad" if key == "ref_psi" else "m", "source": "tracker"}
    Path("map.json").write_text(json.dumps(by))
    code, printed, _ = call(capsys, "import", "new.csv", "--robot", "differential")
    assert code == 0
    assert "  wheel_1l: left_ticks (counts)" in printed.splitlines()
    assert printed.splitlines()[-1] == "note: map.json: does not fit this recording, which has no channel 'left'"
    assert json.loads(Path("map.json").read_text()) == by
    Path("map.json").write_text(json.dumps(by).replace('"channel": "right"', '"channel": "?"'))
    assert "which has no channel 'left'" in call(capsys, "import", "new.csv", "--robot", "differential")[1]
    Path("map.json").write_text(json.dumps(by))
    code, printed, _ = call(capsys, "import", "old.csv", "--robot", "differential")
    assert printed.splitlines()[-1].startswith("next: castor-bench import old.csv")


def test_a_log_that_is_asked_for_without_a_map_is_said_not_to_be_made(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("t,left,right\n0,1,2\n1,2,3\n")
    for more in ([], ["--robot", "differential"]):
        code, printed, _ = call(capsys, "import", "run.csv", "--out", "mine.csv", *more)
        assert code == 0
        assert "note: without --map no log is made, and --out mine.csv is not used" in printed
    assert printed.splitlines()[-1].endswith("--map map.json --out mine.csv")
    assert not Path("mine.csv").exists()


def test_no_command_that_fails_is_printed_while_a_column_is_undecided(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("t,left,odd\n0,1,2\n1,2,3\n")
    _, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential")
    assert "wheel_1r: undecided" in printed
    assert printed.splitlines()[-1].startswith("next: edit map.json: replace each '?'")


@pytest.mark.parametrize("names", ["time,A,B,x,y,theta", "zeit;links;rechts;x;y;theta"])
def test_wheels_that_no_name_tells_are_to_be_chosen_beside_a_reference(tmp_path, capsys, monkeypatch, names):
    monkeypatch.chdir(tmp_path)
    rows = [names, *(f"{k};{9 * k};{9 * k};{k};0;0" for k in range(5))]
    Path("run.csv").write_text("\n".join(rows if ";" in names else (row.replace(";", ",") for row in rows)) + "\n")
    code, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential")
    assert code == 0
    assert "note: no name says which channel is a wheel's; if none is, this is the reference" in printed
    columns = json.loads(Path("map.json").read_text())["columns"]
    assert {key: column["channel"] for key, column in columns.items()} == {
        "wheel_1l": "?", "wheel_1r": "?", "ref_x": "x", "ref_y": "y", "ref_psi": "theta",
    }  # fmt: skip


@pytest.mark.parametrize(("heading", "said"), [("Mocap Gier [deg]", True), ("Mocap Yaw [deg]", False)])
def test_a_heading_that_no_name_tells_is_asked_for_beside_positions(tmp_path, capsys, monkeypatch, heading, said):
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{k},{9 * k},{9 * k},{k},0,{k}\n" for k in range(5))
    Path("run.csv").write_text(f"t,left_ticks,right_ticks,Mocap X [mm],Mocap Y [mm],{heading}\n{rows}")
    _, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential")
    assert "  ref_y: Mocap Y [mm] (mm)" in printed.splitlines()
    asked = "note: no name says which channel is the heading of the reference; if one is, map it to ref_psi"
    assert (asked in printed.splitlines()) == said


@pytest.mark.parametrize(
    ("names", "units"),
    [
        ("left_speed,right_speed,x,y,yaw", ("rad/s, unit guessed", "m, unit guessed", "rad, unit guessed")),
        ("left.speed,right.speed,x,y,yaw", ("rad/s, unit guessed", "m, unit guessed", "rad, unit guessed")),
        ("left_speed_mps,right_speed_mps,x_mm,y_mm,yaw_deg", ("m/s", "mm", "deg")),
        ("left wheel [°],right wheel [°],x [m],y [m],yaw [°]", ("deg", "m", "deg")),
        ("wheel_1l,wheel_1r,ref_x,ref_y,ref_psi", ("counts", "m", "rad")),
        ("/j position[left],/j position[right],/v pose.x,/v pose.y,/v pose.heading", ("rad", "m", "rad")),
    ],
)
def test_units_that_nothing_says_are_marked(tmp_path, capsys, monkeypatch, names, units):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text(f"t,{names}\n" + "".join(f"{k},{k}.5,{k}.5,{k},{k},{k}\n" for k in range(4)))
    _, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential")
    left, _, x, _, psi = names.split(",")
    for key, channel, unit in zip(("wheel_1l", "ref_x", "ref_psi"), (left, x, psi), units, strict=True):
        assert f"  {key}: {channel} ({unit})" in printed.splitlines()


def test_what_is_left_out_is_listed_by_reasons(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("t,left_ticks,mode,state,right_ticks\n0,0,A,B,0\n1,1,A,B,1\n2,2,A,B,2\n")
    _, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential")
    assert "left out (text): mode, state" in printed.splitlines()
    by = json.loads(Path("map.json").read_text())
    by["columns"]["wheel_1l"]["channel"] = "mode"
    Path("map.json").write_text(json.dumps(by))
    code, _, said = call(capsys, "import", "run.csv", "--robot", "differential", "--map", "map.json")
    assert (code, "'A' is not a number" in said) == (2, True)
    Path("text.csv").write_text("t,mode\n0,A\n1,B\n")
    code, _, said = call(capsys, "import", "text.csv", "--robot", "differential")
    assert code == 2
    assert said.endswith("without numbers that can be read; left out (text): mode\n")


def test_wheels_named_by_a_side_and_a_symbol_are_to_be_chosen(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("t,omega_left,omega_right\n" + "".join(f"{k},{k}.5,{k}.5\n" for k in range(5)))
    code, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential")
    assert (code, "no channel can be a wheel's" in printed, Path("map.json").exists()) == (0, False, True)


def test_odometry_alone_is_no_log_and_what_to_do_is_said(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("run.csv").write_text("t,odom_x,odom_y,odom_theta\n" + "".join(f"{k},{k},0,0\n" for k in range(5)))
    code, printed, _ = call(capsys, "import", "run.csv", "--robot", "differential")
    assert code == 0
    assert "no channel can be a wheel's: poses and speeds of a body, as of odometry or TF, are no encoders" in printed
    assert "next: record the wheels too" in printed
    assert "this is the reference" not in printed
    assert not Path("map.json").exists()


@pytest.mark.parametrize("kind", ["tum", "kitti"])
def test_a_trajectory_alone_is_the_reference_of_another_recording(tmp_path, capsys, monkeypatch, kind):
    """What is shown, added to the map of a drive, makes its reference, with the positions of the file."""
    monkeypatch.chdir(tmp_path)
    t = 0.1 * np.arange(30)
    rows = [f"{k},{round(100 * k)},{round(100 * k)}" for k in t]
    Path("run.csv").write_text("\n".join(["t,left_ticks,right_ticks", *rows]) + "\n")
    poses = {"tum": [f"{k} {k} 0 0 0 0 0 1" for k in t], "kitti": [f"1 0 0 {k} 0 1 0 0 0 0 1 0" for k in t]}
    Path("seen.txt").write_text("\n".join(poses[kind]) + "\n")
    code, printed, _ = call(capsys, "import", "seen.txt", "--robot", "differential")
    assert code == 0
    assert "this is the reference of another recording" in printed
    assert ("for '?' the time between poses, s" in printed) == (kind == "kitti")
    assert "next:" not in printed
    assert not Path("map.json").exists()
    assert call(capsys, "import", "run.csv", "--robot", "differential")[0] == 0
    by = json.loads(Path("map.json").read_text())
    for part in ("sources", "columns"):
        for line in (line for line in printed.splitlines() if line.startswith(f"  {part}: ")):
            line = line.replace('"period": "?"', '"period": 0.1')  # of KITTI text, whose times stand in no file here
            by[part] |= json.loads("{" + line.removeprefix(f"  {part}: ") + "}")
    Path("map.json").write_text(json.dumps(by))
    assert call(capsys, "import", "run.csv", "--robot", "differential", "--map", "map.json")[0] == 0
    reference = read_log("log.csv", preset("differential")).reference
    assert reference is not None
    np.testing.assert_allclose(reference, np.column_stack([t, 0 * t, 0 * t]), atol=1e-9)


def test_positions_of_a_receiver_are_imported_and_calibrate_the_robot(tmp_path, capsys, monkeypatch):
    """A left wheel 1 % larger than described, in a recording with eastings and northings to 3 mm."""
    monkeypatch.chdir(tmp_path)
    robot = preset("differential")
    left, right = robot.castors[0].wheels
    axle = dataclasses.replace(robot.castors[0], wheels=(dataclasses.replace(left, radius=1.01 * left.radius), right))
    motion = roll(
        dataclasses.replace(robot, castors=(axle,)), wander(np.random.default_rng(4), duration=60.0, holonomic=False)
    )
    counts = np.round(motion.wheel_angle * np.array([left.counts_per_rev, right.counts_per_rev], float) / (2 * np.pi))
    noise = 0.003 * np.random.default_rng(5).normal(size=(len(motion.t), 2))
    places = (motion.pose[:, :2] + noise + [431_000.0, 5_411_000.0]).tolist()
    rows = [
        f"{t:.3f},{a:.0f},{b:.0f},{x:.4f},{y:.4f}" if k % 4 == 0 else f"{t:.3f},{a:.0f},{b:.0f},,"
        for k, (t, (a, b), (x, y)) in enumerate(zip(motion.t, counts, places, strict=True))
    ]
    Path("run.csv").write_text("\n".join(["t,left_ticks,right_ticks,gps easting,gps northing", *rows]) + "\n")
    given = ("run.csv", "--robot", "differential")
    code, out, _ = call(capsys, "import", *given)
    assert (code, "ref_y: gps northing" in out, "ref_psi" in out) == (0, True, False)
    code, out, _ = call(capsys, "import", *given, "--map", "map.json", "--out", "log.csv")
    assert (code, "reference poses, positions without headings" in out) == (0, True)
    code, out, err = call(capsys, "calibrate", "log.csv", "--robot", "differential", "--out", "found.json")
    assert code == 0, err
    assert "without headings" in out
    found = [wheel.radius for wheel in load_robot("found.json").castors[0].wheels]
    np.testing.assert_allclose(found, [1.01 * left.radius, right.radius], rtol=4e-3)
    assert found[0] / found[1] == pytest.approx(1.01, abs=1e-3)
