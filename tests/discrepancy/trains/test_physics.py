"""The train finder on physics: wheels held at speeds that disagree, and several logs together."""

import dataclasses

import pytest

from castor_envs.effects.dimensions import WheelRadius
from castor_envs.effects.train import AxleSlip, DeadGauge, ForeshorteningLeftOut, FrameLength, GaugeGain
from castor_envs.vehicles.presets import cfmmr
from discrepancy.posterior.verdicts import Material
from discrepancy.report import sentences
from discrepancy.trains.candidates import Candidate
from discrepancy.trains.examine import examine_train
from discrepancy.trains.posterior import diagnose_train
from discrepancy.trials.trains.outside import Outside
from discrepancy.trials.trains.simulate import log_at_random

TRAIN = cfmmr(2)


def only(found):
    """The one effect that is named, its value and standard error, and the axle that has it."""
    assert found.verdict == "named", found.answers
    (answer,) = found.answers
    assert isinstance(answer.candidate, Candidate)
    return answer.effect, answer.size, answer.error, answer.candidate.axle


@pytest.mark.parametrize("seed", [11, 12])
def test_wheels_held_at_speeds_that_disagree_are_no_effect(seed):
    """Here frames pull at their axles with 10 N and more, which slip a third of a per cent."""
    found = diagnose_train(TRAIN, [log_at_random(TRAIN, seed, 5.0, "servo")])
    assert (found.verdict, found.answers) == ("no discrepancy", ())


def test_an_effect_is_named_with_wheels_held_at_speed():
    modules = (TRAIN.modules[0], TRAIN.modules[1].with_effects(WheelRadius(castor=1, wheel=2, value=0.01)))
    found = diagnose_train(TRAIN, [log_at_random(dataclasses.replace(TRAIN, modules=modules), 3, 4.0, "servo")])
    effect, value, error, axle = only(found)
    assert (type(effect), axle) == (WheelRadius, 2)
    assert abs(value - 0.01) < 3 * error < 0.003


def test_sliding_axles_are_reported():
    """A gain of 40 % sets the driver's axles so much against each other that they slide."""
    train = TRAIN.with_effects(GaugeGain(frame=1, value=0.4))
    data = examine_train(TRAIN, {"a.csv": log_at_random(train, 5, 4.0, "servo")}, {}, {}).data
    (remark,) = data["preflight"]
    assert "some may slide" in remark
    assert f"pre-flight: {remark}" in sentences.as_lines(data)


def test_lost_counts_are_no_sliding():
    """A wheel that counts 10 % less for a while would have to slide, and nothing else shows what would push it."""
    log = Outside("lost_counts", wheel=3, frame=0, value=0.1, begins=0.3).changed(TRAIN, log_at_random(TRAIN, 7, 4.0))
    found = diagnose_train(TRAIN, [log])
    assert found.verdict == "unexplained"
    assert {answer.credible for answer in found.answers} == {("wheel 2r counts otherwise",)}


def test_slip_under_one_axle_is_named():
    slippery = TRAIN.with_effects(AxleSlip(axle=1, value=14.0))
    effect, value, error, _ = only(diagnose_train(TRAIN, [log_at_random(slippery, 7, 4.0)]))
    assert effect == AxleSlip(axle=1, value=value)
    assert abs(value - 14.0) < 3 * error


@pytest.mark.parametrize(("longer", "drive"), [(0.008, "servo"), (-0.006, "voltage")])
def test_the_length_of_a_frame_is_no_gain_of_its_gauges(longer, drive):
    """Bent by the same angle a longer frame curves less, so that its gauges read as if all had a smaller gain."""
    real = TRAIN.with_effects(FrameLength(frame=1, value=longer))
    log, other = (log_at_random(real, seed, 5.0, drive) for seed in (20, 21))
    effect, value, error, _ = only(diagnose_train(TRAIN, [log], [other]))
    assert effect == FrameLength(frame=1, value=value)
    assert abs(value - longer) < 3 * error < 0.004


def test_several_logs_are_fitted_together():
    """What a train has is the same in all of them, and known as well as two independent measurements make it."""
    train = TRAIN.with_effects(GaugeGain(frame=1, value=0.1))
    logs = [log_at_random(train, seed, 4.0) for seed in (1, 2)]
    one, other, both = (only(diagnose_train(TRAIN, some)) for some in (logs[:1], logs[1:], logs))
    assert all(found[0] == GaugeGain(frame=1, value=found[1]) for found in (one, other, both))
    assert both[2] == pytest.approx((one[2] ** -2 + other[2] ** -2) ** -0.5, rel=0.15)
    assert abs(both[1] - 0.1) < 3 * both[2]


def test_the_gap_compares_descriptions_with_the_same_noise():
    """Beside a wrong description a sensor seems noisy, so that the train is localised by its wheels, and the right one
    looked worse. Here the wheels are held at speeds that disagree."""
    train = TRAIN.with_effects(ForeshorteningLeftOut(frame=1, value=0.8))
    log, other = (log_at_random(train, seed, 7.0, "servo") for seed in (1, 2))
    effect, value, error, _ = only(diagnose_train(TRAIN, [log], [other], material=Material(0.0, 0.0)))
    assert effect == ForeshorteningLeftOut(frame=1, value=value)
    assert abs(value - 0.8) < 3 * error


@pytest.mark.parametrize("drive", ["voltage", "servo"])
def test_a_late_sensor_is_no_gain(drive):
    log, other = (
        Outside("sensor_late", wheel=0, frame=0, value=0.2, begins=0.0).changed(
            TRAIN, log_at_random(TRAIN, seed, 5.0, drive)
        )
        for seed in (1, 2)
    )
    found = diagnose_train(TRAIN, [log], [other])
    assert found.verdict == "unexplained"
    assert {answer.credible for answer in found.answers} == {("frame A's sensor reads late",)}


def test_a_jackknifed_train_is_told_as_such():
    """A driver that hears a dead gauge steers axles held at speed across each other until they slide."""
    train = TRAIN.with_effects(DeadGauge(frame=1, gauge=1))
    found = diagnose_train(TRAIN, [log_at_random(train, 1, 5.0, "servo")])
    assert found.verdict == "unexplained"
    assert [answer.effect for answer in found.answers] == [None]
    assert "axles 1, 2 seem to slide nearly all the time" in found.answers[0].reason
