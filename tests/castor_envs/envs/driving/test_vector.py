"""A vector environment is its members, bit for bit, whatever they are and however they are reset."""

# pyright: reportCallIssue=false, reportArgumentType=false, reportAttributeAccessIssue=false

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from castor_envs.envs.driving.vector import TrackingVectorEnv
from castor_envs.errors import InputError
from castor_envs.floor import Cable, Floor, Patch
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.presets import any_preset, preset
from castor_envs.vehicles.robot import Castor, RobotDescription, Wheel

ROBOT, TRAIN = "castor/ASOC-v1", "castor/CFMMR-v1"
ROUGH = Floor(
    patches=(Patch(center=(0.2, 0.0), size=(0.3, 2.0), friction=0.1),),
    cables=(Cable(center=(0.1, 0.0), direction=1.5, length=2.0, diameter=0.01),),
    slope=(0.03, -0.02),
)
SLIPPERY = Floor(patches=(Patch(center=(0.0, 0.0), size=(4.0, 4.0), friction=0.15),))


def differing(one, other, where=""):
    """Return where two results differ, "" for nowhere."""
    if isinstance(one, tuple | list):
        return "".join(differing(a, b, f"{where}/{i}") for i, (a, b) in enumerate(zip(one, other, strict=True)))
    if isinstance(one, dict):
        if one.keys() != other.keys():
            return f"{where}: {one.keys() ^ other.keys()}"
        return "".join(differing(one[name], other[name], f"{where}/{name}") for name in one)
    one, other = np.asarray(one), np.asarray(other)
    if one.dtype == object:
        pairs = [(a, b) for a, b in zip(one, other, strict=True) if a is not None or b is not None]
        return "".join(differing(a, b, where) for a, b in pairs)
    return "" if one.shape == other.shape and one.tobytes() == other.tobytes() else f" {where}"


def vector_of(name, size, mode=AutoresetMode.NEXT_STEP, **arguments):
    vector = gym.make_vec(
        name, num_envs=size, vectorization_mode="vector_entry_point", autoreset_mode=mode, **arguments
    )
    assert isinstance(vector.unwrapped, TrackingVectorEnv)
    return vector


def both(name, members, mode=AutoresetMode.NEXT_STEP):
    """Return a vector of members with these arguments, and gymnasium's loop over the same."""
    lists = {key: [member[key] for member in members] for key in members[0]}
    loop = SyncVectorEnv(
        [lambda arguments=arguments: gym.make(name, **arguments) for arguments in members],
        autoreset_mode=mode,
        observation_mode="different",
    )
    return vector_of(name, len(members), mode, **lists), loop


def follow(vector, loop, steps, seed=0):
    """Step both with the same actions, resetting where the mode leaves it to the user; return how many ended."""
    random, ended = np.random.default_rng(seed), 0
    assert not differing(vector.reset(seed=seed), loop.reset(seed=seed))
    for step in range(steps):
        actions = random.uniform(-1, 1, vector.action_space.shape).astype(np.float32)
        ours, theirs = vector.step(actions), loop.step(actions)
        assert not differing(ours, theirs, f"step {step}")
        over = ours[2] | ours[3]
        ended += int(over.sum())
        if vector.unwrapped.autoreset_mode == AutoresetMode.DISABLED and over.any():
            answers = [env.reset(options={"reset_mask": over.copy()}) for env in (vector, loop)]
            assert not differing(*answers)
    return ended


@pytest.mark.parametrize("mode", AutoresetMode)
@pytest.mark.parametrize("arguments", [{}, {"control": "voltage", "scaled": True}])
def test_episodes_end_and_begin_as_gymnasium_says(mode, arguments):
    assert follow(*both(ROBOT, [{"robot": "differential", **arguments}] * 5, mode), steps=60) > 0


@pytest.mark.parametrize("control", ["speed", "residual"])
@pytest.mark.parametrize(
    "name", ["asoc-prototype", "2-castor", "omnimate", "tricycle", "powered-caster", "swerve", "omni3"]
)
def test_robots_on_rough_floors(name, control):
    members = [{"robot": name, "control": control, "floor": floor} for floor in (ROUGH, ROUGH, SLIPPERY, Floor())]
    follow(*both(ROBOT, members), steps=12)


@pytest.mark.parametrize(("train", "steps"), [("cfmmr-2", 50), ("cfmmr-10", 4)])
def test_trains(train, steps):
    members = [{"train": train, "floor": floor, "scaled": True} for floor in (ROUGH, SLIPPERY, SLIPPERY)]
    follow(*both(TRAIN, members, AutoresetMode.SAME_STEP), steps=steps)


