"""What the filter learns from redundancy, how sure it is, and what it leaves out; rolling is integrated in conftest."""

import dataclasses

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.tasks import kinematic
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.mobility import moves_sideways
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset, preset_names
from castor_envs.vehicles.robot import Contact, Gyro
from estimators import CalibratingFilter, WheelOdometry
from estimators.calibration.drives import log_of
from estimators.filtering.sample import SLIP
from estimators.plugins import drives
from estimators.robots.calibrating_filter import COVARIANCE
from estimators.steps.rolling_equations import Rows

SAMPLES = 400
"""Of 50 ms."""


def rounded(observations, random):
    """Observations with counts and readings of pivots rounded; each wheel begins anywhere within a count."""
    total = np.cumsum([seen["wheel"] for seen in observations], axis=0)
    wheel = np.diff(
        np.floor(total + random.uniform(size=total.shape[1])), axis=0, prepend=np.zeros((1, total.shape[1]))
    )
    wheel[0] = 0.0
    return [
        {**seen, "wheel": counts, "pivot": np.round(seen["pivot"])}
        for seen, counts in zip(observations, wheel, strict=True)
    ]


@pytest.fixture(scope="module", name="run")
def _run(exact_motion, winding):
    """The prototype's true poses and observations in 20 s."""
    true, observations = exact_motion(preset("asoc-prototype"), winding, 0.05 * SAMPLES).sampled(SAMPLES)
    return true, rounded(observations, np.random.default_rng(1))


def with_radius(factor):
    """The prototype as described with its first wheel's radius too large by a factor."""
    robot = preset("asoc-prototype")
    first = robot.castors[0]
    wheels = (dataclasses.replace(first.wheels[0], radius=factor * first.wheels[0].radius), *first.wheels[1:])
    return dataclasses.replace(robot, castors=(dataclasses.replace(first, wheels=wheels), *robot.castors[1:]))


def variances(estimator):
    return np.diagonal(estimator._stack.parts[COVARIANCE], axis1=-2, axis2=-1)


def farthest(path, true):
    return np.hypot(*(path - true).T[:2]).max()


def test_no_variance_is_negative_in_short_samples(exact_motion, winding):
    """At 250 Hz, where steered castors move by less than the rounding of what is known of a sample's motion before."""
    robot, estimator = preset("swerve"), CalibratingFilter()
    true, observations = exact_motion(robot, winding, 2.0).sampled(500)
    estimator.reset(robot, true[0])
    for observation in rounded(observations, np.random.default_rng(1)):
        estimator.update(observation)
        assert (variances(estimator) >= 0.0).all()


def test_a_wheel_that_is_described_too_large_is_learned(run, drive):
    true, observations = run
    robot, estimator = with_radius(1.05), CalibratingFilter()
    path = drive(estimator, robot, observations, true[0])
    radius = estimator.geometry.radius
    np.testing.assert_allclose(radius, Geometry.of(preset("asoc-prototype")).radius, rtol=2e-3)
    assert farthest(path, true) < farthest(drive(WheelOdometry(), robot, observations, true[0]), true) / 5


def test_a_calibrated_description_stays_as_it_is(run, drive):
    true, observations = run
    robot, estimator = preset("asoc-prototype"), CalibratingFilter()
    path = drive(estimator, robot, observations, true[0])
    np.testing.assert_allclose(estimator.geometry.radius, Geometry.of(robot).radius, rtol=1e-3)
    assert farthest(path, true) < 2e-3


@pytest.mark.parametrize("task", [kinematic.CALIBRATED, kinematic.UNCALIBRATED], ids=["calibrated", "uncalibrated"])
@pytest.mark.parametrize("slips", [False, True])
def test_errors_are_no_larger_than_stated(slips, task, exact_motion, winding):
    """Normalised estimation error squared at the end, over 100 descriptions of Table I. Wheels that never slip make
    them smaller than a filter that reckons with slip states; where each slips as much, they are half as large at least,
    as wheels that slip alone contradict others, and the filter finds out."""
    robot = preset("asoc-prototype")
    true, observations = exact_motion(robot, winding, 0.05 * SAMPLES).sampled(SAMPLES)
    random, rolled = np.random.default_rng(3), Rows.of(Geometry.of(robot)).way_per_count
    described = Geometry.of([task.applied(robot, random) for _ in range(100)])
    counts = np.array([seen["wheel"] for seen in observations])[:, None] + np.zeros((100, 1))
    slip = SLIP * np.sqrt(np.abs(counts) / rolled) * random.normal(size=counts.shape)
    total = np.floor(np.cumsum(counts + slips * slip, axis=0) + random.uniform(size=counts.shape[1:]))
    estimator = CalibratingFilter()
    estimator.reset(described, np.tile(true[0], (100, 1)))
    for seen, wheel in zip(observations, np.diff(total, axis=0, prepend=total[:1]), strict=True):
        pivot, time = (np.tile(values, (100, 1)) for values in (np.round(seen["pivot"]), seen["time"]))
        estimator.update({"wheel": wheel, "pivot": pivot, "time": time})
    off = estimator.pose - true[-1]
    squares = np.einsum("ki,kij,kj->k", off, np.linalg.inv(estimator.covariance), off)
    assert squares.sum() < chi2.ppf(0.995, 300)
    if slips:
        assert squares.sum() > chi2.ppf(0.005, 300) / 2


