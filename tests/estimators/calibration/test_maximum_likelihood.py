# pyright: reportOptionalIterable=false, reportAttributeAccessIssue=false, reportArgumentType=false
# pyright: reportOptionalSubscript=false, reportOptionalOperand=false, reportOperatorIssue=false, reportGeneralTypeIssues=false

"""Calibration by maximum likelihood: against rolling integrated by other code, arcs in closed form and eqs. 1-9."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

from castor_envs.errors import InputError
from castor_envs.logs.importers.optiodom import find_sessions, published_correction, read_session
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import cfmmr, n_castor, preset
from estimators.calibration import pivoting
from estimators.calibration.maximum_likelihood.calibrate import calibrate
from estimators.likelihood.log_likelihood import Noise

KNOWN, NONE = Noise(along=1e-3, across=1e-3), Noise(along=1e-5, across=1e-5)


def twist(seed, speed=0.12):
    """A smooth random body twist in which all three components change sign."""
    random = np.random.default_rng(seed)
    size = random.uniform(0.4, 1.0, (3, 2)) * np.array([[speed], [speed], [2 * speed]])
    rate, phase = random.uniform(0.3, 0.8, (3, 2)), random.uniform(0, 2 * np.pi, (3, 2))
    return lambda t: tuple(np.sum(size * np.sin(rate * t + phase), axis=1))


def log_of(motion, period, *, rounded=False, random=None, slip=0.0, reference=None):
    """A log of an exact motion. slip: of each wheel, m after 1 m of the wheel that rolls farthest; reference: noise (m,
    rad) of poses; None: none."""
    random = np.random.default_rng(0) if random is None else random
    poses, seen = motion.sampled(round(motion.duration / period))
    per_metre = np.array([w.counts_per_rev / (2 * np.pi * w.radius) for w in motion.robot.wheels])
    rolled = np.array([observation["wheel"] for observation in seen]) / per_metre
    rolled += slip * np.sqrt(np.abs(rolled).max(axis=1, keepdims=True)) * random.normal(size=rolled.shape)
    wheel, pivot = np.cumsum(rolled, axis=0) * per_metre, np.array([observation["pivot"] for observation in seen])
    if rounded:
        wheel, pivot = np.round(wheel + random.uniform(size=wheel.shape[1])), np.round(pivot)
    if reference is not None:
        poses = poses + random.normal(size=poses.shape) * np.array([reference[0], reference[0], reference[1]])
    return Log(period * np.arange(len(wheel)), wheel, pivot, reference=poses if reference is not None else None)


def wander_of(exact_motion, robot, seed, seconds=25.0, speed=0.12):
    theta = np.random.default_rng([seed, 9]).uniform(-np.pi, np.pi, len(robot.castors))
    return exact_motion(robot, twist(seed, speed), seconds, theta=theta)


def numbers_of(robot, parameters):
    """What a robot file says of parameters, read here once more."""
    found = []
    for p in parameters:
        castor = robot.castors[p.castor]
        if p.wheel is not None:
            found.append(getattr(robot.wheels[p.wheel], p.kind))
        elif p.kind.startswith("pivot_") and p.kind != "pivot_zero":
            found.append(castor.pivot["xy".index(p.kind[-1])])
        else:
            found.append(getattr(castor, p.kind))
    return np.array(found)


def wrong(robot, seed, size=0.04, bias=0.1):
    """The robot as it truly is, where the file has errors of parameters but not of the pivots' places."""
    random = np.random.default_rng(seed)

    def of_wheel(wheel):
        off = 1 + random.uniform(-size, size, 2)
        return dataclasses.replace(wheel, radius=wheel.radius * off[0], lateral=wheel.lateral * off[1])

    castors = tuple(
        dataclasses.replace(
            castor,
            offset=castor.offset * (1 + random.uniform(-size, size)),
            pivot_zero=castor.pivot_zero + random.uniform(-bias, bias),
            wheels=tuple(map(of_wheel, castor.wheels)),
        )
        for castor in robot.castors
    )
    return dataclasses.replace(robot, castors=castors)


def off(found, true):
    """Errors of what was found over scales (relative for lengths, rad)."""
    away = found.after - numbers_of(true, found.parameters)
    return away / np.array([p.scale for p in found.parameters])


# Bases on split castors.


