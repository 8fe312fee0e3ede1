# pyright: reportPossiblyUnboundVariable=false, reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportOperatorIssue=false, reportOptionalSubscript=false

import importlib.util
import os
import re
import subprocess
import sys
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.utils.env_checker import check_env

from castor_envs.envs import ENVIRONMENTS, register_envs
from castor_envs.errors import InputError
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.logs.csv import read_log
from castor_envs.logs.recorder import RecordLog
from castor_envs.logs.trajectory_files import write_drive
from castor_envs.motion.trajectories import Leg, Run, Trajectory, umbmark
from castor_envs.rendering.drawing.palette import ESTIMATE
from castor_envs.vehicles.presets import any_preset, preset, preset_names
from castor_envs.vehicles.robot import RobotDescription

IDS = tuple(ENVIRONMENTS)
TRAIN_IDS = ("castor/CFMMR-v1", "castor/Configuration-v0")

ESTIMATION = (
    # The action is a pose in m and rad: scaling it to [-1, 1] would make every estimator undo the scaling.
    "symmetric and normalized",
    # float32 keeps 7 digits: not enough for errors of micrometres on paths of metres.
    "we recommend using np.float32",
)
#: Every warning that checkers may still give, by environment, and why it stays.
JUSTIFIED = {
    "castor/UMBmark-v0": ESTIMATION,
    "castor/ASOC-v1": (),
    "castor/CFMMR-v1": (),
    "castor/Configuration-v0": ESTIMATION,
}


def play(env, seed, steps=40):
    """Return all that a seeded episode with seeded actions gives, flat, up to its end."""
    env.action_space.seed(seed)
    observation, info = env.reset(seed=seed)
    numbers = [*observation.values(), *info.values()]
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        numbers += [*observation.values(), reward, terminated, truncated, *info.values()]
        if terminated or truncated:
            break
    return np.concatenate([np.ravel(np.asarray(number, dtype=float)) for number in numbers])


def listed(caught, name):
    """Return the warnings that are not justified for this environment."""
    return [str(w.message) for w in caught if not any(words in str(w.message) for words in JUSTIFIED[name])]


@pytest.mark.parametrize("name", IDS)
def test_gymnasium_finds_no_fault(name):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check_env(gym.make(name, render_mode="rgb_array").unwrapped)
    assert listed(caught, name) == []


@pytest.mark.parametrize("name", IDS)
def test_stable_baselines_finds_no_fault(name):
    if importlib.util.find_spec("stable_baselines3") is None:
        pytest.skip("stable-baselines3 is not installed (extra 'rl')")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        from stable_baselines3.common.env_checker import check_env as check

        check(gym.make(name).unwrapped)
    assert listed(caught, name) == []
    for words in JUSTIFIED[name]:
        assert any(words in str(w.message) for w in caught), f"nobody warns of {words!r} any more"


def test_registering_twice_is_harmless_and_no_import_is_needed():
    register_envs()
    code = "import gymnasium as gym; print(gym.make('castor_envs:castor/ASOC-v1').spec.id)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split()[-1] == "castor/ASOC-v1"


@pytest.mark.parametrize("name", IDS)
def test_the_same_seed_gives_the_same_episode_bit_for_bit(name):
    floor = Floor(
        patches=(Patch(center=(0.5, 0.0), size=(0.4, 0.4), friction=0.05),),
        cables=(Cable(center=(0.3, 0.0), direction=1.5, length=1.0, diameter=0.01),),
    )
    env = gym.make(name, floor=floor)
    first = play(env, 7)
    np.testing.assert_array_equal(play(env, 7), first)
    np.testing.assert_array_equal(play(gym.make(name, floor=floor), 7), first)
    assert not np.array_equal(play(env, 8), first)


