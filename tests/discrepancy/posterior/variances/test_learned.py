"""Curves learned of what the catalogue lacks: a curve put in comes out, and the gap of other logs shrinks."""

import dataclasses
from functools import cache

import numpy as np
import pytest
from pydantic import ValidationError

from castor_envs.effects.catalogue import readings
from castor_envs.effects.encoders import LearnedTerm, WheelEccentricity
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import described
from discrepancy.posterior.finder import diagnose
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.variances.learned import helps, learned
from discrepancy.trials.pymunk_generator import drive
from discrepancy.trials.reading import USUAL

ROBOT = preset("asoc-prototype")
KNOTS = tuple(np.linspace(0.0, 5.8, 12).tolist())
TRUE = LearnedTerm(
    castor=2, wheel=1, of="castor angle", knots=KNOTS, values=tuple((0.01 * np.sin(KNOTS) ** 3).tolist())
)


@cache
def driven(seed, hidden):
    robot = ROBOT.with_effects(TRUE) if hidden else ROBOT
    return drive(robot, wander(np.random.default_rng([seed, 1]), duration=25.0), seed, duration=25.0)


@cache
def found(hidden):
    log = driven(3, hidden)
    seen = linearise(ROBOT, [log], among=())

    def look(robot, among):
        return linearise(robot, [log], start=seen, among=among)

    return learned(ROBOT, [log], seen, ["wheel_2l"], look)


def test_the_curve_put_in_comes_out_within_its_errors():
    curve = found(True)
    assert curve is not None
    assert (curve.effect.castor, curve.effect.wheel, curve.effect.of) == (2, 1, "castor angle")
    off = np.array(curve.effect.values) - TRUE.curve(np.array(curve.effect.knots))
    assert np.abs(off).max() < 0.15 * np.abs(TRUE.values).max()
    assert np.median(np.abs(off) / curve.errors) < 3


def test_other_logs_confirm_it_and_clean_logs_do_not():
    curve = found(True)
    assert curve is not None
    for hidden in (True, False):
        assert (
            helps(ROBOT, curve, lambda robot, hidden=hidden: linearise(robot, [driven(4, hidden)], among=())) == hidden
        )


def test_a_robot_in_good_order_has_none():
    assert found(False) is None


def test_it_is_unexplained_and_of_the_held_out_gap_the_reference_s_noise_is_left_all_the_same():
    told = diagnose(ROBOT, [driven(3, True)], [driven(4, True)])
    assert told.verdict == "unexplained"
    (answer,) = [answer for answer in told.answers if answer.learned]
    assert "nearest in the catalogue" in answer.reason
    assert answer.effect in told.found.effects
    assert RobotDescription.from_dict(told.found.to_dict()).effects == told.found.effects
    plain = linearise(ROBOT, [driven(4, True)], among=()).gap
    after = linearise(told.found, [driven(4, True)], among=()).gap
    assert plain is not None
    assert after is not None
    assert told.held_out is not None
    assert told.held_out[0].gap == pytest.approx(plain, rel=0.05)
    noise = np.sqrt(2) * USUAL.position  # along two axes
    assert after[0] < noise < plain[0] / 2.5


@pytest.mark.slow
def test_a_curve_that_the_catalogue_has_is_nearest_to_its_effect():
    """An eccentric encoder disc of any phase reads too much by the cosine of its angle."""
    wave = dataclasses.replace(TRUE, of="own angle", values=tuple((0.05 * np.cos(np.array(KNOTS) - 1.0)).tolist()))
    log = drive(ROBOT.with_effects(wave), wander(np.random.default_rng([3, 1]), duration=25.0), 3, duration=25.0)
    seen = linearise(ROBOT, [log], among=())
    curve = learned(ROBOT, [log], seen, ["wheel_2l"], lambda robot, among: linearise(robot, [log], among=among))
    assert curve is not None
    assert curve.nearest is not None
    what, cosine = curve.nearest
    assert what == described(WheelEccentricity(castor=2, wheel=1, value=0.05))
    assert 0.9 < cosine < 1.0001


def turning(speed):
    """A second in which everything turns at a speed (rad/s): t, wheels, castors."""
    t = np.linspace(0.0, 1.0, 101)
    return t, np.tile(speed * t[:, None], len(ROBOT.wheels)), np.zeros((len(t), len(ROBOT.castors)))


@pytest.mark.parametrize(("speed", "more"), [(1.0, 0.1), (-4.0, -0.05), (3.0, 0.2), (100.0, 0.2)])
def test_a_term_by_speed_reads_its_part_too_much(speed, more):
    term = LearnedTerm(castor=1, wheel=1, of="speed", knots=(-4.0, 0.0, 2.0), values=(-0.05, 0.0, 0.2))
    t, wheel, castor = turning(speed)
    read, _ = readings(ROBOT.with_effects(term), t, wheel, castor)
    assert read[-1, 0] == pytest.approx((1 + more) * speed)
    np.testing.assert_array_equal(read[:, 1:], wheel[:, 1:])


def test_a_term_by_angle_repeats_every_turn():
    term = LearnedTerm(castor=1, wheel=1, of="own angle", knots=(0.0, np.pi / 2, np.pi), values=(0.0, 0.1, 0.0))
    t, wheel, castor = turning(4 * np.pi)
    read, _ = readings(ROBOT.with_effects(term), t, wheel, castor)
    more = read[:, 0] - wheel[:, 0]
    assert more[50] == pytest.approx(np.pi / 2 * 0.1, rel=0.01)  # a triangle over half a turn
    assert more[100] == pytest.approx(2 * more[50], rel=0.01)


@pytest.mark.parametrize("changes", [{"values": (0.1,)}, {"knots": (1.0, 0.0)}, {"knots": (0.0, 7.0)}])
def test_knots_that_cannot_be_are_refused(changes):
    term = LearnedTerm(castor=1, wheel=1, of="own angle", knots=(0.0, 1.0), values=(0.0, 0.1))
    with pytest.raises(ValidationError, match="knots"):
        dataclasses.replace(term, **changes)
