"""The check for authors passes what is right, and names what is wrong."""

import dataclasses
import re
from functools import cache
from typing import Any

import numpy as np
import pytest

from castor_envs.errors import Declined, InputError
from castor_envs.motion.kinematics import Geometry, castor_rates, inverse
from castor_envs.vehicles.presets import preset, preset_names
from castor_envs.vehicles.robot import Gyro
from estimators import CAST, DeadReckoning, EstimatorEntry, load_estimator
from estimators.plugins.conformance.check import check, refusal
from estimators.plugins.drives import straight, turning, winding, with_pivot_counts_unwrapped


class Careful:
    """A plug-in that passes; those below spoil one thing each."""

    def reset(self, robot, pose):
        self.inner = DeadReckoning()
        self.inner.reset(robot, pose)

    def update(self, observation) -> Any:
        return self.inner.update(observation)


class NaN(Careful):
    def update(self, observation):
        pose = super().update(observation)
        return pose if observation["time"][0] < 1.0 else pose * np.nan


class Column(Careful):
    def update(self, observation):
        return super().update(observation)[:, None]


class Nothing(Careful):
    def update(self, observation):
        super().update(observation)


class Ragged(Careful):
    def update(self, observation):
        return [super().update(observation), 1.0]


class Single(Careful):
    """Gives its poses in single precision, which is enough."""

    def update(self, observation):
        return super().update(observation).astype(np.float32)


class Complex(Careful):
    def update(self, observation):
        return super().update(observation) + 0j


class Digits(Careful):
    def update(self, observation):
        return super().update(observation).astype(str)


class Wrapping(Careful):
    def update(self, observation):
        x, y, psi = super().update(observation)
        return np.array([x, y, np.arctan2(np.sin(psi), np.cos(psi))])


class Backwards(Careful):
    def update(self, observation):
        return super().update({**observation, "wheel": -observation["wheel"]})


class Mirrored(Careful):
    """Takes left for right in turns, and wraps the heading as well."""

    def update(self, observation):
        x, y, psi = super().update(observation)
        return np.array([x, y, np.arctan2(np.sin(-psi), np.cos(-psi))])


class Degrees(Careful):
    def update(self, observation):
        return super().update(observation) * [1.0, 1.0, 180 / np.pi]


class Forgetful(Careful):
    """Keeps the last pivot counts over a reset, as an attribute set only once would."""

    def reset(self, robot, pose):
        last = getattr(getattr(self, "inner", None), "_stack", None)
        super().reset(robot, pose)
        if last is not None:
            self.inner._stack.parts[0]["angle"][...] = last.parts[0]["angle"]


class Shared(Careful):
    """Keeps state in the class."""

    calls = 0

    def update(self, observation):
        Shared.calls += 1
        return super().update(observation) + 1e-6 * Shared.calls * np.abs(observation["wheel"]).max()


class Noisy(Careful):
    def update(self, observation):
        moved = np.abs(observation["wheel"]).max() > 0
        return super().update(observation) + 1e-6 * moved * np.random.default_rng().normal(size=3)


class Overwriting(Careful):
    def update(self, observation):
        observation["wheel"] *= 1.0001
        return super().update(observation)


class Removing(Careful):
    def update(self, observation):
        pose = super().update(observation)
        del observation["time"]
        return pose


class KeepingThePose(Careful):
    def reset(self, robot, pose):
        super().reset(robot, pose)
        self.pose = pose

    def update(self, observation):
        self.pose[:] = super().update(observation)
        return self.pose


class AtTheOrigin(Careful):
    def reset(self, robot, pose):
        super().reset(robot, np.zeros(3))


class TurnedWrongly(Careful):
    """Adds the start position but forgets the start heading."""

    def reset(self, robot, pose):
        super().reset(robot, np.zeros(3))
        self.start = pose.copy()

    def update(self, observation):
        return super().update(observation) + self.start


class Late(Careful):
    """Starts a little ahead."""

    def update(self, observation):
        return super().update(observation) + np.array([0.01, 0.0, 0.0])


class Raising(Careful):
    def update(self, observation):
        return super().update(observation)["pose"]


