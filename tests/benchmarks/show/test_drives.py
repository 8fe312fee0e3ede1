"""A drive as it is shown: errors, ways and slip of arcs that are known in closed form."""

import dataclasses

import numpy as np
import pytest

from benchmarks.show.drives import drive_of, drives_of
from benchmarks.show.follow import failures, follow, poses
from benchmarks.show.slip import Slips, slips_of
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import umbmark
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from estimators.plugins.registry import load_estimator

SPEED, RATE = 0.5, 0.4
"""m/s and rad/s of the fake task's arcs."""


def found_slips(drive) -> Slips:
    """Return the slips of a drive that is long enough for them."""
    slips = slips_of(drive)
    assert slips is not None
    return slips


@pytest.fixture
def arcs(fake_tasks):
    return fake_tasks.Arcs(samples=201)


def test_errors_and_ways_are_those_of_arcs(arcs, plugin, jobs_here):
    """Wheels too large by e turn too far by e on the same circle of radius R: the chord is 2 R sin(e psi / 2)."""
    drives = drives_of(arcs.record(4))
    answers = follow(drives, [load_estimator(plugin("followers:Follower"))], 60.0)
    assert not failures(answers)
    drive = drives[0].followed(poses(answers, 0))
    t = drive.log.t[drive.samples]
    position, heading = drive.errors("followers:Follower")
    np.testing.assert_allclose(position, 2 * SPEED / RATE * np.sin(5e-3 * RATE * t / 2), atol=3e-5)  # steps are chords
    np.testing.assert_allclose(heading, -5e-3 * RATE * t, atol=1e-9)  # clockwise
    np.testing.assert_allclose(drive.way, SPEED * t, rtol=1e-4)  # chords of 50 ms
    assert drive.known.all()


def test_who_declines_or_fails_is_told_with_the_reason(arcs, plugin, jobs_here):
    entries = [load_estimator(plugin("faulty:Raises")), load_estimator("cast-0")]
    told = failures(follow(drives_of(arcs.record(0)), entries, 60.0))
    assert list(told) == ["faulty:Raises", "cast-0"]
    assert "raised" in told["faulty:Raises"]
    assert told["cast-0"].startswith("declined: ")


def without_reference(log, rows):
    """Return a log whose reference is blank in some rows."""
    reference = np.array(log.reference)
    reference[rows] = np.nan
    return dataclasses.replace(log, reference=reference)


def test_a_log_begins_where_its_reference_does(arcs):
    log = arcs.record(0).runs[0].log
    drive = drive_of("log", arcs.robot, without_reference(log, slice(0, 30)))
    assert len(drive.log) == len(log) - 30
    np.testing.assert_array_equal(drive.start, log.reference[30])


def test_positions_alone_are_followed_from_the_heading_that_they_show(arcs):
    log = arcs.record(0).runs[0].log
    positions = dataclasses.replace(log, reference=log.reference * [1.0, 1.0, np.nan])
    drive = drive_of("log", arcs.robot, positions)
    np.testing.assert_allclose(drive.start, log.reference[0], atol=5e-3)
    assert drive.known.all()
    assert not drive.headed.any()
    position, heading = drive.followed({"at": drive.truth + np.array([3.0, 4.0, 0.0])}).errors("at")
    np.testing.assert_allclose(position, 5.0)
    assert np.isnan(heading).all()
    assert found_slips(drive).slip is None


def test_without_a_dense_reference_the_wheels_tell_the_way_and_nothing_the_slip(arcs):
    log = arcs.record(0).runs[0].log
    for blank in (slice(0, None), slice(1, -1)):
        drive = drive_of("log", arcs.robot, without_reference(log, blank))
        assert not drive.dense
        np.testing.assert_allclose(drive.way, SPEED * log.t[drive.samples], rtol=1e-9)
        assert found_slips(drive).slip is None


def asoc_square(change=None):
    """Return the drive of a base on three castors round a square, its counts exact; change: of counts (K, 6) at t."""
    robot = preset("asoc-prototype")
    truth = roll(robot, umbmark("ccw", side=0.5))
    geometry = Geometry.of(robot)
    counts = truth.wheel_angle / (2 * np.pi) * geometry.counts_per_rev
    if change is not None:
        counts = counts + change(truth.t, geometry)
    pivot = Encoders(geometry, np.zeros(6)).pivot(truth.castor_angle)
    return drive_of("square", robot, Log(truth.t, counts, pivot, reference=truth.pose))


