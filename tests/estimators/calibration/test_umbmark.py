"""UMBmark's correction: the published worked example, robots with known errors, and what it refuses."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

from castor_envs.errors import InputError
from castor_envs.geometry.se2 import compose, inverse
from castor_envs.logs.importers.optiodom import find_sessions, read_session
from castor_envs.logs.log import Log
from castor_envs.vehicles.axle import with_axle
from castor_envs.vehicles.presets import differential, tricycle
from castor_envs.vehicles.robot import Wheel
from estimators.calibration.umbmark import corrected, from_errors, from_logs
from estimators.robots.dead_reckoning import DeadReckoning

SIDE = 2.0
BASE, DIAMETER = 0.34, 0.15
ROBOT = differential(DIAMETER / 2, BASE)
WAYS = ("cw", "ccw")


def built(base_factor, ratio):
    """Return the true wheel base and diameters (left, right), m, of `ROBOT` with errors."""
    return BASE * base_factor, np.array([2 * DIAMETER / (1 + ratio), 2 * DIAMETER * ratio / (1 + ratio)])


def square(robot, truth, way, start=0j, heading=0.0):
    """Return the log of a square that `robot` believes to drive and a robot of another axle rolls, arc by arc."""
    base, diameters = truth
    left, right = robot.castors[0].wheels
    believed = 2 * np.array([left.radius, right.radius])
    corner = (left.lateral - right.lateral) * np.pi / 4 * (1 if way == "ccw" else -1)
    wheel, place, psi = np.zeros(2), start, heading
    counts, poses = [wheel], [(place.real, place.imag, psi)]
    for rolled in ([SIDE, SIDE], [-corner, corner]) * 4:
        wheel = wheel + np.array(rolled) / (np.pi * believed) * left.counts_per_rev
        s_left, s_right = np.array(rolled) * diameters / believed
        turn = (s_right - s_left) / base
        arc = (np.exp(1j * turn) - 1) / (1j * turn) if turn else 1.0
        place, psi = place + np.exp(1j * psi) * arc * (s_left + s_right) / 2, psi + turn
        counts.append(wheel)
        poses.append((place.real, place.imag, psi))
    return Log(np.arange(9.0), np.array(counts), np.empty((9, 0)), reference=np.array(poses))


def squares(robot, truth, **start):
    return [square(robot, truth, way, **start) for way in WAYS]


def truth_of(log):
    """Return a log's reference, which it has."""
    assert log.reference is not None
    return log.reference


def end_errors(robot, logs):
    """Return how far dead reckoning ends from the truth, m."""
    errors = []
    for log in logs:
        odometry = DeadReckoning()
        odometry.reset(robot, truth_of(log)[0])
        end = [odometry.update(observation) for observation in log.observations()][-1]
        errors.append(np.hypot(*(truth_of(log)[-1] - end)[:2]))
    return np.array(errors)


def test_published_worked_example_from_its_printed_centroids():
    robot = with_axle(ROBOT, 0.2, 0.084, 0.084)
    found = from_errors(robot, [[-10.9e-3, -6.2e-3]], [[-23.2e-3, 19.7e-3]], 0.75)
    # A centroid printed to 0.1 mm leaves 0.002 deg.
    assert np.degrees([found.alpha, found.beta]) == pytest.approx([0.651, -0.236], abs=2e-3)
    assert (found.wheel_base_factor, found.diameter_ratio) == pytest.approx((1.00729, 0.99890), abs=0.6e-5)
    assert (found.axle.wheel_base, *found.axle.diameters) == pytest.approx((0.20146, 0.08395, 0.08405), abs=0.51e-5)


