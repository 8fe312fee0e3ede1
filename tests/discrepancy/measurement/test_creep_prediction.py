"""What creep masks of effects: against physics in which the controller does not know of them."""

from functools import cache

import numpy as np
import pytest

from castor_envs.effects.dimensions import PivotBias, WheelRadius
from castor_envs.geometry.se2 import relative_pose
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import candidates_of
from discrepancy.measurement.creep_prediction import Slipping
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.refit import Sized, refitted
from discrepancy.trials.pymunk_generator import drive
from estimators.calibration.identifiability import COVERAGE

RADIUS = WheelRadius(castor=3, wheel=2, value=-0.1)
STEERED = PivotBias(castor=1, value=0.1)


@cache
def driven(name, effect):
    return drive(
        preset(name).with_effects(effect), wander(np.random.default_rng([5, 1]), duration=15.0), 5, duration=15.0
    )


def candidate_of(robot, effect):
    return next(candidate for candidate in candidates_of(robot) if candidate.is_of(effect))


def test_steered_wheels_disagree_as_predicted_of_an_effect_in_the_model():
    """By the description, which their controller uses, they agree; with the effect they disagree twenty times as much,
    of which the prediction leaves no more than they disagree by the description."""
    robot, log = preset("swerve"), driven("swerve", STEERED)
    plain, seen = (linearise(vehicle, [log], among=()) for vehicle in (robot, robot.with_effects(STEERED)))
    assert max(seen.disagreements[0].sizes()) < 1.1 * max(plain.disagreements[0].sizes())
    (disagreement,), (design,) = seen.disagreements, seen.designs
    whole = design.model.disagreement(design.geometry, design.state)
    whole = np.abs(np.add.reduceat(whole, np.cumsum([0, *disagreement.steps[:-1]]), axis=0))
    assert np.abs(disagreement.seen).mean() < 0.1 * (whole / np.mean(disagreement.way * disagreement.steps[0])).mean()


def test_passive_castors_show_a_smaller_disagreement_with_the_effect_in_the_model():
    robot, log = preset("asoc-prototype"), driven("asoc-prototype", RADIUS)
    plain, seen = (linearise(vehicle, [log], among=()) for vehicle in (robot, robot.with_effects(RADIUS)))
    assert max(seen.disagreements[0].sizes()) < 0.6 * max(plain.disagreements[0].sizes())


@pytest.mark.parametrize(("name", "effect"), [("asoc-prototype", RADIUS), ("swerve", STEERED)])
def test_odometry_with_predicted_creep_is_right_where_odometry_alone_is_not(name, effect):
    robot, log = preset(name).with_effects(effect), driven(name, effect)
    seen = linearise(robot, [log], among=())
    (design,) = seen.designs
    path = design.model.odometry(design.geometry)
    assert log.reference is not None
    assert seen.gap is not None
    off = relative_pose(path[0], path)[-1] - relative_pose(log.reference[0], log.reference[-1])
    assert seen.gap[0] < 2e-3
    assert np.hypot(*off[:2]) > 8 * seen.gap[0]


SMALL = [
    ("asoc-prototype", WheelRadius(castor=3, wheel=2, value=1e-4)),
    ("swerve", PivotBias(castor=1, value=1e-4)),
    ("powered-caster", WheelRadius(castor=3, wheel=1, value=1e-4)),
]


@pytest.mark.parametrize(("name", "effect"), SMALL)
def test_the_masking_slips_of_a_small_effect_are_those_of_least_power(name, effect):
    """The friction circle does not matter: the contact model has to agree with weighted least squares."""
    log, candidate = driven(name, effect), candidate_of(preset(name), effect)
    (design,) = linearise(preset(name), [log], among=[candidate]).designs
    robot = preset(name).with_effects(effect)
    predicted = Slipping(robot, design.model, log, design.state).masking(effect, candidate)[..., 0]
    linear = design.made.masked[0 : len(log) - 1][..., 0]
    product, square = np.sum(linear * predicted), np.sum(linear**2)
    assert product / np.sqrt(square * np.sum(predicted**2)) > 0.97
    assert product / square == pytest.approx(1.0, abs=0.01)


def test_a_refit_reaches_a_large_effect_that_creep_masks_in_a_step():
    log, candidate = driven("asoc-prototype", RADIUS), candidate_of(preset("asoc-prototype"), RADIUS)
    robot = preset("asoc-prototype")
    looked = []

    def look(named, start, among):
        looked.append(named)
        built = robot
        for effect in named:
            built = effect.candidate.added(built, effect.amplitudes)
        return linearise(built, [log], start=start, among=among)

    near = (Sized(candidate, np.array([-0.09])),)
    found, seen = refitted(robot, look, 0.5 * len(log), (), near, linearise(robot, [log], among=[candidate]))
    statistics, size = seen.logs[0], np.repeat(found[0].amplitudes, 2)  # creep masks it as predicted
    assert np.sum(statistics.information) ** -0.5 < 3e-4
    standard_error = np.sum(statistics.doubted(np.zeros(2), size).information) ** -0.5  # as answers state it
    assert abs(found[0].amplitudes[0] - RADIUS.value) < COVERAGE * standard_error
    assert looked[1][0].amplitudes[0] == pytest.approx(RADIUS.value, abs=1e-3)
