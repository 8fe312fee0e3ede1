# pyright: reportAttributeAccessIssue=false, reportCallIssue=false, reportArgumentType=false
# pyright: reportOperatorIssue=false
"""Every effect of the catalogue: files, bounds, nothing at 0, one meaning online and in prediction, closed forms."""

import dataclasses
import json
import math
import subprocess
import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from castor_envs.effects.catalogue import (
    EFFECTS,
    TRAIN_EFFECTS,
    catalogue,
    floor_of,
    readings,
    reference,
    sensor_model_of,
)
from castor_envs.effects.clocks import AllLatency, ClockOffset, ClockSkew, EncoderLatency, SampleJitter
from castor_envs.effects.contact import SlipStiffness
from castor_envs.effects.dimensions import (
    AllWheelRadius,
    CountsPerRev,
    LoadRadius,
    PivotBias,
    PivotOffset,
    PivotPositionX,
    PivotPositionY,
    Track,
    WheelRadius,
)
from castor_envs.effects.encoders import (
    LearnedTerm,
    LostRemainders,
    PivotBacklash,
    PivotEccentricity,
    PivotGain,
    TickLoss,
    TickLossBursts,
    WheelEccentricity,
)
from castor_envs.effects.floor import Bump, FrictionPatch
from castor_envs.effects.reference import GyroScale
from castor_envs.effects.train import GaugeDrift
from castor_envs.effects.wiring import CastorOrder, EncoderReversed, EncodersSwapped
from castor_envs.envs.sensed import SensedTrain
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.logs.recorder import RecordLog
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import figure_eight
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.load import load_train
from castor_envs.vehicles.presets import preset, preset_names
from castor_envs.vehicles.robot import RobotDescription

ROBOT = preset("asoc-prototype")
ROOT = Path(__file__).parents[3]
PLACED = {
    "bump": Bump(x=0.1, y=0.0, direction=1.4, value=Bump.step),
    "friction_patch": FrictionPatch(x=0.1, y=0.0, length=0.4, width=0.3, value=FrictionPatch.step),
    "gyro_scale": GyroScale(value=GyroScale.step),
    "learned_term": LearnedTerm(
        castor=1, wheel=2, of="castor angle", knots=(0.0, 2.0, 4.0), values=(5.0, -5.0, 2.0), value=LearnedTerm.step
    ),
    "tick_loss_bursts": TickLossBursts(castor=1, wheel=2, period=0.7, width=0.3, seed=1, value=TickLossBursts.step),
}
"""Effects at places and times, as the catalogue cannot know them of this robot, and of a gyro, which it has not."""
BY_NAME = {name: (kind.variants(ROBOT) or (PLACED[name],))[-1] for name, kind in EFFECTS.items()}
WIRING = {"encoders_swapped", "encoder_reversed", "castor_order"}
THERE_OR_NOT = WIRING | {"lost_remainders"}
CLOCKS = {"clock_skew", "clock_offset"}
SENSORS = sorted(name for name, effect in BY_NAME.items() if effect.sensor_model(ROBOT) is not None)


def larger(effect):
    """Return the effect in a size that counts can show."""
    return effect if effect.name in WIRING else dataclasses.replace(effect, value=min(20 * effect.step, 1.0))


def drive(robot, samples=40, seed=3):
    """Drive open loop in castor/ASOC-v1; return its SensedRobot, observations, true angles and sensed angles."""
    env = gym.make("castor_envs:castor/ASOC-v1", robot=robot, trajectory="figure-eight")
    observation, info = env.reset(seed=seed)
    sensed = env.unwrapped.sensed
    random = np.random.default_rng(7)
    rows = []
    for k in range(samples):
        world = sensed.world
        rows.append((observation, world.time, world.wheel_angles, world.castor_angles, *sensed.sensed_angles, info))
        way = 1.0 if k % 20 < 10 else -1.0  # forward and back, for backlash
        action = 0.3 * way * random.uniform(0.2, 1.0, env.action_space.shape).astype(np.float32)
        observation, _, terminated, truncated, info = env.step(action)
        assert env.observation_space.contains(observation)
        assert not terminated
        assert not truncated
    return sensed, rows


PLAIN = drive(ROBOT)[1]


def seen(effect, t, wheel=0.0, castor=0.0):
    """Return what effects' encoders see of the same motion of all wheels (K,) and all castors (K,): (K, w), (K, n)."""
    effects = effect if isinstance(effect, tuple) else (effect,)
    wheels = np.tile(np.broadcast_to(wheel, len(t))[:, None], 6)
    castors = np.tile(np.broadcast_to(castor, len(t))[:, None], 3)
    return readings(ROBOT.with_effects(*effects), t, wheels, castors)


