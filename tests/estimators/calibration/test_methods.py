"""The calibration methods of this package, and how others are plugged in."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from castor_envs.errors import Declined, InputError
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import pivoting, umbmark
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.axle import with_axle
from castor_envs.vehicles.presets import differential, n_castor, preset
from estimators.calibration.likelihood_method import MaximumLikelihoodMethod
from estimators.calibration.pivoting import PivotingMethod
from estimators.calibration.protocol import CalibrationMethod, Recording
from estimators.calibration.umbmark import UMBmarkMethod
from estimators.calibration.uncalibrated import Uncalibrated
from estimators.plugins.registry import CALIBRATION, load_calibration, load_estimator


def log_of(robot, trajectory, theta=None):
    rolled, geometry = roll(robot, trajectory, theta), Geometry.of(robot)
    encoders = Encoders(geometry, np.full(len(robot.driven_wheels), 0.4))
    return Log(rolled.t, encoders.wheel(rolled.wheel_angle), encoders.pivot(rolled.castor_angle), reference=rolled.pose)


@pytest.fixture(scope="module")
def turns():
    """Return recordings of a two-castor base that turns about each castor, both ways."""
    robot = n_castor(2)
    return robot, [
        Recording(log_of(robot, pivoting(robot.castors[held - 1].pivot, way, angle=2.5 * np.pi), np.zeros(2)), held)
        for held in (1, 2)
        for way in ("cw", "ccw")
    ]


@pytest.fixture(scope="module")
def squares():
    """Return a differential robot whose wheel base is 1 % wider than described, and its squares both ways."""
    true = with_axle(differential(counts_per_rev=20000.0), 0.34 * 1.01, 0.15, 0.15)
    return true, [Recording(log_of(true, umbmark(way)), side=1.5) for way in ("cw", "ccw")]


@pytest.mark.parametrize("name", CALIBRATION.built_in)
def test_built_in_methods_are_found_by_name(name):
    entry = load_calibration(name)
    assert isinstance(entry.factory(), CalibrationMethod)
    assert entry.builtin
    again = pickle.loads(pickle.dumps(entry))
    assert (again.name, again.spec, again.source_hash) == (name, name, entry.source_hash)


def test_every_built_in_method_has_a_hash_of_its_own():
    entries = [load_calibration(name) for name in CALIBRATION.built_in]
    assert {entry.kind for entry in entries} == {Uncalibrated, PivotingMethod, UMBmarkMethod, MaximumLikelihoodMethod}
    assert len({entry.source_hash for entry in entries}) == len(entries)


def test_uncalibrated_changes_nothing():
    robot = preset("asoc-prototype")
    assert Uncalibrated().calibrate(robot, []) == robot


def test_pivoting_finds_the_robot_and_the_held_castor_where_nobody_named_it(turns):
    true, recordings = turns
    wheels = with_first_radius(true, 0.04)
    named = PivotingMethod().calibrate(wheels, recordings)
    assert PivotingMethod().calibrate(wheels, [Recording(recording.log) for recording in recordings]) == named
    for castor, expected in zip(named.castors, true.castors, strict=True):
        assert castor.offset == pytest.approx(expected.offset, rel=5e-3)
        for wheel, expected_wheel in zip(castor.wheels, expected.wheels, strict=True):
            assert wheel.radius == pytest.approx(expected_wheel.radius, rel=1e-3)


def with_first_radius(robot, radius):
    data = robot.to_dict()
    data["castors"][0]["wheels"][0]["radius"] = radius
    return type(robot).from_dict(data)


def test_squares_tell_the_wheel_base(squares):
    _, recordings = squares
    found = UMBmarkMethod().calibrate(differential(counts_per_rev=20000.0), recordings)
    left, right = found.castors[0].wheels
    assert left.lateral - right.lateral == pytest.approx(0.34 * 1.01, rel=1e-3)


def test_methods_decline_what_is_not_for_them(turns, squares):
    base, driven = turns
    robot, closed = squares
    with pytest.raises(Declined, match="one castor"):
        PivotingMethod().calibrate(robot, closed)
    with pytest.raises(Declined, match="needs UMBmark squares of one side; sides of these recordings: none"):
        UMBmarkMethod().calibrate(base, driven)
    mixed = [*closed, Recording(closed[0].log, side=2.0)]
    with pytest.raises(Declined, match=r"1\.5 m, 2 m"):
        UMBmarkMethod().calibrate(robot, mixed)


MINE = """
class Mine:
    def calibrate(self, robot, recordings):
        return robot

class MyEstimator:
    def reset(self, robot, pose): ...
    def update(self, observation): ...
"""


def test_a_file_may_hold_an_estimator_and_a_method(tmp_path):
    file = tmp_path / "both.py"
    file.write_text(MINE)
    assert load_calibration(str(file)).name == "both:Mine"
    assert load_estimator(str(file)).name == "both:MyEstimator"
    with pytest.raises(InputError, match="class MyEstimator has no method calibrate"):
        load_calibration(f"{file}:MyEstimator")


def test_an_edited_method_has_another_hash(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(MINE)
    before = load_calibration(f"{file}:Mine").source_hash
    file.write_text(MINE.replace("return robot", "return None"))
    assert load_calibration(f"{file}:Mine").source_hash != before


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("pivotting", r"unknown calibration method 'pivotting'; did you mean 'pivoting'\?"),
        ("cast-0", "unknown calibration method 'cast-0'"),
        ("nowhere.py", r"nowhere\.py: cannot be read"),
        (":Mine", "calibration method ':Mine': expected module:Class"),
    ],
)
def test_a_wrong_name_says_what_to_do(spec, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=said):
        load_calibration(spec)
    assert not list(Path().iterdir())


def test_an_empty_file_says_what_a_method_is(tmp_path):
    (tmp_path / "empty.py").write_text("")
    with pytest.raises(InputError, match="a calibration method is a class with calibrate"):
        load_calibration(str(tmp_path / "empty.py"))
