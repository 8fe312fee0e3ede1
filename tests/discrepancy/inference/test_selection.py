"""How effects are taken in and weighed against rivals: laws of the quadratic form, and logs that decide."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest

from castor_envs.effects.catalogue import readings
from castor_envs.effects.contact import ContactCreep
from castor_envs.effects.dimensions import AllWheelRadius, PivotOffset, Track, WheelRadius
from castor_envs.effects.encoders import TickLoss
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import Candidate, candidates_of
from discrepancy.inference import forward_selection as diagnosis
from discrepancy.inference.evidence import Evidence, evidence_of
from discrepancy.inference.evidence_cache import Known, Looks, background_of
from discrepancy.inference.ranking import LEAST_GAIN, margin, rank_of, ranks_of, sine
from discrepancy.inference.selection import (
    Found,
    _faint,
    _or_two_others,
    _pair_foretold,
    _settled,
    decided,
    foretold,
    one_after_another,
)
from discrepancy.trials.pymunk_generator import drive

pytestmark = pytest.mark.slow

ROBOT = preset("asoc-prototype")
RADIUS = WheelRadius(castor=2, wheel=1, value=3e-4)
LOSS = TickLoss(castor=2, wheel=1, value=2e-3, above=5.0)


def rolled(*effects: Effect, seed: int) -> Log:
    """A log of perfect rolling with effects."""
    robot = ROBOT.with_effects(*effects)
    motion = roll(robot.as_built(), wander(np.random.default_rng([seed, 1]), duration=30.0), [0.3, 2.0, -1.5])
    encoders = Encoders(Geometry.of(robot.as_built()), np.full(6, 0.4))
    wheel, castor = readings(robot, motion.t, motion.wheel_angle, motion.castor_angle)
    reference = motion.pose + np.random.default_rng([seed, 3]).normal(size=motion.pose.shape) * 1e-3
    reference[np.arange(len(reference)) % 20 > 0] = np.nan
    return Log(motion.t, encoders.wheel(wheel), encoders.pivot(castor), reference=reference)


def of(effect: Effect) -> Candidate:
    """The candidate of an effect's kind and place."""
    return next(one for one in candidates_of(ROBOT) if one.is_of(effect))


def looking_at(*logs: Log, rivals: Sequence[Effect] = (RADIUS, LOSS)):
    """Evidence of some logs beside effects, of some rivals alone where not told otherwise."""

    def look(effects, among=None) -> Evidence:
        return evidence_of(ROBOT.with_effects(*effects), logs, among=among or [of(one) for one in rivals])

    return look


@pytest.fixture(scope="module")
def seen() -> Evidence:
    return evidence_of(ROBOT, [rolled(RADIUS, seed=1)])


def test_what_a_candidate_foretells_is_a_parabola_whose_top_is_its_gain(seen: Evidence):
    place = seen.index(of(RADIUS))
    assert place is not None
    amplitudes, _, gain = seen.best([(place, 0.5)])
    assert seen.foretold(of(RADIUS), 0.5, amplitudes.tolist()) == pytest.approx(gain)
    assert seen.foretold(of(RADIUS), 0.5, (2 * amplitudes).tolist()) == pytest.approx(0.0, abs=1e-6 * gain)
    assert seen.foretold(of(RADIUS), 0.5, (-amplitudes).tolist()) == pytest.approx(-3 * gain)
    assert seen.foretold(Candidate("nothing that this log shows"), 0.5, (1.0,)) == 0.0


def test_what_a_rival_leaves_of_a_candidate_is_the_square_of_the_sine_between_them(seen: Evidence):
    """If there is nothing but the candidate."""
    best = ranks_of(seen)[0]
    assert best.candidate == of(RADIUS)
    place = seen.index(best.candidate)
    assert place is not None
    alone = seen.expecting(place, best.part, best.amplitudes)
    assert alone.foretold(best.candidate, best.part, best.amplitudes) == pytest.approx(best.gain)
    sines = {}
    for one in ranks_of(seen):
        rival = alone.index(one.candidate)
        assert rival is not None
        taken = alone.best([(rival, one.part)])[2]
        sines[one.candidate] = sine(seen, best, one)
        assert best.gain * (1 - sines[one.candidate] ** 2) == pytest.approx(taken, abs=1e-6 * best.gain)
    assert sines[best.candidate] < 1e-3
    assert 0.02 < sines[of(LOSS)] < 0.3 < max(sines.values()) <= 1.0


def test_like_candidates_are_told_apart_by_less():
    """A gain of 4,000: the margin grows with the sine, up to what it is of those that are nothing alike."""
    margins = [margin(4000.0, one) for one in (0.0, 0.1, 0.2, 0.5, 1.0)]
    assert margins == pytest.approx([6.0, 18.0, 30.0, 66.0, margin(4000.0)])


