"""castor-bench robot: a file is checked line by line, described and drawn; answers to questions make a valid one."""

import dataclasses
import json

import pytest
from typer.testing import CliRunner

from benchmarks import cli
from castor_envs.cli import command_line
from castor_envs.errors import InputError
from castor_envs.vehicles.load import load_robot, load_vehicle
from castor_envs.vehicles.presets import preset

ANSWERS = {
    "differential": ["my robot", "1", "", "fixed", "", "2", "340", "75", "2000", "", "", "", "", "", "", ""],
    "two split castors": [
        *["split", "2", "240, 0", "free", "72", "5143", "-1.5", "2", "116", "38.1", "1200", "standard"],
        *["-240 0", "y", "20", "12", "0 0", "0.5", "20", "y", "0.002"],
    ],
    "mecanum": [
        *["mecanum", "4", "200, 150", "fixed", "0", "1", "0", "50", "4096", "omni", "45"],
        *["200, -150", "n", "fixed", "0", "1", "0", "50", "4096", "omni", "-45"],
        *["-200, 150", "n", "fixed", "0", "1", "0", "50", "4096", "omni", "-45"],
        *["-200, -150", "n", "fixed", "0", "1", "0", "50", "4096", "omni", "45"],
        *["", "", "", "", "", ""],
    ],
}


@pytest.fixture
def call(monkeypatch, capsys, tmp_path):
    monkeypatch.chdir(tmp_path)

    def run(*arguments):
        with pytest.raises(SystemExit) as leaving:
            command_line.run(cli.app, ["robot", *arguments])
        return leaving.value.code, *capsys.readouterr()

    return run


@pytest.fixture
def answer(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)

    def run(answers, *arguments):
        return CliRunner().invoke(cli.app, ["robot", *arguments], input="".join(f"{line}\n" for line in answers))

    return run