@pytest.mark.parametrize(
    ("name", "before", "after", "base", "diameters"),
    [
        ("230620202042", 33.26, 7.2, 0.20146, (0.08395, 0.08405)),
        ("230620202144", 66.77, 4.6, 0.20130, (0.08398, 0.08402)),
    ],
)
def test_measured_sessions_come_out_as_published(name, before, after, base, diameters):
    data = os.environ.get("CASTOR_DATA")
    folders = find_sessions(Path(data)) if data else {}
    if name not in folders:
        pytest.skip("the OptiOdom data are not there: set CASTOR_DATA")
    session = read_session(folders[name])
    assert session.side is not None
    found = from_logs(session.robot, session.runs, session.directions, session.side)
    if name == "230620202042":
        assert np.degrees([found.alpha, found.beta]) == pytest.approx([0.651, -0.236], abs=6e-4)
        assert (found.wheel_base_factor, found.diameter_ratio) == pytest.approx((1.00729, 0.99890), abs=0.6e-5)
    assert (found.axle.wheel_base, *found.axle.diameters) == pytest.approx((base, *diameters), abs=0.51e-5)
    assert 1e3 * end_errors(session.robot, session.runs).max() == pytest.approx(before, abs=0.1)
    assert 1e3 * end_errors(corrected(session.robot, found), session.runs).max() == pytest.approx(after, abs=0.1)
    assert 0 < found.standard_errors.wheel_base_factor < 1e-3
    assert 0 < found.standard_errors.diameter_ratio < 1e-3


def misses(factor):
    """Return how far E_b and E_d are off for errors in proportion to a factor."""
    base_factor, ratio = 1 + 0.02 * factor, 1 - 0.006 * factor
    found = from_logs(ROBOT, squares(ROBOT, built(base_factor, ratio), start=1 - 2j, heading=0.7), WAYS, SIDE)
    return np.abs([found.wheel_base_factor - base_factor, found.diameter_ratio - ratio])


def test_known_errors_are_recovered_to_first_order():
    full, half, quarter = misses(1), misses(0.5), misses(0.25)
    assert np.all(full < [2.2e-3, 6e-4])
    assert full / half == pytest.approx([4, 4], rel=0.25)
    assert half / quarter == pytest.approx([4, 4], rel=0.15)


@pytest.mark.parametrize("base_factor", [0.99, 1.0])
def test_equal_wheels_have_no_radius_of_curvature(base_factor):
    found = from_logs(ROBOT, squares(ROBOT, built(base_factor, 1.0)), WAYS, SIDE)
    assert found.beta == pytest.approx(0.0, abs=1e-12)
    assert found.diameter_ratio == pytest.approx(1.0, abs=1e-12)
    assert found.wheel_base_factor == pytest.approx(base_factor, abs=4e-4)
    exact = from_errors(ROBOT, np.zeros((2, 2)), np.zeros((2, 2)), SIDE)
    assert (exact.alpha, exact.beta, exact.diameter_ratio) == (0, 0, 1)
    assert corrected(ROBOT, exact) == ROBOT


def test_a_mirrored_robot_gives_the_mirrored_correction():
    truth = built(1.02, 0.994)
    logs = squares(ROBOT, truth)
    mirrored = [
        dataclasses.replace(log, wheel=log.wheel[:, ::-1], reference=truth_of(log) * [1, -1, -1]) for log in logs
    ]
    found, mirror_found = from_logs(ROBOT, logs, WAYS, SIDE), from_logs(ROBOT, mirrored, WAYS[::-1], SIDE)
    assert (mirror_found.alpha, mirror_found.beta) == pytest.approx((found.alpha, -found.beta), rel=1e-9)
    assert mirror_found.wheel_base_factor == pytest.approx(found.wheel_base_factor, rel=1e-12)
    assert mirror_found.diameter_ratio == pytest.approx(1 / found.diameter_ratio, rel=1e-12)
    assert mirror_found.axle.diameters == pytest.approx(found.axle.diameters[::-1], rel=1e-12)


