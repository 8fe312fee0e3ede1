"""The drive that separates two effects is one that does, and is new; none separates an effect from itself."""

import json
from functools import cache

import numpy as np
import pytest

from castor_envs.cli import command_line
from castor_envs.effects.dimensions import CountsPerRev, WheelRadius
from castor_envs.logs.csv import write_log
from castor_envs.logs.trajectory_files import read_drive
from castor_envs.motion.trajectories import Leg, Run, Trajectory
from castor_envs.vehicles.presets import preset
from discrepancy import cli, discriminating_drive
from discrepancy.discriminating_drive import _has_driven, separating_drives
from discrepancy.hypotheses.candidates import Candidate, candidates_of, described
from discrepancy.posterior.answers import Answer
from discrepancy.posterior.linearise import linearise
from discrepancy.trials.cases import motion
from discrepancy.trials.pymunk_generator import drive
from estimators.calibration.drives import DRIVES, log_of

ROBOT = preset("asoc-prototype")
CANDIDATES = {candidate.family: candidate for candidate in reversed(candidates_of(ROBOT))}
RADIUS, TRACK = CANDIDATES["wheel_radius 1 1"], CANDIDATES["track 1"]
ECCENTRIC = CANDIDATES["pivot_eccentricity 1"], CANDIDATES["pivot_eccentricity 2"]


rolled = cache(log_of)
"""The log of a drive, rolled once for all tests."""


@pytest.fixture(autouse=True)
def _few_drives(monkeypatch):
    few = {name: make for name, make in DRIVES.items() if "2 m" in name or "on the spot" in name}
    assert len(few) == 2
    monkeypatch.setattr(discriminating_drive, "DRIVES", few)
    monkeypatch.setattr(discriminating_drive, "SEEDS", ())
    monkeypatch.setattr(discriminating_drive, "log_of", rolled)


def answer(candidate, size, *others):
    names = tuple(effect.family for effect in (candidate, *others))
    amplitudes, covariance = np.zeros(candidate.columns), np.zeros((candidate.columns, candidate.columns))
    amplitudes[0] = size
    told = dict.fromkeys(names, 1 / len(names))
    return Answer(told, names, False, candidate, amplitudes, covariance, np.zeros(2), verdict="ambiguous")


def proposed(candidate, size, *others, driven, among=None):
    """Return what is proposed after a drive, if such candidates are looked at; None: these."""
    seen = looked_at(driven, tuple(among or (candidate, *others)))
    return separating_drives(ROBOT, [answer(candidate, size, *others)], seen)[0]


@cache
def looked_at(driven, among):
    """Return what a drive says of candidates."""
    logs = [rolled(ROBOT, path, "all") for name, make in DRIVES.items() if driven in name for path in make(ROBOT)]
    return linearise(ROBOT, logs, among=among)


def only(monkeypatch, drive_name):
    """Let only one drive be asked for."""
    (name,) = (name for name in DRIVES if drive_name in name)
    monkeypatch.setattr(discriminating_drive, "DRIVES", {name: DRIVES[name]})


def test_the_drive_with_the_largest_bayes_factor_is_proposed(monkeypatch):
    told, alone = proposed(RADIUS, 12e-3, TRACK, driven="squares"), []
    assert told is not None
    for name in list(discriminating_drive.DRIVES):
        only(monkeypatch, name)
        alone += [drive for drive in [proposed(RADIUS, 12e-3, TRACK, driven="squares")] if drive is not None]
    best = max(alone, key=lambda drive: drive.expected)
    assert (told.what, told.expected) == (best.what, best.expected)
    assert told.expected > np.log(19)


@pytest.mark.parametrize(
    ("candidate", "size", "other", "driven"),
    [(RADIUS, 12e-3, TRACK, "squares"), (ECCENTRIC[0], 0.05, ECCENTRIC[1], "random path")],
    ids=["one amplitude", "two amplitudes"],
)
def test_twice_the_effect_has_four_times_the_log_bayes_factor(monkeypatch, candidate, size, other, driven):
    monkeypatch.setattr(discriminating_drive, "DRIVES", {})
    monkeypatch.setattr(discriminating_drive, "SEEDS", (1,))
    once, twice = (proposed(candidate, k * size, other, driven=driven) for k in (1, 2))
    assert once is not None
    assert twice is not None
    assert twice.expected == pytest.approx(4 * once.expected)


def test_a_drive_that_hides_one_of_the_effects_is_not_proposed(monkeypatch):
    """What repeats with a castor's angle does not show where the castor hardly turns."""
    only(monkeypatch, "2 m")
    first, second = ECCENTRIC
    assert proposed(first, 0.05, second, driven="random path") is None
    monkeypatch.setattr(discriminating_drive, "SEEDS", (1,))
    assert proposed(first, 0.05, second, driven="random path") is not None