@pytest.fixture(scope="module")
def played_elsewhere():
    """What another process gets of a seeded episode in each environment, as bytes."""
    code = (
        "import sys, gymnasium as gym, castor_envs; sys.path.insert(0, sys.argv[1]); import test_envs\n"
        "for name in sys.argv[2:]: print(test_envs.play(gym.make(name), 11).tobytes().hex())"
    )
    command = [sys.executable, "-c", code, os.path.dirname(__file__), *IDS]
    lines = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    return dict(zip(IDS, map(bytes.fromhex, lines), strict=True))


@pytest.mark.parametrize("name", IDS)
def test_the_same_seed_gives_the_same_episode_in_another_process(name, played_elsewhere):
    assert played_elsewhere[name] == play(gym.make(name), 11).tobytes()


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_drives_in_the_environments(name):
    env = gym.make("castor/UMBmark-v0", robot=name, corners="fixed" if name == "1-castor" else "turn")
    _, info = env.reset(seed=0)
    for _ in range(60):
        _, _, _, _, info = env.step(np.zeros(3))
    expected = env.unwrapped.trajectory.at(60 * 0.05)[0]
    np.testing.assert_allclose(info["pose"][:2], expected[:2], atol=0.1)
    gym.make("castor/ASOC-v1", robot=name).reset(seed=0)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("castor/UMBmark-v0", {"corners": "turn"}),
        ("castor/UMBmark-v0", {"corners": "rounded"}),
        ("castor/ASOC-v1", {"trajectory": "figure-eight"}),
    ],
)
def test_a_base_that_no_motor_turns_is_refused_courses_that_turn(name, arguments):
    with pytest.raises(InputError, match=r"'1-castor base' cannot drive the .* cannot turn it"):
        gym.make(name, robot="1-castor", **arguments)


def test_a_base_that_no_motor_turns_drives_courses_that_keep_its_heading():
    """The fixed square, and random courses, which bring it where other robots get: within a centimetre."""
    _, info = run_umbmark(gym.make("castor/UMBmark-v0", robot="1-castor", corners="fixed"), lambda info: info["pose"])
    np.testing.assert_allclose(info["pose"], 0.0, atol=0.01)
    env = gym.make("castor/ASOC-v1", robot="1-castor").unwrapped
    for seed in (1, 2):
        observation, _ = env.reset(seed=seed)
        truncated = False
        while not truncated:
            observation, _, terminated, truncated, info = env.step(env.follower.action(observation))
            assert not terminated
        assert abs(info["heading_error"]) < 1e-3
        assert info["position_error"] < 0.01


@pytest.mark.parametrize(
    ("robot", "arguments", "most"),
    [
        ("asoc-prototype", {"speed": 1.0}, r"asks for 22\.\d.*at most 0\.\d+ m/s"),
        ("asoc-prototype", {"corners": "rounded", "speed": 0.5}, r"at most 0\.2\d m/s"),
        ("asoc-prototype", {"turn_speed": 10.0, "turn_acceleration": 50.0}, r"at most \d\.\d+ rad/s"),
        ("differential", {"speed": 2.0, "acceleration": 3.0}, r"at most 1\.1 m/s"),
        ("omnimate", {"corners": "rounded"}, r"at most 0\.1\d* m/s"),
    ],
)
def test_a_square_that_its_motors_are_too_slow_for_is_refused_with_the_largest_speed(robot, arguments, most):
    """That speed is then accepted. Wheels of 75 mm at 15 rad/s roll at 1.125 m/s."""
    name = "castor/UMBmark-v0"
    with pytest.raises(InputError, match=f"too slow for the UMBmark square.*{most}") as refusal:
        gym.make(name, robot=robot, **arguments)
    ahead, on_the_spot = (re.search(rf"at most ([0-9.]+) {unit}", str(refusal.value)) for unit in ("m/s", "rad/s"))
    slower = {"speed": ahead, "turn_speed": on_the_spot}
    gym.make(name, robot=robot, **arguments | {key: float(found[1]) for key, found in slower.items() if found})


