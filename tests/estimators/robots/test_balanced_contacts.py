"""What the filter takes from wheels that motors drive against each other: what they show of it, and of those of swerves
nothing but how they move the robot."""

import math

import numpy as np
import pytest

from benchmarks.scoring.registry import score
from benchmarks.tasks.driving.task import KINDS, DrivenRobot
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.presets import preset
from estimators import CalibratingFilter, WheelOdometry
from estimators.filtering import creep
from estimators.filtering.creep import (
    ARM,
    FREE_X,
    HOLD,
    OF_CASTOR,
    OF_NUMBERS,
    ROWS,
    YIELD,
    YIELDING,
    balanced,
    shown,
)
from estimators.robots.calibrating_filter import COVARIANCE
from estimators.steps.rolling_equations import ROW

SEEDS = range(930_000, 930_002)


def drawn(*size):
    return np.random.default_rng(5).standard_normal(size)


CASTOR = np.array([0, 0, 1, 1, 2, 2, 0, 1])
"""Of eight contacts, whose they are."""


def balance(moves, stiffness, disagreeing, swings=None, shown=0.0):
    """Balance disagreements (m, c) of contacts that move by moves (m, 3) and by swings (m,) as their castors swivel.

    Returns what readings show, the covariance (m, m) of the creep if each disagreement has the variance of its number,
    1 to c, and the creep of numbers 1 to c.
    """
    (m, c), compliance = disagreeing.shape, 1.0 / stiffness
    rows, found, held = np.zeros((1, m), ROW).view(np.recarray), np.zeros((ROWS, m)), np.zeros((OF_CASTOR, 3))
    rows["castor"] = CASTOR
    found[YIELD], small = compliance, np.zeros((4, 3))
    found[FREE_X : FREE_X + 3], normal = moves.T, moves.T @ (stiffness[:, None] * moves)
    if swings is not None:
        on = np.equal.outer(np.arange(3), CASTOR)
        found[ARM], held[HOLD] = -swings, on @ (swings**2 * stiffness)
        held[:3] = (on @ ((swings * stiffness)[:, None] * moves)).T
        found[FREE_X : FREE_X + 3] -= swings * (held[:3] / held[HOLD])[:, CASTOR]
        normal = normal - held[:3] / held[HOLD] @ held[:3].T
    small[:3] = np.linalg.inv(normal)
    carry, slack, numbers = disagreeing.T.copy(), np.full((m + 2, m), np.nan), np.arange(1.0, c + 1)
    balanced(carry, 0, c, rows, 0, 0, found, held, small, shown, numbers, np.diag(numbers), slack)
    return carry.T, slack[:m], slack[m + OF_NUMBERS]


def left_of(moves, stiffness, disagreeing, swings=None):
    """What is left of disagreements (m, c)."""
    return balance(moves, stiffness, disagreeing, swings)[0]


def test_forces_of_the_creep_that_is_taken_off_balance():
    moves, stiffness, disagreeing = drawn(8, 3), np.exp(drawn(8)), drawn(8, 5)
    creep = disagreeing - left_of(moves, stiffness, disagreeing)
    np.testing.assert_allclose(np.einsum("mp,m,mc->pc", moves, stiffness, creep), 0.0, atol=1e-10)


def test_moments_about_pivots_that_the_floor_turns_balance_too():
    moves, stiffness, disagreeing, swings = drawn(8, 3), np.exp(drawn(8)), drawn(8, 5), 1.0 + drawn(8) ** 2
    creep = disagreeing - left_of(moves, stiffness, disagreeing, swings)
    np.testing.assert_allclose(np.einsum("mp,m,mc->pc", moves, stiffness, creep), 0.0, atol=1e-10)
    for castor in range(3):
        at = castor == CASTOR
        np.testing.assert_allclose((swings * stiffness)[at] @ creep[at], 0.0, atol=1e-10)