T = np.arange(200) * 0.05


def test_every_effect_says_what_it_is():
    assert set(EFFECTS) == set(BY_NAME)
    for name, kind in EFFECTS.items():
        assert issubclass(kind, Effect)
        assert kind.title
        assert kind.check.endswith(".")
        assert kind.unit
        assert kind.step > 0
        assert kind.__doc__
        for twin in kind.indistinguishable_from:
            assert EFFECTS[twin].indistinguishable_from == kind.indistinguishable_from
        assert not kind.indistinguishable_from or name in kind.indistinguishable_from


@pytest.mark.parametrize("name", preset_names())
def test_the_catalogue_of_a_robot_has_what_it_can_have(name, tmp_path):
    robot = preset(name)
    effects = catalogue(robot)
    assert len(set(effects)) == len(effects)
    pose = np.column_stack([T, np.sin(T), T / 3])
    for effect in (*effects, *(placed for placed in PLACED.values() if name == "asoc-prototype")):
        assert effect.value == effect.step
        real = robot.with_effects(effect)
        built = real.as_built()
        assert built.effects == ()
        shapes = effect.apply(robot) != robot or effect.radius_change(robot) is not None
        does = [effect.sensor_model(built) is not None, shapes, effect.creep_compliance() != 0.0]
        does += [np.any(effect.reference_time(T) != T), np.any(effect.reference_pose(pose) != pose)]
        does += [floor_of(real, Floor()) != Floor(), effect.gyro_gain() != 1.0]
        assert does.count(True) == 1
        real.save(tmp_path / "robot.json")
        assert RobotDescription.load(tmp_path / "robot.json") == real
    counted = {kind: sum(effect.name == kind for effect in effects) for kind in EFFECTS}
    assert counted["wheel_radius"] == len(robot.driven_wheels)
    assert counted["pivot_bias"] == counted["pivot_backlash"] == len(robot.pivot_encoders)
    assert counted["encoder_latency"] == len(robot.driven_wheels) + len(robot.pivot_encoders)
    assert counted["pivot_offset"] == sum(c.offset > 0 and c.steering != "fixed" for c in robot.castors)


def test_every_effect_together_survives_the_file(tmp_path):
    robot = ROBOT.with_effects(*catalogue(ROBOT), *PLACED.values())
    robot.save(tmp_path / "robot.json")
    assert RobotDescription.load(tmp_path / "robot.json") == robot


@pytest.mark.parametrize("name", EFFECTS)
def test_bounds_are_kept_and_named(name):
    data = ROBOT.with_effects(BY_NAME[name]).to_dict()
    for value in (1e3, -1e3, math.nan, "0.1"):
        data["effects"][0]["value"] = value
        with pytest.raises(InputError, match=rf"mine\.json: effect 1 \({name}\), value|mine\.json: .*value") as error:
            RobotDescription.from_dict(json.loads(json.dumps(data)), source="mine.json")
        assert "\n" not in str(error.value)
        if not isinstance(value, str):
            with pytest.raises(ValidationError):
                dataclasses.replace(BY_NAME[name], value=value)


def test_an_unknown_effect_is_refused_with_the_known_names():
    data = ROBOT.to_dict() | {"effects": [{"name": "ghost", "value": 1.0}]}
    with pytest.raises(InputError, match=r"ghost.*pivot_backlash"):
        RobotDescription.from_dict(data)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (
            {"name": "pivot_bais", "castor": 1, "value": 0.1},
            r"effect 1: unknown effect 'pivot_bais'; did you mean 'pivot_b",
        ),
        ({"name": "gauge_drift", "frame": 1, "value": 0.1}, r"effect 1: unknown effect 'gauge_drift'"),
        ({"castor": 1, "value": 0.1}, r"effect 1: .*'name'"),
        ({"name": ["pivot_bias"]}, r"effect 1: .*'name'"),
        ("pivot_bias", r"effect 1: "),
        (
            {"name": "pivot_bias", "castor": 1, "valu": 0.1},
            r"effect 1 \(pivot_bias\), value: .* valu: is not known; did you mean 'value'",
        ),
        ({"name": "pivot_bias", "castor": 1.5, "value": 0.1}, r"effect 1 \(pivot_bias\), castor: .*1\.5"),
    ],
)
def test_a_wrong_effect_in_a_file_is_reported_by_place_and_key(given, said):
    with pytest.raises(InputError, match=rf"mine\.json: {said}") as error:
        RobotDescription.from_dict(ROBOT.to_dict() | {"effects": [given]}, source="mine.json")
    assert "\n" not in str(error.value)


