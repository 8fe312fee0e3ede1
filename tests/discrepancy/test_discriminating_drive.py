"""The drive that separates two effects is one that does; none separates an effect from itself or from what is tiny."""

import numpy as np
import pytest

from castor_envs.effects.dimensions import CountsPerRev
from castor_envs.vehicles.presets import preset
from discrepancy import discriminating_drive
from discrepancy.discriminating_drive import drive_for
from discrepancy.hypotheses.candidates import Candidate, candidates_of, described
from discrepancy.posterior.answers import Answer
from estimators.calibration.drives import DRIVES

ROBOT = preset("asoc-prototype")
CANDIDATES = {candidate.family: candidate for candidate in reversed(candidates_of(ROBOT))}
RADIUS, TRACK = CANDIDATES["wheel_radius 1 1"], CANDIDATES["track 1"]


@pytest.fixture(autouse=True)
def _few_drives(monkeypatch):
    few = {name: make for name, make in DRIVES.items() if "2 m" in name or "on the spot" in name}
    assert len(few) == 2
    monkeypatch.setattr(discriminating_drive, "DRIVES", few)


def answer(candidate, size, *others):
    names = tuple(one.family for one in (candidate, *others))
    amplitudes, covariance = np.array([size]), np.zeros((1, 1))
    told = dict.fromkeys(names, 1 / len(names))
    return Answer(told, names, False, candidate, amplitudes, covariance, 0.0, 9.0, np.zeros(2), verdict="ambiguous")


def test_it_names_the_drive_that_tells_more():
    """A latency hardly shows where a castor does not turn; a pivot's bias shows straight on."""
    latency, bias = CANDIDATES["encoder_latency 1 None"], CANDIDATES["pivot_bias 1"]
    told = drive_for(ROBOT, answer(latency, 0.02, bias), [latency, bias], "all")
    assert told is not None
    assert told.startswith("a turn on the spot")


def test_what_is_tiny_or_of_one_name_no_drive_separates():
    assert drive_for(ROBOT, answer(RADIUS, 3e-3, TRACK), [RADIUS, TRACK], "all") is not None
    assert drive_for(ROBOT, answer(RADIUS, 1e-7, TRACK), [RADIUS, TRACK], "all") is None
    kind = CountsPerRev(castor=1, wheel=1, value=CountsPerRev.step)
    twin = Candidate(described(kind), (kind,))
    assert twin.family == RADIUS.family
    assert drive_for(ROBOT, answer(RADIUS, 3e-3, twin), [RADIUS, twin], "all") is None
    assert drive_for(ROBOT, answer(RADIUS, 3e-3, twin, TRACK), [RADIUS, twin, TRACK], "all") is not None


def test_of_what_has_no_name_nothing_is_proposed():
    assert drive_for(ROBOT, answer(RADIUS, 3e-3), [RADIUS, TRACK], "all") is None
