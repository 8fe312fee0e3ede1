"""Held-out logs of an eccentric wheel that points elsewhere when they start."""

import numpy as np
import pytest

from castor_envs.effects.encoders import WheelEccentricity
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.diagnose import diagnosed, examine
from discrepancy.hypotheses.candidates import candidates_of
from discrepancy.posterior.model.refit import Sized
from discrepancy.posterior.other_logs import in_phase
from discrepancy.preflight.undo import Undone
from discrepancy.trials.pymunk_generator import drive

ROBOT = preset("differential")
SIZE = 0.05


def eccentric(phase, seed):
    """A log whose right wheel, at its start, points elsewhere by the phase."""
    course = wander(np.random.default_rng([seed, 1]), duration=25.0, holonomic=False)
    effect = WheelEccentricity(castor=1, wheel=2, value=SIZE, phase=phase)
    return drive(ROBOT.with_effects(effect), course, seed, duration=25.0)


def test_wheels_are_turned_by_a_whole_number_of_counts_to_the_phase_of_the_effect():
    candidate = next(one for one in candidates_of(ROBOT) if one.family == "wheel_eccentricity 1 2")
    named = [Sized(candidate, SIZE * np.array([np.cos(0.4), np.sin(0.4)]))]
    log = eccentric(2.4, 4)
    (turned,) = in_phase(ROBOT, [log], named, creep=None, jitter=0.0)
    added = turned.wheel - log.wheel
    assert np.all(added == added[0])
    assert np.all(added == np.round(added))
    assert added[0, 0] == 0
    assert 2 * np.pi * added[0, 1] / ROBOT.wheels[1].counts_per_rev == pytest.approx(-2.0, abs=0.1)


def test_an_eccentric_wheel_is_confirmed_by_a_run_that_starts_with_another_phase():
    logs, held_out = {"log": eccentric(0.4, 3)}, {"other": eccentric(2.4, 4)}
    found = examine(ROBOT, logs, held_out, {})
    assert [answer["verdict"] for answer in found.data["answers"]] == ["named"]
    assert found.data["answers"][0]["size"] == pytest.approx(SIZE, rel=0.1)
    before, after = found.data["held_out_gap"]
    assert after[0] < 0.75 * before[0]  # 1.4 mm is the noise of the reference


def test_an_eccentric_wheel_of_another_size_is_not_confirmed():
    straight = drive(ROBOT, wander(np.random.default_rng([4, 1]), duration=25.0, holonomic=False), 4, duration=25.0)
    found = diagnosed(Undone(ROBOT, {"log": eccentric(0.4, 3)}, {"other": straight}, {}))
    assert all(answer.verdict != "named" for answer in found.answers)
