# pyright: reportArgumentType=false
"""The description of a train: files, presets, effects, and what is refused."""

import dataclasses
import json
import math

import pytest

from castor_envs.effects.dimensions import WheelRadius
from castor_envs.effects.train import DeadGauge, GaugeDrift, GaugeGain, GaugeNoise, SensorStops
from castor_envs.errors import InputError
from castor_envs.floor import Cable, Floor
from castor_envs.physics.train_world import TrainWorld
from castor_envs.vehicles.load import file_name, load_train, load_vehicle, vehicle_from_dict
from castor_envs.vehicles.presets import axle_module, cfmmr, preset, train_names
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import Frame, TrainDescription

EVERY_EFFECT = (
    GaugeNoise(frame=1, value=0.2),
    GaugeGain(frame=2, value=-0.1),
    GaugeGain(frame=1, gauge=3, value=0.05),
    GaugeDrift(frame=2, value=0.01),
    DeadGauge(frame=1, gauge=2),
    SensorStops(frame=2, value=3.0),
)


@pytest.mark.parametrize("name", train_names())
def test_a_train_survives_its_file(name, tmp_path):
    train = load_train(name)
    if train.n_axles > 2:
        train = train.with_effects(*EVERY_EFFECT)
    train.save(tmp_path / "train.json")
    assert TrainDescription.load(tmp_path / "train.json") == train
    assert json.loads((tmp_path / "train.json").read_text())["format"] == "castor-train/1"
    assert load_vehicle(str(tmp_path / "train.json")) == train
    assert load_train(str(tmp_path / "train.json")) == train
    assert TrainDescription.load(tmp_path / "train.json").hash() == train.hash()


def test_presets_are_trains_of_two_to_ten_axles():
    assert [load_train(f"cfmmr-{n}").n_axles for n in range(2, 11)] == list(range(2, 11))
    for n in (2, 7, 10):
        train = cfmmr(n)
        assert train.n_axles == len(train.modules) == len(train.frames) + 1 == n
        assert {frame.length for frame in train.frames} == {0.35}  # Vogt, Figs. 7 to 10
        assert train.frame_names == tuple("ABCDEFGHI"[: n - 1])
        assert train.wheel_names[:4] == ("1l", "1r", "2l", "2r")
        assert len(train.wheel_names) == 2 * n
    for n in (-1, 0, 1, 11):
        with pytest.raises(InputError, match=f"2 to 10 axles, got {n}"):
            cfmmr(n)


def test_gauges_stand_evenly_where_nobody_says_where():
    places = Frame(length=0.8).gauge_positions
    assert places == pytest.approx((0.1, 0.3, 0.5, 0.7))
    assert Frame(length=0.8, gauges=(0.0, 0.8)).gauge_positions == (0.0, 0.8)


def change(path, value):
    """Return the data of a train of three axles with the entry at a dotted path set, or deleted if it is ... ."""
    data = cfmmr(3).to_dict()
    *way, last = [int(key) if key.isdigit() else key for key in path.split(".")]
    part = data
    for key in way:
        part = part[key]
    if value is ...:
        del part[last]
    else:
        part[last] = value
    return data


def modules_like(*changes):
    """Data of a train of three axles whose second module is changed."""
    data = cfmmr(3).to_dict()
    for way, value in changes:
        part = data["modules"][1]
        for key in way[:-1]:
            part = part[key]
        part[way[-1]] = value
    return data


AXLE = axle_module().to_dict()
AXLE.pop("format")
ROBOT = preset("asoc-prototype").to_dict()
ROBOT.pop("format")

