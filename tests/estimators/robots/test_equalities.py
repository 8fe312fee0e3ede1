"""Where theory says that two algorithms, or an algorithm and its equations, are equal."""

import copy
import dataclasses
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.presets import n_castor, preset
from estimators import CAST, IPEC, CASTArc, DeadReckoning
from estimators.robots.cast import centred_solution, design_matrix, normal_inverse
from estimators.steps.castor_odometry import CastorSteps, Step, castor_records, castor_steps

pytestmark = pytest.mark.filterwarnings("ignore::estimators.robots.cast.SmallTurnWarning")

lengths = st.floats(-1.0, 1.0)
angles = st.floats(-10.0, 10.0)


def moved(records, observation, step: Step = "arc"):
    """Return the steps of a robot's castors, each part (n,)."""
    steps = castor_steps(records[None], observation["wheel"][None], observation["pivot"][None], step)
    return CastorSteps(*(part[0] for part in steps))


@st.composite
def layouts(draw):
    """Pivots (n, 2) well apart, anywhere about the origin."""
    n = draw(st.integers(2, 6))
    corners = np.exp(2j * np.pi * np.arange(n) / n).view(float).reshape(n, 2)
    shaken = corners + 0.3 * draw(arrays(float, (n, 2), elements=lengths))
    return draw(st.floats(0.2, 2.0)) * shaken + draw(arrays(float, 2, elements=lengths))


@given(layouts(), angles, st.data())
def test_closed_form_of_eq_18_solves_the_least_squares_of_eq_15(pivot, psi, data):
    n = len(pivot)
    y = data.draw(arrays(float, 2 * n, elements=lengths))
    radius, phi = np.hypot(*pivot.T), np.arctan2(pivot[:, 1], pivot[:, 0])
    h = np.zeros((2 * n, 3))  # eq. 17 as printed
    h[:n, 0], h[:n, 2] = 1.0, -radius * np.sin(psi + phi)
    h[n:, 1], h[n:, 2] = 1.0, radius * np.cos(psi + phi)
    np.testing.assert_allclose(design_matrix(pivot, psi), h, atol=1e-12)
    expected = np.linalg.lstsq(h, y, rcond=None)[0]
    np.testing.assert_allclose(normal_inverse(pivot, psi) @ h.T @ y, expected, atol=1e-9)


@given(st.integers(2, 6), st.floats(0.1, 1.0), angles, angles, st.data())
def test_eq_22_is_eq_15_for_equal_radii_about_the_centroid(n, radius, turned, psi, data):
    pivot = radius * np.exp(1j * (2 * np.pi * np.arange(n) / n + turned)).view(float).reshape(n, 2)
    x, y = data.draw(arrays(float, (2, n), elements=lengths))
    general = normal_inverse(pivot, psi) @ design_matrix(pivot, psi).T @ np.concatenate([x, y])
    np.testing.assert_allclose(centred_solution(pivot, psi, x, y), general, atol=1e-10)


def test_eq_22_needs_equal_radii_too():
    pivot = np.array([[2.0, 0.0], [-1.0, 0.5], [-1.0, -0.5]])
    x, y = np.array([0.0, 0.1, 0.0]), np.array([0.1, 0.0, 0.0])
    general = normal_inverse(pivot, 0.0) @ design_matrix(pivot, 0.0).T @ np.concatenate([x, y])
    assert abs(centred_solution(pivot, 0.0, x, y)[2] - general[2]) > 1e-3


@pytest.mark.parametrize("left_out", [0, 1, 2, 3])
def test_cast_is_least_squares_in_the_world_frame_at_every_step(odd_robot, noise, drive, left_out):
    """CAST solves in the body frame; the paper's H(psi-) in N, solved by lstsq, must give the same path."""
    robot = odd_robot(3, centred=False)
    observations = noise(robot)
    castors = [i for i in range(3) if i != left_out - 1]
    records = castor_records(Geometry.of(robot), castors)
    pivot = np.array([robot.castors[i].pivot for i in castors])
    pose, expected = np.array([1.0, 2.0, 3.0]), []
    for observation in observations:
        steps = moved(records, observation)
        moves = (steps.x + 1j * steps.y) * np.exp(1j * pose[2])
        y = np.concatenate([moves.real, moves.imag])
        pose = pose + np.linalg.lstsq(design_matrix(pivot, pose[2]), y, rcond=None)[0]
        expected.append(pose)
    np.testing.assert_allclose(drive(CAST(left_out), robot, observations, (1.0, 2.0, 3.0)), expected, atol=1e-10)


@pytest.mark.parametrize(("n", "left_out"), [(2, 0), (3, 1), (3, 2), (3, 3)])
def test_ipec_and_rigid_registration_agree_in_heading_and_share_the_stretch(odd_robot, noise, drive, n, left_out):
    """Both turn the line between two pivots. If it stretches by L - D, IPEC keeps pivot 1, the fit moves it by half."""
    robot = odd_robot(n, centred=False)
    observations = noise(robot, seed=left_out)
    ipec = drive(IPEC(left_out), robot, observations, (0.5, -1.0, 2.0))
    fit = drive(CASTArc(left_out), robot, observations, (0.5, -1.0, 2.0))
    np.testing.assert_allclose(ipec[:, 2], fit[:, 2], atol=1e-12)

    castors = [i for i in range(n) if i != left_out - 1]
    line = complex(*robot.castors[castors[1]].pivot) - complex(*robot.castors[castors[0]].pivot)
    records = castor_records(Geometry.of(robot), castors)
    difference, psi = 0.0, 2.0
    for k, observation in enumerate(observations):
        steps = moved(records, observation)
        apart = (steps.x[1] + 1j * steps.y[1]) - (steps.x[0] + 1j * steps.y[0])
        after = (line + apart) * np.exp(1j * psi)
        difference += 0.5 * (abs(line) - abs(after)) * after / abs(after)
        psi = fit[k, 2]
        np.testing.assert_allclose(ipec[k, :2] - fit[k, :2], [difference.real, difference.imag], atol=1e-12)
    assert abs(difference) > 1e-3