def test_errors_are_stated_in_the_axes_of_the_world(run, drive):
    _, observations = run
    covariances = []
    for psi in (0.0, 1.0):
        estimator = CalibratingFilter()
        drive(estimator, preset("asoc-prototype"), observations, (1.0, 2.0, psi))
        covariances.append(estimator.covariance)
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(1.0), -np.sin(1.0)], [np.sin(1.0), np.cos(1.0)]]
    np.testing.assert_allclose(covariances[1], turn @ covariances[0] @ turn.T, rtol=1e-6, atol=1e-15)
    assert np.linalg.eigvalsh(covariances[0]).min() > 0


def test_a_wheel_on_a_bump_is_released(run, drive):
    """It rolls 4 mm more than the floor is long, in a third of a second."""
    true, observations = run
    counts = 0.004 / (2 * np.pi * 0.0381) * 1200 / 7
    bumped = [
        {**seen, "wheel": seen["wheel"] + np.round(counts) * (np.arange(6) == 2) * (150 <= k < 157)}
        for k, seen in enumerate(observations)
    ]
    robot, ends = preset("asoc-prototype"), {}
    for kind in (CalibratingFilter, WheelOdometry):
        even, bumpy = (drive(kind(), robot, seen, true[0])[-1] for seen in (observations, bumped))
        ends[kind] = np.abs(bumpy - even)[2]
    assert ends[CalibratingFilter] < ends[WheelOdometry] / 5


def test_measurements_of_rolling_wheels_are_hardly_released(run):
    """Of normal residuals one in 370 is beyond the gate."""
    true, observations = run
    estimator, released = CalibratingFilter(), []
    estimator.reset(preset("asoc-prototype"), true[0])
    for observation in observations:
        estimator.update(observation)
        released.append(estimator.released[0])  # of the filter that takes the description as calibrated
    assert np.mean(released) < 1e-3


def test_only_what_bumps_is_released(run):
    """The third wheel reads 4 mm more than the floor is long within one sample."""
    true, observations = run
    estimator = CalibratingFilter()
    estimator.reset(preset("asoc-prototype"), true[0])
    for observation in observations[:150]:
        estimator.update(observation)
    counts = round(0.004 / (2 * np.pi * 0.0381) * 1200)
    estimator.update({**observations[150], "wheel": observations[150]["wheel"] + counts * (np.arange(6) == 2)})
    np.testing.assert_array_equal(np.flatnonzero(estimator.released[0]), [2])


@pytest.mark.parametrize("errors", [kinematic.CALIBRATED, kinematic.UNCALIBRATED], ids=["calibrated", "uncalibrated"])
@pytest.mark.parametrize("name", preset_names())
def test_no_preset_is_followed_worse_than_without_learning(name, errors):
    """Half a minute of wandering with six descriptions that are off as in Table I, and the mean of what odometry is
    off at the farthest."""
    truth, random = preset(name), np.random.default_rng(5)
    path = wander(np.random.default_rng(2), duration=30.0, holonomic=moves_sideways(truth))
    log = log_of(truth, path, "all")
    assert log.reference is not None
    described, off = Geometry.of([errors.applied(truth, random) for _ in range(6)]), []
    for estimator in (CalibratingFilter(), WheelOdometry()):
        estimator.reset(described, np.tile(log.reference[0], (6, 1)))
        seen = [{of: np.tile(values, (6, 1)) for of, values in sample.items()} for sample in log.observations()]
        poses = np.array([estimator.update(sample) for sample in seen]) - log.reference[:, None]
        off.append(np.hypot(poses[..., 0], poses[..., 1]).max(axis=0).mean())
    assert off[0] < 1.1 * off[1] + 1e-3