def test_robots_and_trains_take_their_own_effects_only():
    drift = GaugeDrift(frame=1, value=0.1)
    with pytest.raises(ValidationError, match="effect 'gauge_drift' is one of a train, not of a robot"):
        ROBOT.with_effects(drift)
    with pytest.raises(ValidationError, match="effect 'pivot_bias' is one of a robot, not of a train"):
        load_train("cfmmr-2").with_effects(BY_NAME["pivot_bias"])
    assert {effect.name for effect in catalogue(load_train("cfmmr-2"))} == set(TRAIN_EFFECTS)
    assert not set(EFFECTS) & set(TRAIN_EFFECTS)


@pytest.mark.parametrize("kind", [*EFFECTS.values(), *TRAIN_EFFECTS.values()], ids=lambda kind: kind.__name__)
def test_what_an_effect_says_of_itself_is_so(kind):
    name = kind.__dataclass_fields__["name"].default
    effect = BY_NAME[name] if kind.scope == "robot" else kind.variants(load_train("cfmmr-2"))[-1]
    bounds = TypeAdapter(kind).json_schema()["properties"]["value"]
    assert kind.binary == (bounds.get("minimum") == bounds.get("maximum") == 1.0)
    if kind.wiring:  # twice it is undone
        angles = np.random.default_rng(1).normal(size=(5, 9))
        twice = readings(ROBOT.with_effects(effect, effect), T[:5], angles[:, :6], angles[:, 6:])
        np.testing.assert_allclose(np.hstack(twice), angles, atol=1e-12)
    if kind.timing:  # constant angles and poses show nothing of it
        unit_angles = np.ones((len(T), 9))
        built = ROBOT.with_effects(effect)
        np.testing.assert_allclose(
            np.hstack(readings(built, T, unit_angles[:, :6], unit_angles[:, 6:])), unit_angles, atol=1e-12
        )
        shown = reference(built, T, unit_angles[:, :3])
        assert np.all((shown == 1.0) | np.isnan(shown))
    if kind.creep == "compliance":
        assert effect.apply(ROBOT).contact != ROBOT.contact or effect.creep_compliance() > 0
    if kind.creep == "forces":
        assert effect.floor(ROBOT, Floor()).slope != (0.0, 0.0)


@pytest.mark.parametrize(
    ("robot", "effect", "said"),
    [
        ("asoc-prototype", PivotGain(castor=4, value=0.1), "no castor 4"),
        ("asoc-prototype", WheelEccentricity(castor=1, wheel=3, value=0.1), "castor 1 has no wheel 3"),
        ("asoc-prototype", EncoderLatency(castor=9, value=0.1), "no castor 9"),
        ("asoc-prototype", CastorOrder(castor=2, exchanged_with=2), "not two castors"),
        ("asoc-prototype", PivotOffset(castor=1, value=-0.072), "too large for castor 1"),
        ("asoc-prototype", PivotOffset(castor=1, value=-0.1), "too large for castor 1"),
        ("asoc-full-scale", LoadRadius(value=1e-3), "too large for castor 1: its wheels"),
        ("asoc-prototype", Bump(x=0.0, y=0.0, direction=0.0, value=0.04), "too thick"),
        ("tricycle", TickLossBursts(castor=2, wheel=1, value=0.1, period=1.0, width=0.1), "has no encoder"),
        ("differential", PivotBacklash(castor=1, value=0.1), "castor 1 has no pivot encoder"),
        ("differential", EncoderReversed(castor=1), "castor 1 has no pivot encoder"),
        ("tricycle", TickLoss(castor=2, wheel=1, value=0.1, above=1.0), "wheel 1 of castor 2 has no encoder"),
        ("tricycle", CountsPerRev(castor=2, wheel=1, value=0.1), "wheel 1 of castor 2 has no encoder"),
        ("tricycle", EncodersSwapped(castor=1), "has not two wheels"),
        ("tricycle", CastorOrder(castor=1, exchanged_with=2), "not two castors"),
    ],
)
def test_what_the_robot_does_not_have_is_refused_by_name(robot, effect, said, tmp_path):
    real = preset(robot).with_effects(effect)
    with pytest.raises(InputError, match=said) as error:
        real.as_built()
    assert effect.name in str(error.value)
    real.save(tmp_path / "real.json")
    with pytest.raises(InputError, match=rf"real\.json: .*{said}"):
        RobotDescription.load(tmp_path / "real.json")


