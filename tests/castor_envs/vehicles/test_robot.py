# pyright: reportPossiblyUnboundVariable=false, reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportOperatorIssue=false, reportOptionalSubscript=false

import dataclasses
import json
import math

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from castor_envs.description import place_of
from castor_envs.effects.dimensions import PivotBias, WheelRadius
from castor_envs.errors import InputError
from castor_envs.motion.kinematics import Geometry
from castor_envs.physics.robot_world import RobotWorld
from castor_envs.sensors.encoders import Encoders, castor_angles
from castor_envs.vehicles.load import load_robot
from castor_envs.vehicles.presets import n_castor, preset, preset_names
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel
from castor_envs.vehicles.weight import swung_loads, wheel_loads


@pytest.mark.parametrize("name", preset_names())
def test_a_robot_survives_its_file(name, tmp_path):
    robot = preset(name).with_effects(PivotBias(castor=1, value=0.013))
    robot.save(tmp_path / "robot.json")
    assert RobotDescription.load(tmp_path / "robot.json") == robot
    assert json.loads((tmp_path / "robot.json").read_text())["format"] == "castor-robot/1"
    assert load_robot(str(tmp_path / "robot.json")) == robot


def keys_of(path):
    return [int(key) if key.isdigit() else key for key in path.split(".")]


def change(path, value):
    """Return the prototype's data with the entry at a dotted path set, or deleted if value is ... (Ellipsis)."""
    data = preset("asoc-prototype").to_dict()
    *way, last = keys_of(path)
    part = data
    for key in way:
        part = part[key]
    if value is ...:
        del part[last]
    else:
        part[last] = value
    return data


IMPOSSIBLE = [
    ("castors.1.wheels.0.radius", -0.01, ["castor 2, wheel 1, radius", "greater than or equal to 0.000001", "-0.01"]),
    ("castors.1.wheels.0.lateral", -0.0579999, ["castor 2", "less than 1e-06 m apart"]),
    ("castors.1.offset", 1e-300, ["castor 2, offset", "0, or greater than or equal to 1e-06", "1e-300"]),
    ("castors.1.pivot_counts_per_rev", 2**40, ["castor 2, pivot_counts_per_rev", "less than or equal to 4294967296"]),
    ("sample_period", 1e10, ["sample_period", "less than or equal to 1000000000"]),
    ("castors.1.wheels.0.radius", 0, ["castor 2, wheel 1, radius"]),
    ("castors.1.wheels.0.radius", "0.04", ["castor 2, wheel 1, radius", "'0.04'"]),
    ("castors.1.wheels.0.radius", ..., ["castor 2, wheel 1, radius", "required"]),
    ("castors.0.pivot", ..., ["castor 1, pivot", "required"]),
    ("castors.0.pivot", [0.1], ["castor 1, pivot"]),
    ("castors.2.steering", "loose", ["castor 3, steering", "'loose'"]),
    ("castors.2.offset", 0.0, ["castor 3", "offset"]),
    ("castors.2.offset", -0.1, ["castor 3, offset", "-0.1"]),
    ("castors", [], ["castors: needs at least 1 of them, has 0"]),
    ("sample_period", 0.0, ["sample_period"]),
    ("mass", True, ["mass"]),
    ("name", "", ["name"]),
    ("contact.friction", -1.0, ["contact.friction"]),
    ("contact.grip", 1.0, ["contact.grip"]),
    ("wheel_radius", 0.1, ["wheel_radius"]),
    ("format", "castor-robot/2", ["format", "castor-robot/1"]),
    ("effects", [{"name": "ghost"}], ["effect 1", "ghost"]),
    ("effects", [{"name": "pivot_bias", "castor": 0, "value": 0.0}], ["effect 1 (pivot_bias), castor"]),
]


@pytest.mark.parametrize(("path", "value", "said"), IMPOSSIBLE)
def test_an_impossible_value_is_named(path, value, said):
    with pytest.raises(InputError) as error:
        RobotDescription.from_dict(change(path, value), source="mine.json")
    message = str(error.value)
    assert message.startswith("mine.json: ")
    assert "\n" not in message
    for word in said:
        assert word in message


