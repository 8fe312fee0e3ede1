"""The environments whose agent drives: reward, what agents see, and the scripted drivers."""

# pyright: reportPossiblyUnboundVariable=false, reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportOptionalSubscript=false, reportCallIssue=false, reportOptionalMemberAccess=false

import functools
import math

import gymnasium as gym
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import estimators
from castor_envs.envs.driving.reference_table import ROWS, ReferenceTable
from castor_envs.envs.driving.reward import LOST, quality, tracking_error
from castor_envs.envs.driving.scaling import LIMIT
from castor_envs.envs.driving.tracking import AHEAD
from castor_envs.errors import InputError
from castor_envs.logs.recorder import RecordLog
from castor_envs.motion.paths import TrainPath
from castor_envs.motion.trajectories import LONGEST_RANDOM, RANDOM, Leg, Run, Trajectory, wander
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from estimators.robots.cast import CAST
from estimators.robots.dead_reckoning import DeadReckoning

IDS = ("castor/ASOC-v1", "castor/CFMMR-v1")
SHORT = {
    "castor/ASOC-v1": {"trajectory": Trajectory("short", (Run((Leg((1.0, 0.0, 0.9), 0.7),), 0.25, 0.5),))},
    "castor/CFMMR-v1": {"path": TrainPath("short", ((0.6, 0.8),))},
}
FLOORS = (None, "slippery")


def made(name, **arguments):
    return gym.make(name, **arguments).unwrapped


def drive(env, policy, seed=0):
    """Return the rewards of an episode, all its observations and its last step's flags and info."""
    observation, info = env.reset(seed=seed)
    rewards, seen, over = [], [observation], False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy(env, observation))
        rewards.append(reward)
        seen.append(observation)
        over = terminated or truncated
    return np.array(rewards), seen, terminated, info


@functools.cache
def driven(name, floor, policy, seed=0):
    """Return what `drive` returns for the default course of a seed; driven once."""
    return drive(made(name, floor=floor), policy, seed)


def scripted(env, observation):
    return env.follower.action(observation)


def still(env, observation):
    return np.zeros(env.action_space.shape)


def full_throttle(env, observation):
    return np.ones(env.action_space.shape)


def swerving(env, observation):
    """Drives well for a while, then ever worse."""
    time = observation["time"][0]
    return scripted(env, observation) + 0.2 * max(0.0, time - 1.0) * np.cos(np.arange(env.action_space.shape[0]))


errors = st.floats(0.0, 100.0), st.floats(0.0, math.pi)


@given(*errors)
def test_no_state_is_worth_less_than_the_end_of_an_episode(distance, turned):
    """After the end there is nothing, 0: whatever is left of an episode is never worth less, discounted or not."""
    assert 0.0 <= quality(distance, turned) <= 1.0
    if distance > LOST:
        assert quality(distance, turned) == 0.0


