"""Whatever a vehicle that can be described does, its observations are in their space."""

# pyright: reportPossiblyUnboundVariable=false, reportAttributeAccessIssue=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

from castor_envs.effects.train import FrameLength
from castor_envs.floor import Floor
from castor_envs.vehicles.presets import any_preset, preset


def seen(name, steps=100, **arguments):
    """Yield the observations of an environment in which every action is at its bounds; its space first."""
    env = gym.make(name, disable_env_checker=True, **arguments)
    env.action_space.seed(0)
    yield env.observation_space
    yield env.reset(seed=0)[0]
    for step in range(steps):
        if step % 8 == 0:
            action = np.sign(env.action_space.sample()).astype(np.float32)
        observation, _, terminated, truncated, _ = env.step(action)
        yield observation
        if terminated or truncated:
            yield env.reset()[0]


@pytest.mark.parametrize("error", [-0.03, 0.05])
def test_sensors_that_compute_by_another_length_of_their_frame(error):
    train = any_preset("cfmmr-3").with_effects(FrameLength(frame=1, value=error))
    space, *observations = seen("castor/CFMMR-v1", steps=10, train=train, path="straight")
    assert all(map(space.contains, observations))


@pytest.mark.parametrize("length", [0.3, 0.33, 0.7])
def test_straight_frames_without_noise_are_read_to_rounding(length):
    train = any_preset("cfmmr-2")
    frame = dataclasses.replace(train.frames[0], length=length, gauge_noise=0.0, gauge_offset=0.0)
    space, *observations = seen("castor/CFMMR-v1", steps=2, train=dataclasses.replace(train, frames=(frame,)))
    assert all(map(space.contains, observations))


@pytest.mark.parametrize("slope", [-0.5, 0.3])
def test_weak_motors_are_overrun_downhill(slope):
    robot = dataclasses.replace(preset("differential"), max_wheel_torque=0.1, max_wheel_speed=3.0)
    space, *observations = seen("castor/ASOC-v1", robot=robot, floor=Floor(slope=(slope, 0.0)))
    assert all(map(space.contains, observations))
    fastest = 3.0 * 0.05 * robot.wheels[0].counts_per_rev / (2 * np.pi)
    assert max(np.abs(observation["wheel"]).max() for observation in observations) > 2 * fastest + 1


@pytest.mark.parametrize("counts", [4.0, 4096.0, 512.5])
def test_pivot_counts_reach_the_last_of_a_turn_and_no_further(counts):
    robot = preset("asoc-prototype")
    castors = [dataclasses.replace(castor, pivot_counts_per_rev=counts) for castor in robot.castors]
    robot = dataclasses.replace(robot, castors=tuple(castors))
    env = gym.make("castor/ASOC-v1", robot=robot)
    encoders = env.unwrapped.sensed.encoders
    read = encoders.pivot(np.linspace(-10.0, 10.0, 100_000)[:, None] * np.ones(3))
    high = env.observation_space["pivot"].high
    assert np.all(read.max(axis=0) <= high)
    assert np.all(read.max(axis=0) > high - 1.0)
