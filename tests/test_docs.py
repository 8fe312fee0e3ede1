"""Pages in docs/ name files that exist, and what they show runs."""

import re
import runpy
from pathlib import Path

import pytest

from castor_envs.logs.csv import read_log
from castor_envs.vehicles.load import load_vehicle
from castor_envs.vehicles.presets import preset

ROOT = Path(__file__).parents[1]
PAGES = ("physics", "effects", "diagnose", "policies")


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


def test_the_effects_of_the_example_stand_in_its_file(tmp_path, monkeypatch):
    code, *_ = re.findall(r"```python\n(.*?)```", page("effects"), flags=re.S)
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    saved = load_vehicle("real.json").to_dict()["effects"]
    assert str(saved).replace("'", '"').replace("None", "null") in page("effects")
