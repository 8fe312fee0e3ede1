"""Counts that an encoder loses at speed are found where no linear signature shows them."""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from castor_envs.effects.dimensions import WheelRadius
from castor_envs.effects.encoders import TickLoss
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.trajectories import Leg, Run, Trajectory, wander
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import Candidate, candidates_of, described, signatures_of
from discrepancy.posterior.finder import diagnose
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.model.refit import Sized, with_effects
from discrepancy.posterior.model.search import Search
from discrepancy.posterior.variances.lost import _is_radius, as_one_loss, lossy_above, lossy_encoders, of_same_wheel
from discrepancy.posterior.verdicts import MATERIAL
from discrepancy.trials.pymunk_generator import drive
from estimators.likelihood.log_likelihood import LogLikelihood

ROBOT = preset("omni3")
LOSS = TickLoss(castor=1, wheel=1, value=0.2, above=5.0)


@cache
def log_of(seed, *effects):
    """A log of straight ways at 0.28 m/s, on some of which wheel 1 turns by up to 5.5 rad/s, and reads 4.4 at most."""
    random = np.random.default_rng(seed)
    ways = np.append(ROBOT.castors[0].angle, random.uniform(-math.pi, math.pi, 5)).tolist()
    legs = [Leg((math.cos(way), math.sin(way), random.uniform(-0.3, 0.3)), 1.0) for way in ways]
    motion = Trajectory("straight ways", tuple(Run((leg,), 0.28, 0.5) for leg in legs))
    return drive(ROBOT.with_effects(*effects), motion, seed, duration=motion.duration)


def test_counts_lost_at_speeds_that_the_fitted_wheel_does_not_reach_are_named():
    """Without, a wheel too small by an eighth is named, and three quarters of the gap stay."""
    found = diagnose(ROBOT, [log_of(1, LOSS)], [log_of(2, LOSS)])
    (answer,) = found.answers
    assert (found.verdict, answer.credible) == ("named", ("tick_loss 1 1 forward",))
    assert answer.size == pytest.approx(LOSS.value, rel=0.05)
    assert found.held_out is not None
    assert gap_of(found.held_out[1]) < 0.1 * gap_of(found.held_out[0])


def test_counts_lost_at_speed_do_not_pass_for_a_wheel_that_slips_at_a_time():
    robot = preset("asoc-full-scale")
    loss = TickLoss(castor=3, wheel=2, value=0.3, above=robot.max_wheel_speed / 4)
    drives = (wander(np.random.default_rng([16, k]), duration=30.0) for k in (1, 2))
    log, held_out = (drive(robot.with_effects(loss), motion, k, duration=30.0) for k, motion in enumerate(drives))
    (answer,) = diagnose(robot, [log], [held_out]).answers
    assert (answer.verdict, answer.credible) == ("named", ("tick_loss 3 2 forward",))
    assert answer.size == pytest.approx(loss.value, rel=0.02)


def test_the_speed_from_which_on_counts_are_lost_is_found():
    """The catalogue's quarter of the top speed is 7.5 rad/s, which this wheel does not reach: by that, it is too small,
    or slips."""
    loss = TickLoss(castor=1, wheel=1, value=0.05, above=3.0, direction="both")
    found = diagnose(ROBOT, [log_of(3, loss)], [log_of(4, loss)])
    (answer,) = found.answers
    assert (found.verdict, answer.credible) == ("named", ("tick_loss 1 1 both",))
    assert answer.size == pytest.approx(loss.value, rel=0.1)
    assert isinstance(answer.effect, TickLoss)
    assert answer.effect.above == pytest.approx(loss.above, rel=0.15)