@pytest.mark.parametrize("at", [12.0, 0.3])
def test_a_jump_is_found_where_it_is_and_near_the_ends_it_is_a_bias(at: float):
    log = rolled(seed=1)
    pivot = log.pivot + np.where(log.t >= at, 5.0, 0.0)[:, None] * [0, 1, 0]
    told = ranks_of(evidence_of(ROBOT, [dataclasses.replace(log, pivot=pivot)]))
    own = [one.candidate.what for one in told if "pivot_2 jumps" in one.candidate.what or "bias" in one.candidate.what]
    assert own[0] == ("pivot_2 jumps at 12.0 s" if at == 12.0 else "pivot bias, castor 2")


@pytest.mark.parametrize(
    ("more", "in_logs", "verdict"),
    [(7.0, 1.0, "ambiguous"), (7.0, -1.0, "named"), (5.0, 1.0, "named"), (-1.0, 1.0, "named")],
)
def test_no_effect_is_sure_where_what_has_no_name_explains_more(
    seen: Evidence, monkeypatch, more: float, in_logs: float, verdict: str
):
    """In logs and held-out ones together, and not because held-out ones take away from the effect alone."""
    own = ranks_of(seen)[0]
    other = dataclasses.replace(own, candidate=Candidate("wheel_2l repeats 3 times a turn"), gain=own.gain + more)
    alone = dataclasses.replace(other, gain=own.gain + in_logs)
    monkeypatch.setattr(diagnosis, "foretold", lambda *_: [own, other])
    monkeypatch.setattr(diagnosis, "ranks_of", lambda _: (own, alone))
    finding = diagnosis._judged(lambda effects, among=None: seen, None, [Found(own.candidate, RADIUS, own.error)], 0)
    assert finding.verdict == verdict
    assert finding.effect == RADIUS
    assert other in finding.chosen


def test_counts_lost_above_another_speed_win_against_what_has_no_name():
    """Above 8 rad/s: as lost above 5, among the candidates of every robot, they look less like it than a rival."""
    loss = TickLoss(castor=1, wheel=2, value=0.01, above=8.0)
    look = Looks(Known(ROBOT), [rolled(loss, seed=1)], finds=True)
    first = look([])
    assert not ranks_of(first)[0].candidate.kinds
    (found,), _ = one_after_another(ROBOT, look, None, first, LEAST_GAIN, False)
    assert isinstance(found.effect, TickLoss)
    assert (found.effect.castor, found.effect.wheel, found.effect.direction) == (1, 2, "forward")
    assert found.effect.above == pytest.approx(8.0, abs=ROBOT.max_wheel_speed / 32)
    assert found.effect.value == pytest.approx(0.01, rel=0.1)


def test_held_out_logs_make_up_for_what_is_faint():
    """0.025 mm of an offset: in the first log it takes away too little, and another effect looks more like it."""
    faint = PivotOffset(castor=1, value=2.5e-5)
    log, held, clean = rolled(faint, seed=3), rolled(faint, seed=6), rolled(seed=6)
    first = evidence_of(ROBOT, [log])
    assert ranks_of(first)[0].candidate != of(faint)
    assert ranks_of(first)[0].gain < LEAST_GAIN
    best = _faint(first, evidence_of(ROBOT, [held]), LEAST_GAIN)
    assert best is not None
    assert best.candidate == of(faint)
    assert _faint(first, evidence_of(ROBOT, [clean]), LEAST_GAIN) is None
    for again, names in ((held, ["pivot_offset"]), (clean, [])):
        look, later = looking_at(log, rivals=(faint, RADIUS)), looking_at(again, rivals=(faint, RADIUS))
        found, _ = one_after_another(ROBOT, look, later, first, LEAST_GAIN, True)
        assert [one.effect.name for one in found] == names
    assert not one_after_another(ROBOT, look, later, first, LEAST_GAIN, False)[0]