def test_the_place_of_the_axle_in_the_body_does_not_matter():
    logs = squares(ROBOT, built(1.02, 0.994))
    (axle,) = ROBOT.castors
    wheels = tuple(dataclasses.replace(wheel, lateral=wheel.lateral + 0.02) for wheel in axle.wheels)
    idle = dataclasses.replace(
        axle, pivot=(-0.2, 0.0), steering="free", offset=0.05, wheels=(Wheel(radius=0.03, counts_per_rev=None),)
    )
    moved = dataclasses.replace(axle, pivot=(0.3, -0.1), angle=0.5, wheels=wheels)
    robot = dataclasses.replace(ROBOT, castors=(idle, moved))
    seat = compose([0.3, -0.1, 0.5], [0, 0.02, 0])
    moved_logs = [dataclasses.replace(log, reference=compose(truth_of(log), inverse(seat))) for log in logs]
    found, moved_found = from_logs(ROBOT, logs, WAYS, SIDE), from_logs(robot, moved_logs, WAYS, SIDE)
    assert (moved_found.alpha, moved_found.beta) == pytest.approx((found.alpha, found.beta), rel=1e-9)
    left, right = corrected(robot, moved_found).castors[1].wheels
    assert left.lateral + right.lateral == pytest.approx(0.04, rel=1e-9)
    assert left.lateral - right.lateral == pytest.approx(found.axle.wheel_base, rel=1e-9)
    assert corrected(robot, moved_found).castors[0] == idle


def test_the_corrected_robot_closes_its_square_and_a_second_time_better():
    truth = built(1.02, 0.994)
    robot, left = ROBOT, []
    for _ in range(4):
        logs = squares(robot, truth)
        away = [np.hypot(*truth_of(log)[-1, :2]) for log in logs]
        np.testing.assert_allclose(end_errors(robot, logs), away, atol=1e-12)
        left.append(max(away))
        robot = corrected(robot, from_logs(robot, logs, WAYS, SIDE))
        assert sum(wheel.radius for wheel in robot.castors[0].wheels) == pytest.approx(DIAMETER, rel=1e-12)
    assert left[1] < 0.1 * left[0]
    assert left[2] < 0.1 * left[1]
    assert left[3] < 1e-4


def test_standard_errors_cover():
    """Sessions of 20 runs each way, the clockwise ones noisier: estimates spread as they say, together too."""
    rng, n, sessions = np.random.default_rng(3), 20, 300
    robot = with_axle(ROBOT, 0.33, 0.151, 0.149)
    cw, ccw = np.array([-0.12, -0.1]), np.array([-0.05, 0.06])
    truth = from_errors(robot, cw[None], ccw[None], SIDE)
    found = [
        from_errors(robot, cw + rng.normal(0, 0.03, (n, 2)), ccw + rng.normal(0, 0.01, (n, 2)), SIDE)
        for _ in range(sessions)
    ]

    def numbers(result):
        return np.hstack(tuple(result))

    def values(calibration):
        return numbers(
            (
                calibration.alpha,
                calibration.beta,
                calibration.wheel_base_factor,
                calibration.diameter_ratio,
                calibration.axle.wheel_base,
                calibration.axle.diameters,
            )
        )

    off = np.array([values(calibration) - values(truth) for calibration in found])
    said = np.array([numbers(calibration.standard_errors) for calibration in found])
    np.testing.assert_allclose(np.sqrt(np.mean(off**2, axis=0)), np.sqrt(np.mean(said**2, axis=0)), rtol=0.12)
    covered = np.mean(np.abs(off) < 2 * said, axis=0)
    assert np.all((covered > 0.91) & (covered < 0.985))
    covariance = np.mean(
        [calibration.covariance for calibration in found if calibration.covariance is not None], axis=0
    )
    np.testing.assert_allclose(np.cov(off[:, 2:4].T), covariance, rtol=0.25)


def test_one_run_a_direction_gives_the_estimate_without_its_errors():
    found = from_logs(ROBOT, squares(ROBOT, built(1.01, 1.002)), WAYS, SIDE)
    assert found.covariance is None
    with pytest.raises(InputError, match="record at least 2 runs in each direction"):
        _ = found.standard_errors


