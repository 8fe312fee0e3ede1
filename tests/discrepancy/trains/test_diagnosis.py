"""Trains with hidden effects: what the finder says, on perfect rolling built here and on physics."""

import dataclasses
import json
from typing import Any

import pytest

from castor_envs.effects.train import (
    AxleSlip,
    DeadGauge,
    SensorStops,
)
from castor_envs.errors import InputError
from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.train import TrainDescription
from discrepancy.trains.selection.diagnosis import diagnose_train
from discrepancy.trains.selection.report import as_data, as_lines
from discrepancy.trains.trial.simulate import log_at_random


def found_in(*logs, **more):
    """What the finder says of such logs; frames so soft that they do not make axles creep."""
    return diagnose_train(logs[0][1], [log for log, _ in logs], **more)


def only(found):
    """The one effect that is named, its axle, value and standard error."""
    assert found.verdict == "named", found.reason
    (one,) = found.findings
    assert one.placed is not None
    return one.placed.effect, one.placed.axle, one.placed.value, one.error or 0.0


def test_an_effect_is_named_with_its_place_and_size(driven, hidden_effect):
    hidden, effect, axle = hidden_effect
    found = found_in(driven(**hidden))
    named, place, value, error = only(found)
    assert (dataclasses.replace(named, value=effect.value), place) == (effect, axle)
    assert abs(value - effect.value) < 3 * error < abs(effect.value)
    assert found.found is not None
    assert found.found.as_described() == found.train


def test_a_dead_gauge_is_named(driven):
    found = found_in(driven(dead=(3,)), held_out=[driven(seed=2, dead=(3,))[0]])
    assert only(found)[0] == DeadGauge(frame=1, gauge=3)
    assert found.held_out is not None
    before, after = found.held_out
    assert after.posture_heading < 0.5 * before.posture_heading


def test_a_sensor_that_stops_is_named(driven):
    effect, _, value, _ = only(found_in(driven(stops=7.0)))
    assert isinstance(effect, SensorStops)
    assert value == pytest.approx(7.0, abs=0.06)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_is_found_where_nothing_is_hidden(driven, seed):
    found = found_in(driven(seed=seed, reference=seed > 1))
    assert (found.verdict, found.findings, found.found) == ("no discrepancy", (), None)
    assert (found.before.position is None) == (seed == 1)


def test_without_a_reference_sensors_and_wheels_still_tell(driven):
    effect, axle, value, error = only(found_in(driven(tracks=(1.0, 0.97), reference=False)))
    assert (effect.name, axle) == ("track", 2)
    assert abs(value + 0.03) < 3 * error


def test_two_effects_are_found_one_after_another(driven):
    hidden: dict[str, Any] = {"gains": (1.15,) * 4, "radii": (1.0, 1.015, 1.0, 1.0)}
    found = found_in(driven(**hidden), held_out=[driven(seed=2, **hidden)[0]])
    assert found.verdict == "named", found.reason
    values = {(one.effect.name, one.axle): one.value for one in found.effects}
    assert values == {
        ("gauge_gain", None): pytest.approx(0.15, abs=0.02),
        ("wheel_radius", 1): pytest.approx(0.015, abs=1e-3),
    }
    assert found.after is not None
    assert found.found is not None
    assert found.after.posture_heading < 0.5 * found.before.posture_heading
    assert TrainDescription.from_dict(json.loads(json.dumps(found.found.to_dict()))) == found.found


def test_a_motion_that_does_not_show_it_confirms_nothing(driven):
    hidden: dict[str, Any] = {"gains": (1.15,) * 4}
    found = found_in(driven(**hidden), held_out=[driven(seed=2, straight=True, **hidden)[0]])
    assert found.verdict == "unconfirmed"
    assert "does not show gain of gauges, frame A" in found.reason
    assert found.found is None


def test_a_name_that_held_out_logs_deny_is_not_confirmed(driven):
    found = found_in(driven(gains=(1.15,) * 4), held_out=[driven(seed=2)[0]])
    assert found.verdict == "unconfirmed"
    assert "does not help" in found.reason


def test_a_wheel_that_loses_counts_for_a_while_has_no_name(driven):
    found = found_in(driven(lost=(2, 4.5, 6.0, 0.08)))
    assert found.verdict == "unexplained"
    assert "wheel 2l counts otherwise from 4.5 to 6.0 s" in found.reason
    assert found.found is None


def test_what_clean_logs_show_as_well_is_background(driven):
    worn: dict[str, Any] = {"gains": (1.1,) * 4}
    found = found_in(driven(tracks=(1.03, 1.0), **worn), clean=[driven(seed=4, **worn)[0]])
    assert [(one.effect.name, one.axle) for one in found.effects] == [("track", 1)]


def test_physics_with_slip_under_one_axle():
    train = cfmmr(2)
    slippery = train.with_effects(AxleSlip(axle=1, value=14.0))
    found = diagnose_train(train, [log_at_random(slippery, 7, 4.0)])
    effect, _, value, error = only(found)
    assert isinstance(effect, AxleSlip)
    assert effect.axle == 1
    assert abs(value - 14.0) < 3 * error
    data = as_data(found, ["a.csv"])
    assert json.loads(json.dumps(data, allow_nan=False)) == data
    assert data["effect"] == {"name": "axle_slip", "axle": 1, "value": pytest.approx(value)}
    text = "\n".join(as_lines(found, ["a.csv"]))
    assert "slip under one axle, axle 1" in text
    assert "to check" in text


def test_a_log_that_shows_nothing_or_is_of_another_train_is_refused(driven):
    log, train = driven(reference=False, seconds=1.0)
    with pytest.raises(InputError, match="neither relative poses nor a reference"):
        diagnose_train(train, [dataclasses.replace(log, rps=None, rps_age=None)])
    with pytest.raises(InputError, match="counts of 4 wheels; train 'CFMMR, 3 axles' has 6"):
        diagnose_train(cfmmr(3), [log])
    with pytest.raises(InputError, match="no log"):
        diagnose_train(train, [])
