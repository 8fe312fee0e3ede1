"""Trains with hidden effects: what the finder says, on perfect rolling built here and on physics."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from numpy.polynomial import Polynomial

from castor_envs.effects.dimensions import AllWheelRadius, Track, WheelRadius
from castor_envs.effects.train import (
    AxleSlip,
    DeadGauge,
    ForeshorteningLeftOut,
    GaugeDrift,
    GaugeGain,
    GaugeNoise,
    SensorStops,
)
from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.train import TrainDescription
from discrepancy.trains.diagnosis import diagnose_train
from discrepancy.trains.report import as_data, as_lines
from discrepancy.trains.trial.simulate import log_at_random

TRAIN, SPEED, SECONDS = cfmmr(2), 0.3, 12.0
LENGTH, STEP = TRAIN.frames[0].length, 1e-3
COUNTS = 2000  # a turn


def path(s, seed):
    """Heading of a winding path at arc lengths s, m."""
    a, b = np.random.default_rng(seed).uniform(-0.5, 0.5, 2)
    return 0.9 * np.sin((1.4 + 0.2 * a) * s + b) + 0.1 * s


def driven(
    seed=1,
    *,
    gains=(1.0,) * 4,
    dead=(),
    drift=0.0,
    shortening=1.0,
    tracks=(1.0, 1.0),
    radii=(1.0,) * 4,
    noise=1.0,
    stops=np.inf,
    lost=None,
    straight=False,
    reference=True,
    seconds=SECONDS,
):
    """A log of two axles that roll along one path without slip or force, the frame bent along it.

    What sensors read is worked out here: curvature of the path at the gauges, a parabola through them in the least
    squares, its integrals along the frame by the trapezium rule.
    """
    random = np.random.default_rng([seed, 5])
    t = 0.05 * np.arange(round(seconds / 0.05) + 1)
    front = SPEED * (t + 0.3 * np.sin(1.1 * t))
    grid = np.arange(-LENGTH - 0.1, front[-1] + 0.1, STEP)
    heading = np.zeros_like(grid) if straight else path(grid, seed)
    x, y = (np.concatenate([[0.0], np.cumsum(STEP * f((heading[1:] + heading[:-1]) / 2))]) for f in (np.cos, np.sin))
    at = np.stack([front, front - LENGTH], axis=1)
    pose = np.stack([np.interp(at, grid, column) for column in (x, y, heading)], axis=-1)

    rolled, turned = at - at[0], pose[..., 2] - pose[0, :, 2]
    half = 0.16 * np.array(tracks)
    wheel = np.stack([rolled - half * turned, rolled + half * turned], axis=-1).reshape(-1, 4)
    counts = wheel / (0.075 * np.array(radii)) * COUNTS / (2 * np.pi)
    if lost is not None:
        which, start, end, share = lost
        inside = (t[1:] > start) & (t[1:] <= end)
        counts[1:, which] -= np.cumsum(share * inside * np.diff(counts[:, which]))

    places = LENGTH * (np.arange(4) + 0.5) / 4
    bend = np.gradient(heading, grid)
    kappa = np.interp(at[:, 1:] + places, grid, bend) * np.array(gains) + random.normal(0.0, 0.4, 4)
    kappa += noise * 0.1 * random.standard_normal(kappa.shape) + drift * t[:, None]
    kappa[:, [number - 1 for number in dead]] = 0.0
    s = np.linspace(0.0, LENGTH, 401)
    rps = np.zeros((len(t), 3))
    for k, reading in enumerate(kappa):
        phi = Polynomial.fit(places, reading, 2).integ(lbnd=0.0)(s)
        rps[k] = np.trapezoid(np.cos(phi), s), np.trapezoid(np.sin(phi), s), phi[-1]
    rps[:, 0] = LENGTH - shortening * (LENGTH - rps[:, 0])
    last = np.searchsorted(t, stops)
    age = np.where(t > stops, t - t[min(last, len(t) - 1)], 0.0)
    rps[last:] = rps[min(last, len(t) - 1)]

    truth = pose + random.normal(0.0, 1e-3, pose.shape)
    truth[np.arange(len(t)) % 20 > 0] = np.nan
    soft = dataclasses.replace(TRAIN.frames[0], bending_stiffness=1e-6)
    log = Log(
        t=t,
        wheel=np.round(counts + random.uniform(size=4)),
        pivot=np.zeros((len(t), 0)),
        reference=truth.reshape(-1, 6) if reference else None,
        rps=rps,
        rps_age=age[:, None],
    )
    return log, dataclasses.replace(TRAIN, frames=(soft,))


def found_in(*logs, **more):
    """What the finder says of such logs; frames so soft that they do not make axles creep."""
    return diagnose_train(logs[0][1], [log for log, _ in logs], **more)


def only(found):
    """The one effect that is named, its axle, value and standard error."""
    assert found.verdict == "named", found.reason
    (one,) = found.findings
    assert one.placed is not None
    return one.placed.effect, one.placed.axle, one.placed.value, one.error or 0.0


HIDDEN = [
    ({"gains": (1.1,) * 4}, GaugeGain(frame=1, value=0.1), None),
    ({"gains": (1.0, 1.0, 1.0, 0.7)}, GaugeGain(frame=1, gauge=4, value=-0.3), None),
    ({"drift": 0.02}, GaugeDrift(frame=1, value=0.02), None),
    ({"shortening": 0.3}, ForeshorteningLeftOut(frame=1, value=0.7), None),
    ({"tracks": (1.02, 1.0)}, Track(castor=1, value=0.02), 1),
    ({"radii": (1.0, 1.0, 1.0, 1.01)}, WheelRadius(castor=1, wheel=2, value=0.01), 2),
    ({"radii": (0.99, 0.99, 1.0, 1.0)}, AllWheelRadius(value=-0.01), 1),
    ({"noise": 5**0.5}, GaugeNoise(frame=1, value=0.2), None),
]


@pytest.mark.parametrize(("hidden", "effect", "axle"), HIDDEN, ids=lambda case: getattr(case, "name", None))
def test_an_effect_is_named_with_its_place_and_size(hidden, effect, axle):
    found = found_in(driven(**hidden))
    named, place, value, error = only(found)
    assert (dataclasses.replace(named, value=effect.value), place) == (effect, axle)
    assert abs(value - effect.value) < 3 * error < abs(effect.value)
    assert found.found is not None
    assert found.found.as_described() == found.train


def test_a_dead_gauge_is_named():
    found = found_in(driven(dead=(3,)), held_out=[driven(seed=2, dead=(3,))[0]])
    assert only(found)[0] == DeadGauge(frame=1, gauge=3)
    assert found.held_out is not None
    before, after = found.held_out
    assert after.posture_heading < 0.5 * before.posture_heading


def test_a_sensor_that_stops_is_named():
    effect, _, value, _ = only(found_in(driven(stops=7.0)))
    assert isinstance(effect, SensorStops)
    assert value == pytest.approx(7.0, abs=0.06)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nothing_is_found_where_nothing_is_hidden(seed):
    found = found_in(driven(seed=seed, reference=seed > 1))
    assert (found.verdict, found.findings, found.found) == ("no discrepancy", (), None)
    assert (found.before.position is None) == (seed == 1)


def test_without_a_reference_sensors_and_wheels_still_tell():
    effect, axle, value, error = only(found_in(driven(tracks=(1.0, 0.97), reference=False)))
    assert (effect.name, axle) == ("track", 2)
    assert abs(value + 0.03) < 3 * error


def test_two_effects_are_found_one_after_another():
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


def test_a_motion_that_does_not_show_it_confirms_nothing():
    hidden: dict[str, Any] = {"gains": (1.15,) * 4}
    found = found_in(driven(**hidden), held_out=[driven(seed=2, straight=True, **hidden)[0]])
    assert found.verdict == "unconfirmed"
    assert "does not show gain of gauges, frame A" in found.reason
    assert found.found is None


def test_a_name_that_held_out_logs_deny_is_not_confirmed():
    found = found_in(driven(gains=(1.15,) * 4), held_out=[driven(seed=2)[0]])
    assert found.verdict == "unconfirmed"
    assert "does not help" in found.reason


def test_a_wheel_that_loses_counts_for_a_while_has_no_name():
    found = found_in(driven(lost=(2, 4.5, 6.0, 0.08)))
    assert found.verdict == "unexplained"
    assert "wheel 2l counts otherwise from 4.5 to 6.0 s" in found.reason
    assert found.found is None


def test_what_clean_logs_show_as_well_is_background():
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


def test_a_log_that_shows_nothing_or_is_of_another_train_is_refused():
    log, train = driven(reference=False, seconds=1.0)
    with pytest.raises(InputError, match="neither relative poses nor a reference"):
        diagnose_train(train, [dataclasses.replace(log, rps=None, rps_age=None)])
    with pytest.raises(InputError, match="counts of 4 wheels; train 'CFMMR, 3 axles' has 6"):
        diagnose_train(cfmmr(3), [log])
    with pytest.raises(InputError, match="no log"):
        diagnose_train(train, [])