def test_a_gyro_tells_a_differential_robot_how_far_it_turns(exact_motion, drive):
    """The track is described 3 % too large. The gyro's bias, half a degree per second, shows while the robot stands: as
    it drives, one wheel larger than the other would have the same effect."""
    truth, bias, noise = preset("differential"), 0.009, 0.002

    def turning(t):
        begins = 1.0 / (1.0 + np.exp(-10.0 * (t - 6.0)))
        return 0.3 * begins, 0.0, 0.8 * np.sin(0.5 * (t - 6.0)) * begins

    true, observations = exact_motion(truth, turning, 60.0).sampled(1200)
    random = np.random.default_rng(7)
    times = np.array([seen["time"] for seen in observations])
    rate = turning(times)[2] + bias + noise * random.normal(size=times.shape)
    seen = [{**sample, "gyro": reading} for sample, reading in zip(rounded(observations, random), rate, strict=True)]
    castor = truth.castors[0]
    wheels = tuple(dataclasses.replace(wheel, lateral=1.03 * wheel.lateral) for wheel in castor.wheels)
    described = dataclasses.replace(
        truth, castors=(dataclasses.replace(castor, wheels=wheels),), gyro=Gyro(noise=noise)
    )
    estimator = CalibratingFilter()
    learned, plain = (drive(kind, described, seen, true[0]) for kind in (estimator, WheelOdometry()))
    assert np.abs(learned - true)[:, 2].max() < np.abs(plain - true)[:, 2].max() / 5
    assert estimator.gyro_bias == pytest.approx(bias, abs=5e-4)
    track, radius = np.ptp(estimator.geometry.lateral), np.mean(estimator.geometry.radius)
    assert track / radius == pytest.approx(0.34 / 0.075, rel=3e-3)  # all that turns show


def with_gyro(robot, noise=1e-3):
    return dataclasses.replace(robot, gyro=Gyro(noise=noise))


def read_by_gyro(observations, rate):
    return [{**seen, "gyro": np.array([w])} for seen, w in zip(observations, rate, strict=True)]


def test_stacked_robots_read_their_gyros_as_single_ones_do(exact_motion, drive):
    robot = with_gyro(preset("asoc-prototype"))
    _, observations = exact_motion(robot, lambda t: (0.3, 0.0, 0.5), 5.0).sampled(100)
    seen = [read_by_gyro(observations, np.full(len(observations), 0.5 + bias)) for bias in (0.0, 0.05)]
    single = np.stack([drive(CalibratingFilter(), robot, of, np.zeros(3)) for of in seen], axis=1)
    stacked = [{part: np.stack([one[part] for one in both]) for part in both[0]} for both in zip(*seen, strict=True)]
    together = drive(CalibratingFilter(), Geometry.of([robot, robot]), stacked, np.zeros((2, 3)))
    np.testing.assert_allclose(together, single, atol=1e-9)
    assert np.abs(single[-1, 0] - single[-1, 1]).max() > 1e-6  # a gyro that is read makes a difference


def test_where_either_wheel_may_slip_neither_is_preferred(exact_motion, drive):
    """Of two wheels and a gyro any may be wrong: slip of the left wheel and of the right give mirrored estimates."""
    robot = with_gyro(preset("differential"))
    _, observations = exact_motion(robot, lambda t: (0.3, 0.0, 0.0), 5.0).sampled(100)
    ends = []
    for wheel in (0, 1):
        seen = read_by_gyro(observations, np.zeros(len(observations)))
        for k in range(40, 50):
            seen[k] = {**seen[k], "wheel": seen[k]["wheel"] + 40.0 * (np.arange(2) == wheel)}
        ends.append(drive(CalibratingFilter(), robot, seen, np.zeros(3))[-1])
    np.testing.assert_allclose(ends[0], ends[1] * [1.0, -1.0, -1.0], atol=1e-9)
    assert abs(ends[0][2]) < 0.02  # the gyro tells the heading, of which 400 counts would make 0.28 rad


def test_what_no_redundancy_shows_is_not_learned(drive):
    """Of a differential robot whose contacts do not creep the filter is odometry."""
    stiff = Contact(slip_stiffness_long=1e6, slip_stiffness_lat=1e6)
    robot = dataclasses.replace(preset("differential"), contact=stiff)
    log = log_of(robot, wander(np.random.default_rng(2), duration=30.0, holonomic=False), "all")
    observations = list(log.observations())
    learned, plain = (drive(kind(), robot, observations) for kind in (CalibratingFilter, WheelOdometry))
    np.testing.assert_allclose(learned, plain, atol=1e-6)


def test_a_robot_that_stands_still_gets_no_surer(run, drive):
    true, observations = run
    estimator = CalibratingFilter()
    drive(estimator, preset("asoc-prototype"), observations, true[0])
    pose, covariance = estimator.pose, estimator.covariance
    for _ in range(50):
        estimator.update({**observations[-1], "wheel": 0 * observations[-1]["wheel"]})
    np.testing.assert_array_equal(estimator.pose, pose)
    np.testing.assert_array_equal(estimator.covariance, covariance)


def test_perfectly_rolling_wheels_turn_out_not_to_creep(run, drive):
    """The description says that they do under forces, once as much as it states; that is unlearned."""
    true, observations = run
    estimator = CalibratingFilter()
    estimator.reset(preset("asoc-prototype"), true[0])
    assert estimator.compliance == 1.0
    drive(estimator, preset("asoc-prototype"), observations, true[0])
    assert abs(estimator.compliance) < 0.5


