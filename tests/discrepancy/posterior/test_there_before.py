"""Effects that clean logs show as large, of logs with such an effect and without."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from castor_envs.effects.clocks import EncoderLatency
from castor_envs.effects.dimensions import PivotPositionX, Track, WheelRadius
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.model.refit import Sized
from discrepancy.posterior.other_logs import in_good_order
from discrepancy.trials.pymunk_generator import drive

ROBOT = preset("differential")
RADIUS = Candidate("radius", (WheelRadius(castor=1, wheel=1, value=WheelRadius.step),))
TRACK = Candidate("track", (Track(castor=1, value=Track.step),))


@cache
def clean(size):
    """Two logs of a robot with a wheel that is larger by `size`."""
    real = ROBOT.with_effects(WheelRadius(castor=1, wheel=1, value=size)) if size else ROBOT
    courses = [wander(np.random.default_rng([seed, 1]), duration=20.0, holonomic=False) for seed in (1, 2)]
    logs = [drive(real, course, seed, duration=20.0) for seed, course in enumerate(courses)]
    return logs, linearise(ROBOT, logs, among=[RADIUS, TRACK])


def of(candidate, size):
    return Sized(candidate, np.array([size]))


@pytest.mark.parametrize(("in_clean", "there"), [(0.01, True), (0.009, True), (0.004, False), (0.0, False)])
def test_an_effect_was_there_before_if_clean_logs_show_nearer_to_it_than_to_half_of_it(in_clean, there):
    found = in_good_order(ROBOT, *clean(in_clean), [of(RADIUS, 0.01)])
    assert found == (frozenset({RADIUS.family}) if there else frozenset())


def test_what_clean_logs_do_not_show_at_all_is_not_fitted_to_them(monkeypatch):
    logs, good = clean(0.0)
    monkeypatch.setattr("discrepancy.posterior.other_logs.linearise", None)
    assert in_good_order(ROBOT, logs, good, [of(RADIUS, 0.01), of(TRACK, 0.03)]) == frozenset()


def test_of_two_effects_only_the_one_that_clean_logs_show_was_there_before():
    found = in_good_order(ROBOT, *clean(0.01), [of(RADIUS, 0.01), of(TRACK, 0.03)])
    assert found == {RADIUS.family}


def test_an_effect_that_no_robot_can_have_was_not_there_before():
    assert in_good_order(ROBOT, *clean(0.0), [of(TRACK, -2.0)]) == frozenset()


@pytest.mark.parametrize("lag", [0.0, 1e-3])
def test_a_latency_that_only_looks_like_how_wheels_disagree_was_not_there_before(lag):
    """Encoders of clean logs are late by 4 to 11 times `lag`; whatever steered wheels mask of 30 or 60 ms looks like
    that."""
    robot = preset("swerve")
    late = [EncoderLatency(castor=i, wheel=1, value=lag * (3 + 2 * i)) for i in (1, 2, 3, 4)]
    drives = [wander(np.random.default_rng([seed, 1]), duration=20.0) for seed in (1, 2)]
    logs = [
        drive(robot.with_effects(*late), course, seed, duration=20.0) for seed, course in enumerate(drives, start=1)
    ]
    kind = EncoderLatency(castor=1, wheel=1, value=EncoderLatency.step)
    late = Candidate("late", (kind,))
    good = linearise(robot, logs, among=[late])
    for told in (0.03, 0.06):
        assert in_good_order(robot, logs, good, [of(late, told)]) == frozenset()


def test_clean_logs_of_which_all_has_given_way_show_no_size():
    """Without a reference, motors that steer make wheels agree with the description, whatever the robot is like: a
    module that is 70 mm farther ahead makes these logs likelier by 3 to 10, and half of that by as much, within 1."""
    robot = preset("swerve")
    drives = [wander(np.random.default_rng([seed, 1]), duration=20.0) for seed in (1, 2, 3)]
    logs = [
        dataclasses.replace(drive(robot, course, seed, duration=20.0), reference=None)
        for seed, course in enumerate(drives, start=1)
    ]
    positions = [PivotPositionX(castor=castor, value=PivotPositionX.step) for castor in (1, 2, 3, 4)]
    ahead = [Candidate("ahead", (kind,)) for kind in positions]
    good = linearise(robot, logs, among=ahead)
    for candidate in ahead:
        for size in (0.07, -0.1):
            assert in_good_order(robot, logs, good, [of(candidate, size)]) == frozenset()