@pytest.mark.parametrize("n", [2, 3, 4])
def test_finds_every_parameter_without_reference_and_to_fourth_order(n, exact_motion):
    true = wrong(n_castor(n), n)
    motion = wander_of(exact_motion, true, n)
    errors = {}
    for period in (0.08, 0.04):
        found = calibrate(n_castor(n), [log_of(motion, period)], noise=NONE)
        assert len(found.unseen) == 0
        assert found.left is None
        assert {p.kind for p in found.parameters} == {"radius", "lateral", "offset", "pivot_zero"}
        np.testing.assert_array_equal(found.before, numbers_of(n_castor(n), found.parameters))
        np.testing.assert_array_equal(found.after, numbers_of(found.calibrated, found.parameters))
        errors[period] = np.abs(off(found, true)).max()
    assert errors[0.04] < 1e-6
    assert 9 < errors[0.08] / errors[0.04] < 28  # 16, were there nothing but the fourth order's term


def steady(robot, held, sense):
    """Angles of castors that have long swung in while the base turns about a pivot; the held one's is any."""
    pivots = np.array([complex(*castor.pivot) for castor in robot.castors])
    arms = pivots - pivots[held]
    return [
        0.7 if arm == 0 else np.angle(sense * 1j * arm) - sense * np.arcsin(castor.offset / abs(arm))
        for castor, arm in zip(robot.castors, arms, strict=True)
    ]


def turns(exact_motion, robot, seed, theta=None):
    """Logs of full turns, both ways, about every pivot, as `pivoting.Turn`; rounded counts of random phase."""
    found, random = [], np.random.default_rng([seed, 1])
    for held in range(len(robot.castors)):
        x, y = robot.castors[held].pivot
        for sense in (-1, 1):
            rate = 0.5 * sense
            angles = steady(robot, held, sense) if theta is None else theta(random)
            motion = exact_motion(robot, lambda t, r=rate, x=x, y=y: (r * y, -r * x, r), 4 * np.pi, theta=angles)
            found.append(pivoting.Turn(log_of(motion, 4 * np.pi / 251, rounded=True, random=random), held + 1))
    return found


@pytest.mark.parametrize(("n", "robots"), [(2, 3), (3, 1)])
def test_steady_turns_agree_with_equations_1_to_9(n, robots, exact_motion):
    """With two castors eqs. 1-9 have one estimate of each, and their standard error is that of rounding alone."""
    for seed in range(robots):
        true = wrong(n_castor(n), seed)
        runs = turns(exact_motion, true, seed)
        closed = pivoting.calibrate(n_castor(n), runs)
        found = calibrate(n_castor(n), [run.log for run in runs])
        offsets = [p.kind == "offset" for p in found.parameters]
        error = found.standard_errors[offsets]
        apart = (found.after[offsets] - closed.parameters.offset) / error
        assert np.sqrt(np.mean(apart**2)) < 0.15
        assert np.abs(apart).max() < 0.2
        if n == 2:
            np.testing.assert_allclose(error, closed.errors.offset, rtol=0.2)


def test_swinging_castors_show_more_than_steady_ones(exact_motion):
    errors = {"likely": [], "closed": []}
    for seed in range(3):
        described = preset("asoc-prototype")
        true = wrong(described, seed)
        runs = turns(exact_motion, true, seed, theta=lambda random: random.uniform(-np.pi, np.pi, 3))
        likely = calibrate(described, [run.log for run in runs], noise=Noise()).calibrated
        closed = pivoting.calibrate(described, turns(exact_motion, true, seed)).applied()
        for name, robot in (("likely", likely), ("closed", closed)):
            pairs = list(zip(robot.castors, true.castors, strict=True))
            errors[name].append([[abs(a.offset - b.offset), abs(a.pivot_zero - b.pivot_zero)] for a, b in pairs])
    (r_c, beta), (r_c_closed, beta_closed) = (np.mean(errors[name], axis=(0, 1)) for name in ("likely", "closed"))
    assert r_c < r_c_closed / 2
    assert beta < beta_closed / 2


