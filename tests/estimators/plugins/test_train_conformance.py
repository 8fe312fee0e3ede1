"""The check for authors on trains: passes what is right, names what is wrong; its drives are true."""

import re
from functools import cache
from typing import Any

import numpy as np
import pytest

from castor_envs.vehicles.load import load_vehicle
from castor_envs.vehicles.presets import cfmmr
from estimators import CAST, GRPECXY, EstimatorEntry, TrainOdometry, load_estimator
from estimators.plugins.conformance.check import candidates, check, refusal
from estimators.plugins.registry import builtin_names
from estimators.plugins.train_drives import straight, turning, winding, with_silent_sensors


class Careful(GRPECXY):
    """A plug-in that passes; those below spoil one thing each."""


class OneAxle(Careful):
    def update(self, observation):
        return super().update(observation)[0]


class Flat(Careful):
    def update(self, observation):
        return super().update(observation).ravel()


class Wrapping(Careful):
    def update(self, observation):
        poses = super().update(observation)
        poses[1, 2] = np.arctan2(np.sin(poses[1, 2]), np.cos(poses[1, 2]))
        return poses


class Reversed(TrainOdometry):
    """Takes the axles from the rear."""

    def update(self, observation):
        return super().update({**observation, "wheel": observation["wheel"].reshape(-1, 2)[::-1].ravel()})


class WrongFrame(Careful):
    """Takes a relative pose for that of the rear axle in the front axle's frame."""

    def update(self, observation):
        x, y, phi = observation["rps"].reshape(-1, 3).T
        mirrored = np.stack([x, -y, -phi], axis=-1)
        return super().update({**observation, "rps": mirrored.ravel()})


class SpoiltByNaN(TrainOdometry):
    def update(self, observation):
        poses = super().update(observation)
        poses[1:] += 0.0 * observation["rps"].reshape(-1, 3)
        return poses


class StopsWithoutSensors(TrainOdometry):
    def reset(self, train, poses):
        super().reset(train, poses)
        self.last = np.array(poses)

    def update(self, observation):
        poses = super().update(observation)
        if np.isfinite(observation["rps"]).all():
            self.last = poses
            return poses
        return self.last + [[1.0, 0.0, 0.0]] * len(poses)


class KeepingThePoses(TrainOdometry):
    def reset(self, train, poses):
        super().reset(train, poses)
        self.poses: Any = poses

    def update(self, observation):
        self.poses[:] = super().update(observation)
        return self.poses.copy()


def entry(kind):
    return EstimatorEntry(kind.__name__, "test", "0" * 16, kind)


@cache
def failed(kind, train=None):
    return {finding.name: finding.message for finding in check(entry(kind), train) if not finding.passed}


@pytest.mark.parametrize("train", ["cfmmr-2", "cfmmr-10", None])
def test_careful_plugin_passes(train):
    findings = check(entry(Careful), train and load_vehicle(train))
    assert [finding for finding in findings if not finding.passed] == []
    assert {"drives round where the train does", "survives missing relative poses"} <= {f.name for f in findings}


@pytest.mark.slow
@pytest.mark.parametrize("name", builtin_names(cfmmr(2)))
def test_builtins_pass(name):
    """On a train of three axles where they can follow it, of two otherwise."""
    train = cfmmr(3 if name in builtin_names(cfmmr(3)) else 2)
    assert [finding for finding in check(load_estimator(name), train) if not finding.passed] == []


@pytest.mark.parametrize(
    ("kind", "name", "message"),
    [
        (OneAxle, "returns three finite numbers", r"returns shape \(3,\) instead of \(3, 3\).*for each of 3 axles"),
        (Flat, "returns three finite numbers", r"returns shape \(9,\)"),
        (Wrapping, "keeps psi unwrapped", "psi jumps by -6.2.* while the train turns evenly"),
        (Reversed, "drives round where the train does", "through bends.*which wheels and frames belong to which axle"),
        (WrongFrame, "drives round where the train does", "whose frame a relative pose is in"),
        (SpoiltByNaN, "survives missing relative poses", r"returns \[.*nan.*return finite numbers"),
        (StopsWithoutSensors, "survives missing relative poses", "go on by odometry alone"),
        (KeepingThePoses, "leaves its input alone", "pose array given to reset is changed later"),
    ],
)
def test_broken_plugin_is_found_out(kind, name, message):
    findings = failed(kind)
    assert name in findings
    assert re.search(message, findings[name])
    assert "\n" not in findings[name]