def test_perfect_rolling_neither_slips_nor_disagrees():
    slips = found_slips(asoc_square())
    assert slips.parts == ("castor 1", "castor 2", "castor 3")
    assert slips.slip is not None
    assert slips.slip.max() < 2e-4  # pivots are read to a count, and counts are integrated over 50 ms
    assert slips.disagreement.max() < 2e-4
    assert not slips.worst()


def test_slip_is_as_large_as_it_was_and_named_where_it_was():
    """Both wheels of castor 2 roll 10 mm too far within one window."""

    def spin(t, geometry):
        far = 0.01 * np.clip((t - 3.0) / 0.5, 0, 1)[:, None] * np.array([0, 0, 1, 1, 0, 0])
        return far / (2 * np.pi * geometry.radius) * geometry.counts_per_rev

    drive = asoc_square(spin)
    slips = found_slips(drive)
    first, *others = slips.worst()
    assert (first.part, others) == ("castor 2", [])
    assert first.slip == pytest.approx(0.01 * np.sqrt(2), rel=0.02)
    assert first.t == pytest.approx(3.25, abs=0.02)
    k = int(np.argmin(np.abs(drive.log.t[drive.samples] - 3.25)))
    x, y, psi = drive.truth[k]
    px, py = preset("asoc-prototype").castors[1].pivot
    there = (x + np.cos(psi) * px - np.sin(psi) * py, y + np.sin(psi) * px + np.cos(psi) * py)
    assert (first.x, first.y) == pytest.approx(there, abs=1e-3)
    k, part = np.unravel_index(np.argmax(slips.disagreement), slips.disagreement.shape)
    assert (slips.parts[part], slips.t[k]) == ("castor 2", pytest.approx(first.t))


def test_an_axle_of_a_train_that_slips_is_named(fake_trains):
    """The wheels of axle 2 roll 5 mm too far within one window."""
    episode = fake_trains.moving_train(samples=81)
    log, wheel = episode.runs[0].log, episode.robot.modules[1].wheels[0]
    far = 0.005 * np.clip((log.t - 2.0) / 0.5, 0, 1) / (2 * np.pi * wheel.radius) * wheel.counts_per_rev
    counts = log.wheel + far[:, None] * [0, 0, 1, 1, 0, 0]
    slips = found_slips(drive_of("log", episode.robot, dataclasses.replace(log, wheel=counts)))
    assert slips.parts == ("axle 1", "axle 2", "axle 3")
    (place,) = slips.worst()
    assert (place.part, place.slip) == ("axle 2", pytest.approx(0.005 * np.sqrt(2), rel=1e-3))
    assert (place.x, place.y) == (pytest.approx(0.4 * 2.25 + 0.35, abs=0.02), pytest.approx(0.0))
    assert not slips.disagreement.any()


def test_a_log_that_is_shorter_than_a_window_has_no_slip(arcs):
    log = Log(np.array([0.0, 0.1]), np.zeros((2, 2)), np.empty((2, 0)))
    assert slips_of(drive_of("log", arcs.robot, log)) is None


def test_where_the_reference_has_a_gap_nothing_slips_and_lines_end():
    """A tracker that starts late, loses the robot for 2 s and ends early says nothing of slip then."""
    whole = asoc_square().log
    blank = (whole.t < 3.0) | ((whole.t > 8.0) & (whole.t < 10.0)) | (whole.t > whole.t[-1] - 1.0)
    drive = drive_of("log", preset("asoc-prototype"), without_reference(whole, blank))
    slips = found_slips(drive)
    assert slips.slip is not None
    assert not slips.worst()
    assert np.nanmax(slips.slip) < 2e-4
    np.testing.assert_array_equal(np.isnan(slips.slip).all(axis=1), np.isnan(slips.slip).any(axis=1))
    assert np.isnan(slips.slip[(slips.t > 8.3) & (slips.t < 9.7)]).all()
    assert np.isnan(slips.slip[-1]).all()
    path = drive.path()
    (gap,) = np.flatnonzero(np.isnan(path[:, 0]))
    assert 0 < gap < len(path) - 1
    way, error = drive.against_way(np.where(drive.known, 0.0, np.nan))
    assert np.isnan(error).sum() == 1
    assert np.all(np.diff(way) >= 0)


def test_a_reference_that_is_taken_less_often_than_encoders_has_no_gaps(arcs):
    log = arcs.record(0).runs[0].log
    drive = drive_of("log", arcs.robot, without_reference(log, np.arange(len(log)) % 4 > 0))
    assert drive.dense
    assert np.isfinite(drive.path()).all()