def test_what_a_pair_foretells_is_the_deviance_of_both_together():
    """2 a p - a I a of the held-out logs, a: as large as the logs ask for together, not each alone."""
    both = (RADIUS, LOSS)
    left, held = (looking_at(rolled(RADIUS, LOSS, seed=seed), rivals=both)([]) for seed in (5, 6))
    pair = [rank_of(left, left.candidates.index(of(one))) for one in both]
    amplitudes = left.best([(left.candidates.index(one.candidate), one.part) for one in pair])[0]
    information, pull = held.plain
    change = np.zeros(len(pull))
    for one, size in zip(pair, amplitudes, strict=True):
        column = held.columns[held.candidates.index(one.candidate)]
        change[column], change[column + len(pull) // 2] = size, one.part * size
    assert _pair_foretold(left, held, pair) == pytest.approx(2 * change @ pull - change @ information @ change)
    assert _pair_foretold(left, held, pair) > max(
        held.foretold(one.candidate, one.part, one.amplitudes) for one in pair
    )


def test_the_best_effect_is_taken_in_if_all_that_is_near_it_has_vanished_before(monkeypatch):
    monkeypatch.setattr("discrepancy.inference.selection._near", lambda *_: ((), None))
    look = looking_at(rolled(RADIUS, seed=1))
    (found,), _ = one_after_another(ROBOT, look, None, look([]), LEAST_GAIN, False)
    assert found.candidate == of(RADIUS)


def test_the_background_counts_whichever_candidates_are_looked_at(seen: Evidence):
    place = seen.index(of(LOSS))
    assert place is not None
    log, background = rolled(RADIUS, seed=1), [(of(LOSS), 0.0, np.array([1e-4]))]

    def size(background, among):
        one = Looks(Known(ROBOT, background=background), [log], finds=False)([], among)
        return one.best([(one.candidates.index(of(RADIUS)), 0.5)])[0].item()

    by_some, by_all = (size([], among) - size(background, among) for among in ([of(RADIUS)], None))
    assert by_all > 5e-5
    assert by_some == pytest.approx(by_all, rel=0.1)


def test_what_little_clean_logs_have_of_all_radii_is_background():
    """Too little to be named, and taken off all the same: what goes beyond it is what changed."""
    soft, truth = (AllWheelRadius(value=value) for value in (2e-5, 1.2e-4))
    clean = evidence_of(ROBOT, [rolled(soft, seed=seed) for seed in (6, 7)], among=[of(soft), of(RADIUS)])
    (candidate, part, amplitudes), *others = background_of(clean)
    assert (candidate, others) == (of(soft), [])
    assert amplitudes[0] == pytest.approx(soft.value, abs=2e-5)
    assert clean.foretold(candidate, part, amplitudes) < LEAST_GAIN
    seen = Looks(Known(ROBOT, background=[(candidate, part, amplitudes)]), [rolled(truth, seed=8)], finds=False)
    plain = Looks(Known(ROBOT), [rolled(truth, seed=8)], finds=False)
    less, more = (rank_of(one([], [of(soft)]), 0).size for one in (seen, plain))
    assert more - less == pytest.approx(amplitudes[0], rel=1e-6)


@pytest.mark.parametrize(("truth", "other"), [(RADIUS, LOSS), (LOSS, RADIUS)], ids=["radius", "loss"])
def test_held_out_logs_decide_between_near_rivals(truth: Effect, other: Effect):
    """A radius looks much as counts lost when a wheel is fast; found is the wrong one, with its best size."""
    look, again = looking_at(rolled(truth, seed=2)), looking_at(*(rolled(truth, seed=seed) for seed in (3, 4)))
    alone = look([])
    size = rank_of(alone, alone.candidates.index(of(other))).size
    wrong = [Found(of(other), of(other).effect([size]), 1e-5)]
    near = foretold(look, again, wrong, 0)
    assert near[0].candidate == of(other)
    found, _ = decided(ROBOT, look, again, wrong, alone)
    assert [one.candidate for one in found] == [of(truth)]
    assert found[0].effect.value == pytest.approx(truth.value, rel=0.2)


def test_two_effects_that_do_better_together_take_the_place_of_what_was_found():
    """Of tracks and offsets, wherever the search went before: one of each wrong, or one alone. Where it found none,
    it had reasons: one of the two alone takes away nearly as much."""
    truth = Track(castor=3, value=9e-4), PivotOffset(castor=1, value=1.5e-4)
    rivals = [kind(castor=i, value=1e-3) for kind in (Track, PivotOffset) for i in (1, 2, 3)]
    look = looking_at(rolled(*truth, seed=5), rivals=rivals)
    first = look([])
    for wrong in ((rivals[0], rivals[4]), (rivals[0],)):
        before = _settled(ROBOT, look, [Found(of(one), one, 1e-5) for one in wrong])
        assert before is not None
        found, left = _or_two_others(ROBOT, look, first, *before)
        assert {one.candidate for one in found} == {of(one) for one in truth}, wrong
        sizes = {one.candidate: one.effect.value for one in found}
        assert [sizes[of(one)] for one in truth] == pytest.approx([one.value for one in truth], rel=0.2)
        assert _or_two_others(ROBOT, look, first, found, left) == (found, left)
    assert _or_two_others(ROBOT, look, first, [], first) == ([], first)


def test_creep_in_the_model_and_creep_that_is_wanted_add_up():
    """Whatever part of it the model has, contacts must creep as much in all."""
    true = ContactCreep(value=2e-4)
    motion = wander(np.random.default_rng([1, 1]), duration=30.0)
    log = drive(ROBOT.with_effects(true), motion, 1, duration=30.0)
    wanted = []
    for value in (5e-5, 1e-4, 2e-4):
        seen = evidence_of(ROBOT.with_effects(ContactCreep(value=value)), [log], among=[of(true)])
        wanted.append(value + rank_of(seen, 0).size)
    assert wanted == pytest.approx([wanted[-1]] * 3, rel=0.15)
    assert wanted[-1] == pytest.approx(true.value, rel=0.35)
