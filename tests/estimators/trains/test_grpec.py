"""GRPEC: Table 1 and 2 of the paper, the same computed once more with complex numbers, ties, and symmetry."""

import cmath
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.tasks.static_tests import STATIC_TESTS
from castor_envs.errors import InputError
from castor_envs.vehicles.presets import cfmmr
from estimators.trains.grpec import GRPEC, GRPECXY, GRPECDev, GRPECPhi, attached, confidence, corrected, errors, select

# Table 1: rows axles 1 to 3, then CON1 and CON2; m and deg.
TABLE_1 = {
    1: {
        "theta_xy": (0.357, 0.138, 0.135, 0.622, 0.022),
        "theta_phi": (68.4, 34.6, 34.3, 0.498, 0.008),
        "theta_dev": (23.0, 11.3, 11.1, 0.519, 0.024),
    },
    2: {
        "theta_xy": (0.758, 0.277, 0.544, 0.635, 0.491),
        "theta_phi": (151.9, 91.2, 121.5, 0.400, 0.250),
        "theta_dev": (52.3, 8.5, 38.8, 0.838, 0.782),
    },
    3: {
        "theta_xy": (0.305, 0.300, 0.613, 0.511, 0.016),
        "theta_phi": (60.8, 101.5, 80.8, 0.401, 0.248),
        "theta_dev": (15.7, 25.0, 35.7, 0.561, 0.374),
    },
    4: {
        "theta_xy": (0.608, 0.225, 0.228, 0.630, 0.013),
        "theta_phi": (120.8, 60.6, 60.8, 0.499, 0.005),
        "theta_dev": (41.8, 18.4, 18.7, 0.559, 0.015),
    },
}
# Table 2: the printed verdicts, as axles; the true ones are 3, 2, 2, 2.
SELECTED = {"theta_xy": (3, 2, 2, 2), "theta_phi": (3, 2, 1, 2), "theta_dev": (3, 2, 1, 2)}
CLASSES = {"theta_xy": GRPECXY, "theta_phi": GRPECPhi, "theta_dev": GRPECDev}


@pytest.mark.parametrize("test", STATIC_TESTS, ids=lambda test: f"test-{test.number}")
@pytest.mark.parametrize("metric", SELECTED)
def test_table_1_to_its_rounding(test, metric):
    found = getattr(errors(test.odometry, test.relative), metric)
    *printed, con1, con2 = TABLE_1[test.number][metric]
    half = 0.0005 if metric == "theta_xy" else 0.05
    np.testing.assert_allclose(found if metric == "theta_xy" else np.degrees(found), printed, rtol=0, atol=half)
    np.testing.assert_allclose(confidence(found), (con1, con2), rtol=0, atol=0.0005)


@pytest.mark.parametrize("metric", SELECTED)
def test_table_2_by_the_estimators(metric, standing):
    passed = []
    for test, axle in zip(STATIC_TESTS, SELECTED[metric], strict=True):
        estimator = CLASSES[metric]()
        estimator.reset(cfmmr(3), test.odometry)
        first, second = (estimator.update(seen) for seen in standing(3, test.relative))
        np.testing.assert_array_equal(first, test.odometry)
        np.testing.assert_array_equal(second[axle - 1], test.odometry[axle - 1])
        assert estimator.selected == axle
        con1, con2 = TABLE_1[test.number][metric][3:]
        np.testing.assert_allclose(estimator.confidence, (con1, con2), rtol=0, atol=0.0005)
        passed.append(np.abs(second - test.truth).max() < 1e-12)
    assert passed == [True, True, metric == "theta_xy", True]


def naive(od, relative):
    """Errors, by attachment, of the three metrics: loops over complex numbers and headings."""
    n = len(od)
    z, phi = [complex(x, y) for x, y, _ in od], [psi for *_, psi in od]
    result = []
    for j in range(n):
        place, heading = {j: z[j]}, {j: phi[j]}
        for i in range(j - 1, -1, -1):
            x, y, turn = relative[i]
            place[i] = place[i + 1] + cmath.exp(1j * heading[i + 1]) * complex(x, y)
            heading[i] = heading[i + 1] + turn
        for i in range(j + 1, n):
            x, y, turn = relative[i - 1]
            heading[i] = heading[i - 1] - turn
            place[i] = place[i - 1] - cmath.exp(1j * heading[i]) * complex(x, y)
        distance = sum(abs(z[i] - place[i]) for i in range(n))
        turned = sum(abs(cmath.phase(cmath.exp(1j * (phi[i] - heading[i])))) for i in range(n))
        ratio = (z[0] - z[-1]) * (place[0] - place[n - 1]).conjugate()
        result.append((distance, turned, abs(cmath.phase(ratio))))
    return result


def first_of_ties(rows, metric):
    """The rule of ties, over rows (theta_xy, theta_phi, theta_dev)."""
    least = min(row[metric] for row in rows)
    tied = [j for j, row in enumerate(rows) if row[metric] <= least + 1e-12]
    nearest = min(rows[j][0] for j in tied)
    return min(j for j in tied if rows[j][0] <= nearest + 1e-12)