def numbers(data, way=()):
    """All dotted paths to numbers in plain data."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        if isinstance(value, dict | list):
            yield from numbers(value, (*way, key))
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield ".".join(map(str, (*way, key)))


@pytest.mark.parametrize("value", [1e200, -1e200, 1e308, int("9" * 40), math.nan, math.inf])
def test_no_number_of_a_robot_is_beyond_all_measure(value):
    """Every number of the file; the error names file, key, value and bound."""
    ways = list(numbers(preset("asoc-prototype").to_dict()))
    assert len(ways) > 40
    for way in ways:
        with pytest.raises(InputError, match=r"^mine\.json: ") as error:
            RobotDescription.from_dict(change(way, value), source="mine.json")
        said = str(error.value)
        assert f"{place_of(keys_of(way))}: Input should be " in said
        assert "\n" not in said
        if math.isfinite(value):
            assert said.endswith(f"got {value!r}")


@pytest.mark.parametrize("value", [0, -1, 1e-300, 5e-324])
def test_a_robot_with_any_number_too_small_is_refused_or_stands(value):
    """Nothing else happens: no overflow, no number that is not finite, no warning."""
    for way in numbers(preset("asoc-prototype").to_dict()):
        try:
            world = RobotWorld(RobotDescription.from_dict(change(way, value)))
            world.advance(np.ones(6))
        except InputError:
            continue
        assert np.all(np.isfinite(world.pose))


@pytest.mark.parametrize("text", ["", "{", "[]", "3", '{"format": "castor-robot/1", "mass": NaN}', "\x00"])
def test_a_file_that_is_no_robot_is_refused_by_name(tmp_path, text):
    path = tmp_path / "robot.json"
    path.write_text(text)
    with pytest.raises(InputError, match=r"robot\.json"):
        RobotDescription.load(path)


@pytest.mark.parametrize(
    ("data", "said"),
    [
        ({"name": "x"}, "robot: castors: is required; add it"),
        (preset("differential").to_dict() | {"mss": 3}, r"robot: mss: is not known; did you mean 'mass'\?"),
        (preset("differential").to_dict() | {"zzz": 3}, "robot: zzz: is not known; known: castors, center_of_mass, .*"),
    ],
)
def test_keys_that_are_missing_or_unknown_are_named(data, said):
    with pytest.raises(InputError, match=f"^{said}$"):
        RobotDescription.from_dict({"format": "castor-robot/1", **data})


def test_a_missing_file_and_an_unknown_preset_are_refused():
    with pytest.raises(InputError, match="nowhere"):
        load_robot("nowhere.json")
    with pytest.raises(InputError, match="did you mean 'asoc-prototype'"):
        load_robot("asoc-prototyp")


def test_wheels_stand_from_left_to_right():
    with pytest.raises(ValueError, match="left"):
        Castor(pivot=(0, 0), steering="fixed", wheels=(Wheel(radius=0.1, lateral=-0.1), Wheel(radius=0.1, lateral=0.1)))


@given(value=st.floats(-0.1, 0.1), castor=st.integers(1, 3))
def test_effects_change_what_they_name_and_nothing_else(value, castor):
    robot = preset("asoc-prototype")
    biased = robot.with_effects(PivotBias(castor=castor, value=value)).as_built()
    for i, (before, after) in enumerate(zip(robot.castors, biased.castors, strict=True), start=1):
        expected = dataclasses.replace(before, pivot_zero=before.pivot_zero + (value if i == castor else 0.0))
        assert after == expected
    grown = robot.with_effects(WheelRadius(castor=castor, wheel=2, value=value))
    assert grown.as_described() == robot
    assert math.isclose(grown.as_built().castors[castor - 1].wheels[1].radius, 0.0381 * (1 + value))
    assert grown.as_built().effects == ()


def test_an_effect_on_a_castor_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="no castor 4"):
        preset("asoc-prototype").with_effects(PivotBias(castor=4, value=0.1)).as_built()


def test_the_hash_knows_parameters_not_names():
    robot = preset("asoc-prototype")
    assert dataclasses.replace(robot, name="other").hash() == robot.hash()
    assert dataclasses.replace(robot, mass=robot.mass + 1e-9).hash() != robot.hash()


@pytest.mark.parametrize("counts", [0.5, 2 * np.pi, 1000.5])
def test_a_pivot_may_have_any_number_of_counts_a_turn(counts, tmp_path):
    robot = preset("1-castor")
    robot = dataclasses.replace(robot, castors=(dataclasses.replace(robot.castors[0], pivot_counts_per_rev=counts),))
    robot.save(tmp_path / "robot.json")
    assert RobotDescription.load(tmp_path / "robot.json") == robot
    counted = Encoders(Geometry.of(robot), np.zeros(2)).pivot(np.array([[0.0], [0.3], [2 * np.pi + 0.3]]))
    assert counted[1] == pytest.approx(counted[0] + round(0.3 * counts / (2 * np.pi)), abs=1e-9)
    angles = castor_angles(Geometry.of(robot), counted + counts)
    off = angles[:, 0] + robot.castors[0].pivot_zero - np.array([0.0, 0.3, 0.3])
    assert np.abs(np.angle(np.exp(1j * off))).max() <= np.pi / counts + 1e-9


def test_whole_counts_a_turn_are_the_same_robot_however_they_are_written():
    data = preset("tricycle").to_dict()
    counts = data["castors"][0]["pivot_counts_per_rev"]
    assert isinstance(counts, int)
    data["castors"][0]["pivot_counts_per_rev"] = float(counts)
    assert RobotDescription.from_dict(data).hash() == preset("tricycle").hash()


def test_papers_numbers_stand_in_the_presets():
    prototype, full = preset("asoc-prototype"), preset("asoc-full-scale")
    assert prototype.sample_period == 1 / 20
    assert 360 / prototype.wheels[0].counts_per_rev == pytest.approx(0.3)
    assert 360 / prototype.castors[0].pivot_counts_per_rev == pytest.approx(0.07, rel=1e-4)
    assert full.mass + sum(castor.mass for castor in full.castors) == pytest.approx(300.0)
    for small, large in zip(prototype.castors, full.castors, strict=True):
        assert large.offset == pytest.approx(3 * small.offset)
        assert large.wheels[0].radius == pytest.approx(3 * small.wheels[0].radius)
    caster = preset("powered-caster")
    assert {(abs(c.pivot[0]), abs(c.pivot[1])) for c in caster.castors} == {(0.19015, 0.17015)}
    assert {(c.offset, c.wheels[0].lateral, c.wheels[0].radius) for c in caster.castors} == {(0.014, -0.00375, 0.0508)}
    with pytest.raises(InputError):
        n_castor(7)


def test_a_robot_that_would_tip_is_refused_where_it_is_built():
    robot = preset("asoc-prototype")
    with pytest.raises(InputError, match="center_of_mass"):
        RobotWorld(dataclasses.replace(robot, center_of_mass=(1.0, 0.0)))
    wheels = (Wheel(radius=0.05, lateral=0.2), Wheel(radius=0.05, lateral=0.1))
    castor = dataclasses.replace(robot.castors[0], wheels=wheels)
    with pytest.raises(InputError, match="one side"):
        RobotWorld(dataclasses.replace(robot, castors=(castor, *robot.castors[1:])))


def test_the_pivots_carry_the_weight_and_its_moments():
    """Three pivots: the loads are those of a plate on three legs, found from the balance of force and moments."""
    robot = dataclasses.replace(preset("asoc-prototype"), center_of_mass=(0.05, -0.03))
    loads = wheel_loads(robot, 9.81).reshape(3, 2)
    np.testing.assert_allclose(loads[:, 0], loads[:, 1])
    legs = loads.sum(axis=1) - 1.5 * 9.81
    assert np.sum(legs) == pytest.approx(18 * 9.81)
    pivots = np.array([castor.pivot for castor in robot.castors])
    np.testing.assert_allclose(legs @ pivots, 18 * 9.81 * np.array([0.05, -0.03]), atol=1e-9)


def test_the_weight_shifts_as_castors_trail():
    """A plate of 18 kg and three castors of 1.5 kg on the castors' axles: force and moments balance at any angles."""
    robot = dataclasses.replace(preset("asoc-prototype"), center_of_mass=(0.02, -0.01))
    angles = np.random.default_rng(1).uniform(-np.pi, np.pi, (50, 3))
    loads = swung_loads(robot, 9.81, angles)
    np.testing.assert_allclose(loads[:, 0::2], loads[:, 1::2])
    assert np.all(loads > 0)
    weight, moment = loads.sum(axis=1), np.zeros((50, 2))
    np.testing.assert_allclose(weight, 22.5 * 9.81)
    for i, castor in enumerate(robot.castors):
        u = np.column_stack([np.cos(angles[:, i]), np.sin(angles[:, i])])
        axle = np.array(castor.pivot) - castor.offset * u
        moment += (2 * loads[:, 2 * i] - 1.5 * 9.81)[:, None] * axle
    np.testing.assert_allclose(moment, np.tile(18 * 9.81 * np.array([0.02, -0.01]), (50, 1)), atol=1e-9)
    straight = swung_loads(robot, 9.81, np.zeros((1, 3)))[0]
    assert straight[0] > wheel_loads(robot, 9.81)[0]  # all trail backward, so the weight is nearer the front wheels


