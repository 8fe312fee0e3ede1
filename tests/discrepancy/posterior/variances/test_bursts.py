"""Counts lost in bursts: taken off by hand from a robot that rolls perfectly, and found with wheel, part and times."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from castor_envs.effects.dimensions import PivotPositionX
from castor_envs.effects.encoders import TickLossBursts
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from discrepancy.posterior.calibrated import CREDIBLE
from discrepancy.posterior.finder import diagnose
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.priors import order_of
from discrepancy.posterior.variances.at_times import answer_of, at_times
from discrepancy.posterior.variances.bursts import bursts_of, steady_box
from discrepancy.posterior.variances.events import Events
from discrepancy.posterior.verdicts import MATERIAL, judged
from discrepancy.trials.pymunk_generator import drive

ROBOT = preset("asoc-prototype")


@cache
def rolled():
    """Times, angles of wheels and of castors of a minute of perfect rolling."""
    run = roll(ROBOT, wander(np.random.default_rng([5, 1]), duration=60.0), [0.3, 2.0, -1.5])
    return run.t, run.wheel_angle, run.castor_angle


def read(turned):
    """The log of encoders on wheels that turned so far (K, w)."""
    t, _, castors = rolled()
    encoders = Encoders(Geometry.of(ROBOT), np.full(6, 0.4))
    return Log(t, encoders.wheel(turned), encoders.pivot(castors))


def less(wheel, part):
    """Angles of the wheels, one of which loses a part (K - 1,) of what it turns in every step."""
    _, turned, _ = rolled()
    steps = np.diff(turned, axis=0)
    steps[:, wheel] *= 1 - part
    return turned[0] + np.pad(np.cumsum(steps, axis=0), ((1, 0), (0, 0)))


def when(starts, width):
    """Which steps lie between each start and a time later."""
    middle = (rolled()[0][1:] + rolled()[0][:-1]) / 2
    return np.any([(middle > start) & (middle < start + width) for start in starts], axis=0)


def losing(log):
    """The rows that contradict the others at times, and what the first of them loses."""
    seen = linearise(ROBOT, [log], among=())
    faulty = at_times([log], seen, None, [], 100)
    return faulty, bursts_of(ROBOT, [log], seen, faulty[0].row, faulty[0].active) if faulty else None


@pytest.mark.parametrize(("wheel", "part"), [(0, 0.2), (3, 0.2), (4, 1.0)])
def test_a_steady_beat_is_found_with_its_wheel_part_and_times(wheel, part):
    _, found = losing(read(less(wheel, part * when(np.arange(1.0, 60.0, 4.0), 0.4))))
    assert found is not None
    effect = found.effect
    assert (effect.castor, effect.wheel) == (wheel // 2 + 1, wheel % 2 + 1)
    assert effect.value == pytest.approx(part, rel=0.05)
    assert (effect.period, effect.width, effect.start) == (
        pytest.approx(4.0, abs=0.05),
        pytest.approx(0.4, abs=0.06),
        pytest.approx(1.0, abs=0.15),
    )
    assert effect.seed is None


@pytest.mark.parametrize("period", [1.5, 2.0, 3.0])
def test_bursts_in_most_windows_are_found_too(period):
    """Those of a swerve base that fall into up to all of the windows of a second."""
    effect = TickLossBursts(castor=4, wheel=1, value=0.06, period=period, width=0.3, start=0.6)
    robot, log = preset("swerve"), dataclasses.replace(driven(5, effect), reference=None)
    seen = linearise(robot, [log], among=())
    (fault, *_) = at_times([log], seen, None, [], 100)
    found = bursts_of(robot, [log], seen, fault.row, fault.active)
    assert found is not None
    assert (found.effect.castor, found.effect.wheel) == (4, 1)
    assert (found.effect.value, found.effect.period) == (pytest.approx(0.06, rel=0.05), pytest.approx(period, abs=0.01))
    assert found.effect.width == pytest.approx(0.3, abs=0.06)


@pytest.mark.parametrize("samples", [3, 8, 14, 40])
def test_short_and_slow_logs_have_a_beat_or_none(samples):
    """A row a second: at least three bursts of four rows make a beat."""
    t, way = np.arange(float(samples)), np.full(samples - 1, 0.1)
    lost = np.where(np.arange(samples - 1) % 5 == 2, 0.02, 0.0)
    found = steady_box(t, lost, way)
    assert (found is None) == (samples < 13)
    assert steady_box(t, 0 * lost, way) is None
    if samples == 40:
        assert found is not None
        assert (found.period, found.width) == (pytest.approx(5.0, abs=0.1), pytest.approx(1.0, abs=0.1))
        assert np.array_equal(found.inside, lost > 0)


def test_bursts_at_random_are_found_without_a_beat():
    starts = np.cumsum(np.random.default_rng(2).uniform(0.5, 8.0, size=14))
    _, found = losing(read(less(5, 0.1 * when(starts, 0.5))))
    assert found is not None
    assert found.effect.seed is not None
    assert (found.effect.castor, found.effect.wheel) == (3, 2)
    assert found.effect.value == pytest.approx(0.1, rel=0.1)


def test_a_wheel_that_rolls_perfectly_contradicts_none():
    assert losing(read(rolled()[1])) == ([], None)


def test_as_many_counts_too_much_as_too_few_are_not_lost():
    part = 0.2 * (when(np.arange(1.0, 60.0, 8.0), 0.4) * 1.0 - when(np.arange(5.0, 60.0, 8.0), 0.4))
    faulty, found = losing(read(less(2, part)))
    assert faulty[0].row == 2
    assert found is None


def test_encoders_that_cannot_contradict_each_other_tell_nothing():
    t, turned, _ = rolled()
    poses = np.zeros((len(t), 3))
    log = Log(t, np.round(20 * turned[:, :2]), np.zeros((len(t), 0)), reference=poses)
    assert at_times([log], linearise(preset("differential"), [log], among=()), None, [], 100) == []


@pytest.mark.parametrize(("bursts", "sure"), [(3, False), (6, True)])
def test_few_bursts_may_be_chance(bursts, sure):
    """Were nothing lost, every burst would be of either sense: 2 to the power of their number, if it is certain that
    there were any. While the wheel hardly turns, as in one of six, none shows."""
    log = read(less(3, 0.3 * when(np.arange(bursts) * 9.0 + 3.3, 0.4)))
    seen = linearise(ROBOT, [log], among=())
    (fault,) = at_times([log], seen, None, [], 100)
    answer = answer_of(ROBOT, [log], seen, fault, None, ())
    odds = (1 + CREDIBLE) ** (bursts - (bursts == 6))
    assert answer.probability == pytest.approx(odds / (1 + odds), abs=1e-3)
    assert answer.unnamed != sure
    assert len(answer.credible) == (1 if sure else 2)
    for_another_reason = answer_of(ROBOT, [log], seen, fault, None, [f"wheel_{ROBOT.wheel_names[fault.row]}"])
    assert for_another_reason.unnamed
    assert for_another_reason.effect is None


@cache
def driven(seed, *effects):
    robot = preset("swerve").with_effects(*effects)
    return drive(robot, wander(np.random.default_rng([seed, 1]), duration=40.0), seed, duration=40.0)


def test_counts_lost_in_physics_are_named_and_confirmed():
    effect = TickLossBursts(castor=2, wheel=1, value=0.2, period=4.0, width=0.4, start=1.0)
    found = diagnose(preset("swerve"), [driven(3, effect)], [driven(4, effect)])
    assert found.verdict == "named", [answer.reason for answer in found.answers]
    (answer,) = (answer for answer in found.answers if answer.verdict != "negligible")
    assert isinstance(answer.effect, TickLossBursts)
    assert (answer.effect.castor, answer.effect.wheel) == (2, 1)
    assert answer.effect.value == pytest.approx(0.2, rel=0.05)
    assert answer.effect.period == pytest.approx(4.0, abs=0.05)


def test_held_out_logs_without_losses_do_not_confirm_them():
    robot, effect = preset("swerve"), TickLossBursts(castor=2, wheel=1, value=0.2, period=4.0, width=0.4, start=1.0)
    seen, good = (linearise(robot, [log], among=()) for log in (driven(3, effect), driven(4)))
    events = Events(faulty=tuple(at_times([driven(3, effect)], seen, None, [], 100)))
    _, confirmed = events.in_other_logs(robot, [driven(4)], good)
    answers = events.answers(robot, [driven(3, effect)], seen, confirmed, ())
    (answer,) = judged(answers, [], (good, good), order_of(good, None), MATERIAL)
    assert isinstance(answer.effect, TickLossBursts)
    assert answer.verdict == "unconfirmed", answer.reason
    (sure,) = judged(events.answers(robot, [driven(3, effect)], seen, [5.0], ()), [], None, None, MATERIAL)
    assert sure.verdict == "named", sure.reason


def test_windows_that_are_found_later_are_of_the_same_fault():
    """Told as two, a robot would lose twice the counts in its bursts."""
    robot, effect = preset("swerve"), TickLossBursts(castor=2, wheel=1, value=0.2, period=4.0, width=0.4, start=1.0)
    log = driven(3, effect)
    seen = linearise(robot, [log], among=())
    (whole,) = at_times([log], seen, None, [], 100)
    (active,), (slips,) = whole.active, whole.slips
    half = np.arange(len(active)) < len(active) / 2
    known = whole._replace(active=(half * active,), slips=(half * slips,))
    found = Events((known,), looked=True).extended(robot, [log], seen, None, [], 100)
    assert found is not None
    (fault,) = found.faulty
    assert np.all(fault.hits[0] == whole.hits[0])
    assert fault.slips[0] == pytest.approx(slips)
    (answer,) = found.answers(robot, [log], seen, [5.0], ())
    assert answer.amplitudes == pytest.approx([0.2], rel=0.05)


def test_what_lasts_most_of_the_time_is_no_burst():
    """Each burst is long, so that a wheel loses counts nearly all the time."""
    log = read(less(0, 0.2 * when(np.arange(1.0, 60.0, 8.0), 6.0)))
    seen = linearise(ROBOT, [log], among=())
    (disagreement,) = seen.disagreements
    middle = disagreement.t + 0.5 * float(np.median(np.diff(disagreement.t)))
    active = np.any([(middle > start) & (middle < start + 6.0) for start in np.arange(1.0, 60.0, 8.0)], axis=0)
    assert bursts_of(ROBOT, [log], seen, 0, [active.astype(float)]) is None
    short = read(less(0, 0.2 * when(np.arange(1.0, 60.0, 8.0), 2.0)))
    seen = linearise(ROBOT, [short], among=())
    active = np.any([(middle > start) & (middle < start + 2.0) for start in np.arange(1.0, 60.0, 8.0)], axis=0)
    assert bursts_of(ROBOT, [short], seen, 0, [active.astype(float)]) is not None


def test_bursts_are_no_wheel_that_is_too_large():
    """On average the wheel loses 0.4 % of its counts, as if it were larger by 0.3 %, which was named."""
    robot = preset("2-castor")
    bursts = TickLossBursts(castor=1, wheel=2, value=0.036, period=4.68, width=0.53, start=0.57)
    drives = (wander(np.random.default_rng([21, k]), duration=60.0) for k in (1, 2))
    logs = [drive(robot.with_effects(bursts), motion, k, duration=60.0) for k, motion in enumerate(drives)]
    log, held_out = (dataclasses.replace(log, reference=None) for log in logs)
    (answer,) = diagnose(robot, [log], [held_out]).answers
    assert (answer.verdict, answer.candidate.alike) == ("named", "tick_loss_bursts")
    found = answer.effect
    assert isinstance(found, TickLossBursts)
    assert (found.castor, found.wheel, found.period) == (1, 2, pytest.approx(bursts.period, rel=0.02))
    assert found.value * found.width == pytest.approx(bursts.value * bursts.width, rel=0.2)


@pytest.mark.slow
def test_the_gap_is_that_of_a_robot_that_loses_counts_in_its_bursts():
    """Beside a castor out of place. Where steps of bursts are released, odometry is off as if nothing were known."""
    robot = preset("omnimate")
    bursts = TickLossBursts(castor=1, wheel=2, value=0.06, period=4.0, width=0.3, start=1.3)
    effects = bursts, PivotPositionX(castor=2, value=0.009)
    drives = [wander(np.random.default_rng([k, 1]), duration=30.0) for k in (3, 4)]
    logs = [drive(robot.with_effects(*effects), motion, k, duration=30.0) for k, motion in enumerate(drives)]
    found = diagnose(robot, logs[:1], logs[1:])
    assert {answer.candidate.alike for answer in found.answers} == {"pivot_position_x", "tick_loss_bursts"}
    assert found.verdict == "named"
    assert found.held_out is not None
    before, after = found.held_out
    assert before.gap is not None
    assert after.gap is not None
    assert after.gap[0] < 0.7 * before.gap[0]
