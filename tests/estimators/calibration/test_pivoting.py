"""Doebbler's calibration by pivoting: against rolling integrated by other code, and everything it must refuse."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest

from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.logs.recorder import RecordLog
from castor_envs.motion.trajectories import pivoting
from castor_envs.vehicles.presets import n_castor, preset
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.pivoting import Turn, calibrate, from_turns


def steady(robot, held, sense):
    """Angles of castors that have long swung in while the base turns about a pivot; the held one's is any."""
    pivots = np.array([complex(*castor.pivot) for castor in robot.castors])
    angles = []
    for castor, arm in zip(robot.castors, pivots - pivots[held - 1], strict=True):
        if arm == 0:
            angles.append(0.7)
        else:
            # The axle's foot trails the pivot: it lies where the circle of the axle has its tangent.
            angles.append(np.angle(sense * 1j * arm) - sense * np.arcsin(castor.offset / abs(arm)))
    return angles


def turn(exact_motion, robot, held, sense, *, rounded=False, phase=0.0, radians=2 * np.pi, theta=None):
    """A log of the base turning about the pivot of castor `held`, by integration of the rolling castors."""
    x, y = robot.castors[held - 1].pivot
    rate = sense * 0.5
    motion = exact_motion(
        robot,
        lambda t: (rate * y, -rate * x, rate),
        radians / 0.5,
        theta=steady(robot, held, sense) if theta is None else theta,
    )
    _, observations = motion.sampled(round(radians / 0.5 * 20))
    wheel = np.cumsum([seen["wheel"] for seen in observations], axis=0)
    pivot = np.array([seen["pivot"] for seen in observations])
    if rounded:
        wheel, pivot = np.round(wheel + phase), np.round(pivot)
    return Turn(Log(0.05 * np.arange(len(wheel)), wheel, pivot), held)


def all_turns(exact_motion, robot, held=None, **options):
    held = range(1, len(robot.castors) + 1) if held is None else held
    return [turn(exact_motion, robot, castor, sense, **options) for castor in held for sense in (-1, 1)]


def wrong(robot, seed, size=0.04, bias=0.25):
    """The robot as a user describes it, with errors of parameters but not of the pivots' places."""
    random = np.random.default_rng(seed)
    castors = tuple(
        dataclasses.replace(
            castor,
            offset=castor.offset * (1 + random.uniform(-size, size)),
            pivot_zero=castor.pivot_zero + random.uniform(-bias, bias),
            wheels=tuple(
                dataclasses.replace(
                    wheel,
                    radius=wheel.radius * (1 + random.uniform(-size, size)),
                    lateral=wheel.lateral * (1 + random.uniform(-size, size)),
                )
                for wheel in castor.wheels
            ),
        )
        for castor in robot.castors
    )
    return dataclasses.replace(robot, castors=castors)


def off(found: RobotDescription, true: RobotDescription):
    """Largest relative error of lengths, and largest error of pivot zeros (rad)."""
    lengths, zeros = [], []
    for a, b in zip(found.castors, true.castors, strict=True):
        lengths.append(a.offset / b.offset - 1)
        zeros.append(np.angle(np.exp(1j * (a.pivot_zero - b.pivot_zero))))
        for first, second in zip(a.wheels, b.wheels, strict=True):
            lengths += [first.radius / second.radius - 1, first.lateral / second.lateral - 1]
    return np.max(np.abs(lengths)), np.max(np.abs(zeros))


@pytest.mark.parametrize("n", [2, 3, 4, 6])
def test_finds_every_parameter_of_unrounded_turns(n, exact_motion):
    true = wrong(n_castor(n), seed=n)
    found = calibrate(n_castor(n), all_turns(exact_motion, true))
    lengths, zeros = off(found.applied(), true)
    assert lengths < 1e-7
    assert zeros < 1e-7
    assert found.estimates.offset.shape == (n, n)
    assert np.isnan(found.estimates.offset[np.diag_indices(n)]).all()