@pytest.mark.slow
def test_intervals_cover_and_noise_is_found(exact_motion):
    z, position, heading, along = [], [], [], []
    for seed in range(8):
        described = n_castor(2 + seed % 2)
        true, random = wrong(described, seed), np.random.default_rng([seed, 2])
        motion = wander_of(exact_motion, true, 20 + seed, seconds=60.0, speed=0.2)
        log = log_of(motion, 0.12, rounded=True, random=random, slip=1e-3, reference=(2e-3, 4e-3))
        found = calibrate(described, [log])
        assert len(found.unseen) == 0
        z.extend((found.after - numbers_of(true, found.parameters)) / found.standard_errors)
        position.append(found.noise.position)
        heading.append(found.noise.heading)
        along.append(found.noise.along)
        before, after = found.left
        assert after < before / 3
    assert 0.9 <= np.mean(np.abs(z) < 1.96) <= 0.995
    assert np.sqrt(np.mean(np.square(position))) == pytest.approx(2e-3, rel=0.3)
    assert np.sqrt(np.mean(np.square(heading))) == pytest.approx(4e-3, rel=0.3)
    assert np.sqrt(np.mean(np.square(along))) == pytest.approx(1e-3, rel=0.15)


# Other robots, in closed form.

PERIOD = 0.05


def arcs(seed, count=40, samples=40, sideways=False):
    """Body twists (K, 3) of constant arcs of 2 s, with rests of 0.5 s between them; None where the robot rests."""
    random = np.random.default_rng(seed)
    twists = []
    for _ in range(count):
        way = random.uniform(-np.pi, np.pi) if sideways else random.choice([0.0, np.pi])
        motion = np.array([0.25 * np.cos(way), 0.25 * np.sin(way) * sideways, random.uniform(-0.8, 0.8)])
        twists += [*np.tile(motion, (samples, 1)), *np.zeros((10, 3))]
    return np.array(twists)


def along(twists, period=PERIOD):
    """Poses (K + 1, 3) after arcs, in closed form."""
    poses = [np.array([0.3 + 0.2j, 0.5])]
    for v_x, v_y, omega in twists:
        place, psi = poses[-1]
        arc = period if omega == 0 else (np.exp(1j * omega * period) - 1) / (1j * omega)
        poses.append(np.array([place + np.exp(1j * psi.real) * (v_x + 1j * v_y) * arc, psi + omega * period]))
    poses = np.array(poses)
    return np.column_stack([poses[:, 0].real, poses[:, 0].imag, poses[:, 1].real])


def recorded(rolled, radii, per_rev, pivot, poses, seed=0):
    """A log of rolled distances (K, d), m, in every step; reference poses are off by 2 mm and 4 mrad."""
    random = np.random.default_rng([seed, 3])
    counts = np.cumsum(np.vstack([0 * rolled[:1], rolled]), axis=0) / (2 * np.pi * np.array(radii)) * per_rev
    noisy = poses + random.normal(size=poses.shape) * [2e-3, 2e-3, 4e-3]
    wheel = np.round(counts + random.uniform(size=counts.shape[1]))
    return Log(PERIOD * np.arange(len(poses)), wheel, pivot, reference=noisy)


def differential_log(base=0.345, radii=(0.0742, 0.0756), seed=0, **options):
    twists = arcs(seed, **options)
    sides = twists[:, :1] + twists[:, 2:] * np.array([-base / 2, base / 2])
    poses = along(twists)
    return recorded(sides * PERIOD, radii, 2000.0, np.zeros((len(poses), 0)), poses, seed)


def tricycle_log(length=0.51, radius=0.0741, zero=0.02094395, seed=0, count=40):
    """The front wheel steers at rest; its place is on the body's x axis, as the preset's."""
    random = np.random.default_rng(seed)
    speed, steering = [], [0.0]
    for _ in range(count):
        angle, way = random.uniform(-1.2, 1.2), random.choice([-0.25, 0.25])
        steering += [*np.linspace(steering[-1], angle, 21)[1:], *np.full(40, angle)]
        speed += [*np.zeros(20), *np.full(40, way)]
    speed, theta = np.array(speed), np.array(steering)
    twists = np.column_stack([speed * np.cos(theta[1:]), 0 * speed, speed * np.sin(theta[1:]) / length])
    pivot = np.round((theta[:, None] + zero) / (2 * np.pi) * 5143)
    return recorded(speed[:, None] * PERIOD, [radius], 2000.0, pivot, along(twists), seed)


