"""The floor's file: every number has a bound, and what is within works."""

import gymnasium as gym
import numpy as np
import pytest

from castor_envs.description import place_of
from castor_envs.effects.catalogue import floor_of
from castor_envs.effects.floor import Bump, FloorSlope
from castor_envs.errors import InputError
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.vehicles.presets import preset

FLOOR = Floor(
    patches=(Patch(center=(1.0, 0.0), size=(1.0, 2.0), friction=0.3, angle=0.1),),
    cables=(Cable(center=(2.0, 0.0), direction=0.3, length=2.0, diameter=0.005),),
    slope=(0.01, 0.02),
)
KEYS = [
    *(("patches", 0, key) for key in ("friction", "angle")),
    *(("patches", 0, key, axis) for key in ("center", "size") for axis in (0, 1)),
    *(("cables", 0, key) for key in ("direction", "length", "diameter")),
    *(("cables", 0, "center", axis) for axis in (0, 1)),
    ("slope", 0),
    ("slope", 1),
    ("gravity",),
]


def changed(way, value):
    """Return the floor's data with one number replaced."""
    data = FLOOR.to_dict()
    part = data
    for key in way[:-1]:
        part = part[key]
    part[way[-1]] = value
    return data


@pytest.mark.parametrize("value", [1e200, -1e200, 1e308, int("9" * 40)])
@pytest.mark.parametrize("way", KEYS)
def test_a_number_beyond_all_measure_is_refused_with_key_value_and_bound(way, value):
    with pytest.raises(InputError, match="than or equal to") as error:
        Floor.from_dict(changed(way, value), source="mine.json")
    said = str(error.value)
    assert said.startswith(f"mine.json: {place_of(way)}: Input should be ")
    assert said.endswith(f"got {value!r}")


@pytest.mark.parametrize("value", [0.0, 1e-300, 1.0, -1.0, 10.0])
@pytest.mark.parametrize("way", KEYS)
def test_what_is_read_is_driven_on(way, value):
    try:
        floor = Floor.from_dict(changed(way, value))
        env = gym.make("castor_envs:castor/UMBmark-v0", floor=floor)
    except InputError:
        return
    env.reset(seed=0)
    for _ in range(3):
        observation, reward, *_ = env.step(np.zeros(3))
        assert np.all(np.isfinite(observation["wheel"]))
        assert np.isfinite(float(reward))


def test_effects_that_make_a_floor_too_steep_are_refused_in_one_line():
    robot = preset("differential").with_effects(*[FloorSlope(direction="x", value=0.5)] * 3)
    with pytest.raises(
        InputError, match=r"effect floor_slope is too large for this floor: slope, number 1: .* equal to 1"
    ):
        floor_of(robot, Floor())


def test_a_cable_too_thin_to_be_one_is_none():
    robot = preset("differential").with_effects(Bump(x=1.0, y=0.0, direction=0.0, value=1e-300))
    assert floor_of(robot, Floor()) == Floor()