@pytest.mark.parametrize("arguments", [{"speed": 0.5}, {"corners": "rounded"}, {"corners": "fixed", "speed": 0.5}])
def test_squares_that_motors_are_fast_enough_for_are_driven(arguments):
    _, info = run_umbmark(gym.make("castor/UMBmark-v0", **arguments), lambda info: info["pose"])
    np.testing.assert_allclose(info["pose"][:2], 0.0, atol=0.03)


def run_umbmark(env, estimate):
    """Return the whole return of an episode whose estimates are `estimate(info)`, and the last info."""
    _, info = env.reset(seed=3)
    total, done = 0.0, False
    while not done:
        _, reward, done, _, info = env.step(estimate(info))
        total += reward
    return total, info


def test_the_return_is_minus_the_error_at_the_end():
    env = gym.make("castor/UMBmark-v0", side=0.3)
    total, _ = run_umbmark(env, lambda info: info["pose"])
    assert total == 0.0
    total, info = run_umbmark(env, lambda info: info["pose"] + [0.3, 0.4, 0.1])
    assert total == pytest.approx(-0.5)
    assert info["position_error"] == pytest.approx(0.5)
    assert info["heading_error"] == pytest.approx(0.1)


def test_estimates_do_not_move_the_robot():
    env = gym.make("castor/UMBmark-v0", side=0.3)
    _, at_rest = run_umbmark(env, lambda info: np.zeros(3))
    _, moved = run_umbmark(env, lambda info: np.array([1.0, -2.0, 3.0]))
    np.testing.assert_array_equal(at_rest["pose"], moved["pose"])


def test_observations_do_not_hold_the_truth():
    env = gym.make("castor/UMBmark-v0")
    observation, _ = env.reset(seed=1)
    assert set(observation) == {"wheel", "pivot", "time"}
    np.testing.assert_array_equal(observation["wheel"], 0.0)
    assert env.unwrapped.robot.effects == ()


def test_voltage_drives_less_hard_the_faster_the_wheel():
    """At full voltage a wheel ends at its no-load speed; at half, at half of it."""
    ends = []
    for voltage in (1.0, 0.5):
        ahead = Run((Leg((1.0, 0.0, 0.0), 10.0),), voltage * 15.0 * 0.075, 2.0)
        env = gym.make(
            "castor/ASOC-v1", robot="differential", control="voltage", trajectory=Trajectory("ahead", (ahead,))
        )
        env.reset(seed=0)
        for _ in range(120):
            observation, *_ = env.step(np.full(2, voltage, dtype=np.float32))
        ends.append(observation["wheel"][0] * 2 * np.pi / 2000 / 0.05)
    np.testing.assert_allclose(ends, [15.0, 7.5], rtol=0.02)


