"""A pickled environment goes on as the one that it was copied from, bit for bit."""

# pyright: reportAttributeAccessIssue=false

import copy
import dataclasses
import pickle

import gymnasium as gym
import numpy as np
import pytest

from castor_envs.effects.catalogue import catalogue
from castor_envs.effects.encoders import LearnedTerm, TickLossBursts
from castor_envs.envs import ENVIRONMENTS
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import Gyro

FOUND_IN_LOGS = (
    TickLossBursts(castor=1, wheel=1, value=0.5, period=0.1, width=0.05, seed=3),
    LearnedTerm(castor=1, wheel=1, of="castor angle", knots=(0.0, 1.0), values=(0.1, -0.2)),
)
#: A robot with each effect, by its name, and one with a gyro.
SENSED = {
    effect.name: robot.with_effects(effect)
    for robot in (preset("differential"), preset("asoc-prototype"))
    for effect in (*catalogue(robot), *FOUND_IN_LOGS)
}
SENSED["gyro"] = dataclasses.replace(preset("differential"), gyro=Gyro(noise=0.02, bias=0.01))


def number_bytes(given):
    """Return an observation's numbers as bytes."""
    return [values.tobytes() for values in (given.values() if isinstance(given, dict) else [given])]


def going_on(env, steps=25):
    """Return what the next steps of an environment give with seeded actions, and the reset after them."""
    env.action_space.seed(0)
    said = []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        said.append([*number_bytes(observation), reward, terminated, truncated, info["pose"].tobytes()])
    observation, info = env.reset()
    return said, number_bytes(observation), info["pose"].tobytes()


def pickled(env):
    return pickle.loads(pickle.dumps(env))


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_copy_goes_on_bit_for_bit(name):
    env = gym.make(name)
    copies = [pickled(env)]
    for each in (env, *copies):
        each.reset(seed=2)
    assert going_on(env) == going_on(copies[0])
    going_on(env)  # into another episode, on a course of its own
    for _ in range(5):
        env.step(env.action_space.sample())
    copies = [pickled(env), copy.deepcopy(env)]
    expected = going_on(env)
    assert [going_on(each) for each in copies] == [expected, expected]


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("castor/ASOC-v1", {"control": "residual", "scaled": True, "estimator": "estimators.robots.cast:CAST"}),
        ("castor/CFMMR-v1", {"estimator": "estimators.trains.odometry:TrainOdometry"}),
    ],
)
def test_a_copy_has_the_estimate_too(name, arguments):
    env = gym.make(name, **arguments)
    env.reset(seed=2)
    env.step(env.action_space.sample())
    assert going_on(pickled(env)) == going_on(env)


def test_a_copy_draws_pictures_of_its_own():
    env = gym.make("castor/ASOC-v1", render_mode="rgb_array")
    env.reset(seed=2)
    env.render()
    twin = pickled(env)
    assert twin.unwrapped._renderer is None
    assert isinstance(twin.render(), np.ndarray)


@pytest.mark.parametrize("name", SENSED)
def test_sensors_go_on_in_a_copy(name):
    """Those with effects keep what they have read: latency, backlash, counts lost so far; a gyro draws its noise."""
    env = gym.make("castor/UMBmark-v0", robot=SENSED[name])
    env.reset(seed=2)
    for _ in range(5):
        env.step(env.action_space.sample())
    assert going_on(pickled(env)) == going_on(env)


def stepped(vector, steps=25):
    """Return what the next steps of a vector give with seeded actions, and the reset after them, as bytes."""
    vector.action_space.seed(0)
    said = []
    for _ in range(steps):
        observation, reward, terminated, truncated, info = vector.step(vector.action_space.sample())
        outcomes = [values.tobytes() for values in (reward, terminated, truncated, info["pose"])]
        said.append([*number_bytes(observation), *outcomes])
    observation, info = vector.reset()
    return said, number_bytes(observation), info["pose"].tobytes()


@pytest.mark.parametrize("copied", [pickled, copy.deepcopy])
@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("castor/ASOC-v1", {}),
        ("castor/ASOC-v1", {"control": "residual", "scaled": True, "threads": 2}),
        ("castor/CFMMR-v1", {}),
        ("castor/UMBmark-v0", {}),
    ],
)
def test_a_copy_of_a_vector_goes_on_bit_for_bit_and_leaves_the_other_alone(name, arguments, copied):
    vector = gym.make_vec(name, num_envs=20, **arguments)
    twin = copied(vector)
    for each in (vector, twin):
        each.reset(seed=2)
    assert stepped(twin) == stepped(vector)
    for _ in range(5):
        vector.step(vector.action_space.sample())
    twin = copied(vector)
    assert stepped(twin) == stepped(vector)