def test_a_key_that_stands_twice_is_refused(tmp_path):
    path = tmp_path / "robot.json"
    preset("asoc-prototype").save(path)
    path.write_text(path.read_text().replace('"mass": 18.0,', '"mass": 18.0, "mass": 1.0,'))
    with pytest.raises(InputError, match="'mass' stands twice"):
        RobotDescription.load(path)


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("asoc-prototype", {"mass": 0.5}),
        ("asoc-prototype", {"inertia": 0.01}),
        ("omnimate", {"mass": 0.5}),
        ("swerve", {"mass": 0.5}),
    ],
)
def test_a_chassis_lighter_than_its_castors_drives_as_the_heavy_one(name, changes):
    robot = dataclasses.replace(preset(name), **changes)
    env = gym.make("castor_envs:castor/UMBmark-v0", robot=robot)
    env.reset(seed=0)
    for _ in range(120):
        *_, info = env.step(np.zeros(3))
    np.testing.assert_allclose(info["pose"][:2], [0.25 * 6 - 0.0625, 0.0], atol=0.02)


def test_physics_that_goes_wrong_says_so():
    castor = dataclasses.replace(preset("asoc-prototype").castors[0], inertia=1e-12, mass=1e-6)
    robot = dataclasses.replace(preset("asoc-prototype"), castors=(castor, *preset("asoc-prototype").castors[1:]))
    with pytest.raises(InputError, match=r"substeps|unstable"):
        RobotWorld(robot).advance(np.ones(6))