def test_equations_4_to_7_hold_for_what_8_and_9_return():
    random = np.random.default_rng(0)
    distance, gamma_cw, path = 0.42, random.uniform(-1, 1, 50), random.uniform(0.05, 0.3, 50)
    gamma_ccw = gamma_cw + np.pi - 2 * path
    cw, ccw = random.uniform(3, 7, 50), random.uniform(3, 7, 50)
    c_cw, c_ccw = random.uniform(40, 60, (50, 2)), random.uniform(40, 60, (50, 2))
    found = from_turns(distance, gamma_cw - path - 0.3, (gamma_cw, gamma_ccw), (cw, ccw), (c_cw, c_ccw))
    arm, d, r = distance * np.cos(path), found.half_track, found.radius
    np.testing.assert_allclose(cw * (arm + d[:, 0]), c_cw[:, 0] * r[:, 0])
    np.testing.assert_allclose(cw * (arm - d[:, 1]), c_cw[:, 1] * r[:, 1])
    np.testing.assert_allclose(ccw * (arm - d[:, 0]), c_ccw[:, 0] * r[:, 0])
    np.testing.assert_allclose(ccw * (arm + d[:, 1]), c_ccw[:, 1] * r[:, 1])
    np.testing.assert_allclose(found.offset, distance * np.sin(path))
    np.testing.assert_allclose(found.pivot_zero, 0.3)


def test_rounded_encoders_leave_what_a_recomputation_says_and_standard_errors_cover_it(exact_motion):
    """With D exact and one full turn a recomputation gave mean sizes r_c .089, r_w .004, d .013 % and beta .008 deg."""
    sizes, standard = [], []
    for seed in range(12):
        true = wrong(preset("asoc-prototype"), seed)
        phase = np.random.default_rng([seed, 1]).uniform(size=6)
        found = calibrate(preset("asoc-prototype"), all_turns(exact_motion, true, rounded=True, phase=phase))
        r_c = np.array([castor.offset for castor in true.castors])
        r_w = np.array([[wheel.radius for wheel in castor.wheels] for castor in true.castors])
        d = np.array([[abs(wheel.lateral) for wheel in castor.wheels] for castor in true.castors])
        beta = np.array([castor.pivot_zero for castor in true.castors])
        away = [part - truth for part, truth in zip(found.parameters, (r_c, beta, r_w, d), strict=True)]
        sizes.append([np.mean(np.abs(part / size)) for part, size in zip(away, (r_c, 1.0, r_w, d), strict=True)])
        standard.append([np.mean((part / error) ** 2) for part, error in zip(away, found.errors, strict=True)])
    r_c, beta, r_w, d = np.mean(sizes, axis=0) * [100, 180 / np.pi, 100, 100]
    assert r_c == pytest.approx(0.089, rel=0.35)
    assert 0.001 < r_w < 0.006
    assert 0.004 < d < 0.018
    assert beta == pytest.approx(0.008, rel=0.35)
    assert np.all(np.sqrt(np.mean(standard, axis=0)) < 1.3)


def test_castors_that_still_swing_in_are_waited_for(exact_motion):
    true = wrong(n_castor(3), seed=5)
    theta = [angle + 0.8 for angle in steady(true, 1, 1)]
    turns = all_turns(exact_motion, true)
    turns[1] = turn(exact_motion, true, 1, 1, theta=theta, radians=4 * np.pi)
    lengths, zeros = off(calibrate(n_castor(3), turns).applied(), true)
    assert lengths < 1e-3
    assert zeros < 2e-3


def test_a_castor_that_was_never_free_keeps_its_numbers(exact_motion):
    true = wrong(n_castor(2), seed=3)
    found = calibrate(n_castor(2), all_turns(exact_motion, true, held=[1]))
    assert found.applied().castors[0] == n_castor(2).castors[0]
    assert found.applied().castors[1].offset == pytest.approx(true.castors[1].offset, rel=1e-6)


