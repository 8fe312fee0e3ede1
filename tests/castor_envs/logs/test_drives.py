"""Drives as files: what is read is what was written, robots follow it, and every mistake has a place."""

import gymnasium as gym
import numpy as np
import pytest

import castor_envs  # noqa: F401  (registers the environments)
from castor_envs.errors import InputError
from castor_envs.logs.trajectory_files import DRIVE, read_drive, write_drive
from castor_envs.motion.controllers import KinematicController
from castor_envs.motion.trajectories import chained, figure_eight, pivoting, umbmark, wander
from castor_envs.vehicles.presets import preset

PERIOD = 0.05
TRAJECTORIES = [
    *(umbmark("cw", corners) for corners in ("turn", "fixed", "rounded")),
    pivoting((0.2, -0.1)),
    figure_eight(),
    wander(np.random.default_rng(3), duration=20),
]


@pytest.mark.parametrize("trajectory", TRAJECTORIES, ids=lambda trajectory: trajectory.name)
def test_a_drive_from_a_file_is_where_it_was_at_every_row(tmp_path, trajectory):
    write_drive(tmp_path / "drive.csv", trajectory, PERIOD)
    rows = np.loadtxt(tmp_path / "drive.csv", delimiter=",", skiprows=1)
    read = read_drive(tmp_path / "drive.csv")
    np.testing.assert_array_equal(rows[:, 1:4], trajectory.at(rows[:, 0])[0])
    np.testing.assert_allclose(np.diff(rows[:, 0]), PERIOD, atol=1e-9)
    np.testing.assert_allclose(read.at(rows[:, 0])[0], rows[:, 1:4], atol=1e-3)
    np.testing.assert_allclose(read.at(rows[:-1, 0] + 0.5 * PERIOD)[1], rows[:-1, 4:], atol=1e-12)
    assert trajectory.duration <= read.duration + 1e-6 < trajectory.duration + PERIOD + 2e-6


@pytest.mark.parametrize(
    ("robot", "trajectory"),
    [("asoc-prototype", wander(np.random.default_rng(1), duration=20)), ("differential", umbmark("ccw"))],
    ids=["asoc-prototype", "differential"],
)
def test_a_robot_follows_a_drive_from_a_file(tmp_path, robot, trajectory):
    """Open loop, commanded by the file's velocities alone: within 3 cm of the poses that the file has."""
    path = tmp_path / "drive.csv"
    write_drive(path, trajectory, preset(robot).sample_period)
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    env = gym.make("castor/ASOC-v1", robot=robot, trajectory=str(path))
    known, controller = env.unwrapped.robot, KinematicController(env.unwrapped.robot)  # type: ignore[attr-defined]
    env.reset(seed=1)
    pose, over, info = [], False, {}
    for velocity in rows[:-1, 4:]:
        castors = env.unwrapped.sensed.measured_castor_angles()  # type: ignore[attr-defined]
        commands = controller.commands(castors, velocity)
        wheel = np.asarray(commands.wheel) / known.max_wheel_speed
        action = np.concatenate([wheel, commands.steering / known.max_steering_speed]).astype(np.float32)
        _, _, lost, over, info = env.step(action)
        pose.append(info["pose"])
        assert not lost
    assert over
    assert np.max(np.hypot(*(np.array(pose) - rows[1:, 1:4])[:, :2].T)) < 0.03
    np.testing.assert_allclose(info["target"], rows[-1, 1:4], atol=2e-3)


def test_trajectories_one_after_the_other_begin_where_the_last_one_ended():
    first, second = umbmark("cw"), wander(np.random.default_rng(3), duration=5)
    chain = chained("both", [first, second])
    assert chain.duration == pytest.approx(first.duration + second.duration)
    np.testing.assert_allclose(chain.at(first.duration + 2.0)[1], second.at(2.0)[1], atol=1e-9)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda rows: rows[:2], "fewer than two rows"),
        (lambda rows: [rows[0].replace("psi_rad", "psi"), *rows[1:]], ":1: column 'psi_rad'"),
        (lambda rows: [*rows[:2], rows[1], *rows[3:]], ":3: column 't_s': does not increase"),
        (lambda rows: [*rows[:9], rows[9].replace(",", ",x", 1), *rows[10:]], ":10: column 'x_m'"),
        (lambda rows: [*rows[:-1], rows[-1] + ",0"], "8 cells"),
        (
            lambda rows: [rows[0], *(",".join([*row.split(",")[:4], "0", "0", "0"]) for row in rows[1:])],
            "velocities lead",
        ),
    ],
    ids=["short", "column", "time", "number", "width", "poses"],
)
def test_mistakes_in_a_drive_have_a_place(tmp_path, change, said):
    path = tmp_path / "drive.csv"
    write_drive(path, umbmark("cw"), PERIOD)
    lines = path.read_text().splitlines()
    assert lines[0].split(",") == list(DRIVE)
    path.write_text("\n".join(change(lines)) + "\n")
    with pytest.raises(InputError) as error:
        read_drive(path)
    assert str(error.value).startswith(str(path))
    assert said in str(error.value)