SOME = np.array([[-0.1, 0.02], [-0.11, 0.03]])
OMNI = dataclasses.replace(
    ROBOT,
    castors=(
        dataclasses.replace(
            ROBOT.castors[0], wheels=tuple(dataclasses.replace(wheel, grip="omni") for wheel in ROBOT.castors[0].wheels)
        ),
    ),
)


@pytest.mark.parametrize(
    ("robot", "cw", "ccw", "side", "message"),
    [
        (ROBOT, SOME, [], SIDE, "no counter-clockwise run; record runs in both directions"),
        (ROBOT, [], SOME, SIDE, "no clockwise run; record runs in both directions"),
        (ROBOT, SOME[0], SOME, SIDE, r"clockwise return errors have shape \(2,\); give \(n, 2\)"),
        (ROBOT, [[0, 0], [np.nan, 0]], SOME, SIDE, "clockwise run 2 has an error that is not finite"),
        (ROBOT, SOME, [[0, np.inf]], SIDE, "counter-clockwise run 1 has an error that is not finite"),
        (ROBOT, SOME, SOME, 0.0, "side of the square is 0.0 m; give its length, above 0"),
        (ROBOT, SOME, SOME, np.nan, "side of the square is nan m"),
        (ROBOT, [[-9.0, 0]], [[-9.0, 0]], SIDE, "too much for a square of side 2 m; check the side"),
        (ROBOT, [[-0.28, 0]], [[0.28, 0]], 0.1, "bend with a radius of 0.0776 m, within half the wheel base of 0.34 m"),
        (tricycle(), SOME, SOME, SIDE, "'tricycle' is not a differential robot; give one with exactly two driven"),
        (OMNI, SOME, SOME, SIDE, "is not a differential robot"),
    ],
)
def test_errors_it_cannot_use(robot, cw, ccw, side, message):
    with pytest.raises(InputError, match=f"^[^\n]*{message}"):
        from_errors(robot, cw, ccw, side)


def changed(**values):
    """Return logs of both directions, the second changed."""
    cw, ccw = squares(ROBOT, built(1.01, 1.002))
    return cw, dataclasses.replace(ccw, **values)


def blank(*rows):
    reference = truth_of(changed()[1]).copy()
    reference[list(rows)] = np.nan
    return reference


def cut(log, samples):
    return Log(log.t[:samples], log.wheel[:samples], log.pivot[:samples], reference=truth_of(log)[:samples])


@pytest.mark.parametrize(
    ("logs", "directions", "message"),
    [
        (changed(reference=None), WAYS, "log 2 has no reference at the start; record the true pose, with its heading"),
        (changed(reference=blank(0)), WAYS, "log 2 has no reference at the start"),
        (changed(reference=blank(8)), WAYS, "log 2 has no reference at the end"),
        (changed(wheel=np.full((9, 2), np.inf)), WAYS, "log 2 has wheel counts that are not finite"),
        (
            (changed()[0], cut(changed()[1], 6)),
            WAYS,
            r"log 2: the square was not closed: .* ended 2.02 m from its start",
        ),
        (
            (changed()[0], cut(changed()[1], 8)),
            WAYS,
            r"log 2: the robot truly turned by 2.* deg, which is no ccw square",
        ),
        (changed(), WAYS[::-1], "log 1: the robot truly turned by -35.* deg, which is no ccw square"),
        (changed(), ("cw", "left"), "log 2: unknown direction 'left'; give 'cw' or 'ccw'"),
        (changed(), ("cw",), "2 logs, but 1 directions"),
        (changed()[:1], ("cw",), "no counter-clockwise run; record runs in both directions"),
    ],
)
def test_logs_it_cannot_use(logs, directions, message):
    with pytest.raises(InputError, match=f"^{message}"):
        from_logs(ROBOT, logs, directions, SIDE)


def test_references_between_start_and_end_may_be_missing():
    full, gaps = changed(), changed(reference=blank(3, 4, 5))
    assert from_logs(ROBOT, gaps, WAYS, SIDE).alpha == from_logs(ROBOT, full, WAYS, SIDE).alpha