OMNI = (np.array([0.0505, 0.0513, 0.0511]), np.array([-0.01, 0.02, 0.005]), np.array([0.196, 0.193, 0.1965]))
"""Radii, m; by how much each wheel is turned, rad; and distances, m, of a true robot."""


def omni_rows(angle, lever, radius):
    """Rows (3, 3): how far (rad) each wheel turns by the body's v_x, v_y, omega."""
    return np.column_stack([np.cos(angle), np.sin(angle), lever]) / np.array(radius)[:, None]


def omni_log(seed=0, count=40):
    radius, turned, distance = OMNI
    bearing = np.array([-np.pi / 3, np.pi / 3, np.pi])
    angle = bearing - np.pi / 2 + turned
    twists = arcs(seed, count=count, sideways=True)
    rolled = twists @ omni_rows(angle, -distance * np.cos(turned), np.ones(3)).T * PERIOD
    poses = along(twists)
    return recorded(rolled, radius, 12 * 1024, np.zeros((len(poses), 0)), poses, seed)


def test_a_differential_robot_is_found_by_reference_poses():
    found = calibrate(preset("differential"), [differential_log(seed=1)])
    left, right = found.calibrated.castors[0].wheels
    errors = dict(zip([p.name for p in found.parameters], found.standard_errors, strict=True))
    assert [p.kind for p in found.parameters] == ["radius", "lateral"] * 2
    for wheel, true, name in ((left, 0.0742, "left"), (right, 0.0756, "right")):
        error = errors[f"castor 1 {name} radius"]
        assert 0 < error < 5e-5
        assert wheel.radius == pytest.approx(true, abs=min(4 * error, 1.5e-4))
    track = np.array([p.kind == "lateral" for p in found.parameters]) * np.sign(found.before)
    error = np.sqrt(track @ found.covariance @ track)
    assert 0 < error < 2e-4
    assert left.lateral - right.lateral == pytest.approx(0.345, abs=min(4 * error, 5e-4))
    assert found.left is not None
    assert found.left[1] < found.left[0] / 5


def test_a_tricycle_is_found_by_reference_poses():
    found = calibrate(preset("tricycle"), [tricycle_log(seed=1)])
    true = {"pivot_zero": np.radians(1.2), "pivot_x": 0.51, "pivot_y": 0.0, "radius": 0.0741}
    close = {"pivot_zero": 1e-3, "pivot_x": 1e-3, "pivot_y": 1e-3, "radius": 5e-5}
    assert [p.kind for p in found.parameters] == list(true)
    for p, value, error in zip(found.parameters, found.after, found.standard_errors, strict=True):
        if p.kind == "pivot_y":  # the origin may stand anywhere on the rear axle, with the tracked point
            assert value == pytest.approx(0.0, abs=1e-5)
            assert error < 1e-5
        else:
            assert 0 < error < close[p.kind]
            assert value == pytest.approx(true[p.kind], abs=min(4 * error, close[p.kind]))
    assert len(found.unseen) == 1


def test_an_omni_robot_is_found_by_reference_poses_but_for_its_frame():
    """Seen are three radii, two angles between wheels, and the levers but for a shift of the origin."""
    found = calibrate(preset("omni3"), [omni_log(seed=1)])

    def of_rows(rows):
        radius = 1 / np.hypot(rows[:, 0], rows[:, 1])
        e = rows[:, :2] * radius[:, None]
        angle = np.unwrap(np.arctan2(e[:, 1], e[:, 0]))
        weights = np.linalg.det(np.stack([np.roll(e, -1, axis=0), np.roll(e, 1, axis=0)], axis=1))  # weights @ e = 0
        return np.array([*radius, *np.diff(angle), weights @ (rows[:, 2] * radius) / weights.sum()])

    def of_numbers(after):
        parts = {kind: after[[p.kind == kind for p in found.parameters]] for kind in ("angle", "pivot_x", "pivot_y")}
        angle, x, y = parts.values()
        radius = after[[p.kind == "radius" for p in found.parameters]]
        return of_rows(omni_rows(angle, x * np.sin(angle) - y * np.cos(angle), radius))

    radius, turned, distance = OMNI
    bearing = np.array([-np.pi / 3, np.pi / 3, np.pi])
    true = of_rows(omni_rows(bearing - np.pi / 2 + turned, -distance * np.cos(turned), radius))
    by = np.array([(of_numbers(found.after + d) - of_numbers(found.after - d)) / 2e-6 for d in 1e-6 * np.eye(12)]).T
    error = np.sqrt(np.diag(by @ found.covariance @ by.T))
    away = np.abs(of_numbers(found.after) - true)
    assert np.all(error > 0)
    assert np.all(away < 4 * error)
    assert np.all(away < [1e-4, 1e-4, 1e-4, 5e-3, 5e-3, 1e-3])
    assert len(found.unseen) == 6