def test_a_gyro_reads_the_turning_rate():
    robot = RobotDescription.from_dict({**preset("differential").to_dict(), "gyro": {"noise": 0.0, "bias": 0.5}})
    env = gym.make("castor/ASOC-v1", robot=robot, control="speed")
    env.reset(seed=0)
    for _ in range(20):
        observation, *_ = env.step(np.array([-0.1, 0.1], dtype=np.float32))
    expected = 0.1 * 15 * 0.075 * 2 / 0.34 + 0.5
    assert observation["gyro"][0] == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize(
    ("name", "arguments", "said"),
    [
        ("castor/UMBmark-v0", {"robot": "asoc-prototyp"}, "did you mean 'asoc-prototype'"),
        ("castor/UMBmark-v0", {"robot": "differential", "corners": "fixed"}, "slip sideways"),
        ("castor/UMBmark-v0", {"direction": "left"}, "direction"),
        ("castor/UMBmark-v0", {"floor": "nowhere.json"}, "nowhere.json"),
        ("castor/UMBmark-v0", {"floor": "slipery"}, "did you mean 'slippery'"),
        ("castor/ASOC-v1", {"trajectory": "figure-nine"}, "did you mean 'figure-eight'"),
        ("castor/ASOC-v1", {"control": "torque"}, "control"),
        ("castor/ASOC-v1", {"trajectory": None}, "trajectory"),
        ("castor/ASOC-v1", {"estimator": "estimators.robots.cast:CASTLE"}, "there is no estimator"),
        ("castor/ASOC-v1", {"estimator": "nowhere"}, "there is no estimator"),
        ("castor/ASOC-v1", {"estimator": dict}, "`reset` and `update`"),
        ("castor/ASOC-v1", {"estimator": 5}, "`reset` and `update`"),
        ("castor/ASOC-v1", {"scaled": "yes"}, "scaled must be True or False, got 'yes'"),
        ("castor/CFMMR-v1", {"scaled": 1}, "scaled must be True or False, got 1"),
        ("castor/ASOC-v1", {"held": "1"}, "held, .* must be a whole number of at least 1, got '1'"),
        ("castor/ASOC-v1", {"held": 1.5}, "held, .* must be a whole number"),
        ("castor/ASOC-v1", {"held": True}, "held, .* must be a whole number"),
        ("castor/ASOC-v1", {"held": 4}, "no castor 4 with driven wheels to hold"),
        ("castor/UMBmark-v0", {"side": 0}, "side"),
        ("castor/UMBmark-v0", {"side": "1"}, "side"),
        ("castor/UMBmark-v0", {"turn_speed": -1.0}, "turn_speed"),
        ("castor/UMBmark-v0", {"acceleration": float("inf")}, "acceleration"),
        ("castor/UMBmark-v0", {"floor": 5}, "floor"),
    ],
)
def test_wrong_arguments_are_refused(name, arguments, said):
    with pytest.raises(InputError, match=said):
        gym.make(name, **arguments)


def test_the_recorder_writes_what_was_driven(tmp_path):
    env = RecordLog(gym.make("castor/UMBmark-v0", side=0.2), folder=tmp_path)
    counts, poses, commands = [], [], []
    observation, info = env.reset(seed=5)
    done = False
    while not done:
        counts.append(observation["wheel"])
        poses.append(info["pose"])
        observation, _, done, _, info = env.step(np.zeros(3))
        commands.append(info["command"])
    robot = RobotDescription.load(tmp_path / "robot.json")
    log = read_log(tmp_path / "episode-0000.csv", robot)
    assert robot == env.unwrapped.robot
    np.testing.assert_array_equal(log.wheel, np.cumsum(counts, axis=0))
    np.testing.assert_array_equal(log.reference, poses)
    np.testing.assert_array_equal(log.command, commands)
    np.testing.assert_allclose(log.t, 0.05 * np.arange(len(counts)), atol=1e-9)


@pytest.fixture(scope="module")
def videos(tmp_path_factory):
    """The folder with a folder of videos of each environment, recorded by a process without a display."""
    if importlib.util.find_spec("moviepy") is None:
        pytest.skip("moviepy is not installed (extra 'video')")
    code = (
        "import sys, gymnasium as gym, castor_envs\n"
        "for name in sys.argv[2:]:\n"
        "    env = gym.make(name, render_mode='rgb_array')\n"
        "    env = gym.wrappers.RecordVideo(env, f'{sys.argv[1]}/{name}', video_length=5)\n"
        "    env.reset(seed=0)\n"
        "    for _ in range(8): env.step(env.action_space.sample())\n"
        "    env.close()\n"
    )
    environment = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", "WAYLAND_DISPLAY")}
    folder = tmp_path_factory.mktemp("videos")
    subprocess.run([sys.executable, "-c", code, str(folder), *IDS], check=True, env=environment, capture_output=True)
    return folder


@pytest.mark.parametrize("name", IDS)
def test_a_video_is_recorded_without_a_display(name, videos):
    (video,) = (videos / name).glob("*.mp4")
    assert video.stat().st_size > 1000