IMPOSSIBLE = [
    ("format", "castor-train/2", ["format", "castor-train/1"]),
    ("format", ..., ["format"]),
    ("name", "", ["name"]),
    ("name", ..., ["name", "required"]),
    ("axles", 3, ["axles"]),
    ("modules", ..., ["modules", "required"]),
    ("modules", [], ["2 to 10 modules", "got 0"]),
    ("modules", [AXLE], ["2 to 10 modules", "got 1"]),
    ("modules", [AXLE] * 11, ["2 to 10 modules", "got 11"]),
    ("modules", [AXLE] * 2, ["2 modules has 1 frames, got 2"]),
    ("modules", [AXLE] * 4, ["4 modules has 3 frames, got 2"]),
    ("modules", 3, ["modules"]),
    ("modules.1.speed", 3, ["module 2, speed"]),
    ("modules.1.castors.0.wheels.0.radius", -1.0, ["module 2, castor 1, wheel 1, radius", "-1.0"]),
    ("modules.1", ROBOT, ["module 2", "3 castors"]),
    ("frames", ..., ["frames", "required"]),
    ("frames", [], ["3 modules has 2 frames, got 0"]),
    ("frames.1.length", ..., ["frame 2, length", "required"]),
    ("frames.1.length", 0.0, ["frame 2, length", "greater than or equal to 0.001"]),
    ("frames.1.length", -0.35, ["frame 2, length", "-0.35"]),
    ("frames.1.length", math.nan, ["frame 2, length", "finite"]),
    ("frames.1.length", math.inf, ["frame 2, length", "finite"]),
    ("frames.1.length", "0.35", ["frame 2, length", "'0.35'"]),
    ("frames.0.bending_stiffness", 0.0, ["frame 1, bending_stiffness"]),
    ("frames.0.linear_density", -0.5, ["frame 1, linear_density"]),
    ("frames.0.linear_density", 0.0, ["frame 1, linear_density"]),
    ("frames.0.damping", -0.001, ["frame 1, damping"]),
    ("frames.0.links", 2, ["frame 1, links"]),
    ("frames.0.links", 25, ["frame 1, links"]),
    ("frames.0.links", 6.5, ["frame 1, links"]),
    ("frames.0.gauge_noise", -0.1, ["frame 1, gauge_noise"]),
    ("frames.0.gauge_offset", math.nan, ["frame 1, gauge_offset"]),
    ("frames.0.rps_stops", -1.0, ["frame 1, rps_stops"]),
    ("frames.0.stiffness", 1.0, ["frame 1, stiffness"]),
    ("frames.0.gauges", [], ["frame 1, gauges"]),
    ("frames.0.gauges", [0.1, 0.36], ["frame 1", "gauges", "0.35"]),
    ("frames.0.gauges", [-0.01, 0.1], ["frame 1", "gauges"]),
    ("frames.0.gauges", [0.2, 0.1], ["frame 1", "gauges must increase"]),
    ("frames.0.gauges", [0.1, 0.1], ["frame 1", "gauges must increase"]),
    ("frames.0.gauges", [0.1, math.nan], ["frame 1, gauge 2"]),
    ("frames.0.gauge_gains", [1.0, 1.0], ["frame 1", "gauge_gains", "4 gauges"]),
    ("frames.0.dead_gauges", [5], ["frame 1", "dead_gauges", "4"]),
    ("frames.0.dead_gauges", [0], ["frame 1, dead_gauges"]),
    ("effects", [{"name": "ghost", "frame": 1}], ["effect 1", "ghost"]),
    ("effects", [{"frame": 1, "value": 0.1}], ["effect 1"]),
    ("effects", [{"name": "gauge_gain", "frame": 0, "value": 0.0}], ["effect 1", "frame"]),
    ("effects", [{"name": "gauge_gain", "frame": 1, "value": 0.6}], ["effect 1", "value", "0.6"]),
    ("effects", [{"name": "gauge_noise", "frame": 1, "value": -0.1}], ["effect 1", "value"]),
    ("effects", [{"name": "gauge_drift", "frame": 1, "value": math.nan}], ["effect 1", "value"]),
    ("effects", [{"name": "dead_gauge", "frame": 1}], ["effect 1", "gauge", "required"]),
    ("effects", [{"name": "dead_gauge", "frame": 1, "gauge": 0}], ["effect 1", "gauge"]),
    ("effects", [{"name": "sensor_stops", "frame": 1, "value": -1.0}], ["effect 1", "value"]),
    ("effects", [{"name": "sensor_stops", "frame": 1, "value": 1.0, "gauge": 2}], ["effect 1", "gauge"]),
]