def test_the_speed_is_found_where_encoders_contradict_each_other():
    """The catalogue's quarter of the top speed is 5 rad/s."""
    robot = preset("asoc-prototype")
    loss = TickLoss(castor=2, wheel=1, value=0.02, above=6.4)
    logs = [drive(robot.with_effects(loss), wander(np.random.default_rng([17, 1]), duration=20.0), 1, duration=20.0)]

    def look(effects, among):
        return linearise(with_effects(robot, effects), logs, among=among)

    found = lossy_above(robot, logs, (), look, -8.0)
    assert found is not None
    (sized,) = found
    assert isinstance(sized.effect, TickLoss)
    assert (sized.effect.castor, sized.effect.wheel, sized.effect.direction) == (2, 1, "forward")
    assert sized.effect.above == pytest.approx(loss.above, rel=0.05)


def test_a_loss_above_another_speed_than_the_catalogue_s_is_one_loss():
    """The catalogue's is 5 rad/s: losses above that and above 4.2 rad/s were named, of 3.7 and 1.4 %."""
    robot = preset("5-castor")
    loss = TickLoss(castor=5, wheel=2, value=0.05, above=4.4)
    drives = (wander(np.random.default_rng([18, k]), duration=30.0) for k in (1, 2))
    log, held_out = (drive(robot.with_effects(loss), motion, k, duration=30.0) for k, motion in enumerate(drives))
    (answer,) = diagnose(robot, [log], [held_out]).answers
    assert (answer.verdict, answer.credible) == ("named", ("tick_loss 5 2 forward",))
    assert answer.size == pytest.approx(loss.value, rel=0.02)
    assert isinstance(answer.effect, TickLoss)
    assert answer.effect.above == pytest.approx(loss.above, rel=0.02)


def test_a_loss_far_below_the_catalogue_s_speed_is_refined_from_the_best_of_all_speeds():
    """From 5 rad/s a search by halves ends at 4.2, with a loss that is too large."""
    robot = preset("asoc-prototype")
    loss = TickLoss(castor=2, wheel=1, value=0.048, above=2.2, direction="backward")
    logs = [drive(robot.with_effects(loss), wander(np.random.default_rng([17, 1]), duration=20.0), 1, duration=20.0)]
    catalogue = replace(loss, above=5.0)

    def look(effects, among):
        return linearise(with_effects(robot, effects), logs, among=among)

    (found,) = as_one_loss(robot, logs, [Sized(Candidate(described(catalogue), (catalogue,)), np.array([0.05]))], look)
    assert isinstance(found.effect, TickLoss)
    assert found.effect.above == pytest.approx(loss.above, rel=0.1)


def test_losses_of_a_wheel_forward_and_backward_are_one():
    robot = preset("asoc-prototype")
    loss = TickLoss(castor=2, wheel=1, value=0.02, above=6.4, direction="both")
    logs = [drive(robot.with_effects(loss), wander(np.random.default_rng([17, 1]), duration=20.0), 1, duration=20.0)]
    ways = [replace(loss, above=above, direction=way) for above, way in ((5.0, "forward"), (6.0, "backward"))]
    radius = Sized(Candidate("radius", (WheelRadius(castor=1, wheel=1, value=0.001),)), np.array([1e-4]))
    named = [*(Sized(Candidate(described(way), (way,)), np.array([way.value])) for way in ways), radius]

    def look(effects, among):
        return linearise(with_effects(robot, effects), logs, among=among)

    kept, both = as_one_loss(robot, logs, named, look)
    assert (kept.candidate, both.candidate.family) == (radius.candidate, "tick_loss 2 1 both")
    assert abs(kept.size) < 1e-4
    assert isinstance(both.effect, TickLoss)
    assert both.effect.above == pytest.approx(loss.above, rel=0.05)