class RaisingInReset(Careful):
    def reset(self, robot, pose):
        self.gain = robot.no_such_attribute


class Exiting(Careful):
    def update(self, observation):
        raise SystemExit(3)


class Choosy(Careful):
    def __init__(self, gain):
        self.gain = gain


class Refusing(Careful):
    def reset(self, robot, pose):
        raise Declined("serves nobody")


class Unwrapped(Careful):
    """Takes differences of pivot counts as they are."""

    def reset(self, robot, pose):
        super().reset(robot, pose)
        self.pivot, self.drift = None, 0.0

    def update(self, observation):
        if self.pivot is not None:
            self.drift += 1e-4 * np.sum(observation["pivot"] - self.pivot)
        self.pivot = observation["pivot"].copy()
        return super().update(observation) + np.array([0.0, 0.0, self.drift])


class NotBatched(Careful):
    """Says that it broadcasts, and takes the first axis for x, y, psi."""

    batched = True

    def update(self, observation):
        x, y, psi = super().update(observation)
        return np.array([x, y, psi])


class ShapelessInBatch(Careful):
    batched = True

    def update(self, observation):
        pose = super().update(observation)
        return pose if pose.ndim == 1 else pose[0]


def entry(kind, argument=None):
    return EstimatorEntry(kind.__name__, "test", "0" * 16, kind, argument)


@cache
def failed(kind, robot=None):
    return {finding.name: finding.message for finding in check(entry(kind), robot) if not finding.passed}


class InTheBody(Careful):
    """Gives a covariance in the axes of its body: 1 cm along, 2 cm across."""

    covariance = np.diag([1e-4, 4e-4, 1e-3])


class Unequal(Careful):
    covariance = np.diag([1e-4, 4e-4, -1e-3])


class Shapeless(Careful):
    covariance = np.eye(2)


class SureAtTimes(Careful):
    """Gives no covariance at every twentieth sample."""

    def reset(self, robot, pose):
        super().reset(robot, pose)
        self.k = -1

    def update(self, observation):
        self.k += 1
        self.covariance = None if self.k % 20 == 7 else 1e-4 * np.eye(3)
        return super().update(observation)


class LateInfinite(SureAtTimes):
    def update(self, observation):
        pose = super().update(observation)
        self.covariance = np.diag([np.inf if self.k == 100 else 1e-4, 1e-4, 1e-4])
        return pose


class Chatty(Careful):
    status = ("lost", "found")


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        (InTheBody, "world's axes"),
        (Unequal, "a variance is negative"),
        (SureAtTimes, "has a covariance after some updates, and none after update 7"),
        (LateInfinite, "after update 100 its covariance is not finite"),
        (Shapeless, r"covariance has shape \(2, 2\) instead of \(3, 3\)"),
        (Chatty, "status is of type tuple: None or a text"),
    ],
)
def test_a_wrong_covariance_or_status_is_found(kind, words):
    (message,) = failed(kind).values()
    assert re.search(words, message)


@pytest.mark.parametrize("robot", ["asoc-prototype", "differential", None])
def test_careful_plugin_passes(robot):
    findings = check(entry(Careful), robot and preset(robot))
    assert all(finding.passed and not finding.message for finding in findings)
    assert len(findings) == 15


