"""The environments of trains: what is theirs alone. What all environments share is in test_envs.py."""

# pyright: reportPossiblyUnboundVariable=false, reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportOperatorIssue=false, reportCallIssue=false

import gymnasium as gym
import numpy as np
import pytest

from castor_envs.effects.train import DeadGauge, SensorStops
from castor_envs.errors import InputError
from castor_envs.geometry.se2 import relative_pose
from castor_envs.logs.csv import read_log
from castor_envs.logs.recorder import RecordLog
from castor_envs.motion.paths import TrainPath
from castor_envs.vehicles.presets import cfmmr, preset
from castor_envs.vehicles.train import TrainDescription

SHORT = TrainPath("short", ((0.6, 0.8),))


def estimate_all(env, estimate, seed=3):
    """Return the return of an episode whose estimates are `estimate(info)`, the last info and all observations."""
    observation, info = env.reset(seed=seed)
    total, done, seen = 0.0, False, [observation]
    while not done:
        observation, reward, done, _, info = env.step(estimate(info))
        seen.append(observation)
        total += reward
    return total, info, seen


@pytest.mark.parametrize("axles", [2, 4, 7])
def test_the_return_is_minus_the_mean_axle_error_at_the_end(axles):
    env = gym.make("castor/Configuration-v0", train=f"cfmmr-{axles}", path=SHORT)
    total, *_ = estimate_all(env, lambda info: info["pose"].ravel())
    assert total == 0.0
    off = np.zeros((axles, 3))
    off[0] = [0.3, 0.4, 0.1]
    total, info, _ = estimate_all(env, lambda info: (info["pose"] + off).ravel())
    assert total == pytest.approx(-0.5 / axles)
    assert info["heading_error"] == pytest.approx(0.1 / axles)


def test_estimates_do_not_move_the_train_and_may_come_as_poses():
    env = gym.make("castor/Configuration-v0", path=SHORT)
    _, flat, _ = estimate_all(env, lambda info: np.zeros(9))
    _, poses, _ = estimate_all(env.unwrapped, lambda info: np.ones((3, 3)))
    np.testing.assert_array_equal(flat["pose"], poses["pose"])


def test_observations_hold_what_sensors_say_and_not_the_truth():
    env = gym.make("castor/Configuration-v0", train="cfmmr-4", path=SHORT)
    observation, info = env.reset(seed=1)
    assert {key: value.shape for key, value in observation.items()} == {
        "wheel": (8,),
        "rps": (9,),
        "rps_age": (3,),
        "time": (1,),
    }
    np.testing.assert_array_equal(observation["wheel"], 0.0)
    np.testing.assert_array_equal(observation["rps_age"], 0.0)
    true = relative_pose(info["pose"][1:], info["pose"][:-1]).ravel()
    assert np.all(observation["rps"] != true)
    np.testing.assert_allclose(true, np.tile([0.35, 0.0, 0.0], 3), atol=1e-12)
    assert env.unwrapped.train.effects == ()


def test_a_sound_sensor_sees_the_true_shape_of_a_driven_train():
    quiet = TrainDescription.from_dict(
        {
            **(data := cfmmr(3).to_dict()),
            "frames": [{**frame, "gauge_noise": 0.0, "gauge_offset": 0.0} for frame in data["frames"]],
        }
    )
    env = gym.make("castor/Configuration-v0", train=quiet, path=SHORT)
    _, info = env.reset(seed=0)
    done, worst = False, 0.0
    while not done:
        observation, _, done, _, info = env.step(np.zeros(9))
        true = relative_pose(info["pose"][1:], info["pose"][:-1]).ravel()
        worst = max(worst, np.abs(observation["rps"] - true).max())
    assert worst < 2e-3  # the polynomial's and the links' share, far below 1 cm
    assert np.abs(true[2]) > 0.1


def test_effects_reach_the_sensors_and_not_the_description():
    train = cfmmr(3).with_effects(SensorStops(frame=2, value=0.5), DeadGauge(frame=1, gauge=2))
    env = gym.make("castor/Configuration-v0", train=train, path=SHORT)
    assert env.unwrapped.train == cfmmr(3)
    _, _, seen = estimate_all(env, lambda info: np.zeros(9))
    age = np.array([observation["rps_age"] for observation in seen])
    time = np.array([observation["time"][0] for observation in seen])
    np.testing.assert_allclose(age[:, 0], 0.0)
    np.testing.assert_allclose(age[:, 1], np.maximum(time - 0.5, 0.0), atol=0.051)
    assert np.ptp([o["rps"][3] for o in seen if o["time"][0] > 0.6]) == 0.0