@pytest.mark.parametrize("n", range(2, 11))
def test_same_as_written_once_more(n):
    random = np.random.default_rng(n)
    od = random.uniform([-2, -2, -9], [2, 2, 9], (60, n, 3))
    relative = random.uniform([-0.1, -0.3, -3], [0.4, 0.3, 3], (60, n - 1, 3))
    found = errors(od, relative)
    for k in range(60):
        rows = naive(od[k], relative[k])
        for m, metric in enumerate(found):
            np.testing.assert_allclose(metric[k], [row[m] for row in rows], rtol=0, atol=1e-9)
            assert select(metric, found.theta_xy)[k] == first_of_ties(rows, m)
            ordered = sorted(row[m] for row in rows)
            con1, con2 = confidence(metric)
            assert math.isclose(con1[k], 1 - ordered[0] / ordered[-1], abs_tol=1e-9)
            assert math.isclose(con2[k], 1 - ordered[0] / ordered[1], abs_tol=1e-9)


@pytest.mark.parametrize("n", [2, 3, 7])
def test_leading_axes_are_snapshots(n, snapshots):
    _, od, relative = snapshots(6, n, 1)
    grid = errors(od.reshape(2, 3, n, 3), relative.reshape(2, 3, n - 1, 3))
    for k in range(6):
        alone = errors(od[k], relative[k])
        for together, single in zip(grid, alone, strict=True):
            np.testing.assert_array_equal(together.reshape(6, n)[k], single)
            assert select(together, grid.theta_xy).ravel()[k] == select(single, alone.theta_xy)


@pytest.mark.parametrize("n", range(2, 11))
def test_odometry_that_agrees_with_the_frames_has_no_error(n, snapshots):
    truth, _, relative = snapshots(5, n, 0)
    od = attached(truth, relative)[:, 0]
    for metric in errors(od, relative):
        np.testing.assert_allclose(metric, 0.0, atol=1e-12)
        np.testing.assert_array_equal(confidence(metric), np.zeros((2, 5)))
        np.testing.assert_array_equal(select(metric, metric), 0)
    np.testing.assert_allclose(attached(od, relative), np.broadcast_to(od[:, None], (5, n, n, 3)), atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 10), st.integers(0, 10**6), st.floats(-50, 50), st.floats(-50, 50), st.floats(-20, 20))
def test_a_common_motion_of_all_axles_changes_no_error(n, seed, x, y, turn):
    random = np.random.default_rng(seed)
    od = random.uniform(-1, 1, (n, 3))
    relative = random.uniform(-1, 1, (n - 1, 3))
    place = (od[:, 0] + 1j * od[:, 1]) * cmath.exp(1j * turn)
    moved = np.stack([place.real + x, place.imag + y, od[:, 2] + turn], axis=-1)
    for original, moved_errors in zip(errors(od, relative), errors(moved, relative), strict=True):
        np.testing.assert_allclose(moved_errors, original, rtol=0, atol=1e-10)


@pytest.mark.parametrize("n", [2, 4, 6, 8, 10])
def test_theta_phi_of_even_trains_ties_and_theta_xy_decides(n):
    random = np.random.default_rng(n)
    for _ in range(50):
        od = random.normal(0, [0.3, 0.3, 0.2], (n, 3))
        relative = random.normal([0.35, 0, 0], [0.02, 0.1, 0.2], (n - 1, 3))
        found = errors(od, relative)
        ordered = np.argsort(found.theta_phi)
        # Headings less those of the frames lie on a line: any point between the two middle ones is as near to all.
        assert found.theta_phi[ordered[1]] - found.theta_phi[ordered[0]] < 1e-12
        chosen = select(found.theta_phi, found.theta_xy)
        assert chosen == min(ordered[:2], key=lambda j: found.theta_xy[j])


def test_ties_within_the_last_digits_go_to_theta_xy_then_to_the_lower_axle():
    assert select([1.0 + 9e-13, 1.0, 2.0], [0.1, 0.2, 0.0]) == 0
    assert select([1.0 + 2e-12, 1.0, 2.0], [0.1, 0.2, 0.0]) == 1
    assert select([1.0, 1.0, 1.0], [0.3, 0.2 + 9e-13, 0.2]) == 1
    assert select([1.0, 1.0, 1.0], [0.3, 0.2 + 2e-12, 0.2]) == 2
    assert select([0.2 + 9e-13, 0.2], [0.2 + 9e-13, 0.2]) == 0


def test_deviation_angle_of_a_vector_without_length_is_0():
    relative = np.array([[0.3, 0.1, 0.4], [-0.3, -0.1, 0.2]])
    ring = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.5]])
    np.testing.assert_array_equal(errors(ring, relative).theta_dev, 0.0)


def test_deviation_angle_is_exact_where_arccos_is_not():
    length, angle = 0.35, 1e-9
    od = np.array([[length, 0.0, 0.0], [0.0, 0.0, 0.0]])
    relative = np.array([[length * math.cos(angle), length * math.sin(angle), 0.0]])
    np.testing.assert_allclose(errors(od, relative).theta_dev, angle, rtol=1e-6)


