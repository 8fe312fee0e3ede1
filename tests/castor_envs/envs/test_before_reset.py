"""Before the first reset there is no episode: whatever is asked of one says so, and what to do. It has no options."""

# pyright: reportAttributeAccessIssue=false, reportArgumentType=false

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from castor_envs.envs import ENVIRONMENTS
from castor_envs.errors import InputError

DRIVEN = ("castor/ASOC-v1", "castor/CFMMR-v1")


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_nothing_is_told_of_an_episode_that_has_not_begun(name):
    env = gym.make(name, render_mode="rgb_array").unwrapped
    told = ["longest_episode", "readings", *(["unscaled"] if name in DRIVEN else [])]
    for attribute in told:
        with pytest.raises(ResetNeeded, match=rf"^{attribute} needs an episode.*env\.reset\(\)"):
            getattr(env, attribute)
    for call in (env.render, lambda: env.step(env.action_space.sample())):
        with pytest.raises(ResetNeeded, match=r"env\.reset\(\)"):
            call()
    env.reset(seed=0)
    for attribute in told:
        assert getattr(env, attribute)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_a_vector_needs_a_reset_before_a_step_and_says_nothing_of_episodes(name):
    vector = gym.make_vec(name, num_envs=2)
    with pytest.raises(ResetNeeded, match="reset"):
        vector.step(vector.action_space.sample())
    with pytest.raises(ResetNeeded, match="longest_episode"):
        vector.unwrapped.call("longest_episode")
    vector.reset(seed=0)
    assert np.isfinite(vector.step(vector.action_space.sample())[1]).all()


@pytest.mark.parametrize("name", DRIVEN)
def test_the_first_reset_of_a_vector_is_of_all_members(name):
    vector = gym.make_vec(name, num_envs=2, autoreset_mode="Disabled")
    with pytest.raises(ResetNeeded, match="reset_mask"):
        vector.reset(options={"reset_mask": np.array([True, False])})
    vector.reset(options={"reset_mask": np.array([True, True])})
    vector.step(vector.action_space.sample())


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_options_that_a_reset_does_not_know_are_refused(name):
    """But a vector's mask, and what a recorder of data sets reads and hands on."""
    env, vector = gym.make(name), gym.make_vec(name, num_envs=2, autoreset_mode="Disabled")
    for options in ({}, {"minari_autoseed": False}):
        env.reset(seed=0, options=options)
        vector.reset(seed=0, options=dict(options))
    said = r"reset has no option 'way'; known: 'reset_mask', of vectors only; .* gymnasium\.make"
    mask = {"reset_mask": np.array([True, False])}
    for reset, known in ((env.reset, {}), (vector.reset, {}), (vector.reset, mask)):
        with pytest.raises(InputError, match=said):
            reset(options=known | {"way": "cw"})
    for reset in (env.reset, vector.reset):
        with pytest.raises(InputError, match=r"options must be a dictionary or None, got \[1\]"):
            reset(options=[1])
        with pytest.raises(InputError, match="reset has no option"):
            reset(options={1: 2, "way": "cw"})
    vector.reset(options=mask)