@pytest.mark.parametrize("name", ["differential", "asoc-prototype", "omnimate", "swerve", "powered-caster"])
@pytest.mark.parametrize("samples", [10, 20, 40])
def test_a_gap_makes_it_as_unsure_as_the_path_in_it_is_unknown(name, samples):
    """Half a second to two without a sample, anywhere in a drive, and a few samples behind it: the normalised
    estimation error squared is hardly larger than its three degrees of freedom."""
    robot = preset(name)
    whole = drives.winding(robot)
    counts, squares = np.cumsum([seen["wheel"] for seen in whole.observations], axis=0), []
    for first in range(21, 240 - samples - 11, 20):
        rows = np.r_[first - 20 : first, first + samples : first + samples + 10]
        estimator = CalibratingFilter()
        estimator.reset(robot, whole.pose[rows[0]])
        for row, wheel in zip(rows, np.diff(counts[rows], axis=0, prepend=counts[rows[:1]]), strict=True):
            estimator.update({**whole.observations[row], "wheel": wheel})
        off = estimator.pose - whole.pose[rows[-1]]
        squares.append(off @ np.linalg.solve(estimator.covariance, off))
    assert np.mean(squares) < 4.5


@pytest.mark.parametrize("name", ["asoc-prototype", "differential", "swerve", "powered-caster"])
@pytest.mark.parametrize(
    "held_back",
    [
        lambda k, t: np.floor(k / 5) * 0.25 + (k % 5) * 1e-3,
        lambda k, t: np.floor(k / 2) * 0.1 + (k % 2) * 1e-6,
        lambda k, t: t - 0.2 * (k == 100),
    ],
    ids=["five a millisecond apart", "pairs a microsecond apart", "one that goes back"],
)
def test_stamps_of_samples_that_were_sent_at_once_change_nothing(name, held_back):
    """Counts are those of even samples; what stamps would tell of accelerations is not to be believed."""
    robot, stamped = preset(name), CalibratingFilter()
    whole, even = drives.winding(robot), CalibratingFilter()
    for estimator in (stamped, even):
        estimator.reset(robot, np.zeros(3))
    for k, seen in enumerate(whole.observations):
        late = stamped.update({**seen, "time": np.array([held_back(k, 0.05 * k)])})
        np.testing.assert_allclose(late, even.update(seen), atol=2e-5)


@pytest.mark.parametrize("name", ["differential", "swerve", "powered-caster"])
def test_no_force_is_larger_than_friction_however_stamps_jitter(name):
    """By a fifth of the period: contacts would creep by what accelerations of tens of m/s2 need."""
    robot, random = preset(name), np.random.default_rng(0)
    whole, off = drives.winding(robot), []
    for _ in range(5):
        time = np.sort(0.05 * np.arange(len(whole.pose)) + 0.01 * random.normal(size=len(whole.pose)))
        seen = [{**one, "time": time[k : k + 1]} for k, one in enumerate(whole.observations)]
        estimator = CalibratingFilter()
        estimator.reset(robot, np.zeros(3))
        off.append(farthest(np.array([estimator.update(one) for one in seen]), whole.pose))
    assert np.mean(off) < (1.5e-2 if name == "differential" else 2e-3)


@pytest.mark.parametrize("name", ["asoc-prototype", "swerve", "powered-caster"])
@pytest.mark.parametrize("counts", [1000.0, 2.0**16, 2.0**32])
def test_a_counter_that_jumps_is_released_by_as_much_as_it_jumps(name, counts):
    """On robots with five equations or more for three degrees of freedom; the filter is linear about the rest."""
    robot, estimator = preset(name), CalibratingFilter()
    whole = drives.winding(robot)
    seen = [{**one, "wheel": one["wheel"].copy()} for one in whole.observations]
    seen[100]["wheel"][0] += counts
    estimator.reset(robot, np.zeros(3))
    assert farthest(np.array([estimator.update(one) for one in seen]), whole.pose) < 1.5e-3


def test_a_counter_that_jumps_wears_no_wheel(drive):
    """Radii wear with the way that wheels roll, and a counter that wraps has rolled none of it."""
    robot, deviations = preset("asoc-prototype"), []
    whole = drives.winding(robot)
    for counts in (0.0, 2.0**32):
        seen = [{**one, "wheel": one["wheel"].copy()} for one in whole.observations]
        seen[100]["wheel"][0] += counts
        estimator = CalibratingFilter()
        drive(estimator, robot, seen, np.zeros(3))
        deviations.append(np.sqrt(variances(estimator)[..., estimator._at.radius.start]))
    np.testing.assert_allclose(deviations[1], deviations[0], rtol=0.01)
