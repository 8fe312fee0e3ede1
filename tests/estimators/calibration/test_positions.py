# pyright: reportOptionalMemberAccess=false, reportOptionalOperand=false, reportArgumentType=false

"""Calibration from positions without headings: against the same drives with headings, and in any frame."""

import dataclasses

import numpy as np
import pytest

from castor_envs.errors import InputError
from castor_envs.geometry.se2 import compose
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import umbmark, wander
from castor_envs.vehicles.presets import preset
from estimators.calibration.likelihood_method import MaximumLikelihoodMethod
from estimators.calibration.maximum_likelihood.calibrate import calibrate
from estimators.calibration.maximum_likelihood.tracker import mount_prior
from estimators.calibration.parameters import values_of
from estimators.calibration.protocol import Recording
from estimators.likelihood.log_likelihood import LogLikelihood, Noise

POSITION, HEADING, POINT = 3e-3, 5e-3, (0.15, -0.1, 0.02)
"""m, rad: errors of the reference; m, m, rad: the tracked point."""

NOISE = Noise(position=POSITION, heading=HEADING)


def driven(name, trajectory, every=8, seed=0):
    """A robot, the same with a left wheel 2 % larger on castor 1 and wheels 1 % further apart, and a log of its drive
    by perfect rolling, with rounded counts and poses every so many rows."""
    robot = preset(name)
    wheels = [dataclasses.replace(wheel, lateral=1.01 * wheel.lateral) for wheel in robot.castors[0].wheels]
    wheels[0] = dataclasses.replace(wheels[0], radius=1.02 * wheels[0].radius)
    first = dataclasses.replace(robot.castors[0], wheels=tuple(wheels))
    built = dataclasses.replace(robot, castors=(first, *robot.castors[1:]))
    rolled, random = roll(built, trajectory), np.random.default_rng(seed)
    turns = np.array([wheel.counts_per_rev for wheel in robot.wheels]) / (2 * np.pi)
    pivots = np.array([robot.castors[i].pivot_counts_per_rev for i in robot.pivot_encoders], float) / (2 * np.pi)
    zeros = np.array([robot.castors[i].pivot_zero for i in robot.pivot_encoders])
    reference = compose(rolled.pose, POINT) + random.normal(size=rolled.pose.shape) * [POSITION, POSITION, HEADING]
    reference[np.arange(len(reference)) % every != 0] = np.nan
    log = Log(
        t=rolled.t,
        wheel=np.round(rolled.wheel_angle * turns),
        pivot=np.round((rolled.castor_angle[:, list(robot.pivot_encoders)] + zeros) * pivots),
        reference=reference,
    )
    return robot, built, log


def headless(log, world=(0.0, 0.0, 0.0)):
    """The log with positions alone, in another world."""
    return dataclasses.replace(log, reference=compose(world, log.reference) * [1.0, 1.0, np.nan])


DRIVES = {
    "differential, wander": ("differential", wander(np.random.default_rng(1), holonomic=False)),
    "differential, square": ("differential", umbmark(side=2.0)),
    "two castors": ("asoc-prototype", wander(np.random.default_rng(2))),
}


@pytest.fixture(scope="module", params=DRIVES)
def drive(request):
    return driven(*DRIVES[request.param])


def test_numbers_are_those_found_with_headings_and_as_they_were_built(drive):
    robot, built, log = drive
    with_headings, found = calibrate(robot, [log]), calibrate(robot, [headless(log)])
    true, errors = values_of(Geometry.of(built), found.parameters), found.standard_errors
    seen = errors > 0
    assert np.all(np.abs(found.after - true)[seen] < 4 * errors[seen] + 1e-9)
    apart = np.abs(found.after - with_headings.after)
    assert np.all(apart <= 3 * np.hypot(errors, with_headings.standard_errors) + 1e-9)
    np.testing.assert_allclose(found.mount[:2], POINT[:2], atol=4 * found.mount_errors[:2].max())


