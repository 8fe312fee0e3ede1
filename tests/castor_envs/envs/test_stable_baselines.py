"""A vector of Gymnasium is for Stable-Baselines3 what its own loop over single environments is, bit for bit."""

# pyright: reportMissingImports=false, reportAttributeAccessIssue=false

import subprocess
import sys
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import SyncVectorEnv

from castor_envs.errors import InputError

pytest.importorskip("stable_baselines3", reason="stable-baselines3 is not installed (extra 'rl')")

from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

from castor_envs.envs.driving.vector import TrackingVectorEnv
from castor_envs.envs.stable_baselines import GymnasiumVecEnv
from castor_envs.motion.trajectories import figure_eight

ROBOT, TRAIN = "castor/ASOC-v1", "castor/CFMMR-v1"


def vector_of(name, size, mode="SameStep", **arguments):
    return gym.make_vec(name, num_envs=size, autoreset_mode=mode, **arguments)


def equal(one, other):
    """Whether two answers have the same keys, shapes and bits; Python's numbers may stand for numpy's."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(equal, one, other))
    one, other = np.asarray(one), np.asarray(other)
    return (one.dtype, one.shape, one.tobytes()) == (other.dtype, other.shape, other.tobytes())


def without_times(infos):
    """Return infos without what clocks say."""
    for info in infos:
        info.get("episode", {}).pop("t", None)
    return infos


def follow(ours, theirs, steps, seed=3):
    """Step both with the same actions; return how many episodes were ended by the agent, and how many by the clock."""
    random, ends = np.random.default_rng(seed), [0, 0]
    assert ours.seed(seed) == theirs.seed(seed)
    assert equal(ours.reset(), theirs.reset())
    assert equal(ours.reset_infos, theirs.reset_infos)
    space = ours.action_space
    for _ in range(steps):
        if isinstance(space, gym.spaces.Discrete):
            actions = random.integers(space.n, size=ours.num_envs)
        else:
            actions = random.uniform(-1, 1, (ours.num_envs, *space.shape)).astype(np.float32)
        (*seen, infos), (*told, said) = ours.step(actions), theirs.step(actions)
        assert equal(seen, told)
        assert equal(without_times(infos), without_times(said))
        assert equal(ours.reset_infos, theirs.reset_infos)
        for info in infos:
            if "episode" in info:
                ends[info["TimeLimit.truncated"]] += 1
    return ends


@pytest.mark.parametrize("arguments", [{}, {"scaled": True, "floor": "slippery"}])
def test_agents_that_get_lost(arguments):
    arguments = {"robot": "differential", **arguments}
    ours = GymnasiumVecEnv(vector_of(ROBOT, 5, **arguments))
    lost, _ = follow(ours, make_vec_env(ROBOT, n_envs=5, env_kwargs=arguments), steps=150)
    assert lost > 5


@pytest.mark.parametrize(
    ("name", "course"), [(ROBOT, {"trajectory": figure_eight(radius=0.1)}), (TRAIN, {"path": "straight"})]
)
def test_agents_that_come_to_the_end(name, course):
    arguments = {"scaled": True, "control": "residual", **course}
    ours, theirs = GymnasiumVecEnv(vector_of(name, 2, **arguments)), make_vec_env(name, 2, env_kwargs=arguments)
    assert isinstance(ours.vector.unwrapped, TrackingVectorEnv)
    theirs.reset()
    _, late = follow(ours, theirs, steps=2 * theirs.get_attr("samples")[0] + 3)
    assert late == 4


def test_any_loop_of_gymnasium_in_wrappers():
    """Discrete actions, members with a time limit that is theirs, an information that is empty."""
    arguments: Any = {"max_episode_steps": 12}
    loop = SyncVectorEnv([lambda: gym.make("CartPole-v1", **arguments)] * 4, autoreset_mode="SameStep")
    ours = GymnasiumVecEnv(gym.wrappers.vector.ClipReward(loop, 0.0, 2.0))
    ends = follow(ours, make_vec_env("CartPole-v1", 4, env_kwargs=arguments), steps=100)
    assert min(ends) > 0


def test_members_answer_and_are_changed_as_those_of_the_loop():
    arguments = {"robot": "differential", "scaled": True}
    ours, theirs = GymnasiumVecEnv(vector_of(ROBOT, 3, **arguments)), make_vec_env(ROBOT, 3, env_kwargs=arguments)
    for env in (ours, theirs):  # some before their first episode
        assert env.get_attr("control", [0, 2]) == ["speed"] * 2
        assert not env.has_attr("unknown")
        env.seed(1)
        env.reset()
        env.step(np.full((3, 2), 0.4, dtype=np.float32))
    assert equal(*([sensed.pose for sensed in env.get_attr("sensed", 1)] for env in (ours, theirs)))
    for env in (ours, theirs):
        env.set_attr("told", "all")
        env.set_attr("told", "one", indices=1)
        assert env.get_attr("told") == ["all", "one", "all"]
        (moved,) = env.env_method("step", np.ones(2, dtype=np.float32), indices=2)
        assert moved[4]["position_error"] > 0
        assert env.env_is_wrapped(Monitor) == [True] * 3
        assert env.env_is_wrapped(gym.wrappers.TimeLimit, indices=0) == [False]
    actions = np.full((3, 2), 0.1, dtype=np.float32)
    assert equal(*(env.step(actions)[0] for env in (ours, theirs)))


def test_options_are_passed_on():
    low = {"low": 0.0, "high": 0.01}
    loop = SyncVectorEnv([lambda: gym.make("CartPole-v1")] * 2, autoreset_mode="SameStep")
    ours, theirs = GymnasiumVecEnv(loop), make_vec_env("CartPole-v1", 2)
    for env in (ours, theirs):
        env.seed(0)
        env.set_options(low)
    assert equal(ours.reset(), theirs.reset())
    ours.set_options([low, {}])
    with pytest.raises(InputError, match="same options"):
        ours.reset()


def test_pictures_stand_side_by_side():
    ours = GymnasiumVecEnv(vector_of(ROBOT, 2, render_mode="rgb_array"))
    theirs = make_vec_env(ROBOT, 2, env_kwargs={"render_mode": "rgb_array"})
    for env in (ours, theirs):
        env.seed(0)
        env.reset()
    assert equal(ours.render(), theirs.render())
    ours.close()


def test_what_cannot_be_taken_is_named():
    with pytest.raises(InputError, match="autoreset_mode='SameStep'"):
        GymnasiumVecEnv(vector_of(ROBOT, 2, "NextStep"))
    with pytest.raises(InputError, match=r"gymnasium\.make_vec"):
        GymnasiumVecEnv(gym.make(ROBOT))


def test_without_the_package_the_extra_is_named():
    code = "import sys; sys.modules['stable_baselines3'] = None; import castor_envs.envs.stable_baselines"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    said = done.stderr.splitlines()[-1]
    assert said.startswith("ImportError: needs Stable-Baselines3 (")
    assert "pip install '.[rl]'" in said


def test_a_policy_learns_as_in_the_loop():
    """The same weights after a few hundred steps: all that PPO sees is the same."""
    arguments = {"robot": "differential", "scaled": True, "trajectory": figure_eight(radius=0.1)}
    settings = {"n_steps": 64, "batch_size": 64, "n_epochs": 2, "seed": 0, "device": "cpu"}
    learned = []
    for env in (GymnasiumVecEnv(vector_of(ROBOT, 3, **arguments)), make_vec_env(ROBOT, 3, env_kwargs=arguments)):
        model = PPO("MlpPolicy", env, policy_kwargs={"net_arch": [16]}, **settings)
        model.learn(600)
        episodes = [(episode["r"], episode["l"]) for episode in model.ep_info_buffer or ()]
        learned.append((model.policy.state_dict(), episodes))
        assert np.mean(evaluate_policy(model, env, n_eval_episodes=2)[0]) > 0
    (ours, lengths), (theirs, told) = learned
    assert lengths == told != []
    assert all(bool((ours[name] == theirs[name]).all()) for name in theirs)