@pytest.mark.parametrize(("path", "value", "said"), IMPOSSIBLE)
def test_an_impossible_value_is_named(path, value, said):
    with pytest.raises(InputError) as error:
        TrainDescription.from_dict(change(path, value), source="mine.json")
    message = str(error.value)
    assert message.startswith("mine.json: ")
    assert "\n" not in message
    for word in said:
        assert word in message


NOT_AXLES = [
    ([(("castors", 0, "steering"), "driven")], "fixed at the origin"),
    ([(("castors", 0, "pivot"), [0.1, 0.0])], "fixed at the origin"),
    ([(("castors", 0, "angle"), 0.1)], "fixed at the origin"),
    ([(("castors", 0, "offset"), 0.05)], "fixed at the origin"),
    ([(("castors", 0, "wheels", 0, "grip"), "omni")], "standard"),
    ([(("castors", 0, "wheels", 1, "counts_per_rev"), None)], "two driven wheels"),
    ([(("castors", 0, "wheels"), [{"radius": 0.075}])], "two driven wheels"),
    ([(("gyro",), {})], "gyro"),
    ([(("sample_period",), 0.1)], "same sample_period"),
]


@pytest.mark.parametrize(("changes", "said"), NOT_AXLES)
def test_a_module_that_is_no_axle_is_refused_by_number(changes, said):
    with pytest.raises(InputError, match="module 2") as error:
        TrainDescription.from_dict(modules_like(*changes))
    assert said in str(error.value)


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"format": "castor-train/1"}', "\x00", '{"format": "x"}'])
def test_a_file_that_is_no_train_is_refused_by_name(tmp_path, text):
    path = tmp_path / "mine.json"
    path.write_text(text)
    for load in (TrainDescription.load, load_train, load_vehicle):
        with pytest.raises(InputError, match=r"mine\.json"):
            load(str(path))


def test_a_key_that_stands_twice_is_refused(tmp_path):
    path = tmp_path / "train.json"
    cfmmr(2).save(path)
    path.write_text(path.read_text().replace('"length": 0.35,', '"length": 0.35, "length": 0.4,'))
    with pytest.raises(InputError, match="'length' stands twice"):
        TrainDescription.load(path)


@pytest.mark.parametrize(
    ("effect", "said"),
    [
        (GaugeNoise(frame=3, value=0.1), "no frame 3"),
        (GaugeGain(frame=3, value=0.1), "no frame 3"),
        (GaugeGain(frame=1, gauge=5, value=0.1), "no gauge 5, it has 4"),
        (GaugeDrift(frame=7, value=0.1), "no frame 7"),
        (DeadGauge(frame=2, gauge=9), "no gauge 9, it has 4"),
        (DeadGauge(frame=3, gauge=1), "no frame 3"),
        (SensorStops(frame=4, value=1.0), "no frame 4"),
    ],
)
def test_an_effect_on_what_is_not_there_is_refused(effect, said):
    with pytest.raises(InputError, match=said) as error:
        cfmmr(3).with_effects(effect).as_built()
    assert effect.name in str(error.value)
    with pytest.raises(InputError, match=said):
        TrainWorld(cfmmr(3).with_effects(effect))


def test_effects_change_what_they_name_and_nothing_else():
    train = cfmmr(3)
    built = train.with_effects(*EVERY_EFFECT).as_built()
    first, second = built.frames
    noise = math.hypot(train.frames[0].gauge_noise, 0.2)
    assert first.gauge_noise == pytest.approx(noise)
    assert first.gauge_gains == pytest.approx((1.0, 1.0, 1.05, 1.0))
    assert first.dead_gauges == (2,)
    expected = dataclasses.replace(
        train.frames[0], gauge_noise=first.gauge_noise, gauge_gains=first.gauge_gains, dead_gauges=(2,)
    )
    assert first == expected
    assert second == dataclasses.replace(train.frames[1], gauge_gains=(0.9,) * 4, gauge_drift=0.01, rps_stops=3.0)
    assert built.modules == train.modules
    assert built.effects == ()
    assert train.with_effects(*EVERY_EFFECT).as_described() == train