# What the reference may be off by.


def nuisance(motion, random, mount, clock, world, seconds):
    """A log whose reference shows at t where a point (x, y) of the body, with axes turned, is at t + late + rate t."""
    t = PERIOD * np.arange(round(seconds / PERIOD) + 1)
    shifted = dataclasses.replace(motion, state=lambda s: motion.state(s + 1.0), duration=seconds)
    log = log_of(shifted, PERIOD, rounded=True, random=random)
    late, rate = clock
    x, y, psi = motion.state(1.0 + t + late + rate * t)[:3]
    place = np.exp(1j * world) * (x + 1j * y + np.exp(1j * psi) * complex(mount[0], mount[1])) + 3 - 2j
    poses = np.column_stack([place.real, place.imag, psi + mount[2] + world])
    noisy = poses + np.random.default_rng(7).normal(size=poses.shape) * [1e-3, 1e-3, 2e-3]
    return dataclasses.replace(log, reference=noisy)


@pytest.fixture(scope="module")
def tracked(exact_motion):
    """A base on three castors as built, its motion, and what a faultless reference reports."""
    true = wrong(n_castor(3), 4)
    motion = wander_of(exact_motion, true, 30, seconds=42.0, speed=0.15)
    plain = calibrate(n_castor(3), [nuisance(motion, np.random.default_rng(1), (0, 0, 0), (0, 0), 0.0, 40.0)])
    return true, motion, plain


@pytest.mark.parametrize("inside", [True, False])
@pytest.mark.parametrize("sign", [1, -1])
def test_tracked_point_axes_and_clock_of_the_reference_are_found(sign, inside, tracked):
    """inside: no pose was taken before the log's first sample or after its last one, by the log's own clock."""
    true, motion, plain = tracked
    mount, clock = np.array([0.03, 0.01, np.radians(2.0)]), sign * np.array([0.12, 1e-3])
    log = nuisance(motion, np.random.default_rng(1), mount, clock, 1.0, 40.0)
    if inside:
        log.reference[[*range(10), *range(-10, 0)]] = np.nan
    found = calibrate(n_castor(3), [log])
    for calibration, place, late in ((plain, 0.0, 0.0), (found, mount, clock)):
        assert (
            np.abs((calibration.after - numbers_of(true, calibration.parameters)) / calibration.standard_errors).max()
            < 4
        )
        np.testing.assert_allclose(calibration.mount, place, atol=3e-3)
        assert np.all(np.abs(calibration.clocks - late) < [0.02, 5e-4])
        assert calibration.noise.position == pytest.approx(1e-3, rel=0.4)
    assert np.abs((found.after - plain.after) / plain.standard_errors).max() < 0.5


# Symmetries.


def base_log(exact_motion, robot, seed, **options):
    motion = wander_of(exact_motion, robot, seed)
    return log_of(motion, 0.1, rounded=True, random=np.random.default_rng(seed), reference=(2e-3, 4e-3), **options)


def mirrored(robot):
    def of(castor):
        wheels = tuple(dataclasses.replace(w, lateral=-w.lateral) for w in castor.wheels[::-1])
        pivot = (castor.pivot[0], -castor.pivot[1])
        return dataclasses.replace(castor, pivot=pivot, pivot_zero=-castor.pivot_zero, wheels=wheels)

    return dataclasses.replace(robot, castors=tuple(map(of, robot.castors)))


def permuted(robot, order):
    return dataclasses.replace(robot, castors=tuple(robot.castors[i] for i in order))


