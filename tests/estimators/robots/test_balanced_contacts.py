"""What the filter takes from wheels that motors steer and drive against each other: nothing but how they move the
robot."""

import numpy as np
import pytest

from benchmarks.scoring.registry import score
from benchmarks.tasks.driving.task import KINDS, DrivenRobot
from castor_envs.vehicles.presets import preset
from estimators import CalibratingFilter, WheelOdometry
from estimators.filtering.creep import balanced
from estimators.robots.calibrating_filter import COVARIANCE

SEEDS = range(930_000, 930_002)


def drawn(*size):
    return np.random.default_rng(5).standard_normal(size)


def balance(moves, stiffness, disagreeing):
    """What is left of disagreements (m, c) of contacts that move by moves (m, 3), and the covariance (m, m) of the
    creep that is taken off if each disagreement has the variance of its number, 1 to c."""
    carry, slack = disagreeing.T.copy(), np.full((len(moves) + 1, len(moves)), np.nan)
    variances = np.diag(np.arange(1.0, len(carry) + 1))
    balanced(carry, 0, len(carry), moves.T.copy(), 0, 1.0 / stiffness, np.zeros((4, 3)), variances, slack)
    return carry.T, slack[:-1]


def left_of(moves, stiffness, disagreeing):
    """What is left of disagreements (m, c) of contacts that move by moves (m, 3)."""
    return balance(moves, stiffness, disagreeing)[0]


def test_forces_of_the_creep_that_is_taken_off_balance():
    moves, stiffness, disagreeing = drawn(8, 3), np.exp(drawn(8)), drawn(8, 5)
    creep = disagreeing - left_of(moves, stiffness, disagreeing)
    np.testing.assert_allclose(np.einsum("mp,m,mc->pc", moves, stiffness, creep), 0.0, atol=1e-10)


def test_wheels_that_agree_do_not_creep():
    moves = drawn(8, 3)
    agreeing = moves @ drawn(3, 5)
    np.testing.assert_allclose(left_of(moves, np.exp(drawn(8)), agreeing), agreeing, rtol=1e-9, atol=1e-10)


def test_creep_loses_the_least_power():
    """Of all motions, that whose contacts lose the least: a derivation that knows no forces."""
    moves, stiffness, disagreeing = drawn(8, 3), np.exp(drawn(8)), drawn(8, 1)
    root = np.sqrt(stiffness)[:, None]
    found, *_ = np.linalg.lstsq(root * moves, root * disagreeing, rcond=None)
    np.testing.assert_allclose(left_of(moves, stiffness, disagreeing), moves @ found, rtol=1e-9)


def test_the_covariance_of_the_creep_is_that_of_what_is_taken_off():
    moves, stiffness, disagreeing = drawn(8, 3), np.exp(drawn(8)), drawn(8, 5)
    left, slack = balance(moves, stiffness, disagreeing)
    off = disagreeing - left
    np.testing.assert_allclose(slack, (off * np.arange(1.0, 6.0)) @ off.T, rtol=1e-9, atol=1e-12)


def test_of_a_swerve_no_radius_is_learned_from_agreement(exact_motion, winding, drive):
    """Wheels that agree with the description for 5 s: they do, as commanded by it, whatever the true radii are. Who
    believes them knows each radius ten times as well."""
    robot = preset("swerve")
    true, observations = exact_motion(robot, winding, 5.0).sampled(100)
    estimator = CalibratingFilter()
    drive(estimator, robot, observations, true[0])
    prior = CalibratingFilter()
    prior.reset(robot, true[0])
    learned, before = (
        np.diagonal(of._stack.parts[COVARIANCE], axis1=-2, axis2=-1)[..., 0, of._at.radius] for of in (estimator, prior)
    )
    assert (learned > 0.95 * before).all()


@pytest.fixture(scope="module", name="driven")
def _driven():
    """Manoeuvres of swerves in physics, described as on drawings."""
    kind = next(kind for kind in KINDS if kind.name == "drawings")
    return [DrivenRobot(kind, "swerve").record(seed) for seed in SEEDS]


def followed(estimator, episode):
    run = episode.runs[0]
    estimator.reset(episode.robot, run.start)
    rows = [(estimator.update(seen), getattr(estimator, "covariance", None)) for seen in run.log.observations()]
    return [np.array([row[k] for row in rows])[run.samples] for k in (0, 1)]


def test_on_swerves_as_on_drawings_the_filter_knows_how_sure_it_is(driven):
    """The mean squared error over the covariance would be 1; it was 220 where agreement was believed."""
    ratios, ates = [], []
    for episode in driven:
        poses, covariance = followed(CalibratingFilter(), episode)
        odometry, _ = followed(WheelOdometry(), episode)
        run = episode.runs[0]
        error = (poses - run.log.reference[run.samples])[1:]
        error[:, 2] = (error[:, 2] + np.pi) % (2 * np.pi) - np.pi
        unlike = np.einsum("ki,ki->k", error, np.linalg.solve(covariance[1:], error[..., None])[..., 0])
        ratios.append(unlike.mean() / 3)
        ates.append([score(episode, [path])["ate"] for path in (poses, odometry)])
    assert np.mean(ratios) < 3.0
    mean = np.mean(ates, axis=0)
    assert mean[0] < 1.05 * mean[1]
