"""The tutorials do what they say: their scripts and commands run, in the order of the page."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from castor_envs.processes import MOST_PRINTED
from castor_envs.vehicles.load import load_robot
from castor_envs.vehicles.presets import preset

ROOT = Path(__file__).parents[1]
BIN = Path(sys.executable).parent


def follow(name, folder):
    """Do what a tutorial says: write scripts that have a name, run others and commands; returns what each printed."""
    said = {}
    for kind, code in re.findall(r"```(python|bash|json)\n(.*?)```", page(name), flags=re.S):
        if kind == "json":
            (folder / "map.json").write_text(code)
        elif kind == "python" and (named := re.match(r"# (\w+\.py)\n", code)):
            (folder / named[1]).write_text(code)
        else:
            lines = [code] if kind == "python" else code.splitlines()
            for line in lines:
                if "DATA" in line or "measured/" in line:  # measured data, which is not included
                    continue
                typed = line.split("#")[0].replace(".venv/bin", str(BIN)).split()
                call = typed if kind == "bash" else [sys.executable, "-c", line]
                environment = os.environ | {"PYTHONWARNINGS": "ignore"}
                done = subprocess.run(call, cwd=folder, capture_output=True, text=True, timeout=300, env=environment)
                assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
                said[" ".join(call[1:]) if kind == "bash" else "python"] = done.stdout
    return said


def page(name):
    return (ROOT / "docs" / "tutorials" / f"{name}.md").read_text(encoding="utf-8")


def test_a_bag_becomes_a_calibrated_file(tmp_path):
    said = follow("own_robot", tmp_path)
    (calibrated,) = (text for call, text in said.items() if call.startswith("calibrate"))
    ((before, after),) = re.findall(r"odometry is ([\d.]+) mm.* before, ([\d.]+) mm after", calibrated)
    assert float(before) == pytest.approx(22, abs=1)
    assert float(after) < 1
    left, right = load_robot(str(tmp_path / "calibrated.json")).castors[0].wheels
    nominal = preset("differential").castors[0].wheels[0].radius
    assert left.radius / nominal == pytest.approx(1.01, abs=1e-4)  # what the script hid
    assert right.radius / nominal == pytest.approx(1.0, abs=1e-4)


def test_the_hidden_effect_is_named(tmp_path):
    said = follow("own_log", tmp_path)
    assert "WheelRadius" in said["python"]
    (effect,) = json.loads((tmp_path / "found" / "robot.json").read_text())["effects"]
    assert (effect["name"], effect["castor"], effect["wheel"]) == ("wheel_radius", 1, 2)
    assert effect["value"] == pytest.approx(-0.008, abs=5e-4)


def test_pages_say_that_printing_too_much_fails_a_case():
    limit = f"{MOST_PRINTED // 1000} kB"
    assert f"a case in which it prints over {limit} fails" in page("own_estimator")
    limits = (ROOT / "docs" / "benchmark.md").read_text(encoding="utf-8").partition("**Limits of a plug-in.**")[2]
    assert f"{limit} of output to stderr per episode" in limits
    assert "that case fails with the reason" in limits


def test_the_site_lists_every_page():
    listed = set(re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text(encoding="utf-8")))
    docs = ROOT / "docs"
    assert listed == {path.relative_to(docs).as_posix() for path in docs.rglob("*.md")}
