"""What logs do not show: robots whose encoders cannot contradict each other, symmetries, and drives that would help."""

import dataclasses

import numpy as np
import pytest

from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import Leg, Run, Trajectory, pivoting, umbmark, wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import n_castor, preset
from castor_envs.vehicles.robot import Gyro
from estimators.calibration.identifiability import Unseen, rests_on, scale_rests_on_pivots, unseen_of
from estimators.calibration.maximum_likelihood.calibrate import calibrate
from estimators.calibration.parameters import values_of
from estimators.likelihood.log_likelihood import Noise

SLIP = Noise(along=3e-4, across=3e-4)


def rolled(robot, trajectory, *, poses=(), theta=None):
    """A log of perfect rolling with rounded counts and reference poses at some rows."""
    run, geometry = roll(robot, trajectory, theta), Geometry.of(robot)
    phase = np.random.default_rng(0).uniform(size=len(robot.driven_wheels))
    encoders = Encoders(geometry, phase)
    reference = np.full((len(run.t), 3), np.nan)
    reference[poses] = run.pose[poses]
    counts = encoders.wheel(run.wheel_angle), encoders.pivot(run.castor_angle)
    return Log(run.t, *counts, reference=reference if len(np.atleast_1d(poses)) else None)


def straight(length=2.0):
    return Trajectory("line", (Run((Leg((1.0, 0.0, 0.0), length),), 0.25, 0.5),))


def built(robot, seed, size=0.02):
    """The robot as it truly is: radii, laterals, offsets and zeros other than described."""
    random = np.random.default_rng(seed)
    castors = tuple(
        dataclasses.replace(
            castor,
            offset=castor.offset * (1 + random.uniform(-size, size)),
            pivot_zero=castor.pivot_zero + random.uniform(-size, size),
            wheels=tuple(
                dataclasses.replace(
                    w,
                    radius=w.radius * (1 + random.uniform(-size, size)),
                    lateral=w.lateral * (1 + random.uniform(-size, size)),
                )
                for w in castor.wheels
            ),
        )
        for castor in robot.castors
    )
    return dataclasses.replace(robot, castors=castors)


@pytest.mark.parametrize("name", ["differential", "tricycle", "omni3"])
def test_robots_whose_encoders_cannot_contradict_each_other_need_reference_poses(name):
    robot = preset(name)
    log = rolled(robot, wander(np.random.default_rng(1), duration=10.0, holonomic=name == "omni3"))
    with pytest.raises(InputError, match=r"without reference poses nothing is observable .* give logs with ref_x"):
        calibrate(robot, [log])


@pytest.fixture(scope="module")
def with_pivots():
    """A base of which nobody knew anything, not even where its pivots are."""
    described = n_castor(3)
    true = built(described, 1)
    theta = np.random.default_rng(2).uniform(-np.pi, np.pi, 3)
    log = rolled(true, wander(np.random.default_rng(1), duration=40.0), theta=theta)
    return calibrate(described, [log], pivots=True, noise=SLIP)


@pytest.fixture(scope="module")
def unseen_with_pivots(with_pivots):
    return unseen_of(with_pivots)


@pytest.mark.slow
def test_four_changes_are_seen_by_no_encoder_and_have_names(with_pivots, unseen_with_pivots):
    left = {change.what: change.shown_by for change in unseen_with_pivots}
    assert set(left) == {
        "the scale (all lengths together)",
        "the direction of the body's axes",
        "the place of the body's origin, x",
        "the place of the body's origin, y",
    }
    scale = left.pop("the scale (all lengths together)")
    assert scale is not None
    assert "with reference poses" in scale
    assert set(left.values()) == {None}
    assert len(with_pivots.unseen) == 4
    np.testing.assert_allclose(with_pivots.unseen @ with_pivots.unseen.T, np.eye(4), atol=1e-9)


def test_words_say_what_would_help():
    moves = np.zeros(3)
    assert "x: " in str(Unseen("x", None, moves))
    assert "keeps the robot file's numbers" in str(Unseen("x", None, moves))
    assert "x (± 3 %): " in str(Unseen("x", None, moves, "± 3 %"))
    assert "a drive would show it" in str(Unseen("x", "a drive", moves))


@pytest.mark.slow
def test_unseen_directions_are_stated_with_intervals(with_pivots, unseen_with_pivots):
    """The file's scale is off: intervals that do not know of it miss; with the assumptions they state, they hold."""
    found, unseen = with_pivots, unseen_with_pivots
    scale = np.array([p.scale for p in found.parameters])
    geometry = Geometry.of(built(n_castor(3), 1))
    off = np.abs(found.after - values_of(geometry, found.parameters))
    missed = off > 4 * found.standard_errors
    rests = rests_on(found, unseen)
    assert missed.any()
    assert all(rests[i] for i in np.flatnonzero(missed))
    lengths = [i for i, p in enumerate(found.parameters) if p.kind in ("radius", "lateral", "offset")]
    assert all("the scale (all lengths together)" in [change.what for change in rests[i]] for i in lengths)
    wide = np.sqrt(found.standard_errors**2 + np.sum([(change.moves * scale) ** 2 for change in unseen], axis=0))
    assert np.all(off < 4 * wide)