@pytest.mark.parametrize(
    ("kind", "name", "message"),
    [
        (Choosy, "is constructed without arguments", "TypeError.*gain"),
        (Refusing, "serves the robot", "serves nobody"),
        (RaisingInReset, "serves the robot", "no_such_attribute.*reset, line"),
        (NaN, "returns three finite numbers", r"update 20 returns \(nan, nan, nan\)"),
        (Column, "returns three finite numbers", r"update 0 returns shape \(3, 1\)"),
        (Nothing, "returns three finite numbers", "update 0 returns NoneType .*: return an array of three numbers"),
        (Ragged, "returns three finite numbers", "update 0 returns list"),
        (Complex, "returns three finite numbers", "update 0 returns complex numbers instead of"),
        (Digits, "returns three finite numbers", "update 0 returns ndarray instead of"),
        (Raising, "returns three finite numbers", "raises IndexError.*update, line"),
        (Exiting, "returns three finite numbers", "raises SystemExit"),
        (Late, "returns the start pose first", "return the start pose until a wheel turns"),
        (AtTheOrigin, "returns the start pose first", "return the start pose"),
        (AtTheOrigin, "moves and turns with the start pose", "start from the pose that reset is given"),
        (TurnedWrongly, "moves and turns with the start pose", "psi included"),
        (Wrapping, "keeps psi unwrapped", "psi jumps by -6.2.*keep it unwrapped"),
        (Backwards, "drives straight where the robot does", "check the signs and units"),
        (Degrees, "turns as the robot does", "psi changes by 57 times as much: psi is in rad, not in degrees"),
        (Mirrored, "turns as the robot does", "psi changes by -1 times as much: the sign"),
        (Forgetful, "forgets all at reset", "set all state in reset"),
        (Shared, "is deterministic", "keep no state in the class"),
        (Noisy, "is deterministic", "draw random numbers from a generator seeded in reset"),
        (Overwriting, "leaves its input alone", "update 1 changes 'wheel'"),
        (Removing, "leaves its input alone", "adds or removes keys"),
        (KeepingThePose, "leaves its input alone", "pose array given to reset is changed later"),
        (Unwrapped, "reads pivot counts that wrap", "wrap differences of pivot angles"),
        (NotBatched, "gives in a batch what it gives alone", "index from the last axis"),
        (ShapelessInBatch, "gives in a batch what it gives alone", r"returns shape \(3,\), not \(7, 3\)"),
    ],
)
def test_broken_plugin_is_found_out(kind, name, message):
    findings = failed(kind)
    assert name in findings
    assert re.search(message, findings[name])
    assert "\n" not in findings[name]


class WithoutPose:
    def reset(self, robot):
        self.robot = robot

    def update(self, observation):
        return np.zeros(3)


def test_a_method_with_too_few_parameters_is_shown_in_its_own_file():
    """Nothing of it ran, so that no line of it is on the way of what was raised."""
    message = failed(WithoutPose)["serves the robot"]
    assert "takes 2 positional arguments but 3 were given" in message
    assert re.search(rf"\(class WithoutPose, line \d+ of {re.escape(__file__)}\)$", message)


@pytest.mark.parametrize("kind", [Noisy, Shared])
def test_an_estimator_is_not_blamed_for_pivots_that_a_robot_lacks(kind):
    wrong = failed(kind, preset("differential"))
    assert "is deterministic" in wrong
    assert "reads pivot counts that wrap" not in wrong


@pytest.mark.parametrize("kind", [Overwriting, Removing, KeepingThePose, Forgetful, NotBatched, Wrapping])
def test_what_is_right_is_not_blamed(kind):
    assert len(failed(kind)) == 1


@pytest.mark.filterwarnings("ignore::estimators.robots.cast.SmallTurnWarning")
@pytest.mark.parametrize(
    ("spec", "robot"),
    [
        ("dead-reckoning", None),
        ("dead-reckoning", "differential"),
        ("dead-reckoning-3", "asoc-full-scale"),
        ("ipec", None),
        ("ipec-1", None),
        ("ipec-2", "asoc-full-scale"),
        ("cast", None),
        ("cast-3", None),
        ("cast-0", "6-castor"),
        ("cast-arc", None),
        ("cast-arc", "2-castor"),
    ],
)
def test_builtins_pass(spec, robot):
    findings = check(load_estimator(spec), robot and preset(robot))
    assert [finding for finding in findings if not finding.passed] == []
    assert len(findings) == 16


def test_poses_in_single_precision_pass_as_they_do_in_a_run():
    assert failed(Single) == {}


def test_a_robot_that_the_estimator_does_not_serve_is_reported():
    assert "needs at least two castors" in failed(CAST, preset("differential"))["serves the robot"]