@pytest.mark.parametrize("n", [2, 3, 4, 6])
def test_arc_variant_is_the_rigid_motion_of_the_singular_value_decomposition(odd_robot, noise, n):
    robot = odd_robot(n, centred=False)
    geometry = Geometry.of(robot)
    pivot = geometry.pivot
    for seed in range(20):
        still, step = noise(robot, seed=seed, steps=2, counts=400)
        estimator, records = CASTArc(), castor_records(geometry, range(n))
        estimator.reset(robot, np.zeros(3))
        estimator.update(still)
        moved(records, still)
        steps = moved(records, step)
        after = pivot + np.stack([steps.x, steps.y], axis=-1)
        u, _, v = np.linalg.svd((pivot - pivot.mean(0)).T @ (after - after.mean(0)))  # Kabsch
        rotation = v.T @ np.diag([1.0, np.linalg.det(v.T @ u.T)]) @ u.T
        x, y, psi = estimator.update(step)
        cos, sin = np.cos(psi), np.sin(psi)
        np.testing.assert_allclose([[cos, -sin], [sin, cos]], rotation, atol=1e-9)
        np.testing.assert_allclose([x, y], after.mean(0) - rotation @ pivot.mean(0), atol=1e-9)


@pytest.mark.parametrize("n", [2, 3, 5])
def test_cast_and_its_arc_variant_agree_to_first_order(odd_robot, noise, drive, n):
    """Their difference over one step shrinks with the square of the step."""
    robot = odd_robot(n, centred=False)

    def difference(scale):
        still, step = noise(robot, seed=7, steps=2)
        observations = [still, {**step, "wheel": scale * step["wheel"]}]
        return np.abs(drive(CAST(), robot, observations) - drive(CASTArc(), robot, observations)).max()

    assert difference(1.0) > 1e-6
    assert difference(1e-3) < 2e-6 * difference(1.0)


@given(st.integers(2, 6), st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_consistent_castors_are_followed_exactly_by_all_with_any_subset(n, seed):
    """If castors turn on the spot and nothing stretches, leaving one out changes nothing; nor does the algorithm."""
    robot = n_castor(n)
    random = np.random.default_rng(seed)
    ahead = float(random.integers(1, 50))
    theta = float(random.integers(0, 5143))
    observation = {"wheel": np.zeros(2 * n), "pivot": np.full(n, theta), "time": np.zeros(1)}
    rolled = {**observation, "wheel": np.full(2 * n, ahead)}
    step = ahead / 1200 * 2 * np.pi * 0.0381 * np.exp(1j * (theta / 5143 * 2 * np.pi + 0.3))
    estimators = [
        CAST(),
        CASTArc(),
        *([IPEC()] if n == 2 else [IPEC(1)] if n == 3 else []),
        *([CAST(n)] if n > 2 else []),
    ]
    for estimator in estimators:
        estimator.reset(robot, np.array([0.0, 0.0, 0.3]))
        estimator.update(observation)
        np.testing.assert_allclose(estimator.update(rolled), [step.real, step.imag, 0.3], atol=1e-12)


def test_body_origin_only_moves_the_point_that_is_reported(odd_robot, exact_motion, winding, drive):
    """The fitted motion of the body is one thing, whichever of its points is called the origin (arc variant)."""
    original = odd_robot(3)
    shift = complex(0.4, -0.7)
    castors = (
        dataclasses.replace(c, pivot=(c.pivot[0] - shift.real, c.pivot[1] - shift.imag)) for c in original.castors
    )
    moved = dataclasses.replace(original, castors=tuple(castors))
    _, observations = exact_motion(original, winding, 3.0).sampled(60)
    for estimator in (CASTArc(), IPEC(2)):
        a, b = (drive(estimator, robot, observations) for robot in (original, moved))
        origin_b = (a[:, 0] + 1j * a[:, 1] + shift * np.exp(1j * a[:, 2])) - shift
        np.testing.assert_allclose(b[:, 2], a[:, 2], atol=1e-12)
        np.testing.assert_allclose(b[:, 0] + 1j * b[:, 1], origin_b, atol=1e-12)


def test_two_castor_least_squares_nearly_matches_ipec(noise, drive):
    """Doebbler IV.B: "the two-castor least squares provides nearly the same solution as IPEC"."""
    robot = preset("asoc-prototype")
    observations = noise(robot, counts=3)
    for i in (1, 2, 3):
        a, b = drive(CAST(i), robot, observations), drive(IPEC(i), robot, observations)
        assert 0 < np.abs(a[:, 2] - b[:, 2]).max() < 1e-3


@pytest.mark.parametrize("estimator", [CAST(), CASTArc(), IPEC(1), DeadReckoning()])
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda estimator: pickle.loads(pickle.dumps(estimator))])
def test_a_copy_goes_its_own_way(odd_robot, noise, drive, estimator, copied):
    robot = odd_robot(3)
    observations = noise(robot)
    expected = drive(estimator, robot, observations, (0.5, -1.0, 2.0))
    estimator.reset(robot, (0.5, -1.0, 2.0))
    half = len(observations) // 2
    for observation in observations[:half]:
        estimator.update(observation)
    twin = copied(estimator)
    for of in (twin, estimator):
        np.testing.assert_array_equal([of.update(observation) for observation in observations[half:]], expected[half:])
