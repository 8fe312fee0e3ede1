"""What environments hand out belongs to whoever gets it: writing into it changes nothing that comes later."""

# pyright: reportCallIssue=false, reportArgumentType=false

import gymnasium as gym
import numpy as np
import pytest

from castor_envs.envs import ENVIRONMENTS
from estimators.robots.cast import CAST

DRIVEN = ("castor/ASOC-v1", "castor/CFMMR-v1")


def wiped(given):
    """Overwrite an observation, and return it as it was."""
    arrays = list(given.values()) if isinstance(given, dict) else [given]
    before = [array.copy() for array in arrays]
    for array in arrays:
        array[...] = 0.5
    return before


def played(env, wiping, steps=40):
    """Return the bytes of all observations and poses of an episode with seeded actions, `wiping` each thing handed out
    after it was seen."""
    env.action_space.seed(1)
    (observation, info), seen = env.reset(seed=1), []
    for _ in range(steps):
        seen += [*wiping(observation), np.array(info["pose"])]
        for name in ("readings", "unscaled"):
            if hasattr(env, name):
                wiping(getattr(env, name))
        observation, _, _, _, info = env.step(env.action_space.sample())
    return [values.tobytes() for values in seen]


def kept(given):
    return list(given.values()) if isinstance(given, dict) else [given]


@pytest.mark.parametrize(
    ("name", "arguments"),
    [(name, {}) for name in ENVIRONMENTS]
    + [(name, {"control": "residual", "scaled": scaled}) for name in DRIVEN for scaled in (False, True)],
)
def test_writing_into_what_an_environment_hands_out_changes_nothing(name, arguments):
    env = gym.make(name, **arguments).unwrapped
    assert played(env, wiped) == played(env, kept)


@pytest.mark.parametrize("name", DRIVEN)
@pytest.mark.parametrize("scaled", [False, True])
def test_writing_into_what_a_vector_hands_out_changes_nothing(name, scaled):
    vector = gym.make_vec(name, num_envs=2, control="residual", scaled=scaled)
    assert played(vector, wiped) == played(vector, kept)


def test_writing_into_what_a_vector_hands_out_stays_out_of_a_partial_reset():
    vector = gym.make_vec("castor/ASOC-v1", num_envs=2, autoreset_mode="Disabled")
    vector.reset(seed=0)
    observation, *_ = vector.step(np.zeros(vector.action_space.shape, dtype=np.float32))
    time = observation["time"][1].copy()
    wiped(observation)
    observation, _ = vector.reset(options={"reset_mask": np.array([True, False])})
    np.testing.assert_array_equal(observation["time"], [[0.0], time])


class Wiping(CAST):
    """Estimates well, and spoils what it was given."""

    def update(self, observation):
        pose = super().update(observation)
        wiped(observation)
        return pose


def test_an_estimator_that_writes_into_what_it_is_given_changes_nothing_that_the_agent_sees():
    runs = [played(gym.make("castor/ASOC-v1", estimator=kind).unwrapped, kept) for kind in (CAST, Wiping)]
    assert runs[0] == runs[1]