def test_members_may_have_dimensions_of_their_own():
    robots = [
        dataclasses.replace(preset("asoc-prototype"), mass=mass, max_wheel_speed=speed)
        for mass, speed in ((8.0, 9.0), (12.0, 10.0), (25.0, 14.0))
    ]
    follow(*both(ROBOT, [{"robot": robot} for robot in robots]), steps=20)


def compared(name, steps, **arguments):
    """Follow what make_vec makes of members and a loop over the same; return whether it steps them as one."""
    size = len(next(value for value in arguments.values() if isinstance(value, list)))
    vector = gym.make_vec(name, num_envs=size, vectorization_mode="vector_entry_point", **arguments)
    members = [
        {key: value[i] if isinstance(value, list) else value for key, value in arguments.items()} for i in range(size)
    ]
    loop = SyncVectorEnv(
        [lambda member=member: gym.make(name, **member) for member in members], observation_mode="different"
    )
    follow(vector, loop, steps)
    return isinstance(vector.unwrapped, TrackingVectorEnv)


def four_omni_wheels(idle):
    """Return a robot on four wheels of which one rolls along: it has neither motor nor encoder."""
    place = np.pi / 2 * np.arange(4)
    castors = [
        Castor(
            pivot=(0.2 * np.cos(angle), 0.2 * np.sin(angle)),
            steering="fixed",
            angle=float(np.remainder(angle, 2 * np.pi) - np.pi / 2),
            wheels=(Wheel(radius=0.05, grip="omni", counts_per_rev=None if k == idle else 1000.0),),
        )
        for k, angle in enumerate(place)
    ]
    return RobotDescription(name="four omni", castors=tuple(castors))


@pytest.mark.parametrize("held", [[1, 1, 1], [1, 2, 2], [None, 1, None]])
def test_wheels_may_be_held_in_each_member_or_in_some(held):
    assert compared(ROBOT, 12, robot="asoc-prototype", held=held) == (held == [1, 1, 1])


@pytest.mark.parametrize("idle", [(3, 3), (3, 0)])
def test_members_may_drive_other_wheels(idle):
    assert compared(ROBOT, 12, robot=[four_omni_wheels(k) for k in idle]) == (idle[0] == idle[1])


@pytest.mark.parametrize("control", ["speed", "residual"])
@pytest.mark.parametrize("name", [ROBOT, TRAIN])
def test_members_may_be_sampled_at_periods_of_their_own(name, control):
    kind, vehicle = ("robot", preset("differential")) if name == ROBOT else ("train", any_preset("cfmmr-2"))
    slower = dataclasses.replace(vehicle, sample_period=0.1) if name == ROBOT else slow_train(vehicle)
    compared(name, 12, control=control, **{kind: [vehicle, slower, vehicle]})


def slow_train(train):
    modules = tuple(dataclasses.replace(module, sample_period=0.1) for module in train.modules)
    return dataclasses.replace(train, modules=modules)


def test_a_gyro_draws_its_noise_from_its_members_seed():
    robot = preset("differential")
    robot = dataclasses.replace(robot, gyro={"bias": 0.01, "noise": 0.02})
    follow(*both(ROBOT, [{"robot": robot}] * 3), steps=45)


def test_members_are_found_as_they_are_and_moved_on_from_there():
    vector, loop = both(ROBOT, [{"robot": "asoc-prototype"}] * 3)
    assert vector.get_attr("control") == loop.get_attr("control")  # before the first episode
    for env in (vector, loop):
        env.reset(seed=2)
        for _ in range(3):
            env.step(np.full(env.action_space.shape, 0.3, dtype=np.float32))
    poses = [[sensed.pose for sensed in env.get_attr("sensed")] for env in (vector, loop)]
    assert not differing(*poses)
    actions = np.full(vector.action_space.shape, 0.2, dtype=np.float32)
    for _ in range(3):
        assert not differing(vector.step(actions), loop.step(actions))