@pytest.mark.parametrize("name", IDS)
def test_a_vector_is_its_members_bit_for_bit(name):
    small = {"train": "cfmmr-2"} if name in TRAIN_IDS else {"robot": "differential"}
    vector = gym.make_vec(name, num_envs=3, vectorization_mode="vector_entry_point", **small)
    members = [gym.make(name, **small) for _ in range(3)]
    observations, infos = vector.reset(seed=[4, 5, 6])
    singles = [env.reset(seed=4 + i) for i, env in enumerate(members)]
    vector.action_space.seed(0)
    for _ in range(30):
        for i, (observation, info) in enumerate(singles):
            assert all(np.array_equal(observations[key][i], observation[key]) for key in observation)
            assert np.array_equal(infos["pose"][i], info["pose"])
        actions = vector.action_space.sample()
        observations, rewards, _, _, infos = vector.step(actions)
        answers = [env.step(action) for env, action in zip(members, actions, strict=True)]
        assert np.array_equal(rewards, [answer[1] for answer in answers])
        singles = [(answer[0], answer[4]) for answer in answers]


@pytest.mark.parametrize("name", IDS)
def test_actions_that_are_no_numbers_are_refused(name):
    env = gym.make(name).unwrapped
    env.reset(seed=0)
    size = env.action_space.shape[0]
    with pytest.raises(InputError, match="shape"):
        env.step(np.zeros(size - 1))
    with pytest.raises(InputError, match="finite"):
        env.step(np.full(size, np.nan))
    for numbers in (np.full(size, 1j), [1j] * size, ["0"] * size, [None] * size):
        with pytest.raises(InputError, match=r"^action.* must be real numbers"):
            env.step(numbers)
    vector = gym.make_vec(name, num_envs=2)
    vector.reset(seed=0)
    with pytest.raises(InputError, match="must be real numbers"):
        vector.step(np.full((2, size), 1j))


@pytest.mark.parametrize("name", ["castor/UMBmark-v0", "castor/Configuration-v0"])
def test_pictures_show_the_error_of_the_estimate_that_was_given(name):
    """It was given a sample ago: it is moved along with the vehicle, which is 12 mm further on."""
    env = gym.make(name, render_mode="rgb_array")
    _, info = env.reset(seed=0)
    assert env.unwrapped.shown_estimate() is None
    without = env.render()
    for _ in range(60):
        _, _, _, _, info = env.step(info["pose"] + [0.03, 0.04, 0.0])
    np.testing.assert_allclose(env.unwrapped.shown_estimate() - info["pose"], 0 * info["pose"] + [0.03, 0.04, 0.0])
    assert info["position_error"] == pytest.approx(0.05)
    ghost = np.all(env.render() == ESTIMATE, axis=-1)
    assert ghost.any()
    assert not np.all(without == ESTIMATE, axis=-1).any()


@pytest.mark.parametrize("name", IDS)
def test_many_environments_at_once_are_the_single_ones_and_their_spec_is_data(name):
    vector = gym.make_vec(name, num_envs=2, vectorization_mode="vector_entry_point")
    observation, info = vector.reset(seed=5)
    for k in range(2):
        alone, alone_info = gym.make(name).reset(seed=5 + k)
        for key, values in alone.items():
            np.testing.assert_array_equal(observation[key][k], values)
        np.testing.assert_array_equal(info["pose"][k], alone_info["pose"])
    vector.close()
    assert gym.envs.registration.EnvSpec.from_json(gym.spec(name).to_json()).id == name