def test_positions_alone_tell_less_than_poses(drive):
    """At known noise: no parameter, and no combination of them, is known better."""
    robot, _, log = drive
    with_headings, found = calibrate(robot, [log], noise=NOISE), calibrate(robot, [headless(log)], noise=NOISE)
    size = np.linalg.eigvalsh(with_headings.information).max()
    assert np.linalg.eigvalsh(with_headings.information - found.information).min() > -1e-3 * size
    assert np.all(found.standard_errors >= 0.99 * with_headings.standard_errors)
    assert np.any(found.standard_errors > 1.005 * with_headings.standard_errors)


def test_the_world_of_the_reference_does_not_matter(drive):
    robot, _, log = drive
    found = [calibrate(robot, [headless(log, world)], noise=NOISE) for world in ((0, 0, 0), (50.0, -30.0, 2.5))]
    np.testing.assert_allclose(found[1].after, found[0].after, atol=0.02 * found[0].standard_errors.max())
    np.testing.assert_allclose(found[1].mount, found[0].mount, atol=1e-4)
    np.testing.assert_allclose(found[1].covariance, found[0].covariance, rtol=0.02, atol=1e-12)


def test_the_axes_of_a_tracker_without_headings_do_nothing(drive):
    robot, _, log = drive
    found = calibrate(robot, [headless(log)])
    assert found.headings == 0
    assert found.mount[2] == 0.0
    assert found.mount_errors[2] == pytest.approx(mount_prior(Geometry.of(robot))[2])
    assert found.noise.heading == pytest.approx(Noise().heading)
    assert not found.mount_seen[2]


def evidence(robot, log, noise, turned=0.0):
    geometry = Geometry.of(robot)
    model = LogLikelihood(geometry, log)
    state = LogLikelihood(geometry, headless(log)).start(geometry)
    mount = np.array([*POINT[:2], turned])
    return model.reduce(geometry, geometry, np.zeros(0), state, np.zeros(2), mount, noise).log_evidence()


def test_headings_that_tell_nothing_add_no_more_than_their_density(drive):
    """The evidence of positions is that of poses whose headings are known to 1000 rad, over these headings' density."""
    robot, _, log = drive
    vague = Noise(heading=1e3)
    used = LogLikelihood(Geometry.of(robot), log).poses_used
    expected = evidence(robot, log, vague) + used * np.log(vague.heading)
    assert evidence(robot, headless(log), vague) == pytest.approx(expected, abs=0.02)
    plain = evidence(robot, headless(log), Noise())
    assert evidence(robot, headless(log), Noise(heading=1.0), turned=0.3) == pytest.approx(plain, abs=1e-6)


def test_some_headings_tell_more_than_none_and_less_than_all(drive):
    robot, _, log = drive
    some = log.reference.copy()
    some[:: 2 * 8, 2] = np.nan
    logs = headless(log), dataclasses.replace(log, reference=some), log
    errors = [calibrate(robot, [each], noise=NOISE).standard_errors for each in logs]
    assert np.all(errors[1] <= 1.01 * errors[0])
    assert np.all(errors[2] <= 1.01 * errors[1])


def test_the_report_says_what_positions_leave_open():
    robot, _, log = driven(*DRIVES["differential, wander"])
    report = MaximumLikelihoodMethod().report(robot, [Recording(headless(log))])
    text = "\n".join(report.remarks)
    assert "without headings" in text
    assert "turned and moved to fit the positions best" in text
    assert "turned by" not in text
    assert report.more["mount"]["psi_rad"] is None
    assert report.more["reference_noise"]["heading_rad"] is None


def test_a_robot_that_turns_on_the_spot_below_its_receiver_is_refused_in_words():
    robot, _, log = driven(*DRIVES["differential, wander"])
    still = log.reference * 0 + [1.0, 2.0, np.nan]
    counts = np.arange(len(log))[:, None] * [-20, 20]

    with pytest.raises(InputError, match="the logs"):
        calibrate(robot, [dataclasses.replace(log, wheel=counts, reference=still)])