def test_above_another_speed_a_loss_needs_no_other_radius_of_its_wheel():
    """Above 5 rad/s, the loss leaves what is lost above 4.2 rad/s to the radius."""
    robot = preset("asoc-prototype")
    loss = TickLoss(castor=2, wheel=2, value=0.016, above=4.2)
    logs = [drive(robot.with_effects(loss), wander(np.random.default_rng([30, 1]), duration=20.0), 1, duration=20.0)]
    search = Search(robot, logs, (), (), None, MATERIAL)
    search.somewhere = ()
    wrong = replace(loss, value=0.0125, above=5.0), WheelRadius(castor=2, wheel=2, value=0.003)
    search.named = tuple(Sized(Candidate(described(kind), (kind,)), np.array([kind.value])) for kind in wrong)
    search.seen = search.look(search.named, search.plain, search.among)
    found = search.with_one_loss()
    assert found is not None
    (effect,) = (one.effect for one in found)
    assert isinstance(effect, TickLoss)
    assert (effect.value, effect.above) == (pytest.approx(0.016, rel=0.03), pytest.approx(4.2, rel=0.05))


def test_no_speed_is_found_where_nothing_is_lost():
    log = log_of(1)

    def look(effects, among):
        return linearise(with_effects(ROBOT, effects), [log], among=among)

    assert lossy_above(ROBOT, [log], (), look, -8.0) is None


@pytest.mark.parametrize("direction", ["forward", "both"])
def test_a_loss_at_nearly_all_speeds_is_another_radius_of_the_wheel(direction):
    """Of a robot that only drives forward, faster than 0.091 rad/s nearly all the time. Where the encoder loses counts
    above half of its speed, it is none."""
    robot, drives = preset("differential"), Trajectory("ahead", (Run((Leg((1.0, 0.0, 0.6), 4.0),), 0.4, 0.5),))
    log = drive(robot.with_effects(WheelRadius(castor=1, wheel=1, value=0.007)), drives, 1, duration=drives.duration)

    def look(effects, among):
        return linearise(with_effects(robot, effects), [log], among=among)

    slow, fast = (TickLoss(castor=1, wheel=1, value=0.01, above=above, direction=direction) for above in (0.091, 3.0))
    alike = [_is_radius(Candidate(described(loss), (loss,)), robot, look, ()) for loss in (slow, fast)]
    assert alike == [True, False]


def test_the_rival_of_a_loss_at_any_speed_is_the_radius_of_its_wheel():
    seen = linearise(ROBOT, [log_of(1, WheelRadius(castor=1, wheel=1, value=0.002))])
    loss = replace(LOSS, above=0.5, direction="both")
    (rival,) = of_same_wheel(Sized(Candidate("loss", (loss,)), np.array([0.002])), (), seen)
    assert rival.candidate.family == "wheel_radius 1 1"
    assert rival.size == pytest.approx(0.002, rel=0.2)
    (other,) = of_same_wheel(Sized(Candidate("loss", (loss,)), np.array([0.002])), (rival,), seen)
    assert other.candidate.family != rival.candidate.family


def gap_of(seen):
    """The gap in position, m."""
    assert seen.gap is not None
    return seen.gap[0]


@pytest.mark.parametrize("effects", [(), (WheelRadius(castor=1, wheel=1, value=-0.1),)])
def test_an_encoder_that_loses_nothing_is_not_suspected(effects):
    log = log_of(1, *effects)
    assert lossy_encoders(ROBOT, [log], linearise(ROBOT.with_effects(*effects), [log], among=()), 3.0) == []


def test_more_of_a_loss_is_a_larger_part_and_not_a_part_lost_twice():
    """What is read after a loss is too slow to be lost again."""
    lossy, log = ROBOT.with_effects(LOSS), log_of(1, LOSS)
    (state,) = linearise(lossy, [log], among=()).state.states
    candidate = next(candidate for candidate in candidates_of(ROBOT) if candidate.is_of(LOSS))
    model = LogLikelihood(Geometry.of(lossy), log)
    signature = signatures_of(lossy, log, state, model, [candidate]).readings[slice(None)][:, 0, 0]
    turned = np.diff(state[:, 3])
    rate = turned * 2 * np.pi / float(ROBOT.castors[0].wheels[0].counts_per_rev or 0) / np.diff(log.t)
    lost = np.concatenate([[0.0], np.cumsum(np.where(rate > LOSS.above, turned, 0.0))])
    assert lost[-1] > 1e4
    np.testing.assert_allclose(signature, -lost, atol=1.0)