def test_what_cannot_be_used_is_refused_with_what_to_record(exact_motion):
    robot = n_castor(3)
    cw, ccw = all_turns(exact_motion, robot, held=[1])
    with pytest.raises(InputError, match="no log; record a turn"):
        calibrate(robot, [])
    with pytest.raises(InputError, match="one direction only; record one counter-clockwise"):
        calibrate(robot, [cw])
    with pytest.raises(InputError, match="one direction only; record one clockwise"):
        calibrate(robot, [ccw])
    with pytest.raises(InputError, match="castor 4 cannot have been held"):
        calibrate(robot, [cw, Turn(ccw.log, 4)])
    with pytest.raises(InputError, match="castor 2 was not held: its wheels turned"):
        calibrate(robot, [Turn(cw.log, 2), Turn(ccw.log, 2)])
    still = dataclasses.replace(ccw.log, wheel=0 * ccw.log.wheel, pivot=0 * ccw.log.pivot + ccw.log.pivot[0])
    with pytest.raises(InputError, match=r"turned by -?0\.0 deg .* at least half a turn"):
        calibrate(robot, [cw, Turn(still, 1)])
    slipped = ccw.log.wheel.copy()
    slipped[60:, 3] += 800.0
    with pytest.raises(InputError, match=r"wheel 2r slipped .* lower voltage"):
        calibrate(robot, [cw, Turn(dataclasses.replace(ccw.log, wheel=slipped), 1)])
    jumping = ccw.log.pivot + np.linspace(0, 6000, len(ccw.log))[:, None]
    jumping[30:, 1] += 3000.0
    with pytest.raises(InputError, match="pivot 2 jumps by over half a turn at row 31"):
        calibrate(robot, [cw, Turn(dataclasses.replace(ccw.log, pivot=jumping), 1)])


@pytest.mark.parametrize(
    ("name", "said"), [("1-castor", "one castor"), ("differential", "one castor"), ("swerve", "two")]
)
def test_other_robots_are_refused(name, said):
    with pytest.raises(InputError, match=said):
        calibrate(preset(name), [])


def driven(robot, held, direction, voltage):
    """A log of the base in physics, castor `held` blocked, all other wheels at one voltage."""
    trajectory = pivoting(robot.castors[held - 1].pivot, direction, angle=2.6 * np.pi, speed=0.5, acceleration=0.3)
    env = RecordLog(
        gym.make("castor_envs:castor/ASOC-v1", robot=robot, trajectory=trajectory, control="voltage", held=held)
    )
    env.reset(seed=held)
    done = False
    while not done:
        _, _, terminated, truncated, _ = env.step(np.full(6, voltage, dtype=np.float32))
        done = terminated or truncated
    return Turn(env.log(), held)


def test_driven_in_physics_at_a_low_voltage_and_refused_at_a_high_one():
    """Slip in proportion to force leaves some tenths of a per cent; a base that slips drags the held castor along."""
    described = preset("asoc-prototype")
    true = wrong(described, seed=1)
    before, _ = off(described, true)
    turns = [driven(true, held, way, 0.2) for held in (1, 2, 3) for way in ("cw", "ccw")]
    lengths, zeros = off(calibrate(described, turns).applied(), true)
    assert before > 0.03
    assert lengths < 0.01
    assert zeros < np.radians(0.15)
    fast = [driven(true, 1, way, 0.6) for way in ("cw", "ccw")]
    with pytest.raises(InputError, match=r"castor 1 was not held: its wheels turned by .* lower voltage"):
        calibrate(described, fast)


def test_a_castor_without_motors_cannot_be_held():
    with pytest.raises(InputError, match="no castor 2 with driven wheels to hold"):
        gym.make("castor_envs:castor/ASOC-v1", robot="tricycle", held=2)