def test_effects_add_up_in_any_order():
    train = cfmmr(2)
    pairs = [
        ([GaugeDrift(frame=1, value=0.1), GaugeDrift(frame=1, value=-0.04)], "gauge_drift", pytest.approx(0.06)),
        ([SensorStops(frame=1, value=4.0), SensorStops(frame=1, value=2.0)], "rps_stops", 2.0),
        ([DeadGauge(frame=1, gauge=3), DeadGauge(frame=1, gauge=1)], "dead_gauges", (1, 3)),
        ([DeadGauge(frame=1, gauge=3), DeadGauge(frame=1, gauge=3)], "dead_gauges", (3,)),
    ]
    for effects, field, expected in pairs:
        for order in (effects, effects[::-1]):
            assert getattr(train.with_effects(*order).as_built().frames[0], field) == expected


def test_effects_of_modules_are_their_own_and_are_built_in_and_left_out_with_the_train_s():
    train = cfmmr(2)
    worn = train.modules[1].with_effects(WheelRadius(castor=1, wheel=2, value=-0.02))
    train = dataclasses.replace(train, modules=(train.modules[0], worn)).with_effects(GaugeDrift(frame=1, value=0.1))
    assert train.as_built().modules[1].wheels[1].radius == pytest.approx(0.075 * 0.98)
    assert train.as_built().modules[0] == cfmmr(2).modules[0]
    assert train.as_described() == cfmmr(2)
    world = TrainWorld(train)
    assert list(world.wheels["radius"]) == pytest.approx([0.075, 0.075, 0.075, 0.0735])