def test_confidence_takes_the_second_smallest_error():
    con1, con2 = confidence([[4.0, 1.0, 8.0, 2.0, 3.0], [0.0, 0.0, 0.0, 0.0, 5.0], [0.0] * 5])
    np.testing.assert_allclose(con1, [7 / 8, 1.0, 0.0])
    np.testing.assert_allclose(con2, [1 / 2, 0.0, 0.0])


@pytest.mark.parametrize("turns", [-2, 0, 3])
def test_corrected_headings_stay_next_to_odometry(turns, standing):
    test = STATIC_TESTS[1]
    od = test.odometry + np.array([[0, 0, 2 * np.pi * turns], [0, 0, 0], [0, 0, -2 * np.pi * turns]])
    relative = test.relative + np.array([0.0, 0.0, 2 * np.pi])
    estimator = GRPEC("xy")
    estimator.reset(cfmmr(3), od)
    poses = [estimator.update(seen) for seen in standing(3, relative)][-1]
    np.testing.assert_allclose(poses - od, test.truth - test.odometry, atol=1e-12)


def test_odometry_goes_on_from_the_corrected_poses(circling):
    train, truth, observations = circling(n=3, curvature=0.8, seconds=2.0)
    start = truth[0] + np.array([[0, 0, 0], [0.1, -0.05, 0.3], [0, 0, 0]])
    estimator = GRPECXY(20)
    estimator.reset(train, start)
    poses = np.array([estimator.update(seen) for seen in observations])
    assert np.abs(poses[19] - truth[19]).max() > 0.05
    np.testing.assert_allclose(poses[20:], truth[20:], atol=1e-9)
    assert estimator.selected in (1, 3)


def test_before_a_correction_nothing_is_selected():
    estimator = GRPECDev()
    estimator.reset(cfmmr(3), np.zeros((3, 3)))
    assert (estimator.selected, estimator.confidence, estimator.status) == (None, None, None)


def test_unknown_metric_is_refused():
    with pytest.raises(InputError, match="'psi'; known: xy, phi, dev"):
        GRPEC("psi")  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("od", "relative"),
    [((3, 3), (1, 3)), ((1, 3), (0, 3)), ((3, 3), (2, 2)), ((3, 2), (2, 3)), ((3,), (2, 3)), ((4, 3, 3), (3, 3))],
)
@pytest.mark.parametrize("function", [attached, errors])
def test_poses_of_other_shapes_are_refused(function, od, relative):
    with pytest.raises(InputError, match=r"shape \(\.\.\., N, 3\) and relative poses"):
        function(np.zeros(od), np.zeros(relative))


def test_what_is_not_a_number_is_never_the_smallest_error():
    od, relative = np.eye(3), np.array([[0.35, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    found = errors(od, relative)
    assert np.isnan(found.theta_dev).all()
    for theta in (found.theta_xy, found.theta_dev):
        with pytest.raises(InputError, match="not a number"):
            select(theta, found.theta_xy)
    with pytest.raises(InputError, match="two axles or more"):
        confidence([1.0])
    with pytest.raises(InputError, match="one for each axle"):
        select([1.0, 2.0, 3.0], [5.0])


def test_far_places_and_whole_turns_cost_no_tie():
    """Headings of an even number of axles always tie; so do the attachments of a symmetric train, wherever it is."""
    random = np.random.default_rng(3)
    for n in (2, 4, 6, 8, 10):
        od = random.uniform(-1, 1, (50, n, 3)) + 2 * np.pi * random.integers(-1000, 1000, (50, n, 1)) * [0, 0, 1]
        phi = errors(od, random.uniform(-0.4, 0.4, (50, n - 1, 3))).theta_phi
        ordered = np.sort(phi, axis=-1)
        assert np.max(ordered[:, 1] - ordered[:, 0]) < 1e-12
    relative = np.array([[0.3, 0.1, 0.4], [0.3, 0.1, 0.4]])
    straight = np.array([[0.3, 0.0, 0.0], [0.0, 0.0, 0.0], [-0.3, 0.0, 0.0]])
    near = errors(straight, relative)
    far = errors(straight + np.array([1024.0, -2048.0, 0.0]), relative)
    for near_error, far_error in zip(near, far, strict=True):
        np.testing.assert_allclose(near_error, far_error, atol=1e-12)


def test_many_snapshots_are_corrected_as_each_is(monkeypatch):
    random = np.random.default_rng(3)
    od, relative = random.normal(size=(50, 4, 3)), random.normal(size=(50, 3, 3))
    whole = errors(od, relative)
    monkeypatch.setattr("estimators.trains.grpec.AT_ONCE", 8)
    for at_once, in_parts in zip(whole, errors(od, relative), strict=True):
        np.testing.assert_array_equal(in_parts, at_once)
    trusted = select(whole.theta_xy, whole.theta_xy)
    one_by_one = [attached(od[k], relative[k])[axle] for k, axle in enumerate(trusted)]
    np.testing.assert_array_equal(corrected(od, relative, trusted), one_by_one)
