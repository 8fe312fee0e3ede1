"""Effects that clean logs show as large, of logs with such an effect and without."""

from functools import cache

import numpy as np
import pytest

from castor_envs.effects.dimensions import Track, WheelRadius
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
    return logs, linearise(ROBOT, logs, among=())


def of(candidate, size):
    return Sized(candidate, np.array([size]))


@pytest.mark.parametrize(("in_clean", "there"), [(0.01, True), (0.009, True), (0.004, False), (0.0, False)])
def test_an_effect_was_there_before_if_clean_logs_show_nearer_to_it_than_to_half_of_it(in_clean, there):
    found = in_good_order(ROBOT, *clean(in_clean), [of(RADIUS, 0.01)])
    assert found == (frozenset({RADIUS.family}) if there else frozenset())


def test_of_two_effects_only_the_one_that_clean_logs_show_was_there_before():
    found = in_good_order(ROBOT, *clean(0.01), [of(RADIUS, 0.01), of(TRACK, 0.03)])
    assert found == {RADIUS.family}


def test_an_effect_that_no_robot_can_have_was_not_there_before():
    assert in_good_order(ROBOT, *clean(0.0), [of(TRACK, -2.0)]) == frozenset()