@given(*errors, st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_nearer_target_is_never_worth_less_and_the_target_is_worth_most(distance, turned, nearer, straighter):
    assert quality(nearer * distance, straighter * turned) >= quality(distance, turned)
    assert quality(0.0, 0.0) == 1.0
    if distance + turned > 1e-9:
        assert quality(distance, turned) < 1.0


@pytest.mark.parametrize("turns", [-2, 0, 3])
def test_errors_are_distances_and_headings_are_alike_after_whole_turns(turns):
    pose, target = np.array([1.0, 2.0, 0.1]), np.array([1.3, 2.4, -0.2 + 2 * np.pi * turns])
    assert tracking_error(pose, target) == pytest.approx((0.5, 0.3))
    axles = np.stack([pose, target])
    assert tracking_error(axles, np.stack([target, target])) == pytest.approx((0.25, 0.15))


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("policy", [scripted, still, full_throttle, swerving])
def test_every_step_of_an_episode_adds_to_the_return_and_the_lost_one_adds_nothing(name, policy):
    env = made(name, **SHORT[name])
    rewards, _, terminated, info = drive(env, policy)
    assert np.all(rewards >= 0.0)
    assert np.all(rewards <= env.vehicle.sample_period)
    assert terminated == (info["position_error"] > LOST)
    if terminated:
        assert rewards[-1] == 0.0


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("floor", FLOORS)
@pytest.mark.parametrize("bad", [still, full_throttle, swerving])
def test_bad_driving_is_paid_less_than_the_scripted_driver(name, floor, bad):
    """Standing still, full throttle and crashing: the return is what an agent maximises, so none of them may pay."""
    badly, _, terminated, _ = driven(name, floor, bad)
    assert terminated
    assert badly.sum() < 0.5 * driven(name, floor, scripted)[0].sum()


@pytest.mark.parametrize("name", IDS)
def test_scripted_drivers_track_on_an_even_floor_and_are_left_room_on_a_slippery_one(name):
    even, slippery = (driven(name, floor, scripted) for floor in FLOORS)
    period = made(name).vehicle.sample_period
    assert not even[2]
    assert not slippery[2]
    assert np.mean(even[0]) / period > 0.99
    assert 0.6 < np.mean(slippery[0]) / period < 0.95


@pytest.mark.parametrize("robot", ["asoc-prototype", "differential", "tricycle", "swerve", "omni3", "powered-caster"])
def test_the_scripted_driver_brings_every_kind_of_robot_back(robot):
    """One motor does what it likes for half a second."""
    straight = Trajectory("straight", (Run((Leg((1.0, 0.0, 0.0), 3.0),), 0.25, 0.5),))
    env = made("castor/ASOC-v1", robot=robot, trajectory=straight)
    observation, _ = env.reset(seed=0)
    off = 0.0
    for k in range(220):
        push = 0.3 * np.eye(1, env.action_space.shape[0])[0] if 20 <= k < 30 else 0.0
        observation, *_, info = env.step(scripted(env, observation) + push)
        off = max(off, info["position_error"] + info["heading_error"])
    assert off > 0.005
    assert info["position_error"] + info["heading_error"] < 0.35 * off


@pytest.mark.parametrize("name", IDS)
def test_the_reference_is_the_target_seen_from_the_vehicle(name):
    """By complex numbers: places that the environment tells are turned back to the world, where `info` has them."""
    env = made(name)
    observation, info = env.reset(seed=4)
    for _ in range(30):
        observation, _, _, _, info = env.step(scripted(env, observation))
    pose, target = np.atleast_2d(info["pose"]), np.atleast_2d(info["target"])
    seen = observation["reference"].reshape(4, *pose.shape)

    def in_world(places):
        there = pose[:, 0] + 1j * pose[:, 1] + np.exp(1j * pose[:, 2]) * (places[..., 0] + 1j * places[..., 1])
        return there, np.exp(1j * (pose[:, 2] + places[..., 2]))

    place, way = in_world(seen)
    np.testing.assert_allclose(place[0], target[:, 0] + 1j * target[:, 1], atol=1e-12)
    np.testing.assert_allclose(way[0], np.exp(1j * target[:, 2]), atol=1e-12)
    # The course goes on at the twist that is shown: over a quarter of a second, which is short, along it.
    twist = observation["reference_twist"].reshape(pose.shape)
    going = np.exp(1j * target[:, 2]) * (twist[:, 0] + 1j * twist[:, 1])
    np.testing.assert_allclose(place[1] - place[0], 0.25 * going, atol=0.02)
    end = in_world(observation["goal"].reshape(pose.shape))[0]
    for _ in range(env.samples - 30):
        observation, _, _, truncated, info = env.step(scripted(env, observation))
    assert truncated
    last = np.atleast_2d(info["target"])
    np.testing.assert_allclose(end, last[:, 0] + 1j * last[:, 1], atol=1e-9)
    np.testing.assert_allclose(observation["goal"], observation["reference"][: observation["goal"].size], atol=1e-9)


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("floor", FLOORS)
def test_scaled_observations_are_within_about_one_when_driven_well(name, floor):
    env = made(name, scaled=True, floor=floor)
    _, observations, *_ = driven(name, floor, scripted)
    assert all(made(name).observation_space.contains(seen) for seen in observations[::20])
    vectors = np.array([env.scaling(seen) for seen in observations])
    assert all(env.observation_space.contains(vector) for vector in vectors)
    largest = np.abs(vectors).max(axis=0)
    if floor is None:
        assert np.all(largest < 1.2)
    else:  # errors are larger, up to the limit, and hardly any number is too small to learn from
        assert np.percentile(np.abs(vectors), 95) < 1.5
        assert np.mean(largest > 0.05) > 0.9


@pytest.mark.parametrize("name", IDS)
def test_the_scripted_driver_takes_what_is_not_scaled(name):
    env, plain = made(name, scaled=True), made(name)
    (vector, _), (observation, _) = env.reset(seed=0), plain.reset(seed=0)
    for _ in range(3):
        action = env.follower.action(env.unscaled)
        np.testing.assert_array_equal(action, scripted(plain, observation))
        vector, observation = env.step(action)[0], plain.step(action)[0]
    with pytest.raises(InputError, match=r"give it env\.unwrapped\.unscaled"):
        env.follower.action(vector)


@pytest.mark.parametrize("name", IDS)
def test_a_scaled_environment_is_the_same_one(name):
    """The same rewards for the same actions; every state has a vector of its own."""
    rewards, observations, *_ = drive(made(name), full_throttle)
    again, vectors, terminated, _ = drive(made(name, scaled=True), full_throttle)
    np.testing.assert_array_equal(again, rewards)
    assert terminated
    assert vectors[0].dtype == np.float32
    assert len({vector.tobytes() for vector in vectors}) == len(vectors) == len(observations)


def test_a_distance_at_which_an_episode_ends_is_the_limit_of_scaled_numbers():
    env = made("castor/ASOC-v1", scaled=True)
    seen, _ = made("castor/ASOC-v1").reset(seed=0)
    for distance in (LOST, 2 * LOST):
        seen["reference"][0] = -distance
        assert np.min(env.scaling(seen)) == -LIMIT


@pytest.mark.parametrize("name", IDS)
@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("policy", [still, full_throttle])
def test_observation_spaces_contain_every_observation_of_bad_driving(name, scaled, policy):
    env = made(name, scaled=scaled, control="voltage")
    assert all(env.observation_space.contains(seen) for seen in drive(env, policy, seed=5)[1])


def test_a_gyro_is_scaled_too_and_a_missing_reading_is_zero():
    robot = RobotDescription.from_dict({**preset("differential").to_dict(), "gyro": {"noise": 0.0, "bias": 0.5}})
    without, within = (
        made("castor/ASOC-v1", robot="differential", scaled=True),
        made("castor/ASOC-v1", robot=robot, scaled=True),
    )
    assert within.observation_space.shape[0] == without.observation_space.shape[0] + 1
    vector, _ = within.reset(seed=0)
    assert np.count_nonzero(vector == 0.5) == 1
    train = made("castor/CFMMR-v1", scaled=True)
    observation, _ = made("castor/CFMMR-v1").reset(seed=0)
    assert np.all(np.isfinite(train.scaling({**observation, "rps": np.full(6, np.nan)})))


def course(env):
    return env.course.target(np.linspace(0.0, 15.0, 40))


@pytest.mark.parametrize("name", IDS)
def test_courses_are_drawn_by_the_seed(name):
    env = made(name)
    drawn = {}
    for seed in (1, 2, 1):
        env.reset(seed=seed)
        if seed in drawn:
            np.testing.assert_array_equal(course(env), drawn[seed])
        drawn[seed] = course(env)
    assert np.abs(drawn[1] - drawn[2]).max() > 0.1
    env.reset(seed=1)
    env.reset()
    assert np.abs(course(env) - drawn[1]).max() > 0.1


def test_random_trajectories_take_as_long_as_the_space_of_time_says():
    for seed in range(200):
        for holonomic in (True, False):
            duration = wander(np.random.default_rng(seed), duration=RANDOM, holonomic=holonomic).duration
            assert RANDOM <= duration <= LONGEST_RANDOM


@pytest.mark.parametrize("name", IDS)
def test_a_residual_of_zero_is_the_scripted_driver_and_others_correct_it(name):
    residual = made(name, control="residual", floor="slippery")
    np.testing.assert_allclose(  # actions are float32
        drive(residual, still)[0], driven(name, "slippery", scripted)[0], atol=1e-4
    )


@pytest.mark.parametrize("robot", ["asoc-prototype", "differential"])
def test_a_correction_changes_the_velocity_of_the_body(robot):
    """Where the scripted driver would stand, a robot goes at fractions of 0.25 m/s and 0.5 rad/s."""
    rest = Trajectory("rest", (Run((Leg((1.0, 0.0, 0.0), 1e-3),), 1e-4, 1.0),))
    env = made("castor/ASOC-v1", robot=robot, trajectory=rest, control="residual")
    env.reset(seed=0)
    size = env.action_space.shape[0]
    action = np.array([0.4, 0.2, 0.5])[[0, 1, 2] if size == 3 else [0, 2]]
    for _ in range(6):
        env.step(action)
    went = env.sensed.world.twist
    expected = np.array([0.1, 0.05 if size == 3 else 0.0, 0.25])
    seen = env.unscaled["reference"][:3]  # what the scripted driver adds to get back
    back = seen if size == 3 else 0.0 * seen
    np.testing.assert_allclose(went[2], expected[2] + back[2], atol=0.02)
    assert np.hypot(*went[:2]) == pytest.approx(np.hypot(*(expected[:2] + back[:2])), abs=0.03)


def test_a_correction_moves_one_axle_of_a_train():
    env = made("castor/CFMMR-v1", control="residual")
    told = []
    for action in (np.zeros(6), np.eye(6)[2]):  # the second axle, 0.25 m/s faster
        env.reset(seed=0)
        told.append(env.step(action)[4]["command"])
    np.testing.assert_allclose(told[1] - told[0], [0, 0, 0.25 / 0.075, 0.25 / 0.075, 0, 0], atol=1e-12)


def test_an_estimator_tells_the_agent_where_it_is_and_the_reward_is_of_the_truth():
    """On a floor that lets wheels slip, what odometry believes and what is true part; the agent sees the first."""
    env = made("castor/ASOC-v1", floor="slippery", estimator="estimators.robots.cast:CAST")
    observation, _ = env.reset(seed=1)
    counted = CAST()
    counted.reset(env.robot, np.zeros(3))
    counted.update(env.readings)
    for _ in range(200):
        observation, reward, _, _, info = env.step(scripted(env, observation))
        believed = counted.update(env.readings)
    np.testing.assert_array_equal(env.shown_estimate(), believed)
    away, turn = info["target"][:2] - believed[:2], np.exp(-1j * believed[2])
    seen = (away[0] + 1j * away[1]) * turn
    np.testing.assert_allclose(observation["reference"][:2], [seen.real, seen.imag], atol=1e-12)
    assert np.hypot(*observation["reference"][:2]) < 0.5 * info["position_error"]
    assert reward == pytest.approx(0.05 * (1 - (info["position_error"] + 0.25 * info["heading_error"]) / 0.5))


@pytest.mark.parametrize("file", [False, True])
def test_what_is_said_of_a_name_of_the_commands_makes_its_estimator(tmp_path, monkeypatch, file):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_cast.py").write_text("from estimators.robots.cast import CAST\n\n\nclass Mine(CAST): ...\n")
    spec = "my_cast.py:Mine?step=euler" if file else "cast-0"
    with pytest.raises(InputError) as refused:
        made("castor/ASOC-v1", estimator=spec)
    said = str(refused.value)
    assert said.startswith(f"there is no estimator {spec!r}; give 'module:Class', such as ")
    written = said.rpartition(", ")[2]
    assert written == f"estimators.load_estimator({spec!r}).factory"
    env = made("castor/ASOC-v1", estimator=eval(written, {"estimators": estimators}))
    env.reset(seed=0)
    assert isinstance(env._estimator, CAST)


def test_estimators_are_classes_or_make_estimators_and_of_trains_too():
    for estimator in (DeadReckoning, functools.partial(CAST)):
        made("castor/ASOC-v1", estimator=estimator).reset(seed=0)
    env = made("castor/CFMMR-v1", estimator="estimators.trains.odometry:TrainOdometry")
    assert not drive(env, scripted)[2]


def test_an_estimate_that_is_no_pose_is_refused():
    class Lost(CAST):
        def update(self, observation):
            return np.full(3, np.nan)

    with pytest.raises(InputError, match="estimator's pose must be finite"):
        made("castor/ASOC-v1", estimator=Lost).reset(seed=0)


@pytest.mark.parametrize("name", IDS)
def test_logs_are_recorded_whatever_the_agent_sees(name):
    logs = []
    for scaled in (False, True):
        env = RecordLog(gym.make(name, scaled=scaled, **SHORT[name]))
        drive(env, lambda env, _: np.full(env.action_space.shape, 0.2), seed=6)
        logs.append(env.log())
    for part in ("t", "wheel", "pivot", "command", "reference"):
        np.testing.assert_array_equal(getattr(logs[0], part), getattr(logs[1], part))


def test_nothing_is_drawn_before_a_picture_is_asked_for():
    """SB3 makes its environments able to draw; courses that change with every episode are not prepared for it."""
    env = made("castor/ASOC-v1", render_mode="rgb_array", floor="slippery")
    env.reset(seed=0)
    assert env._renderer is None
    first = env.render()
    env.reset(seed=1)
    second = env.render()
    assert first.shape == second.shape
    assert not np.array_equal(first, second)


@pytest.mark.parametrize("name", IDS)
def test_the_table_of_a_course_holds_what_the_course_says_of_each_sample(name):
    env = made(name)
    env.reset(seed=4)
    course, period = env.course, env.vehicle.sample_period
    table = ReferenceTable(course, period, AHEAD)
    for sample in (0, 1, ROWS - 1, ROWS, 2 * ROWS + 5, 3):
        places, twist = table.at(sample)
        assert places[:-1].tobytes() == course.target(sample * period + np.array(AHEAD)).tobytes()
        assert places[-1].tobytes() == course.target(course.duration).tobytes()
        assert twist.tobytes() == course.twist(sample * period + 0.5 * period).tobytes()
