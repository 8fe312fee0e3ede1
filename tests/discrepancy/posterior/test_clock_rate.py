"""The rate of the reference's clock: beside all else that logs say, as large as it was made."""

from functools import cache

import numpy as np
import pytest

from castor_envs.effects.clocks import ClockOffset, ClockSkew
from castor_envs.effects.dimensions import AllWheelRadius
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import candidates_of, rate_of
from discrepancy.posterior.finder import diagnose
from discrepancy.posterior.linearise import linearise
from discrepancy.trials.pymunk_generator import drive

ROBOT = preset("differential")


@cache
def driven(seed, *effects):
    motion = wander(np.random.default_rng([seed, 1]), duration=40.0, holonomic=False)
    return drive(ROBOT.with_effects(*effects), motion, seed, duration=40.0)


def column(seen):
    return next(int(columns[0]) for candidate, columns in seen.columns.items() if candidate.family == "clock_skew")


def test_an_offset_is_no_rate():
    assert rate_of([ClockSkew(value=0.01), ClockOffset(value=0.5), ClockSkew(value=-0.004)]) == pytest.approx(0.006)
    assert sum(bool(rate_of(candidate.kinds)) for candidate in candidates_of(ROBOT)) == 1


def test_the_answer_on_a_rate_does_not_depend_on_the_model():
    """The score at 0 beside a rate in the model is that of all of it, less what the model has."""
    effect, log = ClockSkew(value=0.002), driven(3, ClockSkew(value=0.002))
    beside = linearise(ROBOT.with_effects(effect), [log])
    without = linearise(ROBOT, [log]).at_noise(beside.noise)
    k, j = column(without), column(beside)
    (first,), (second,) = without.logs, beside.logs
    assert second.information[j, j] == pytest.approx(first.information[k, k], rel=1e-3)
    sizes = [said.score[at] / said.information[at, at] for said, at in ((first, k), (second, j))]
    assert sizes[0] - sizes[1] == pytest.approx(effect.value, rel=1e-3)
    assert beside.log_evidence - without.log_evidence == pytest.approx(
        effect.value * (first.score[k] - first.information[k, k] * effect.value / 2), rel=0.05
    )


def test_where_clocks_do_not_agree_each_log_has_a_rate_of_its_own():
    """As where the times of recordings are put together by hand; clocks that are said to agree are not doubted."""
    rates, logs = (-0.003, 0.009), [driven(3, ClockSkew(value=-0.003)), driven(4, ClockSkew(value=0.009))]
    seen = linearise(ROBOT.with_effects(ClockSkew(value=0.003)), logs, among=())
    assert [design.rate for design in seen.designs] == pytest.approx(rates, abs=5e-4)
    other = linearise(ROBOT.with_effects(ClockSkew(value=-0.003)), logs[1:], among=(), own_clocks=True)
    assert other.designs[0].rate == pytest.approx(0.009, abs=5e-4)
    assert [design.rate for design in linearise(ROBOT, logs, among=()).designs] == [0.0, 0.0]


def test_logs_without_reference_say_nothing_of_its_clock():
    from dataclasses import replace

    prototype = preset("asoc-prototype")
    log = drive(prototype, wander(np.random.default_rng([3, 1]), duration=15.0), 3, duration=15.0)
    seen = linearise(prototype, [replace(log, reference=None)])
    assert "clock_skew" not in [candidate.family for candidate in seen.candidates]


def test_a_rate_is_named_and_a_radius_beside_it_is_not_taken_for_one():
    effects = ClockSkew(value=-0.003), AllWheelRadius(value=0.01)
    found = diagnose(ROBOT, [driven(3, *effects)], [driven(4, *effects)])
    assert found.verdict == "named", [answer.reason for answer in found.answers]
    sizes = {answer.candidate.family: (answer.size, answer.error) for answer in found.answers}
    assert set(sizes) == {"clock_skew", "all_wheel_radius"}
    for effect in effects:
        size, error = sizes[effect.name]
        assert abs(size - effect.value) < 3 * error
        assert error < 0.1 * abs(effect.value)


def test_a_clock_as_good_as_crystals_is_not_reported():
    log = driven(3, ClockSkew(value=3e-5))
    assert "clock_skew" not in [answer.candidate.family for answer in diagnose(ROBOT, [log]).answers]