def test_what_is_seen_live_is_what_the_log_of_it_gives():
    """But the commands, which `info` has: those of the period that led to the observation; and where to go."""
    for name, parts in (("castor/ASOC-v1", {"pivot"}), ("castor/CFMMR-v1", {"rps", "rps_age"})):
        env = RecordLog(gym.make(name))
        action = np.full_like(env.action_space.sample(), 0.3)
        first, info = env.reset(seed=3)
        steps = [env.step(action * (k % 3)) for k in range(20)]
        seen, told = [first, *(step[0] for step in steps)], [info, *(step[4] for step in steps)]
        logged = list(env.log().observations())
        assert len(logged) == len(seen)
        for live, again, said in zip(seen, logged, told, strict=True):
            sensed = live.keys() - {"reference", "reference_twist", "goal"}
            assert sensed == again.keys() - {"command"} == {"wheel", "time"} | parts
            np.testing.assert_array_equal(again["command"], said["command"])
            for key in sensed:
                np.testing.assert_array_equal(live[key], again[key])


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("castor/UMBmark-v0", {"side": 0.1}),
        ("castor/ASOC-v1", {}),
        ("castor/Configuration-v0", {"path": "straight"}),
        ("castor/CFMMR-v1", {}),
    ],
)
def test_an_ended_episode_cannot_be_stepped(name, arguments):
    """Whoever stands still is lost, or has estimated to the end."""
    env = gym.make(name, **arguments)
    env.reset(seed=0)
    still, ended = 0 * env.action_space.sample(), False
    while not ended:
        *_, terminated, truncated, _ = env.step(still)
        ended = terminated or truncated
    for _ in range(2):
        with pytest.raises(InputError, match=r"this one has ended; call env.reset\(\)"):
            env.step(still)
    env.reset()
    env.step(still)


@pytest.mark.parametrize(("off", "size"), [(0.1, 0.1), (-0.1, 0.1), (2 * np.pi + 0.2, 0.2), (-6 * np.pi - 0.3, 0.3)])
@pytest.mark.parametrize("name", ["castor/UMBmark-v0", "castor/Configuration-v0"])
def test_the_error_of_an_estimated_heading_is_its_size_wrapped(name, off, size):
    """As of a driven one."""
    env = gym.make(name)
    _, info = env.reset(seed=0)
    *_, info = env.step((info["pose"] + [0.0, 0.0, off]).ravel())
    assert info["heading_error"] == pytest.approx(size)


@pytest.mark.parametrize(
    "wrapped",
    [
        lambda: wrappers.TimeAwareObservation(gym.make("castor/ASOC-v1", max_episode_steps=9), dict_time_key="steps"),
        lambda: wrappers.NormalizeObservation(wrappers.FlattenObservation(gym.make("castor/UMBmark-v0"))),
        lambda: wrappers.NormalizeObservation(gym.make("castor/ASOC-v1", scaled=True)),
    ],
)
def test_wrappers_that_the_docs_say_how_to_use_work_so(wrapped):
    env = wrapped()
    env.reset(seed=0)
    observation, *_ = env.step(env.action_space.sample())
    assert env.observation_space.contains(observation)


@pytest.mark.parametrize(
    ("name", "course", "said"),
    [
        ("ASOC-v1", {"trajectory": Trajectory("off", umbmark(side=0.3).runs, (3.0, 0.0, 0.0))}, "at the origin"),
        ("ASOC-v1", {"trajectory": umbmark(side=1e6)}, "more than 1,000,000 sample periods"),
        ("UMBmark-v0", {"side": 1e6}, "more than 1,000,000 sample periods"),
    ],
)
def test_courses_that_start_elsewhere_or_never_end_are_refused(name, course, said):
    with pytest.raises(InputError, match=said):
        gym.make(f"castor/{name}", **course)


def test_files_are_given_as_paths_of_any_kind(tmp_path):
    robot, train, floor, drive = (tmp_path / name for name in ("r.json", "t.json", "f.json", "d.csv"))
    preset("omni3").save(robot)
    any_preset("cfmmr-2").save(train)
    Floor(slope=(0.01, 0.0)).save(floor)
    write_drive(drive, umbmark(side=0.3), 0.05)
    env = gym.make("castor/ASOC-v1", robot=robot, floor=floor, trajectory=drive).unwrapped
    assert (env.robot, env.sensed.floor.slope) == (preset("omni3"), (0.01, 0.0))
    assert env.trajectory.duration == pytest.approx(umbmark(side=0.3).duration, abs=0.05)
    assert gym.make("castor/CFMMR-v1", train=train, floor=floor).unwrapped.train.n_axles == 2