@pytest.mark.parametrize("name", sorted(set(EFFECTS) - THERE_OR_NOT))
def test_at_value_0_nothing_changes_bit_for_bit(name):
    effects = EFFECTS[name].variants(ROBOT) or (PLACED[name],)
    zero_effects = tuple(dataclasses.replace(effect, value=0.0) for effect in effects)
    for plain, row in zip(PLAIN, drive(ROBOT.with_effects(*zero_effects))[1], strict=True):
        for key, value in plain[0].items():
            np.testing.assert_array_equal(row[0][key], value)
        for k in range(1, 6):
            np.testing.assert_array_equal(row[k], plain[k])
        np.testing.assert_array_equal(row[6]["pose"], plain[6]["pose"])
    pose = np.cumsum(np.random.default_rng(1).normal(size=(len(T), 3)), axis=0)
    np.testing.assert_array_equal(reference(ROBOT.with_effects(*zero_effects), T, pose), pose)


@pytest.mark.parametrize("name", [*SENSORS, "all of them", "geometry with sensors"])
def test_the_simulated_sensors_and_the_prediction_are_one(name):
    if name == "all of them":
        effects = [larger(BY_NAME[name]) for name in SENSORS]
    elif name == "geometry with sensors":
        effects = [WheelRadius(castor=1, wheel=1, value=0.02), LostRemainders(castor=1, wheel=1, value=1.0)]
        effects += [CountsPerRev(castor=1, wheel=1, value=0.1), PivotBias(castor=2, value=0.1)]
    else:
        effects = [larger(BY_NAME[name])]
    robot = ROBOT.with_effects(*effects)
    sensed, rows = drive(robot)
    observations, t, wheel, castor, seen_wheel, seen_castor, _ = (list(column) for column in zip(*rows, strict=True))
    predicted_wheel, predicted_castor = readings(robot, t, wheel, castor)
    np.testing.assert_allclose(predicted_wheel, seen_wheel, rtol=0, atol=1e-9)
    np.testing.assert_allclose(predicted_castor, seen_castor, rtol=0, atol=1e-9)
    if name != "geometry with sensors":
        moved = np.abs(np.hstack([predicted_wheel - wheel, predicted_castor - castor]))
        assert np.max(moved) > 1e-5
    count = np.cumsum([observation["wheel"] for observation in observations], axis=0)
    expected = sensed.encoders.wheel(predicted_wheel)
    np.testing.assert_array_equal(count, expected - expected[0])
    np.testing.assert_array_equal(
        [observation["pivot"] for observation in observations], sensed.encoders.pivot(predicted_castor)
    )


@pytest.mark.parametrize("name", SENSORS)
def test_a_reader_touches_only_its_own_channels_and_no_input(name):
    effect = larger(BY_NAME[name])
    random = np.random.default_rng(2)
    wheel, castor = (np.cumsum(random.normal(size=(len(T), k)), axis=0) for k in (6, 3))
    before = wheel.copy(), castor.copy()
    changed = readings(ROBOT.with_effects(effect), T, wheel, castor)
    np.testing.assert_array_equal(wheel, before[0])
    np.testing.assert_array_equal(castor, before[1])
    for a, b in zip(changed, readings(ROBOT.with_effects(effect), T, wheel, castor), strict=True):
        np.testing.assert_array_equal(a, b)
    own_castors = {getattr(effect, "castor", None), getattr(effect, "exchanged_with", None)}
    if hasattr(effect, "castor"):
        for i in {1, 2, 3} - own_castors:
            np.testing.assert_array_equal(changed[0][:, 2 * i - 2 : 2 * i], wheel[:, 2 * i - 2 : 2 * i])
            np.testing.assert_array_equal(changed[1][:, i - 1], castor[:, i - 1])


