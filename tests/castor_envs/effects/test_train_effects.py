"""Effects of trains: the catalogue, files, what foreshortening left out makes of a reading, and slip under an axle."""

import dataclasses

import numpy as np
import pytest

from castor_envs.effects.catalogue import TRAIN_EFFECTS
from castor_envs.effects.train import (
    AxleSlip,
    DeadGauge,
    ForeshorteningLeftOut,
    FrameLength,
    GaugeDrift,
    GaugeGain,
    GaugeNoise,
)
from castor_envs.errors import InputError
from castor_envs.physics.train_world import TrainWorld
from castor_envs.sensors.posture import PostureSensors, sensed
from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.train import Frame, TrainDescription

TRAIN = cfmmr(3)
SMALL = [effect for kind in TRAIN_EFFECTS.values() for effect in kind.variants(TRAIN)]


@pytest.mark.parametrize("effect", SMALL, ids=lambda effect: f"{effect.name}-{getattr(effect, 'frame', '')}")
def test_every_effect_of_the_catalogue_stands_in_a_file_and_changes_the_train(effect, tmp_path):
    train = TRAIN.with_effects(effect)
    train.save(tmp_path / "train.json")
    assert TrainDescription.load(tmp_path / "train.json") == train
    assert train.as_built() != TRAIN.as_built()
    assert train.as_described() == TRAIN
    assert effect.title
    assert effect.check.endswith((".", "?"))
    assert effect.step > 0


def test_the_catalogue_has_one_for_every_place():
    places = {name: len(kind.variants(TRAIN)) for name, kind in TRAIN_EFFECTS.items()}
    expected = {
        "gauge_noise": 2,
        "gauge_gain": 2 * 5,
        "gauge_drift": 2,
        "dead_gauge": 8,
        "foreshortening_left_out": 2,
        "frame_length": 2,
        "sensor_stops": 2,
        "axle_slip": 3,
    }
    assert {name: places[name] for name in expected} == expected
    assert len(DeadGauge.variants(TRAIN.with_effects(DeadGauge(frame=1, gauge=2)))) == 7


@pytest.mark.parametrize(
    ("effect", "said"),
    [
        (ForeshorteningLeftOut(frame=3), "no frame 3"),
        (AxleSlip(axle=4, value=1.0), "no axle 4"),
        (FrameLength(frame=1, value=-0.05), "would be 0.3 m long; its last gauge is 0.3062 m"),
    ],
)
def test_what_is_not_there_is_refused(effect, said):
    with pytest.raises(InputError, match=said):
        TRAIN.with_effects(effect).as_built()


@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_an_arc_without_its_shortening(share):
    """An arc of curvature k: x = sin(k L) / k, y = (1 - cos(k L)) / k; without shortening x = L."""
    train = TRAIN.with_effects(ForeshorteningLeftOut(frame=1, value=share)).as_built()
    frame, k = train.frames[0], 1.7
    x, y, phi = sensed(frame, np.full(4, k), np.zeros(4), 0.0)
    arc = np.sin(k * frame.length) / k
    assert x == pytest.approx(arc + share * (frame.length - arc), abs=1e-12)
    assert (y, phi) == pytest.approx(((1 - np.cos(k * frame.length)) / k, k * frame.length), abs=1e-12)
    assert train.frames[1] == TRAIN.frames[1]


def test_a_longer_frame_is_read_as_the_shorter_one_that_its_sensor_knows():
    """Bent to the same curvature k its true end is at sin(k L) / k with the longer L, and is read with the shorter."""
    built = TRAIN.with_effects(*[FrameLength(frame=1, value=0.01)] * 2).as_built()
    frame, usual, k = built.frames[0], TRAIN.frames[0], 1.7
    assert (frame.length, frame.computed_length) == pytest.approx((usual.length + 0.02, usual.length))
    assert frame.gauge_positions == usual.gauge_positions
    read = sensed(frame, np.full(4, k), np.zeros(4), 0.0)
    arc = [np.sin(k * usual.length) / k, (1 - np.cos(k * usual.length)) / k, k * usual.length]
    assert read == pytest.approx(arc, abs=1e-12)
    world = TrainWorld(TRAIN.with_effects(FrameLength(frame=1, value=0.01)))
    assert np.diff(world.poses[:, 0]) == pytest.approx([-usual.length - 0.01, -usual.length])