def test_the_scale_rests_on_pivots_where_there_is_nothing_else(with_pivots):
    described = n_castor(2)
    drive = wander(np.random.default_rng(3), duration=20.0)
    without, ends = rolled(described, drive), rolled(described, drive, poses=[0, -1])
    blind = calibrate(described, [without], noise=SLIP)
    assert blind.poses == 0
    assert scale_rests_on_pivots(blind)
    tracked = calibrate(described, [ends], noise=SLIP)
    assert tracked.poses == 2
    assert not scale_rests_on_pivots(tracked)
    assert not scale_rests_on_pivots(with_pivots)
    assert not scale_rests_on_pivots(
        calibrate(preset("differential"), [rolled(preset("differential"), umbmark(), poses=slice(None))], noise=SLIP)
    )


DRIVES = {
    "a straight line of 2 m": lambda robot: [straight()],
    "a turn on the spot, both ways,": lambda robot: [pivoting((0.0, 0.0), way) for way in ("cw", "ccw")],
    "squares of 1.5 m, both ways,": lambda robot: [umbmark(way) for way in ("cw", "ccw")],
    "turns about each castor, both ways,": lambda robot: [
        pivoting(castor.pivot, way) for castor in robot.castors for way in ("cw", "ccw")
    ],
    "a random path of 60 s": lambda robot: [wander(np.random.default_rng(5), duration=60.0)],
}
POSES = {
    " without reference poses": (),
    " with reference poses at start and end": [0, -1],
    " with reference poses throughout": slice(None),
}


def proposed(robot, words):
    """Logs of the drive that `shown_by` names."""
    (poses,) = [ending for ending in POSES if words.endswith(ending)]
    return [rolled(robot, drive, poses=POSES[poses]) for drive in DRIVES[words.removesuffix(poses)](robot)]


@pytest.mark.slow
def test_a_straight_line_shows_radii_against_each_other_and_nothing_of_offsets():
    described = n_castor(3)
    true = built(described, 4)
    line = rolled(true, straight(3.0))
    found = calibrate(described, [line], noise=SLIP)
    of = {kind: np.array([p.kind == kind for p in found.parameters]) for kind in ("radius", "offset", "lateral")}
    radii, actual = found.after[of["radius"]], np.array([w.radius for w in true.wheels])
    error = found.standard_errors[of["radius"]] / radii
    away = np.log(radii / actual) - np.mean(np.log(radii / actual))
    assert np.all(np.abs(away) < 4 * error.max())
    assert np.abs(away).max() < 1e-3
    for kind in ("offset", "lateral"):
        np.testing.assert_allclose(found.after[of[kind]], found.before[of[kind]], rtol=1e-5)
        assert np.all(found.standard_errors[of[kind]] < 1e-6)
    np.testing.assert_allclose(radii.mean(), found.before[of["radius"]].mean(), rtol=1e-3)
    scale = np.array([p.scale for p in found.parameters])
    np.testing.assert_allclose(found.unseen @ ((found.after - found.before) / scale), 0.0, atol=1e-9)
    left = unseen_of(found)
    words = {change.shown_by for change in left}
    assert left
    assert None not in words
    for drive in words:
        again = calibrate(described, [line, *proposed(true, drive)], noise=SLIP)
        still = {change.what for change in unseen_of(again)}
        assert not still & {change.what for change in left if change.shown_by == drive}


def test_a_drive_to_add_is_proposed_for_a_differential_robot():
    robot = preset("differential")
    logs = [rolled(robot, straight(), poses=[0, -1])]
    found = calibrate(robot, logs, noise=SLIP)
    left = unseen_of(found)
    helped = [change.shown_by for change in left if change.shown_by is not None]
    assert helped
    assert all("with reference poses" in words for words in helped)
    again = calibrate(robot, [*logs, *(log for words in helped for log in proposed(robot, words))], noise=SLIP)
    assert {change.what for change in unseen_of(again)} == {"the place of the body's origin, y"}


def test_a_gyro_shows_the_track_in_a_turn_without_reference_poses():
    for gyro, reference in (
        (None, "with reference poses at start and end"),
        (Gyro(noise=2e-3), "without reference poses"),
    ):
        robot = dataclasses.replace(preset("differential"), gyro=gyro)
        log = rolled(robot, straight(), poses=slice(None))
        if gyro is not None:
            noise = gyro.noise * np.random.default_rng(0).standard_normal(len(log.t))
            log = dataclasses.replace(log, gyro=noise)
        track = [unseen for unseen in unseen_of(calibrate(robot, [log], noise=SLIP)) if "lateral" in unseen.what]
        assert [unseen.shown_by for unseen in track] == [f"a turn on the spot, both ways, {reference}"]