def test_trains_come_after_all_robots_and_each_kind_refuses_the_other():
    names = candidates()
    first = names.index("cfmmr-3")
    assert all(name.startswith("cfmmr-") for name in names[first:])
    assert not any(name.startswith("cfmmr-") for name in names[:first])
    assert len(names) == len(set(names))
    assert refusal(entry(CAST), cfmmr(3)) is not None
    assert all(refusal(entry(GRPECXY), load_vehicle(name)) is not None for name in names[:first])
    assert refusal(entry(GRPECXY), cfmmr(3)) is None


@pytest.mark.parametrize("n", [2, 3, 10])
@pytest.mark.parametrize("drive_of", [straight, turning, winding])
def test_wheels_of_a_drive_roll_without_slip_and_frames_see_what_is_true(n, drive_of):
    train = cfmmr(n)
    drive = drive_of(train)
    left, right = train.modules[0].castors[0].wheels
    np.testing.assert_array_equal(drive.pose[0, 0], 0.0)
    wheel = np.array([seen["wheel"] for seen in drive.observations]).reshape(-1, n, 2)
    rolled = wheel / left.counts_per_rev * 2 * np.pi * left.radius
    turn = np.diff(drive.pose[..., 2], axis=0)
    np.testing.assert_allclose((rolled[..., 1] - rolled[..., 0])[1:], turn * (left.lateral - right.lateral), atol=1e-12)
    # Step by step each axle goes along its heading half way, by its mean roll.
    place = drive.pose[..., 0] + 1j * drive.pose[..., 1]
    along = np.diff(place, axis=0) * np.exp(-0.5j * (drive.pose[1:, :, 2] + drive.pose[:-1, :, 2]))
    np.testing.assert_allclose(along.real, rolled[1:].mean(axis=-1), rtol=1e-3, atol=1e-9)
    np.testing.assert_allclose(along.imag, 0.0, atol=2e-5)
    rps = np.array([seen["rps"] for seen in drive.observations]).reshape(-1, n - 1, 3)
    seen = (place[:, :-1] - place[:, 1:]) * np.exp(-1j * drive.pose[:, 1:, 2])
    np.testing.assert_allclose(rps[..., 0] + 1j * rps[..., 1], seen, atol=1e-12)
    np.testing.assert_allclose(rps[..., 2], drive.pose[:, :-1, 2] - drive.pose[:, 1:, 2], atol=1e-12)


@pytest.mark.parametrize("n", [2, 5])
def test_frames_are_bent_along_the_circle(n):
    curvature, length = 1.25, 0.35
    angle = curvature * length
    arc = [np.sin(angle) / curvature, (1 - np.cos(angle)) / curvature, angle]
    for seen in turning(cfmmr(n)).observations:
        np.testing.assert_allclose(seen["rps"].reshape(n - 1, 3), [arc] * (n - 1), atol=1e-8)


def test_silence_is_where_it_is_asked_for():
    observations = straight(cfmmr(3)).observations
    silent = with_silent_sensors(observations, slice(3, 5))
    assert [bool(np.isnan(seen["rps"]).all()) for seen in silent[:7]] == [False] * 3 + [True] * 2 + [False] * 2
    assert all(np.isfinite(seen["rps"]).all() for seen in observations)


@pytest.mark.parametrize("kind", [Wrapping, Reversed, SpoiltByNaN, StopsWithoutSensors, KeepingThePoses])
def test_what_is_right_is_not_blamed(kind):
    assert len(failed(kind)) == 1
