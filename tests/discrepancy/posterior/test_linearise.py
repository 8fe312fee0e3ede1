"""What logs say of candidates: against finite differences of an independent odometry, and of robots of symmetry."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from castor_envs.effects.clocks import EncoderLatency
from castor_envs.effects.encoders import PivotBacklash, PivotGain
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.model.refit import Sized, statistics_of
from discrepancy.posterior.priors import bounds_of, hypotheses_of, same_effects
from discrepancy.trials.cases import motion
from discrepancy.trials.pymunk_generator import drive
from discrepancy.validation.cost import cost_of

ROBOT = preset("asoc-prototype")
NAMES = ["wheel_radius", "track", "pivot_offset", "pivot_bias", "encoder_latency", "pivot_gain", "pivot_eccentricity"]


@cache
def seen():
    log = drive(ROBOT, wander(np.random.default_rng([3, 1]), duration=20.0), 3, duration=20.0)
    return log, linearise(ROBOT, [log])


@pytest.mark.parametrize("name", NAMES)
def test_the_linear_cost_of_a_column_is_what_odometry_is_off_with_the_effect(name):
    log, linear = seen()
    candidate, columns = next(
        (candidate, columns)
        for candidate, columns in linear.columns.items()
        if candidate.kinds and candidate.kinds[0].name == name
    )
    kind = candidate.kinds[0]
    assert kind.step * linear.cost[0, columns[0]] == pytest.approx(cost_of(ROBOT, kind, [log]), rel=0.02)


@pytest.mark.parametrize("robot", ["asoc-prototype", "2-castor"])
def test_no_log_is_likelier_with_another_backlash_than_the_true_one(robot):
    """Of castors that the floor turns; it was likelier by up to 190 with another, as readings that stand still counted
    as less certain than others, and how many do depends on the backlash."""
    robot, backlash = preset(robot), PivotBacklash(value=0.03, castor=1)
    log = drive(robot.with_effects(backlash), motion(robot, "wander", 5, 20.0), 5, duration=20.0)
    parts = 0.8, 0.9, 0.95, 1.0, 1.05, 1.1
    others = [robot.with_effects(replace(backlash, value=part * backlash.value)) for part in parts]
    likely = [linearise(other, [log], among=()).log_evidence for other in others]
    true = parts.index(1.0)
    assert np.all(np.diff(likely[: true + 1]) > 20)
    assert np.all(np.diff(likely[true:]) < -20)


def test_information_is_positive_semidefinite_and_finite():
    (said,) = seen()[1].logs
    assert np.isfinite(said.score).all()
    scale = np.sqrt(np.maximum(np.diag(said.information), 1e-30))
    assert np.linalg.eigvalsh(said.information / np.outer(scale, scale)).min() > -1e-6


def test_usual_sizes_of_unnamed_alternatives_do_not_depend_on_the_order_of_logs():
    """The last log's stood for all. A drift has hardly begun in a log that is a third as long."""
    robot, usual = preset("tricycle"), []
    short, long = (drive(robot, motion(robot, "wander", k, 8.0 * k), k, duration=8.0 * k) for k in (1, 3))
    for logs in ([short, long], [long, short]):
        linear = linearise(robot, logs)
        sizes = linear.usual.tolist()
        usual.append({c.what: sizes[k[0]] for c, k in linear.columns.items()})
    shared = [what for what in usual[0] if " of log " not in what and np.isfinite(usual[0][what])]
    assert any("drifts" in what for what in shared)
    for what in shared:
        assert usual[0][what] == pytest.approx(usual[1][what], rel=1e-3)


def test_a_reference_without_any_pose_costs_nothing_that_is_no_number():
    log, _ = seen()
    empty = replace(log, reference=np.full((len(log), 3), np.nan))
    assert np.isfinite(linearise(ROBOT, [empty]).cost).all()


def test_a_robot_in_good_order_has_a_gap_of_the_reference_s_noise():
    gap = seen()[1].gap
    assert gap is not None
    assert all(5e-4 < error < 3e-3 for error in gap)


@pytest.mark.parametrize(
    ("robot", "same", "unseen"),
    [
        ("tricycle", {"all_wheel_radius": "wheel_radius 1 1", "pivot_position_x 2": "pivot_position_x 1"}, "track 2"),
        ("differential", {}, "pivot_position_x 1"),
        ("asoc-prototype", {}, None),
    ],
)
def test_effects_that_are_one_and_the_same_on_a_robot_have_one_name(robot, same, unseen):
    stands, hidden = same_effects(preset(robot))
    assert stands == same
    assert (unseen in hidden) if unseen else not hidden


def test_no_encoder_reads_early_and_a_binary_effect_is_about_one():
    linear = seen()[1]
    kinds = {candidate.kinds[0].name: candidate.kinds[0] for candidate in linear.candidates if candidate.kinds}
    assert bounds_of(kinds["encoder_latency"]) == (0.0, 1.0)
    assert bounds_of(kinds["pivot_backlash"])[0] == 0.0
    least, most = bounds_of(kinds["lost_remainders"])
    assert least < 1 < most


def test_no_length_is_wrong_by_more_than_the_robot_is_wide():
    """A castor 1 m out of place turns the robot as little as wheels that are too large by 1 % do, and cannot be."""
    linear = seen()[1]
    hypotheses, places = hypotheses_of(ROBOT, linear)
    limits = {
        candidate.kinds[0].name: (hypothesis.least, hypothesis.most)
        for (candidate, _), hypothesis in zip(places, hypotheses, strict=True)
        if candidate.kinds and candidate.columns == 1
    }
    reach = max(np.hypot(*castor.pivot) + castor.offset + castor.wheels[0].lateral for castor in ROBOT.castors)
    for name in ("pivot_position_x", "pivot_position_y", "pivot_offset"):
        assert -2.5 * reach < limits[name][0] < -reach
        assert reach < limits[name][1] < 2.5 * reach
    assert limits["wheel_radius"] == bounds_of(next(c.kinds[0] for c, _ in places if c.family == "wheel_radius 1 1"))


@pytest.mark.parametrize(
    ("effect", "part"), [(EncoderLatency(value=0.2, castor=2), 0.02), (PivotGain(value=0.01, castor=2), 0.25)]
)
def test_the_score_of_a_late_encoder_s_effects_is_the_slope_of_the_log_evidence(effect, part):
    """Of a robot whose second pivot is read 0.2 s late: its readings are four samples from what they tell."""
    late = EncoderLatency(value=0.2, castor=2)
    robot = ROBOT if effect == late else ROBOT.with_effects(late)
    course = wander(np.random.default_rng([3, 1]), duration=20.0)
    log = drive(robot.with_effects(effect), course, 3, duration=20.0)

    def seen_with(value):
        linear = linearise(robot.with_effects(replace(effect, value=value)), [log])
        candidate = next(of for of in linear.candidates if of.is_of(effect))
        return linear.log_evidence, statistics_of([Sized(candidate, np.zeros(candidate.columns))], linear).score[0]

    low, middle, high = (seen_with(size * effect.value) for size in (0.93, 0.95, 0.97))
    slope = (high[0] - low[0]) / (0.04 * effect.value)
    assert slope > 0
    assert middle[1] == pytest.approx(slope, rel=part)