def test_a_description_without_the_length_that_a_sensor_knows_is_the_same_file_as_before():
    assert "rps_length" not in TRAIN.to_dict()["frames"][0]


def test_shares_of_foreshortening_add_up_to_no_more_than_all():
    twice = TRAIN.with_effects(*[ForeshorteningLeftOut(frame=2, value=0.5)] * 2).as_built()
    assert twice.frames[1].foreshortening_left_out == pytest.approx(0.75)
    assert TRAIN.with_effects(ForeshorteningLeftOut(frame=2)).as_built().frames[1].foreshortening_left_out == 1.0


def test_the_sensor_of_physics_reads_what_sensed_says():
    effects = GaugeGain(frame=1, value=0.1), GaugeDrift(frame=1, value=0.05), ForeshorteningLeftOut(frame=1, value=0.5)
    quiet = dataclasses.replace(TRAIN, frames=(Frame(length=0.35, gauge_noise=0.0, gauge_offset=0.0),) * 2)
    built = quiet.with_effects(*effects, DeadGauge(frame=1, gauge=4)).as_built()
    angles = [np.full(6, 0.1), np.zeros(6)]
    rps, _ = PostureSensors(built, np.random.default_rng(0)).read(angles, 2.0)
    bend = 0.6 / 0.35
    reading = np.array([1.1 * bend + 0.1] * 3 + [0.0])
    plain = dataclasses.replace(quiet.frames[0], foreshortening_left_out=0.0)
    x, y, phi = sensed(plain, reading, np.zeros(4), 0.0)
    assert rps[0] == pytest.approx([0.5 * (x + 0.35), y, phi], abs=1e-12)
    assert rps[1] == pytest.approx([0.35, 0.0, 0.0], abs=1e-12)


def slipped_on_an_arc(train, curvature, metres):
    """How much further than their wheels rolled two axles on an arc turn, rad (2,); the frame is bent along the arc."""
    world = TrainWorld(train, bends=curvature * 0.35)
    speed = 0.25 / 0.075 * (1.0 + 0.16 * curvature * np.array([-1.0, 1.0] * 2))
    world.advance(speed)
    start, angles = world.poses[:, 2], world.wheel_angles
    for _ in range(round(metres / 0.25 / train.sample_period)):
        world.advance(speed)
    rolled = np.diff((world.wheel_angles - angles).reshape(2, 2), axis=1)[:, 0] * 0.075 / 0.32
    return world.poses[:, 2] - start - rolled


def test_an_axle_slips_as_its_frame_turns_it():
    """The moment E I k of the frame turns the axle by E I k / (d^2 C load) a metre against what its wheels roll.

    d: half track, C: slip stiffness; the front axle is turned back, the rear one on.
    """
    train, curvature, metres = cfmmr(2), 0.6, 0.3
    load = 9.81 * (5.0 + 0.5 * 0.5 * 0.35)
    turned = 0.5 * curvature / (0.16**2 * 80 * load) * metres
    assert slipped_on_an_arc(train, curvature, metres) == pytest.approx([-turned, turned], rel=0.15)
    softer = train.with_effects(AxleSlip(axle=1, value=9.0))
    assert slipped_on_an_arc(softer, curvature, metres) == pytest.approx([-10 * turned, turned], rel=0.15)
    contact, usual = softer.as_built().modules[0].contact, train.modules[0].contact
    assert contact.slip_stiffness_lat == pytest.approx(0.1 * usual.slip_stiffness_lat)
    assert contact.friction == usual.friction


@pytest.mark.parametrize("described", [0.0, 0.1, 10.0])
def test_the_most_noise_that_is_documented_can_be_added(described):
    train = cfmmr(2)
    frame = dataclasses.replace(train.frames[0], gauge_noise=described)
    noisy = dataclasses.replace(train, frames=(frame,)).with_effects(GaugeNoise(frame=1, value=10.0))
    assert noisy.as_built().frames[0].gauge_noise == pytest.approx(np.hypot(10.0, described))
