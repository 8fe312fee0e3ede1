"""Pages in docs/ name files that exist, and what they show runs."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from benchmarks import cli
from castor_envs.cli import command_line
from castor_envs.logs.csv import read_log
from castor_envs.vehicles.load import load_vehicle
from castor_envs.vehicles.presets import preset
from discrepancy import cli as discrepancy_cli

ROOT = Path(__file__).parents[1]
NUMBER = re.compile(r"\d+(?:\.\d+)?")
PAGES = ("physics", "effects", "diagnosis-method", "diagnosis-trials", "logs", "policies")


def page(name):
    return (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("name", PAGES)
def test_files_that_a_page_names_exist(name):
    tops = "castor_envs|estimators|benchmarks|discrepancy|scripts|tests|docs"
    paths = re.findall(rf"\b((?:{tops})/[\w/.]*\w)", page(name))
    assert paths
    for path in paths:
        assert (ROOT / path).exists(), path
    for test in re.findall(r"`(test_\w+\.py)`", page(name)):
        assert (ROOT / "tests" / "castor_envs" / "physics" / test).exists(), test


def test_the_diagnosed_robot_is_recorded_without_its_effect(tmp_path, monkeypatch):
    (code,) = (
        block for block in re.findall(r"```python\n(.*?)```", page("diagnose"), flags=re.S) if "RecordLog" in block
    )
    (tmp_path / "hide.py").write_text(
        code.replace("direction=direction", "direction=direction, side=0.1, turn_speed=2.0")
    )
    monkeypatch.chdir(tmp_path)
    robot = runpy.run_path("hide.py")["robot"]
    assert [effect.name for effect in robot.effects] == ["wheel_radius"]
    described = preset("asoc-prototype")
    for folder in ("log", "holdout"):
        assert load_vehicle(f"{folder}/robot.json") == described
        assert len(read_log(Path(folder, "episode-0000.csv"), described)) > 100


@pytest.mark.slow
def test_the_diagnosed_robot_is_told_as_its_page_says(tmp_path, monkeypatch, capsys):
    """The numbers to a hundredth, or to the last digit that is printed: other machines round otherwise."""
    (_, code), (_, commands), (_, said) = re.findall(r"```(\w+)\n(.*?)```", page("diagnose"), flags=re.S)[:3]
    (tmp_path / "hide.py").write_text(code)
    monkeypatch.chdir(tmp_path)
    runpy.run_path("hide.py")
    printed = typed(discrepancy_cli.app, commands.splitlines()[1], capsys)
    assert NUMBER.sub("#", printed) == NUMBER.sub("#", said)
    for shown, now in zip(NUMBER.findall(said), NUMBER.findall(printed), strict=True):
        digit = 10.0 ** -len(shown.partition(".")[2])
        assert float(now) == pytest.approx(float(shown), rel=0.01, abs=digit), (shown, now)


def test_the_effects_of_the_example_stand_in_its_file(tmp_path, monkeypatch):
    code, *_ = re.findall(r"```python\n(.*?)```", page("effects"), flags=re.S)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    saved = load_vehicle("real.json").to_dict()["effects"]
    assert str(saved).replace("'", '"').replace("None", "null") in page("effects")


def typed(app, line, capsys):
    """Return what a command prints."""
    with pytest.raises(SystemExit) as leaving:
        command_line.run(app, line.split()[1:])
    assert leaving.value.code == 0
    return capsys.readouterr().out


def of_an_own_log():
    """The blocks of docs/logs.md in order: what is typed, what is printed, and the map in between."""
    blocks = re.findall(r"```(\w+)\n(.*?)```", page("logs"), flags=re.S)
    assert [kind for kind, _ in blocks] == ["python", "bash", "text", "json", "bash", "text", "python"]
    return [block for _, block in blocks]


def test_the_example_of_an_own_log_is_as_its_page_says(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    make, look, shown, edited, imports, said, python = of_an_own_log()
    exec(make, {})
    assert typed(cli.app, look, capsys) == shown
    Path("map.json").write_text(edited)
    assert typed(cli.app, imports.splitlines()[0], capsys) == said
    first = Path("log.csv").read_bytes()
    found = {}
    exec(python, found)
    assert Path("log.csv").read_bytes() == first
    log = found["log"]
    assert log.wheel[-1].tolist() == [8440, 11897]
    known = np.isfinite(log.reference[:, 0])
    angle = 0.2 * log.t[known]  # on an arc of 1 m, by a tracker that gives tenths of a millimetre
    arc = np.column_stack([np.sin(angle), 1 - np.cos(angle), angle])
    np.testing.assert_allclose(log.reference[known], arc, atol=3e-4)


@pytest.mark.slow
@pytest.mark.parametrize("signed", [True, False])
def test_what_the_page_of_an_own_log_says_of_its_diagnosis_is_said(tmp_path, monkeypatch, capsys, signed):
    monkeypatch.chdir(tmp_path)
    make, _, _, edited, imports, _, _ = of_an_own_log()
    exec(make, {})
    Path("map.json").write_text(edited if signed else edited.replace(', "sign": -1', ""))
    imported = typed(cli.app, imports.splitlines()[0], capsys)
    command, nothing, _, asked, _, backwards = re.findall(r"`([^`]+)`", page("logs").partition("Whether enc")[2])[:6]
    assert (asked in imported) == (not signed)
    diagnosed = typed(discrepancy_cli.app, command, capsys)
    assert (nothing in diagnosed, backwards in diagnosed) == (signed, not signed)