def test_what_a_file_says_and_its_picture(call, tmp_path):
    preset("tricycle").save("trike.json")
    code, out, _ = call("trike.json", "--png", "trike.png")
    assert code == 0
    for line in (
        "castor 1: pivot at (500, 0) mm, driven, offset 0 mm, 5143 counts a turn, 0.07 deg each, zero 0 deg",
        "  wheel 1: radius 75 mm, 2000 counts a turn, 0.236 mm each",
        "  wheel 2l: radius 75 mm, 170 mm to the left, idle: no motor, no encoder",
        "motion: two independent motions (2 of 3 degrees of freedom)",
        "turns about: any point on the line through (0, 0) mm at 90 deg from x, the line of its fixed axles",
        "a log has: t, wheel_1, pivot_1",
        "ok     nothing odd in it",
    ):
        assert line in out.splitlines()
    assert (tmp_path / "trike.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(("name", "turned"), [("1-castor", False), ("2-castor", True)])
def test_a_base_that_its_motors_cannot_turn_is_described_as_such(call, name, turned):
    code, out, _ = call(name)
    assert code == 0
    assert ("motors cannot turn its body: nothing holds it on its castor" in out.splitlines()) != turned


@pytest.mark.parametrize(
    ("name", "shown"),
    [
        ("\x1b[31mred\u202e\n robot", "?[31mred? robot"),
        ("$\\nothing$ 机器人 \U0001f916", "$\\nothing$ 机器人 \U0001f916"),
        ("n" * 10**6, None),
    ],
    ids=["control", "letters", "long"],
)
def test_a_name_of_any_kind_is_printed_and_drawn(call, tmp_path, name, shown):
    dataclasses.replace(preset("omni3"), name=name).save("named.json")
    code, out, err = call("named.json", "--png", "named.png")
    first, *lines = out.splitlines()
    assert (code, err) == (0, "")
    assert all(line.isprintable() for line in (first, *lines))
    assert first.startswith(f"{shown} (robot, hash ") if shown else len(first) < 300
    assert (tmp_path / "named.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("change", [{"\x1b[2J": 1}, {"mass": "\x1b[2J"}, {"format": "\x1b[2J"}, {"castors": "\u202e"}])
def test_what_is_wrong_is_printable(call, tmp_path, change):
    (tmp_path / "bad.json").write_text(json.dumps(preset("omni3").to_dict() | change))
    code, out, _ = call("bad.json")
    assert code == 1
    assert out.startswith("WRONG  ")
    assert all(line.isprintable() for line in out.splitlines())


def test_every_problem_has_its_own_line(call, tmp_path):
    data = preset("asoc-prototype").to_dict()
    data["castors"][0]["offset"] = 0.0
    data["castors"][1]["wheels"][0]["radius"] = -1
    data["castors"][2]["wheels"][1]["radius"] = "large"
    data["weight"] = 3
    data["mass"] = None
    (tmp_path / "bad.json").write_text(json.dumps(data))
    code, out, _ = call("bad.json")
    lines = out.splitlines()
    assert code == 1
    assert len(lines) == 5
    assert all(line.startswith("WRONG  ") for line in lines)
    assert any(line.startswith("WRONG  weight: is not known; known: castors, center_of_mass, ") for line in lines)
    assert any("castor 1: a castor with free steering needs an offset above 0" in line for line in lines)
    code, out, _ = call("bad.json", "--json")
    assert (code, len(json.loads(out)["problems"])) == (1, 5)


def test_what_is_hardly_meant_is_marked_and_valid(call, tmp_path):
    data = preset("differential").to_dict()
    for wheel in data["castors"][0]["wheels"]:
        wheel["radius"] *= 1000
    (tmp_path / "mm.json").write_text(json.dumps(data))
    code, out, _ = call("mm.json")
    assert code == 0
    assert "CHECK  wheel 1l: radius 75 m is more than any robot has" in out
    assert "nothing odd" not in out


def test_json_says_the_same(call):
    code, out, _ = call("swerve", "--json")
    said = json.loads(out)
    assert code == 0
    assert said["mobility"]["steered_castors"] == [1, 2, 3, 4]
    assert said["log_columns"][:3] == ["t", "wheel_1", "wheel_2"]
    assert "wheel-odometry" in said["estimators"]
    assert json.loads(call("cfmmr-2", "--json")[1])["mobility"] is None


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (("not-there.json",), "not-there.json: there is no such file; --new asks for a robot and writes it"),
        (("swerv",), "unknown robot or train 'swerv'; did you mean 'swerve'?"),
        (("folder.json",), "folder.json: cannot be read (Is a directory)"),
        (("swerve", "--png", "a.jpg"), "--png a.jpg: pictures end in .png; name one"),
        (("new.json", "--new", "--png", "a.jpg"), "--png a.jpg: pictures end in .png; name one"),
        (("here.json", "--new"), "here.json: is there already; name a new file, or give --force to replace it"),
        (("robot.txt", "--new"), "robot.txt: robot files end in .json; name one"),
        (("swerve", "--force"), "--force is for --new"),
    ],
)
def test_mistakes_are_one_line(call, tmp_path, arguments, line):
    (tmp_path / "here.json").write_text("{}")
    (tmp_path / "folder.json").mkdir()
    assert call(*arguments) == (2, "", f"error: {line}\n")


@pytest.mark.parametrize("name", ANSWERS)
def test_answers_make_a_valid_robot(answer, tmp_path, name):
    done = answer(ANSWERS[name], "new.json", "--new", "--png", "new.png")
    assert done.exit_code == 0, done.output
    assert "ok     nothing odd in it" in done.output
    assert (tmp_path / "new.png").exists()
    assert load_vehicle("new.json").name in done.output


def test_answers_in_millimetres_and_degrees_are_in_the_file(answer):
    answer(ANSWERS["two split castors"], "new.json", "--new")
    robot = load_robot("new.json")
    assert robot.gyro is not None
    first, second = robot.castors
    assert (first.pivot, first.offset, first.pivot_counts_per_rev) == ((0.24, 0.0), 0.072, 5143)
    assert first.pivot_zero == pytest.approx(-0.0261799388)
    assert [(w.lateral, w.radius) for w in first.wheels] == [(0.058, 0.0381), (-0.058, 0.0381)]
    assert (second.pivot, second.wheels) == ((-0.24, 0.0), first.wheels)
    assert (robot.sample_period, robot.mass, robot.gyro.noise) == (0.02, 12.0, 0.002)


def test_counts_a_turn_are_what_files_take(answer):
    counts = ["1e-4", "-4096", "4095.7"]
    done = answer(["", "1", "", "free", "72", *counts, "0", "2", "116", "38", "0.5", *[""] * 9], "new.json", "--new")
    assert done.exit_code == 0, done.output
    assert done.output.count("should be greater than or equal to 0.001") == 2
    (castor,) = load_robot("new.json").castors
    assert castor.pivot_counts_per_rev == 4095.7
    assert castor.wheels[0].counts_per_rev == 0.5


def test_impossible_answers_are_asked_for_again(answer):
    free = ["", "1", "", "free", "0", "", "", "2", "300", "75", "", ""]
    done = answer([*free[:2], "far away", *free[2:], *ANSWERS["differential"][2:]], "new.json", "--new")
    assert done.exit_code == 0, done.output
    assert "expected a number, got 'far'" in done.output
    reason = "a castor with free steering needs an offset above 0, or nothing turns it"
    assert f"not possible: {reason}; once more" in done.output


def test_a_file_is_replaced_only_by_force_and_never_by_half_an_answer(answer, tmp_path):
    (tmp_path / "new.json").write_text("mine")
    assert answer(ANSWERS["differential"][:5], "new.json", "--new", "--force").exit_code != 0
    assert (tmp_path / "new.json").read_text() == "mine"
    assert answer(ANSWERS["differential"], "new.json", "--new", "--force").exit_code == 0
    assert load_vehicle("new.json").name == "my robot"


@pytest.mark.parametrize("option", ["--new", "--png"])
def test_a_file_that_cannot_be_written_is_told_before_any_question(answer, tmp_path, option):
    (tmp_path / "file").write_text("")
    named = {"--new": ("--new", "file/new.json"), "--png": ("--new", "new.json", "--png", "file/new.png")}[option]
    found = answer(ANSWERS["differential"], *named)
    assert isinstance(found.exception, InputError)
    assert "cannot be written to" in str(found.exception)
    assert found.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
