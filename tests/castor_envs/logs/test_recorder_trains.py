"""RecordLog on an environment of a train: what is recorded is what was seen, commanded and true."""

import gymnasium as gym
import numpy as np
import pytest

from castor_envs.logs.csv import read_log
from castor_envs.logs.recorder import RecordLog
from castor_envs.vehicles.presets import cfmmr
from castor_envs.vehicles.train import TrainDescription


class ThreeSteps(gym.Env):
    """A train of three axles that shows numbers made of the sample's number k; its sensors miss a reading at k = 2."""

    action_space = gym.spaces.Box(-1, 1, (6,))
    observation_space = gym.spaces.Dict({})

    def __init__(self):
        self.vehicle = cfmmr(3)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.k = 0
        return self._seen(), self._info(np.zeros(6))

    def step(self, action):
        self.k += 1
        return self._seen(), 0.0, False, self.k == 3, self._info(10 * action)

    def _seen(self):
        rps = np.full(6, 0.1 * self.k)
        if self.k == 2:
            rps[3:] = np.nan
        wheel = np.arange(6.0) * (self.k > 0)
        return {"wheel": wheel, "time": np.array([0.05 * self.k]), "rps": rps, "rps_age": np.array([0.0, 0.05])}

    def _info(self, command):
        return {"pose": np.arange(9.0).reshape(3, 3) * 0.1 + 0.01 * self.k, "command": command}


def test_a_trains_episode_is_recorded_and_read_back(tmp_path):
    env = RecordLog(ThreeSteps(), folder=tmp_path)
    env.reset(seed=0)
    for k in range(3):
        env.step(np.full(6, 0.1 * (k + 1)))
    train = TrainDescription.load(tmp_path / "train.json")
    assert train == cfmmr(3)
    log = read_log(tmp_path / "episode-0000.csv", train)
    assert log.command is not None
    assert log.rps is not None
    np.testing.assert_array_equal(log.t, 0.05 * np.arange(4))
    np.testing.assert_array_equal(log.wheel, np.outer(np.arange(4), np.arange(6)))
    np.testing.assert_array_equal(log.command[:, 0], [10 * 0.1, 10 * 0.2, 10 * (0.1 * 3), 0])
    np.testing.assert_array_equal(log.reference, [np.arange(9) * 0.1 + 0.01 * k for k in range(4)])
    np.testing.assert_array_equal(np.isnan(log.rps), [[False] * 6, [False] * 6, [False] * 3 + [True] * 3, [False] * 6])
    np.testing.assert_array_equal(log.rps[:, 0], 0.1 * np.arange(4))
    np.testing.assert_array_equal(log.rps_age, [[0, 0.05]] * 4)
    assert log.steering_command is None
    assert log.pivot.shape == (4, 0)


def test_other_environments_are_refused():
    with pytest.raises(TypeError, match="CartPole"):
        RecordLog(gym.make("CartPole-v1"))