@pytest.mark.parametrize("name", preset_names())
@pytest.mark.parametrize("drive_of", [straight, turning, winding])
def test_drives_obey_the_rolling_constraints(name, drive_of):
    """What the encoders count fits the true motion: each step's mean twist rolls the wheels so, to a count."""
    robot = preset(name)
    made = drive_of(robot)
    geometry = Geometry.of(robot)
    unwrapped = with_pivot_counts_unwrapped(robot, made.observations)
    per_rev = np.array([robot.castors[i].pivot_counts_per_rev for i in robot.pivot_encoders])
    theta = np.tile(geometry.angle, (len(made.pose), 1))
    theta[:, list(robot.pivot_encoders)] = [seen["pivot"] for seen in unwrapped] / per_rev * 2 * np.pi
    rate = np.diff(theta, axis=0) / robot.sample_period
    step = np.diff(made.pose, axis=0) / robot.sample_period
    psi = 0.5 * (made.pose[1:, 2] + made.pose[:-1, 2])
    cos, sin = np.cos(psi), np.sin(psi)
    twist = np.stack([cos * step[:, 0] + sin * step[:, 1], cos * step[:, 1] - sin * step[:, 0], step[:, 2]], axis=-1)
    middle = 0.5 * (theta[1:] + theta[:-1])
    free = castor_rates(geometry, middle, twist)
    settled = slice(20, None)  # castors that start askew turn fast at first
    quantum = 2 * np.pi / (per_rev.min() if len(per_rev) else np.inf) / robot.sample_period
    np.testing.assert_allclose(np.where(np.isnan(free), rate, free)[settled], rate[settled], atol=0.05 + 2 * quantum)
    motion = inverse(geometry, middle, rate, twist)
    driven = list(robot.driven_wheels)
    counts = motion.rate[:, driven] * robot.sample_period * geometry.counts_per_rev[driven] / (2 * np.pi)
    seen = np.array([observation["wheel"] for observation in made.observations[1:]])
    slack = 1.5 + 0.2 * quantum * robot.sample_period / geometry.radius[driven] * geometry.counts_per_rev[driven]
    assert np.all(np.abs(counts - seen)[settled] < slack)
    np.testing.assert_allclose(motion.side_slip[settled][:, geometry.standard], 0.0, atol=0.02)


def test_gyro_of_a_robot_that_has_one_is_observed():
    robot = dataclasses.replace(preset("asoc-prototype"), gyro=Gyro())
    made = turning(robot)
    assert all(seen["gyro"].shape == (1,) for seen in made.observations)
    np.testing.assert_allclose([seen["gyro"][0] for seen in made.observations], 1.0)


def test_robot_that_cannot_drive_straight_is_refused():
    robot = preset("differential")
    fixed = robot.castors[0]
    castors = (fixed, dataclasses.replace(fixed, pivot=(1.0, 0.0), angle=1.0))
    with pytest.raises(InputError, match="cannot drive ahead"):
        check(entry(Careful), dataclasses.replace(robot, castors=castors))


class ForDifferential(Careful):
    """Declines others."""

    def reset(self, robot, pose):
        if len(robot.castors) != 1:
            raise Declined("needs\none castor")
        super().reset(robot, pose)


class Misshapes(Careful):
    """Makes a mistake in `reset` that numpy finds."""

    def reset(self, robot, pose):
        super().reset(robot, pose + np.zeros(2))


def test_a_value_error_in_reset_is_a_mistake_and_no_refusal():
    assert refusal(entry(Misshapes), preset("asoc-prototype")) is None
    message = failed(Misshapes)["serves the robot"]
    assert re.match(r"reset raises ValueError: operands could not be broadcast .* \(reset, line \d+ of", message)
    assert "raise estimators.Declined with what it needs" in message


def test_a_refusal_declines_the_robot():
    assert refusal(entry(ForDifferential), preset("asoc-prototype")) == "needs one castor"
    assert refusal(entry(ForDifferential), preset("differential")) is None
    assert failed(ForDifferential) == {}
    message = failed(ForDifferential, preset("asoc-prototype"))["serves the robot"]
    assert (
        message
        == "reset declines robot 'ASOC prototype, one-third scale': needs one castor; check with one that it serves"
    )


@pytest.mark.parametrize("kind", [Choosy, RaisingInReset, Misshapes])
def test_other_errors_decline_nothing(kind):
    assert refusal(entry(kind), preset("asoc-prototype")) is None