def leaves(data, way=()):
    """All ways to numbers and words in plain data, but for the train's name and the format."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        if isinstance(value, dict | list):
            yield from leaves(value, (*way, key))
        elif (*way, key) not in (("format",), ("name",)):
            yield (*way, key)


def test_the_hash_knows_every_number_and_not_the_name():
    train = cfmmr(3).with_effects(GaugeGain(frame=1, value=0.1))
    assert dataclasses.replace(train, name="other").hash() == train.hash()
    seen, numbers = {train.hash()}, 0
    for way in leaves(train.to_dict()):
        data = train.to_dict()
        part = data
        for key in way[:-1]:
            part = part[key]
        value = part[way[-1]]
        if isinstance(value, bool | str) or value is None or value == 0 or way[-1] in ("sample_period", "links"):
            continue
        part[way[-1]] = 2 if way[-1] == "frame" else value * (1 + 1e-9) if isinstance(value, float) else value
        if part[way[-1]] == value:
            continue
        changed = TrainDescription.from_dict(data)
        assert changed.hash() not in seen, way
        seen.add(changed.hash())
        numbers += 1
    assert numbers > 60
    frame = train.frames[0]
    changes = [
        {"links": 7},
        {"damping": 0.0},
        {"gauges": (0.1, 0.2)},
        {"gauge_drift": 0.1},
        {"dead_gauges": (1,)},
        {"gauge_gains": (1.0, 1.0, 1.0, 1.1)},
        {"rps_stops": 0.0},
    ]
    for change in changes:
        changed = dataclasses.replace(train, frames=(dataclasses.replace(frame, **change), train.frames[1]))
        assert changed.hash() not in seen, change
        seen.add(changed.hash())
    slower = tuple(dataclasses.replace(module, sample_period=0.1) for module in train.modules)
    assert dataclasses.replace(train, modules=slower).hash() not in seen


@pytest.mark.parametrize("value", [1e200, -1e200, int("9" * 40)])
def test_no_number_of_a_train_is_beyond_all_measure(value):
    """Every number of the file, effects of train and modules too."""
    frame = Frame(length=0.35, gauges=(0.1, 0.2), gauge_gains=(1.0, 1.0), rps_stops=1.0)
    module = cfmmr(2).modules[0]
    train = dataclasses.replace(cfmmr(2), modules=(module, module), frames=(frame,))
    train = train.with_effects(GaugeGain(frame=1, value=0.1), SensorStops(frame=1, value=1.0))
    for way in leaves(train.to_dict()):
        data = train.to_dict()
        part = data
        for key in way[:-1]:
            part = part[key]
        if isinstance(part[way[-1]], bool | str) or part[way[-1]] is None:
            continue
        part[way[-1]] = value
        with pytest.raises(InputError, match=r"^mine\.json: ") as error:
            TrainDescription.from_dict(data, source="mine.json")
        assert "\n" not in str(error.value)


def test_a_train_is_as_its_order_says():
    """Front first: exchanging two unlike frames gives another train."""
    train = cfmmr(3)
    unlike = dataclasses.replace(train, frames=(Frame(length=0.3), Frame(length=0.4)))
    turned = dataclasses.replace(train, frames=(Frame(length=0.4), Frame(length=0.3)))
    assert unlike.hash() != turned.hash()
    assert unlike != turned


def test_vehicles_are_read_by_their_format(tmp_path):
    assert vehicle_from_dict(cfmmr(2).to_dict()) == cfmmr(2)
    assert isinstance(vehicle_from_dict(preset("differential").to_dict()), RobotDescription)
    with pytest.raises(InputError, match=r"mine: 'format' must be 'castor-robot/1' or 'castor-train/1', got 'x'"):
        vehicle_from_dict({"format": "x"}, "mine")
    with pytest.raises(InputError, match="mine"):
        vehicle_from_dict([1], "mine")
    assert load_vehicle(cfmmr(2)) == cfmmr(2)
    assert load_vehicle("differential") == preset("differential")
    assert load_vehicle("cfmmr-4") == cfmmr(4)
    assert (file_name(cfmmr(2)), file_name(preset("differential"))) == ("train.json", "robot.json")


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("cfmr-3", "did you mean 'cfmmr-3'"),
        ("cfmmr-11", "did you mean 'cfmmr-1"),
        ("cfmmr-1", "did you mean"),
        ("nowhere.json", "nowhere"),
        ("differentail", "did you mean 'differential'"),
        ("", "cfmmr-2"),
    ],
)
def test_an_unknown_vehicle_is_refused_with_advice(spec, said):
    for load in (load_vehicle, load_train):
        with pytest.raises(InputError, match=said):
            load(spec)


def test_a_file_of_another_kind_is_distinguished_from_a_preset(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("log.csv", "swerve"):
        (tmp_path / name).write_text("t\n")
    with pytest.raises(InputError, match=r"log\.csv: files of robots and trains end in \.json"):
        load_vehicle("log.csv")
    assert load_vehicle("swerve") == preset("swerve")


def test_a_robot_is_no_train_and_a_train_no_robot(tmp_path):
    with pytest.raises(InputError, match="is a robot, not a train"):
        load_train("differential")
    cfmmr(2).save(tmp_path / "train.json")
    with pytest.raises(InputError, match=r"castor-robot/1"):
        RobotDescription.load(tmp_path / "train.json")
    preset("differential").save(tmp_path / "robot.json")
    with pytest.raises(InputError, match=r"castor-train/1"):
        TrainDescription.load(tmp_path / "robot.json")


def test_a_cable_too_thick_for_a_train_s_wheels_is_refused():
    floor = Floor(cables=(Cable(center=(1.0, 0.0), direction=1.5, length=1.0, diameter=0.08),))
    with pytest.raises(InputError, match="too thick"):
        TrainWorld(cfmmr(2), floor)


def test_an_effect_on_what_is_not_there_is_refused_when_read(tmp_path):
    data = cfmmr(3).to_dict()
    data["effects"] = [{"name": "dead_gauge", "frame": 3, "gauge": 1}]
    (tmp_path / "train.json").write_text(json.dumps(data))
    for read in (TrainDescription.load, load_vehicle):
        with pytest.raises(InputError, match=r"train\.json: effect dead_gauge: .* no frame 3"):
            read(str(tmp_path / "train.json"))
    data["effects"] = []
    data["modules"][1]["effects"] = [{"name": "wheel_radius", "castor": 1, "wheel": 9, "value": 0.1}]
    with pytest.raises(InputError, match="train: effect wheel_radius: castor 1 has no wheel 9"):
        TrainDescription.from_dict(data)