@pytest.mark.parametrize("name", sorted(set(SENSORS) - THERE_OR_NOT - {"pivot_backlash"}))
def test_twice_the_value_moves_the_reading_twice_as_far(name):
    """All but backlash are linear in their value (jitter and latency while they stay within a sample)."""
    effect = BY_NAME[name]
    amplitude = min(effect.step, 0.4)
    wheel, castor = 20.0 * np.sin(0.7 * T) + np.sin(3 * T), np.sin(2 * T)
    true = seen((), T, wheel, castor)
    moved = []
    for scale in (1.0, 2.0):
        sized = dataclasses.replace(effect, value=scale * amplitude)
        moved.append(np.hstack(seen(sized, T, wheel, castor)) - np.hstack(true))
    assert np.max(np.abs(moved[0])) > 0
    np.testing.assert_allclose(moved[1], 2 * moved[0], rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("effect", "change"),
    [
        (WheelRadius(castor=2, wheel=1, value=0.1), {("wheels", 0, "radius"): 1.1}),
        (CountsPerRev(castor=2, wheel=2, value=0.1), {("wheels", 1, "counts_per_rev"): 1.1}),
        (Track(castor=2, value=-0.2), {("wheels", 0, "lateral"): 0.8, ("wheels", 1, "lateral"): 0.8}),
        (PivotOffset(castor=2, value=0.018), {("offset",): 1.25}),
        (PivotPositionX(castor=2, value=0.06), {("pivot", 0): 0.5}),
        (PivotPositionY(castor=2, value=0.06 * math.sqrt(3)), {("pivot", 1): 1.5}),
    ],
)
def test_geometry_effects_build_what_they_say(effect, change):
    expected = ROBOT.to_dict()
    for path, scale in change.items():
        *way, last = path
        part = expected["castors"][1]
        for key in way:
            part = part[key]
        part[last] *= scale
    built = ROBOT.with_effects(effect).as_built().to_dict()
    for built_castor, expected_castor in zip(built["castors"], expected["castors"], strict=True):
        assert built_castor.pop("pivot") == pytest.approx(expected_castor.pop("pivot"))
        assert built_castor.pop("offset") == pytest.approx(expected_castor.pop("offset"))
        for wheel, expected_wheel in zip(built_castor.pop("wheels"), expected_castor.pop("wheels"), strict=True):
            assert {wheel.pop("grip"), expected_wheel.pop("grip")} == {"standard"}
            assert wheel == pytest.approx(expected_wheel)
        assert built_castor == expected_castor
    del built["castors"], expected["castors"]
    assert built == expected


def test_common_effects_build_what_they_say():
    built = ROBOT.with_effects(AllWheelRadius(value=0.02), SlipStiffness(value=0.5)).as_built()
    for wheel, before in zip(built.wheels, ROBOT.wheels, strict=True):
        assert wheel.radius == pytest.approx(1.02 * before.radius)
        assert dataclasses.replace(wheel, radius=before.radius) == before
    assert built.contact == dataclasses.replace(ROBOT.contact, slip_stiffness_long=120.0)
    radii = [WheelRadius(castor=i, wheel=j, value=0.02) for i in (1, 2, 3) for j in (1, 2)]
    assert ROBOT.with_effects(*radii).as_built() == ROBOT.with_effects(AllWheelRadius(value=0.02)).as_built()


