"""RecordLog loses no episode, and mixes none with those of another robot or another recorder."""

# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false
# pyright: reportPossiblyUnboundVariable=false, reportOptionalSubscript=false

import gymnasium as gym
import numpy as np
import pytest

from castor_envs.errors import InputError
from castor_envs.logs.csv import read_log
from castor_envs.logs.recorder import RecordLog
from castor_envs.motion.trajectories import pivoting
from castor_envs.vehicles.load import file_name, load_vehicle
from castor_envs.vehicles.presets import preset


def made(folder, robot="differential"):
    return RecordLog(gym.make("castor_envs:castor/UMBmark-v0", robot=robot, side=0.2), folder)


def driven(env, steps, seed=0):
    env.reset(seed=seed)
    for _ in range(steps):
        *_, terminated, truncated, _ = env.step(np.zeros(3))
        if terminated or truncated:
            return


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def rows(folder):
    """How many rows each episode has."""
    logs = sorted(folder.glob("*.csv"))
    assert [log.name for log in logs] == [f"episode-{k:04d}.csv" for k in range(len(logs))]
    return [len(read_log(log, preset("differential"))) for log in logs]


@pytest.mark.parametrize(
    ("name", "vehicle"),
    [("ASOC-v1", {"robot": "differential"}), ("ASOC-v1", {"robot": "swerve"}), ("CFMMR-v1", {"train": "cfmmr-2"})],
)
def test_commands_are_speeds_or_left_out(tmp_path, name, vehicle):
    """A log's commands are in rad/s, so that whoever replays it drives as fast; voltages are none."""
    for control in ("speed", "voltage"):
        env = RecordLog(gym.make(f"castor_envs:castor/{name}", control=control, **vehicle), tmp_path / control)
        env.reset(seed=0)
        for _ in range(3):
            *_, info = env.step(np.full(env.action_space.shape, 0.5, dtype=np.float32))
        env.close()
        log = read_log(tmp_path / control / "episode-0000.csv", env.unwrapped.vehicle)
        assert (log.command is None) == (control == "voltage")
        assert (log.steering_command is None) == (not info["steering_command"].size)
        if control == "speed":
            np.testing.assert_array_equal(log.command[-2], info["command"])


@pytest.mark.parametrize("control", ["speed", "voltage", "residual"])
@pytest.mark.parametrize("held", [1, 3])
def test_wheels_that_are_held_are_told_to_stand(control, held):
    turn = pivoting(preset("asoc-prototype").castors[held - 1].pivot)
    env = gym.make("castor_envs:castor/ASOC-v1", control=control, held=held, trajectory=turn)
    env.reset(seed=0)
    of_held = slice(2 * held - 2, 2 * held)
    for _ in range(10):
        *_, info = env.step(np.full(env.action_space.shape, 0.1, dtype=np.float32))
        blocked = np.zeros(6, dtype=bool)
        blocked[of_held] = True
        np.testing.assert_array_equal(info["command"] == 0.0, blocked)


def test_episodes_that_a_wrapper_outside_cuts_are_written(tmp_path):
    env = gym.wrappers.TimeLimit(made(tmp_path), 5)
    for seed in range(2):
        driven(env, 99, seed)
    assert rows(tmp_path) == [6]
    env.close()
    assert rows(tmp_path) == [6, 6]


def test_an_episode_that_is_left_is_written_once(tmp_path):
    env = made(tmp_path)
    driven(env, 3)
    env.close()
    env.close()
    assert rows(tmp_path) == [4]


def test_of_an_episode_that_ends_or_has_no_step_no_second_log_is_written(tmp_path):
    env = made(tmp_path)
    driven(env, 10_000)
    ended = contents(tmp_path)
    env.reset()
    env.reset()
    env.close()
    assert contents(tmp_path) == ended
    assert len(rows(tmp_path)) == 1


@pytest.mark.parametrize("robot", ["differential", "swerve"])
def test_a_folder_that_holds_episodes_is_refused(tmp_path, robot):
    env = made(tmp_path)
    driven(env, 3)
    env.close()
    before = contents(tmp_path)
    with pytest.raises(InputError, match=r"holds episode-0000\.csv already; name a new folder"):
        made(tmp_path, robot)
    assert contents(tmp_path) == before


@pytest.mark.parametrize("other", ["swerve", "cfmmr-2"])
def test_a_folder_of_another_vehicle_is_refused(tmp_path, other):
    vehicle = load_vehicle(other)
    vehicle.save(tmp_path / file_name(vehicle))
    before = contents(tmp_path)
    with pytest.raises(InputError, match=r"(robot|train)\.json is another (robot|train); name a new folder"):
        made(tmp_path)
    assert contents(tmp_path) == before


def test_the_file_of_the_same_robot_is_left_alone(tmp_path):
    made(tmp_path)
    before = contents(tmp_path)
    made(tmp_path)
    assert contents(tmp_path) == before


def test_two_recorders_at_once_replace_nothing(tmp_path):
    first, second = made(tmp_path), made(tmp_path)
    driven(first, 3)
    driven(second, 4)
    first.close()
    with pytest.raises(InputError, match=r"episode-0000\.csv: was written by another recorder"):
        second.close()
    assert rows(tmp_path) == [4]
