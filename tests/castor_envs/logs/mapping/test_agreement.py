"""A drive of which one thing in the map is wrong: the note names that; without a mistake there is none."""

import dataclasses

import numpy as np
import pytest

from castor_envs.logs import Log
from castor_envs.logs.mapping.agreement import agreement_notes
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import figure_eight, umbmark
from castor_envs.vehicles.presets import preset

DRIVES = {
    "differential, square": ("differential", umbmark(side=1.0)),
    "differential": ("differential", figure_eight()),
    "two castors": ("2-castor", figure_eight()),
    "swerve": ("swerve", figure_eight()),
    "omni": ("omni3", figure_eight()),
}


@pytest.fixture(params=DRIVES)
def drive(request):
    """A robot and the log of its drive by perfect rolling, poses of a tracker with 1 mm and 2 mrad of noise."""
    robot, trajectory = preset(DRIVES[request.param][0]), DRIVES[request.param][1]
    rolled = roll(robot, trajectory)
    turns = [robot.wheels[k].counts_per_rev for k in robot.driven_wheels]
    pivots = [robot.castors[i].pivot_counts_per_rev for i in robot.pivot_encoders]
    zeros = [robot.castors[i].pivot_zero for i in robot.pivot_encoders]
    noise = np.random.default_rng(0).normal(size=rolled.pose.shape) * [0.001, 0.001, 0.002]
    return robot, Log(
        t=rolled.t,
        wheel=np.round(rolled.wheel_angle[:, list(robot.driven_wheels)] * np.array(turns, float) / (2 * np.pi)),
        pivot=np.round((rolled.castor_angle[:, list(robot.pivot_encoders)] + zeros) * np.array(pivots) / (2 * np.pi)),
        reference=rolled.pose + noise,
    )


def noted(robot, log, **parts):
    return [note.split(":")[0] for note in agreement_notes(robot, dataclasses.replace(log, **parts))]


def test_a_drive_without_a_mistake_has_no_note(drive):
    robot, log = drive
    assert noted(robot, log) == []
    assert noted(robot, log, reference=None) == []
    still = np.tile(log.wheel[0], (len(log), 1))
    assert noted(robot, log, wheel=still, reference=log.reference - log.reference + np.array([1.0, 2.0, 3.0])) == []


def test_of_positions_alone_how_far_they_go_is_compared(drive):
    robot, log = drive
    assert noted(robot, log, reference=log.reference * [1, 1, np.nan]) == []
    assert noted(robot, log, reference=log.reference * [1000, 1000, np.nan]) == ["ref_x"]
    turning = np.zeros(log.reference.shape) * [1, 1, np.nan]  # a receiver on the axis of a robot that turns
    assert noted(robot, log, reference=turning) == []


def test_a_slow_tracker_off_the_middle_is_no_mistake(drive):
    robot, log = drive
    psi = log.reference[:, 2]
    off = log.reference + np.column_stack([0.05 * np.cos(psi), 0.05 * np.sin(psi), 0 * psi])
    off[np.arange(len(log)) % 10 != 0] = np.nan
    assert noted(robot, log, reference=off) == []


@pytest.mark.parametrize("factor", [1000, 100])
def test_lengths_in_another_unit_are_noted(drive, factor):
    robot, log = drive
    assert noted(robot, log, reference=log.reference * np.array([factor, factor, 1.0])) == ["ref_x"]


def test_headings_in_degrees_are_noted(drive):
    robot, log = drive
    assert noted(robot, log, reference=log.reference * np.array([1.0, 1.0, 180 / np.pi])) == ["ref_psi"]


@pytest.mark.parametrize("factor", [180 / np.pi, np.pi / 180])
def test_all_wheels_in_another_unit_are_noted(drive, factor):
    robot, log = drive
    assert noted(robot, log, wheel=log.wheel * factor)[0] in ("wheels", "ref_x")


@pytest.mark.parametrize("factor", [180 / np.pi, np.pi / 180, -1])
def test_a_wheel_in_another_unit_or_with_another_sign_is_noted_by_its_name(drive, factor):
    robot, log = drive
    for k, name in enumerate(robot.wheel_names):
        wheel = np.where(np.arange(log.wheel.shape[1]) == k, factor, 1.0) * log.wheel
        assert noted(robot, log, wheel=wheel) == [f"wheel_{name}"]


def test_wheels_that_all_roll_backwards_are_one_note(drive):
    robot, log = drive
    assert noted(robot, log, wheel=-log.wheel) == ["wheels"]