def test_mirror_images_and_orders_change_nothing(exact_motion):
    described, order = n_castor(3), [2, 0, 1]
    logs = [base_log(exact_motion, wrong(described, 5), seed) for seed in (1, 2)]
    found = calibrate(described, logs, noise=KNOWN)
    columns = np.arange(6).reshape(3, 2)
    image = [
        dataclasses.replace(
            log, wheel=log.wheel[:, columns[:, ::-1].ravel()], pivot=-log.pivot, reference=log.reference * [1, -1, -1]
        )
        for log in logs
    ]
    reordered = [
        dataclasses.replace(log, wheel=log.wheel[:, columns[order].ravel()], pivot=log.pivot[:, order]) for log in logs
    ]
    for robot, given, back in (
        (described, logs[::-1], lambda r: r),
        (mirrored(described), image, mirrored),
        (permuted(described, order), reordered, lambda r: permuted(r, np.argsort(order))),
    ):
        again = numbers_of(back(calibrate(robot, given, noise=KNOWN).calibrated), found.parameters)
        assert np.abs((again - found.after) / found.standard_errors).max() < 1e-4


def scaled(robot, by):
    def of(castor):
        wheels = tuple(dataclasses.replace(w, radius=w.radius * by, lateral=w.lateral * by) for w in castor.wheels)
        pivot = (castor.pivot[0] * by, castor.pivot[1] * by)
        return dataclasses.replace(castor, pivot=pivot, offset=castor.offset * by, wheels=wheels)

    return dataclasses.replace(robot, castors=tuple(map(of, robot.castors)))


@pytest.mark.parametrize("pivots", [False, True])
def test_without_reference_the_scale_is_that_described(pivots, exact_motion):
    """Slip per metre grows with the root of the scale; FLOOR and rounding of the arithmetic are left."""
    described = n_castor(3)
    log = dataclasses.replace(base_log(exact_motion, wrong(described, 6), 6), reference=None)
    found = calibrate(described, [log], pivots=pivots, noise=KNOWN)
    slip = KNOWN.along * np.sqrt(1.1)
    larger = calibrate(scaled(described, 1.1), [log], pivots=pivots, noise=Noise(along=slip, across=slip))
    back = numbers_of(scaled(larger.calibrated, 1 / 1.1), found.parameters)
    error = np.maximum(found.standard_errors, 1e-7)
    assert np.abs((back - found.after) / error).max() < 1e-2


# Bad input.


@pytest.fixture(scope="module")
def wandered(exact_motion):
    """A base on two castors as it is described, and as built; a log with reference poses."""
    true = wrong(n_castor(2), 8)
    return n_castor(2), true, base_log(exact_motion, true, 8)


def test_no_log_and_nothing_that_moved_are_refused(wandered):
    described, _, log = wandered
    with pytest.raises(InputError, match="there is no log; record one"):
        calibrate(described, [])
    still = dataclasses.replace(log, wheel=0 * log.wheel, pivot=0 * log.pivot, reference=0 * log.reference)
    for given in (still, dataclasses.replace(still, reference=None)):
        with pytest.raises(InputError, match="no wheel turned in any log; record a drive"):
            calibrate(described, [given])


def test_a_pivot_that_jumps_is_refused(wandered):
    described, _, log = wandered
    pivot = log.pivot.copy()
    pivot[100:, 1] += 8000
    with pytest.raises(InputError, match="pivot 2 jumps by over half a turn at row"):
        calibrate(described, [dataclasses.replace(log, pivot=pivot)])


CHANNELS = {
    "castors swapped": lambda log: {"wheel": log.wheel[:, [2, 3, 0, 1]]},
    "wheels swapped": lambda log: {"wheel": log.wheel[:, [1, 0, 2, 3]]},
    "pivots swapped": lambda log: {"pivot": log.pivot[:, ::-1]},
    "a wheel reversed": lambda log: {"wheel": log.wheel * [-1, 1, 1, 1]},
    "a pivot reversed": lambda log: {"pivot": log.pivot * [-1, 1]},
}


