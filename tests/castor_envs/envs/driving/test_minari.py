"""Episodes go into Minari datasets and come back as they were driven, with the environment they were driven in."""

import importlib.util
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import castor_envs  # noqa: F401  (registers what a dataset asks for)

pytestmark = [
    pytest.mark.skipif(importlib.util.find_spec("minari") is None, reason="Minari is not installed (extra 'minari')"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),  # Minari leaves a temporary folder to the collector
    pytest.mark.filterwarnings("ignore:.*eval_env:UserWarning"),
]


@pytest.mark.parametrize("name", ["castor/ASOC-v1", "castor/CFMMR-v1"])
@pytest.mark.parametrize("scaled", [False, True])
def test_a_dataset_holds_what_was_driven_and_its_environment(name, scaled, tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    import minari

    env = minari.DataCollector(gym.make(name, scaled=scaled, floor="slippery"))
    random, driven = np.random.default_rng(0), []
    for seed in (3, 4):
        observation, _ = env.reset(seed=seed)
        seen, actions, rewards, over = [observation], [], [], False
        while not over:
            action = random.uniform(-1, 1, env.action_space.shape).astype(np.float32)
            observation, reward, terminated, truncated, _ = env.step(action)
            seen.append(observation)
            actions.append(action)
            rewards.append(reward)
            over = terminated or truncated
        driven.append((seen, actions, rewards))
    told: dict[str, Any] = {
        "algorithm_name": "random",
        "author": "A",
        "author_email": "a@b.c",
        "description": "D",
        "code_permalink": "C",
    }
    env.create_dataset("castor/test-v0", **told)
    env.close()

    dataset = minari.load_dataset("castor/test-v0")
    assert dataset.total_episodes == 2
    for episode, (seen, actions, rewards) in zip(dataset, driven, strict=True):
        np.testing.assert_array_equal(episode.actions, actions)
        np.testing.assert_array_equal(episode.rewards, rewards)
        kept = {"": episode.observations} if scaled else episode.observations
        for key, values in kept.items():
            np.testing.assert_array_equal(values, [o if scaled else o[key] for o in seen])
    again = dataset.recover_environment()
    assert again.observation_space == env.observation_space
    observation, _ = again.reset(seed=3)
    for action, reward in zip(driven[0][1], driven[0][2], strict=True):
        assert again.step(action)[1] == reward