def test_wheels_that_agree_do_not_creep():
    moves = drawn(8, 3)
    agreeing = moves @ drawn(3, 5)
    np.testing.assert_allclose(left_of(moves, np.exp(drawn(8)), agreeing), agreeing, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("swivelling", [False, True])
def test_creep_loses_the_least_power(swivelling):
    """Of all motions of the body and swivels, that whose contacts lose the least: a derivation that knows no forces."""
    moves, stiffness, disagreeing, swings = drawn(8, 3), np.exp(drawn(8)), drawn(8, 1), 1.0 + drawn(8) ** 2
    free = np.hstack([moves, swings[:, None] * np.equal.outer(CASTOR, np.arange(3))]) if swivelling else moves
    root = np.sqrt(stiffness)[:, None]
    found, *_ = np.linalg.lstsq(root * free, root * disagreeing, rcond=None)
    left = left_of(moves, stiffness, disagreeing, swings if swivelling else None)
    np.testing.assert_allclose(left, free @ found, rtol=1e-9)


def test_the_covariance_of_the_creep_is_that_of_what_is_taken_off():
    moves, stiffness, disagreeing = drawn(8, 3), np.exp(drawn(8)), drawn(8, 5)
    left, slack, creep = balance(moves, stiffness, disagreeing)
    off = disagreeing - left
    np.testing.assert_allclose(slack, (off * np.arange(1.0, 6.0)) @ off.T, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(creep, off @ np.arange(1.0, 6.0), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("part", [0.3, 1.0])
def test_motors_that_give_way_show_their_part_of_the_creep(part):
    moves, stiffness, disagreeing = drawn(8, 3), np.exp(drawn(8)), drawn(8, 5)
    none, _, _ = balance(moves, stiffness, disagreeing)
    some, _, _ = balance(moves, stiffness, disagreeing, shown=part)
    np.testing.assert_allclose(some, none + part * (disagreeing - none), rtol=1e-9, atol=1e-12)


def test_motors_give_way_by_all_that_is_beyond_their_torque():
    """Regressed on disagreements that are drawn, what clipped creep leaves of them."""
    geometry = Geometry.of(preset("asoc-prototype"))
    load = 9.81 * (geometry.mass + geometry.castor_mass.sum()) / len(geometry.radius)
    most = geometry.max_wheel_torque / geometry.radius[0] / (load * geometry.slip_stiffness[0])
    assert shown(geometry, 1e-3 * most) == pytest.approx(YIELDING, abs=1e-12)
    assert shown(geometry, math.inf) == 1.0
    disagreement = 1.5 * most
    drawn_ones = disagreement * np.random.default_rng(3).standard_normal(200_000)
    crept = (1.0 - YIELDING) * np.clip(drawn_ones, -most, most)
    given_way = drawn_ones - crept
    assert shown(geometry, disagreement) == pytest.approx(drawn_ones @ given_way / (drawn_ones @ drawn_ones), abs=5e-3)


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


@pytest.fixture(scope="module")
def driven_prototypes():
    """The same of the prototype, whose castors the floor turns."""
    kind = next(kind for kind in KINDS if kind.name == "drawings")
    return [DrivenRobot(kind, "prototype").record(seed) for seed in range(930_000, 930_004)]


def followed(estimator, episode):
    run = episode.runs[0]
    estimator.reset(episode.robot, run.start)
    rows = [(estimator.update(seen), getattr(estimator, "covariance", None)) for seen in run.log.observations()]
    return [np.array([row[k] for row in rows])[run.samples] for k in (0, 1)]


def judged(estimator, episodes):
    """The ATE of each drive, m, and its mean squared error over the covariance."""
    ates, ratios = [], []
    for episode in episodes:
        poses, covariance = followed(estimator(), episode)
        run = episode.runs[0]
        error = (poses - run.log.reference[run.samples])[1:]
        error[:, 2] = (error[:, 2] + np.pi) % (2 * np.pi) - np.pi
        unlike = np.einsum("ki,ki->k", error, np.linalg.solve(covariance[1:], error[..., None])[..., 0])
        ratios.append(unlike.mean() / 3)
        ates.append(score(episode, [poses])["ate"])
    return ates, ratios


def test_on_swerves_as_on_drawings_the_filter_knows_how_sure_it_is(driven):
    """The mean squared error over the covariance would be 1; it was 220 where agreement was believed."""
    ates, ratios = judged(CalibratingFilter, driven)
    odometry = [score(episode, [followed(WheelOdometry(), episode)[0]])["ate"] for episode in driven]
    assert np.mean(ratios) < 3.0
    assert np.mean(ates) < 1.05 * np.mean(odometry)


def test_a_robot_as_on_drawings_is_learned_by_what_its_motors_give_way(driven_prototypes, monkeypatch):
    """Who takes counts to show all that wheels disagree by learns wrong dimensions and is too sure of them."""
    ates, ratios = judged(CalibratingFilter, driven_prototypes)
    monkeypatch.setattr(creep, "YIELDING", 1.0)
    believing, more = judged(CalibratingFilter, driven_prototypes)
    assert np.mean(ates) < 0.5 * np.mean(believing)
    assert np.mean(ratios) < 0.2 * np.mean(more)