@pytest.mark.parametrize("reference", [True, False])
@pytest.mark.parametrize("name", CHANNELS)
def test_channels_that_contradict_the_robot_are_refused(name, reference, wandered):
    described, _, log = wandered
    log = thinned(log, slice(0, len(log) // 2))
    bad = dataclasses.replace(log, **CHANNELS[name](log))
    with pytest.raises(InputError, match=r"cannot be made to fit .* look for channels that are swapped, reversed"):
        calibrate(described, [bad if reference else dataclasses.replace(bad, reference=None)])


@pytest.mark.parametrize("swap", [True, False])
def test_channels_that_contradict_a_differential_robot_are_refused(swap):
    log = differential_log(seed=2, count=20)
    bad = dataclasses.replace(log, wheel=log.wheel[:, ::-1] if swap else log.wheel * [1, -1])
    with pytest.raises(InputError, match=r"cannot be made to fit .* look for channels that are swapped, reversed"):
        calibrate(preset("differential"), [bad])


def thinned(log, rows):
    return Log(log.t[rows], log.wheel[rows], log.pivot[rows], reference=log.reference[rows])


def test_logs_of_two_rows_are_harmless(wandered):
    described, true, log = wandered
    short = thinned(log, slice(0, 2))
    found = calibrate(described, [log, short], noise=KNOWN)
    alone = calibrate(described, [log], noise=KNOWN)
    assert np.abs((found.after - alone.after) / alone.standard_errors).max() < 0.5
    for step in (short, dataclasses.replace(short, reference=None)):
        blind = calibrate(described, [step])
        assert len(blind.unseen) > 6
        assert np.abs(off(blind, true)).max() < 0.2


@pytest.mark.parametrize("case", ["even", "a fifth missing", "a gap of 5 s", "two logs"])
def test_irregular_samples_and_gaps_do_no_harm(case, exact_motion):
    true = wrong(n_castor(2), 8)
    motion = wander_of(exact_motion, true, 8)
    log = log_of(motion, 0.05, rounded=True, random=np.random.default_rng(8), reference=(2e-3, 4e-3))
    rows = np.arange(len(log))
    before, after = rows[rows < 200], rows[rows >= 300]
    parts = {
        "even": [rows],
        "a fifth missing": [rows[np.random.default_rng(0).uniform(size=len(log)) < 0.8]],
        "a gap of 5 s": [np.concatenate([before, after])],
        "two logs": [before, after],
    }
    found = calibrate(n_castor(2), [thinned(log, part) for part in parts[case]])
    assert np.isfinite(found.after).all()
    assert np.abs((found.after - numbers_of(true, found.parameters)) / found.standard_errors).max() < 4


def test_a_train_is_refused(wandered):
    with pytest.raises(InputError, match="train"):
        calibrate(cfmmr(2), [wandered[2]])


# Measured.


@pytest.fixture(scope="module")
def sessions():
    root = Path(os.environ.get("CASTOR_DATA", ""))
    if not os.environ.get("CASTOR_DATA") or not (root / "optiodom").is_dir():
        pytest.skip("the measured data are absent: CASTOR_DATA names no folder that holds optiodom/")
    return find_sessions(root)


@pytest.mark.slow
def test_measured_tricycle(sessions):
    """The session with the larger residuals of two."""
    session = read_session(sessions["140120211508"])
    found = calibrate(session.robot, session.runs)
    front, _ = found.calibrated.castors
    assert 0.9 < np.degrees(front.pivot_zero) < 1.4
    assert 0.0639 < 2 * front.wheels[0].radius < 0.0648
    assert 0.154 < front.pivot[0] < 0.159
    before, after = found.left
    assert after < min(0.05, before / 5)


@pytest.mark.parametrize("name", ["230620202042", "230620202144"])
def test_measured_differential_agrees_with_the_published_and_held_out_runs(name, sessions):
    session = read_session(sessions[name])
    found = calibrate(session.robot, [session.runs[k - 1] for k in (1, 3, 4, 6)]).calibrated
    left, right = found.castors[0].wheels
    published = published_correction(name)
    ratio = (left.lateral - right.lateral) / (left.radius + right.radius)
    assert ratio == pytest.approx(published.wheel_base / 0.0840, rel=3e-3)
    for k in (2, 5):
        run = session.runs[k - 1]
        step = np.diff(run.wheel, axis=0) * 2 * np.pi / left.counts_per_rev * [left.radius, right.radius]
        turn = (step[:, 1] - step[:, 0]) / (left.lateral - right.lateral)
        middle = run.reference[0, 2] + np.cumsum(turn) - turn / 2
        ahead = step.mean(axis=1)
        end = run.reference[0, :2] + [ahead @ np.cos(middle), ahead @ np.sin(middle)]
        assert np.linalg.norm(run.reference[-1, :2] - end) < 0.015