def test_the_path_is_followed_when_its_wheel_rates_are_commanded():
    """Rolling at v and v times the curvature keeps every axle on the path, but for slip."""
    env = gym.make("castor/CFMMR-v1", path=SHORT)
    observation, _ = env.reset(seed=0)
    truncated = False
    while not truncated:
        t = observation["time"][0] + 0.025
        peak, length = 0.25, 0.6
        covered = 0.125 * t**2 if t < 1 else 0.125 + peak * (t - 1) if t < 2.4 else length - 0.125 * (3.4 - t) ** 2
        speed = min(peak, 0.25 * t, 0.25 * (3.4 - t))
        rates = []
        for axle in range(3):
            s = covered - 0.35 * axle
            turn = speed * (0.8 if 0 < s < 0.6 else 0.0)
            rates += [(speed - 0.16 * turn) / 0.075, (speed + 0.16 * turn) / 0.075]
        observation, _, terminated, truncated, info = env.step(np.array(rates, dtype=np.float32) / 10.0)
        assert not terminated
    assert info["position_error"] < 0.02


def test_a_random_path_is_drawn_for_every_episode():
    env = gym.make("castor/Configuration-v0", path="random")
    env.reset(seed=1)
    first = env.unwrapped.path
    env.reset()
    assert env.unwrapped.path != first
    env.reset(seed=1)
    assert env.unwrapped.path == first


@pytest.mark.parametrize("name", ["castor/CFMMR-v1", "castor/Configuration-v0"])
@pytest.mark.parametrize("path", ["straight", "arc", "s-bend", "random"])
def test_every_path_gives_observations_within_their_space(name, path):
    env = gym.make(name, train="cfmmr-2", path=path)
    observation, _ = env.reset(seed=2)
    done = False
    while not done:
        assert env.observation_space.contains(observation)
        observation, _, terminated, truncated, _ = env.step(np.zeros(env.action_space.shape, dtype=np.float32))
        done = terminated or truncated


@pytest.mark.parametrize(
    ("name", "arguments", "said"),
    [
        ("castor/CFMMR-v1", {"train": "cfmmr-1"}, "did you mean"),
        ("castor/CFMMR-v1", {"train": "cfmr-3"}, "did you mean 'cfmmr-3'"),
        ("castor/CFMMR-v1", {"train": "differential"}, "not a train"),
        ("castor/Configuration-v0", {"train": preset("differential")}, "not a train"),
        ("castor/Configuration-v0", {"train": 5}, "train"),
        ("castor/CFMMR-v1", {"path": "s-bent"}, "did you mean 's-bend'"),
        ("castor/CFMMR-v1", {"path": 3}, "path"),
        ("castor/CFMMR-v1", {"control": "torque"}, "control"),
        ("castor/CFMMR-v1", {"floor": 5}, "floor"),
        ("castor/ASOC-v1", {"robot": cfmmr(3)}, "not a robot"),
        ("castor/ASOC-v1", {"robot": "cfmmr-3"}, "not a robot"),
    ],
)
def test_wrong_arguments_are_refused(name, arguments, said):
    with pytest.raises(InputError, match=said):
        gym.make(name, **arguments)


def test_the_recorder_writes_what_was_driven(tmp_path):
    env = RecordLog(gym.make("castor/Configuration-v0", path=SHORT), folder=tmp_path)
    observation, info = env.reset(seed=5)
    seen, poses, done = [], [], False
    while not done:
        seen.append(observation)
        poses.append(info["pose"].ravel())
        observation, _, done, _, info = env.step(np.zeros(9))
    train = TrainDescription.load(tmp_path / "train.json")
    assert train == env.unwrapped.train
    log = read_log(tmp_path / "episode-0000.csv", train)
    np.testing.assert_array_equal(log.wheel, np.cumsum([o["wheel"] for o in seen], axis=0))
    np.testing.assert_array_equal(log.rps, [o["rps"] for o in seen])
    np.testing.assert_array_equal(log.reference, poses)
    for read, given in zip(log.observations(), seen, strict=True):
        assert read.keys() - {"command"} == given.keys()
        for key in given:
            np.testing.assert_array_equal(read[key], given[key])