@given(value=st.floats(-0.1, 0.9), speed=st.floats(-10, 10))
def test_latency_at_constant_speed_is_speed_times_value(value, speed):
    wheel, castor = seen(EncoderLatency(castor=2, wheel=1, value=value), T, speed * T, speed * T)
    running = value < T
    expected = speed * T - np.where(running, speed * value, speed * T)
    if value < 0:
        expected[0] = 0.0  # one sample alone has no speed
    np.testing.assert_allclose(wheel[:, 2], expected, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(castor[:, 0], speed * T)
    np.testing.assert_array_equal(wheel[:, 3], speed * T)
    pivot = seen(EncoderLatency(castor=2, value=value), T, speed * T, speed * T)[1]
    np.testing.assert_allclose(pivot[:, 1], expected, rtol=0, atol=1e-9)


def test_latency_of_all_is_latency_of_each():
    latencies = tuple(effect for effect in catalogue(ROBOT) if effect.name == "encoder_latency")
    for by_each, by_all in zip(
        seen(latencies, T, np.sin(T), np.cos(T)), seen(AllLatency(value=1e-3), T, np.sin(T), np.cos(T)), strict=True
    ):
        np.testing.assert_array_equal(by_each, by_all)


def test_jitter_at_constant_speed_is_white_with_the_size_it_says():
    t = np.arange(20_000) * 0.05
    wheel, castor = seen(SampleJitter(value=0.003, seed=5), t, 2.0 * t, -4.0 * t)
    early = (wheel[1:, 0] - 2.0 * t[1:]) / 2.0
    assert np.std(early) == pytest.approx(0.003, rel=0.03)
    assert np.mean(early) == pytest.approx(0.0, abs=1e-4)
    assert np.corrcoef(early[1:], early[:-1])[0, 1] == pytest.approx(0.0, abs=0.03)
    np.testing.assert_allclose((castor[1:, 2] + 4.0 * t[1:]) / -4.0, early, atol=1e-9)
    other_seed = seen(SampleJitter(value=0.003, seed=6), t, 2.0 * t)[0]
    assert np.any(other_seed != wheel)
    wild = seen(SampleJitter(value=0.1, seed=5), t, 2.0 * t)[0][:, 0]
    assert np.all(np.diff(wild) > -1e-9)  # samples keep their order


def test_backlash_stands_still_after_a_reversal_and_then_follows():
    """Up by 1 rad, down by 1 rad: at the end of each way the reading lags by half the backlash."""
    angle = np.concatenate([np.linspace(0, 1, 101), np.linspace(1, 0, 101)[1:]])
    t = np.arange(len(angle)) * 0.05
    read = seen(PivotBacklash(castor=3, value=0.1), t, 0.0, angle)[1][:, 2]
    assert read[0] == 0.0
    assert read[100] == pytest.approx(1.0 - 0.05)
    np.testing.assert_allclose(read[100:111], 0.95, atol=1e-12)  # stands still for 0.1 rad
    np.testing.assert_allclose(read[111:], angle[111:] + 0.05, atol=1e-12)
    np.testing.assert_array_equal(read[:6], 0.0)  # from the middle: half of it


@given(phase=st.floats(-math.pi, math.pi), value=st.floats(-0.3, 0.3))
def test_eccentricity_is_a_sine_once_a_turn_of_its_amplitude(phase, value):
    turn = np.linspace(0, 2 * math.pi, len(T), endpoint=False)
    wheel, castor = seen(
        (
            PivotEccentricity(castor=1, value=value, phase=phase),
            WheelEccentricity(castor=3, wheel=2, value=value, phase=phase),
        ),
        T,
        turn,
        turn,
    )
    for error in (wheel[:, 5] - turn, castor[:, 0] - turn):
        wave = np.fft.rfft(error) / (len(T) / 2)
        assert wave[1] == pytest.approx(-1j * value * np.exp(-1j * phase), abs=1e-12)
        assert np.max(np.abs(np.delete(wave, 1))) < 1e-12


def test_two_quarters_make_an_eccentricity_of_any_phase():
    angle = np.linspace(-5, 5, len(T))
    eccentric = seen(WheelEccentricity(castor=1, wheel=1, value=0.01, phase=0.7), T, angle)[0][:, 0] - angle
    parts = [
        seen(WheelEccentricity(castor=1, wheel=1, value=0.01, phase=phase), T, angle)[0][:, 0] - angle
        for phase in (0.0, math.pi / 2)
    ]
    np.testing.assert_allclose(eccentric, math.cos(0.7) * parts[0] + math.sin(0.7) * parts[1], atol=1e-12)


def test_a_gain_scales_theta():
    angle = np.linspace(-5, 5, len(T))
    np.testing.assert_allclose(seen(PivotGain(castor=2, value=0.01), T, 0.0, angle)[1][:, 1], 1.01 * angle)


@pytest.mark.parametrize("direction", ["forward", "backward", "both"])
def test_ticks_are_lost_only_at_speed_and_that_way(direction):
    """Slow and fast forward, slow and fast back, 2.5 s each: one of the fast ways, or both, loses 10 %."""
    speed = np.repeat([2.0, 8.0, -2.0, -8.0], 50)
    angle = np.concatenate([[0.0], np.cumsum(speed * 0.05)])
    t = np.arange(len(angle)) * 0.05
    effect = TickLoss(castor=1, wheel=2, value=0.1, above=5.0, direction=direction)
    lost = angle - seen(effect, t, angle)[0][:, 1]
    expected = {"forward": [0, 2.0, 2.0, 2.0], "backward": [0, 0, 0, -2.0], "both": [0, 2.0, 2.0, 0.0]}[direction]
    np.testing.assert_allclose(lost[[50, 100, 150, 200]], expected, atol=1e-9)


@given(speed=st.floats(-20, 20))
def test_lost_remainders_leave_whole_counts_each_sample(speed):
    counts = speed * 0.05 * 1200 / (2 * math.pi)  # a sample
    if abs(counts - round(counts)) < 1e-6:
        return
    effect = LostRemainders(castor=1, wheel=1)
    read = seen(effect, T, speed * T)[0][:, 0] * 1200 / (2 * math.pi)
    np.testing.assert_allclose(np.diff(read), math.trunc(counts), atol=1e-6)


def test_wiring_exchanges_and_reverses_counts():
    """Also between castors whose encoders differ in zero and in counts a turn: counts are what is exchanged."""
    castors = list(ROBOT.castors)
    castors[1] = dataclasses.replace(castors[1], pivot_zero=0.3, pivot_counts_per_rev=4096)
    robot = dataclasses.replace(ROBOT, castors=tuple(castors))
    wheel, castor = np.arange(6.0)[None], np.array([[0.1, 0.2, 0.3]])
    swapped = readings(robot.with_effects(EncodersSwapped(castor=2)), [0.0], wheel, castor)
    np.testing.assert_array_equal(swapped[0], [[0, 1, 3, 2, 4, 5]])
    np.testing.assert_array_equal(swapped[1], castor)
    turned = readings(
        robot.with_effects(EncoderReversed(castor=3, wheel=1), EncoderReversed(castor=1)), [0], wheel, castor
    )
    np.testing.assert_array_equal(turned[0], [[0, 1, 2, 3, -4, 5]])
    np.testing.assert_array_equal(turned[1], [[-0.1, 0.2, 0.3]])
    order = readings(robot.with_effects(CastorOrder(castor=1, exchanged_with=2)), [0.0], wheel, castor)
    np.testing.assert_array_equal(order[0], [[2, 3, 0, 1, 4, 5]])
    first, second = (castor.pivot_counts_per_rev for castor in castors[:2])
    assert order[1][0, 0] * first == pytest.approx((0.2 + 0.3) * second)
    assert (order[1][0, 1] + 0.3) * second == pytest.approx(0.1 * first)
    again = robot.with_effects(CastorOrder(castor=1, exchanged_with=2), CastorOrder(castor=2, exchanged_with=1))
    np.testing.assert_allclose(readings(again, [0.0], wheel, castor)[1], castor, atol=1e-12)


def test_readers_act_in_the_order_of_the_file():
    angle = np.linspace(0, 3, len(T))
    gain, wave = PivotGain(castor=1, value=0.2), PivotEccentricity(castor=1, value=0.1)
    gain_first = seen((gain, wave), T, 0.0, angle)[1][:, 0]
    np.testing.assert_allclose(gain_first, 1.2 * angle + 0.1 * np.sin(1.2 * angle))
    wave_first = seen((wave, gain), T, 0.0, angle)[1][:, 0]
    np.testing.assert_allclose(wave_first, 1.2 * (angle + 0.1 * np.sin(angle)))


def test_a_reader_starts_anew_for_each_run():
    robot = ROBOT.with_effects(TickLoss(castor=1, wheel=1, value=0.1, above=0.0), AllLatency(value=0.01))
    first_model, second_model = sensor_model_of(robot), sensor_model_of(robot)
    for t in (0.0, 0.05, 0.1):
        first_model(np.array([t]), np.full((1, 6), 9 * t), np.zeros((1, 3)))
    np.testing.assert_array_equal(second_model(np.zeros(1), np.full((1, 6), 7.0), np.ones((1, 3)))[0], 7.0)


@pytest.mark.parametrize("name", SENSORS)
def test_samples_may_be_read_one_or_many_at_once(name):
    effect = larger(BY_NAME[name])
    random, t = np.random.default_rng(5), np.sort(np.concatenate([T, T[::7] + 0.013]))
    wheel, castor = (np.cumsum(random.normal(size=(len(t), k)), axis=0) for k in (6, 3))
    at_once = readings(ROBOT.with_effects(effect), t, wheel, castor)
    for cuts in (range(1, len(t)), (2, 30, 31), ()):
        read = sensor_model_of(ROBOT.with_effects(effect))
        blocks = zip(*(np.split(angles, cuts) for angles in (t, wheel, castor)), strict=True)
        parts = [read(*block) for block in blocks]
        for k, block in enumerate(at_once):
            np.testing.assert_array_equal(np.concatenate([part[k] for part in parts]), block)


def test_radius_and_counts_of_a_wheel_leave_one_trace():
    """A wheel larger by v and an encoder that counts less by v/(1+v): the same counts on any motion."""
    v = 0.02
    counts = []
    for effect in (WheelRadius(castor=2, wheel=1, value=v), CountsPerRev(castor=2, wheel=1, value=1 / (1 + v) - 1)):
        built = ROBOT.with_effects(effect).as_built()
        rolled = roll(built, figure_eight())
        per_rev = np.array([wheel.counts_per_rev for wheel in built.wheels])
        counts.append(np.hstack([rolled.wheel_angle * per_rev / (2 * math.pi), rolled.castor_angle]))
    assert (
        WheelRadius.indistinguishable_from == CountsPerRev.indistinguishable_from == ("wheel_radius", "counts_per_rev")
    )
    np.testing.assert_allclose(counts[0], counts[1], rtol=0, atol=1e-6)
    plain = roll(ROBOT, figure_eight()).wheel_angle * 1200 / (2 * math.pi)
    assert np.max(np.abs(counts[0][:, :6] - plain)) > 10


def test_late_encoders_are_an_early_reference():
    """At constant speed the difference of wheels and reference is the same; the reference ends early."""
    assert AllLatency.indistinguishable_from == ClockOffset.indistinguishable_from
    pose = np.stack([0.3 * T, 0.1 * T, 0.2 * T], axis=-1)
    late = seen(AllLatency(value=0.12), T, 4.0 * T)[0][:, 0] / 4.0 - pose[:, 0] / 0.3
    early = reference(ROBOT.with_effects(ClockOffset(value=0.12)), T, pose)
    assert np.all(np.isnan(early[-3:-1]))
    known = (T > 0.12) & ~np.isnan(early[:, 0])
    np.testing.assert_allclose((T - early[:, 0] / 0.3)[known], late[known], atol=1e-9)


def test_a_recorded_reference_carries_the_clock_and_the_rest_of_the_log_does_not():
    logs = []
    for effects in ((), (ClockSkew(value=0.05), ClockOffset(value=-0.03))):
        env = RecordLog(
            gym.make("castor_envs:castor/ASOC-v1", robot=ROBOT.with_effects(*effects), trajectory="figure-eight")
        )
        env.reset(seed=4)
        for _ in range(40):
            env.step(np.array([0.2, 0.25] * 3, dtype=np.float32))
        logs.append(env.log())
    plain, moved = logs
    taken = 1.05 * plain.t - 0.03
    within_log = taken <= plain.t[-1]
    assert not np.all(within_log)
    np.testing.assert_array_equal(plain.wheel, moved.wheel)
    np.testing.assert_array_equal(plain.pivot, moved.pivot)
    np.testing.assert_array_equal(plain.t, moved.t)
    for k in range(3):
        expected = np.interp(taken, plain.t, plain.reference[:, k])
        np.testing.assert_allclose(moved.reference[within_log, k], expected[within_log], atol=1e-12)
        assert np.all(np.isnan(moved.reference[~within_log, k]))


def test_modules_of_a_train_have_sensor_effects_too():
    train = load_train("cfmmr-2")
    worn = train.modules[1].with_effects(EncoderReversed(castor=1, wheel=2))
    changed = dataclasses.replace(train, modules=(train.modules[0], worn))
    counts = []
    for vehicle in (train, changed):
        sensed = SensedTrain(vehicle, Floor())
        sensed.reset(np.random.default_rng(0))
        np.testing.assert_array_equal(sensed.observation["wheel"], 0.0)
        total = np.zeros(4)
        for _ in range(10):
            sensed.advance(np.full(4, 2.0))
            total += sensed.observation["wheel"]
        counts.append(total)
    assert np.all(counts[0] > 10)
    np.testing.assert_array_equal(counts[1][:3], counts[0][:3])
    assert abs(counts[1][3] + counts[0][3]) <= 1  # rounded the other way


def test_a_controller_sees_what_the_sensors_report():
    """The scripted driver of castor/UMBmark-v0 steers by a pivot that lies, so the robot goes another way."""
    ends = []
    for robot in (ROBOT, ROBOT.with_effects(PivotGain(castor=1, value=0.2))):
        env = gym.make("castor_envs:castor/UMBmark-v0", robot=robot, side=0.5)
        env.reset(seed=0)
        for _ in range(60):
            env.step(np.zeros(3))
        ends.append(env.unwrapped.sensed.world.pose)
    assert np.max(np.abs(ends[1] - ends[0])) > 1e-4


def test_the_page_is_up_to_date(script_called):
    module = script_called("make_effects_table")
    page = (ROOT / "docs" / "effects.md").read_text(encoding="utf-8")
    assert module.with_tables(page) == page, "run python scripts/tables/make_effects_table.py"
    for name in (*EFFECTS, *TRAIN_EFFECTS):
        assert page.count(f"\n| `{name}` |") == 1


TWICE = """
from pydantic.dataclasses import dataclass
from castor_envs.effects.catalogue import catalogue
from castor_envs.errors import InputError
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription

@dataclass(frozen=True)
class Mine(Effect[RobotDescription]):
    name: str = "wheel_radius"
    value: float = 1.0

try:
    catalogue(preset("differential"))
except InputError as error:
    print(error)
"""


def test_a_name_that_another_effect_has_is_refused():
    told = subprocess.run([sys.executable, "-c", TWICE], capture_output=True, text=True, check=True).stdout
    assert told.strip() == (
        "__main__.Mine has the name 'wheel_radius' of castor_envs.effects.dimensions.WheelRadius; give it another one"
    )