def test_threads_change_nothing():
    members = [{"robot": "differential", "floor": floor} for floor in (ROUGH, SLIPPERY)] * 20
    vector, loop = both(ROBOT, members)
    threaded = vector_of(ROBOT, len(members), threads=2, **{key: [m[key] for m in members] for key in members[0]})
    follow(threaded, loop, steps=5)
    follow(vector, threaded, steps=5)


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize(("name", "vehicle"), [(ROBOT, {"robot": "differential"}), (TRAIN, {"train": "cfmmr-2"})])
def test_a_limit_of_steps_truncates_as_that_of_single_ones(mode, name, vehicle):
    vector = vector_of(name, 3, mode, max_episode_steps=5, **vehicle)
    kwargs = {"vectorization_mode": "sync", "vector_kwargs": {"autoreset_mode": mode}, "max_episode_steps": 5}
    assert follow(vector, gym.make_vec(name, num_envs=3, **kwargs, **vehicle), steps=14) >= 6
    assert vector.call("longest_episode")[0] > 5 * 0.05  # that of the course


def test_a_limit_of_steps_holds_where_members_are_stepped_one_after_the_other():
    vector = gym.make_vec("castor/UMBmark-v0", num_envs=2, max_episode_steps=3)
    vector.reset(seed=0)
    ends = [vector.step(np.zeros((2, 3)))[3].tolist() for _ in range(3)]
    assert ends == [[False, False], [False, False], [True, True]]
    for no_limit in (None, -1):
        gym.make_vec(ROBOT, num_envs=2, max_episode_steps=no_limit)


def test_one_alone_is_not_stepped_in_lanes():
    vector = gym.make_vec(ROBOT, num_envs=1, vectorization_mode="vector_entry_point")
    assert type(vector.unwrapped) is SyncVectorEnv


def test_what_only_one_at_a_time_can_do_is_done_one_after_the_other():
    """An effect on sensors keeps the past of its own encoders: the loop over members serves it."""
    effect = next(kind for kind in Effect.__subclasses__() if kind.__name__ == "EncoderReversed")(castor=1, wheel=1)
    for arguments in (
        {"robot": preset("differential").with_effects(effect)},
        {"robot": "differential", "estimator": "estimators.robots.dead_reckoning:DeadReckoning"},
    ):
        vector = gym.make_vec(ROBOT, num_envs=2, vectorization_mode="vector_entry_point", **arguments)
        assert type(vector.unwrapped) is SyncVectorEnv
        vector.reset(seed=0)
        vector.step(vector.action_space.sample())


@pytest.mark.parametrize("name", [ROBOT, "castor/UMBmark-v0"])
@pytest.mark.parametrize(
    ("argument", "value"),
    [
        *(("num_envs", value) for value in (0, -1, 2.0, "2")),
        *(("threads", value) for value in (0, "a", True, 1.5)),
        *(("max_episode_steps", value) for value in (0, -2, "5", True)),
    ],
)
def test_sizes_that_are_no_whole_numbers_are_refused_at_once(name, argument, value):
    with pytest.raises(InputError, match=rf"{argument}.* must be a whole number of at least 1, got {value!r}"):
        gym.make_vec(name, **{"num_envs": 2, argument: value})


def test_wrong_arguments_are_named():
    with pytest.raises(InputError, match="a value for each of 3"):
        gym.make_vec(ROBOT, num_envs=3, vectorization_mode="vector_entry_point", robot=["differential"])
    vector = vector_of(ROBOT, 2, AutoresetMode.DISABLED, robot="differential")
    vector.reset(seed=0)
    with pytest.raises(InputError, match="finite"):
        vector.step(np.full(vector.action_space.shape, np.nan))
    with pytest.raises(InputError, match="shape"):
        vector.step(np.zeros((3, 2)))
    for _ in range(100):
        over = np.logical_or(*vector.step(np.ones(vector.action_space.shape, dtype=np.float32))[2:4])
        if over.any():
            break
    with pytest.raises(InputError, match="reset_mask"):
        vector.step(np.zeros(vector.action_space.shape))


@pytest.mark.parametrize("vehicle", [{"robot": "differential"}, {"robot": "differential", "control": "voltage"}])
def test_what_a_member_that_begins_again_is_told_is_not_read(vehicle):
    """Gymnasium's loop does not look at it either: policies that give NaN for what has ended go on."""
    vector, loop = both(ROBOT, [vehicle] * 3)
    random = np.random.default_rng(0)
    assert not differing(vector.reset(seed=0), loop.reset(seed=0))
    over, skipped = np.zeros(3, dtype=bool), 0
    for _ in range(80):
        actions = random.uniform(-1, 1, vector.action_space.shape).astype(np.float32)
        actions[over] = np.nan
        skipped += over.sum()
        ours, theirs = vector.step(actions), loop.step(actions)
        assert not differing(ours, theirs)
        over = ours[2] | ours[3]
    assert skipped
