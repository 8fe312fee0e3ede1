"""The check in a worker process: whatever a plug-in raises there is a finding, as it is a failed case of a run."""

import re

import pytest

from benchmarks.run.check import check_apart, refusals_apart
from castor_envs.errors import InputError
from castor_envs.vehicles.presets import preset

INTERRUPTS = "raises KeyboardInterrupt"


@pytest.mark.parametrize(
    ("body", "check"),
    [
        ("def __init__(self): raise KeyboardInterrupt\n    reset = update = print", "is constructed without arguments"),
        ("def reset(self, *_): raise KeyboardInterrupt\n    update = print", "serves the robot"),
        ("def reset(self, *_): ...\n    def update(self, _): raise KeyboardInterrupt", "returns three finite numbers"),
    ],
)
def test_an_interrupt_that_a_plug_in_raises_is_found(tmp_path, body, check):
    file, robot = tmp_path / "bad.py", preset("differential")
    file.write_text(f"class Bad:\n    {body}\n")
    *_, found = check_apart(str(file), robot, 20.0, print)
    assert (found.name, found.passed, found.message[: len(INTERRUPTS)]) == (check, False, INTERRUPTS)
    assert refusals_apart(str(file), [robot], 20.0) == [None]


FLAT = """
from estimators import TrainOdometry

class Flat(TrainOdometry):
    def update(self, observation):
        return super().update(observation).ravel()
"""


def test_what_is_wrong_alike_on_many_presets_is_one_finding(tmp_path):
    """Messages differ by the number of axles; the first is shown."""
    file = tmp_path / "flat.py"
    file.write_text(FLAT)
    whole, brief = (finding for finding in check_apart(str(file), None, 20.0, print) if not finding.passed)
    assert whole.name == "returns three finite numbers"
    assert re.fullmatch(r"returns three finite numbers \(on cfmmr-2, (cfmmr-\d+, )+cfmmr-10\)", brief.name)
    assert brief.message.startswith("on cfmmr-2, update 0 returns shape (6,) instead of (2, 3)")


def test_an_interrupt_on_import_is_one_line(tmp_path):
    file = tmp_path / "bad.py"
    file.write_text("raise KeyboardInterrupt\n")
    with pytest.raises(InputError, match=r"cannot be imported, line 1 .KeyboardInterrupt."):
        check_apart(str(file), None, 20.0, print)