def test_a_drive_of_the_logs_is_not_proposed(monkeypatch):
    only(monkeypatch, "on the spot")
    assert proposed(RADIUS, 12e-3, TRACK, driven="squares") is not None
    (turns,) = discriminating_drive.DRIVES.values()
    monkeypatch.setattr(discriminating_drive, "DRIVES", {"a turn": lambda robot: turns(robot)[:1]})
    assert proposed(RADIUS, 12e-3, TRACK, driven="squares") is not None
    assert proposed(RADIUS, 12e-3, TRACK, driven="on the spot") is None


def test_a_drive_is_recognised_at_any_speed_and_place():
    def poses(*runs, start=(0.0, 0.0, 0.0)):
        path = Trajectory("", runs, start)
        return path.at(np.linspace(-1.0, path.duration + 1.0, 300))[0]

    def line(length, speed):
        return Run((Leg((1.0, 0.0, 0.0), length),), speed, 0.5)

    turn = Run((Leg((0.0, 0.0, 1.0), 2.0),), 0.5, 1.0)
    asked, square = poses(line(2.0, 0.25)), DRIVES["squares of 1.5 m, both ways,"](ROBOT)[0]
    for same in (line(2.0, 0.25),), (line(2.0, 0.1),), (line(3.0, 0.25),), (line(2.0, 0.25), turn):
        assert _has_driven(poses(*same, start=(1.0, 2.0, 3.0)), asked, 0.1)
    for other in (line(1.0, 0.25),), square.runs, (turn, line(2.0, 0.25)):
        assert not _has_driven(poses(*other), asked, 0.1)


def test_no_drive_separates_tiny_effects_or_effects_of_one_family():
    assert proposed(RADIUS, 1e-7, TRACK, driven="squares") is None
    kind = CountsPerRev(castor=1, wheel=1, value=CountsPerRev.step)
    twin = Candidate(described(kind), (kind,))
    assert twin.family == RADIUS.family
    assert proposed(RADIUS, 12e-3, twin, driven="squares") is None
    assert proposed(RADIUS, 12e-3, twin, TRACK, driven="squares") is not None


def test_nothing_is_proposed_for_a_single_effect():
    assert proposed(RADIUS, 12e-3, among=[RADIUS, TRACK], driven="squares") is None


@pytest.mark.slow
def test_the_proposed_drive_names_what_circles_cannot(tmp_path, capsys):
    """By the command, its file and a second log; scripts/studies/study_separating_drives.py measures how often."""
    robot, log = preset("differential"), tmp_path / "first.csv"
    real = robot.with_effects(WheelRadius(castor=1, wheel=1, value=-0.004))
    first = drive(real, motion(robot, "circles", 2, 20.0), 4, duration=20.0)
    write_log(log, first, robot)
    data = call(capsys, log, "--robot", "differential", "--separate", tmp_path / "drive.csv")
    (ambiguous,) = data["answers"]
    assert {"wheel_radius 1 1", "track 1"} <= set(ambiguous["credible_set"])
    told = ambiguous["separating_drive"]
    assert told["expected_log_bayes_factor"] > np.log(19)
    asked = read_drive(tmp_path / "drive.csv")
    assert asked.duration == pytest.approx(told["duration_s"], abs=robot.sample_period)
    second = drive(real, asked, 5, duration=asked.duration)
    write_log(tmp_path / "second.csv", second, robot)
    again = call(capsys, log, tmp_path / "second.csv", "--robot", "differential", "--separate", tmp_path / "no.csv")
    (named,) = [answer for answer in again["answers"] if answer["verdict"] != "negligible"]
    assert (named["verdict"], named["credible_set"]) == ("named", ["wheel_radius 1 1"])
    assert not (tmp_path / "no.csv").exists()
    assert again["separating_drive_file"] is None


def test_a_file_that_exists_is_not_overwritten(tmp_path, capsys):
    there = tmp_path / "there.csv"
    there.write_text("mine")
    with pytest.raises(SystemExit) as ended:
        command_line.run(cli.app, list(map(str, (tmp_path / "a.csv", "--robot", "differential", "--separate", there))))
    assert ended.value.code == 2
    assert "is there already" in capsys.readouterr().err
    assert there.read_text() == "mine"


def call(capsys, *arguments):
    """Return what the command prints as JSON."""
    with pytest.raises(SystemExit) as ended:
        command_line.run(cli.app, [*map(str, arguments), "--json"])
    out = capsys.readouterr().out
    assert ended.value.code == 0
    return json.loads(out)
