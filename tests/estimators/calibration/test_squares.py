"""Maximum likelihood on squares whose reference is measured at start and end only: what these say, and what not."""

import dataclasses

import numpy as np
import pytest

from castor_envs.geometry.se2 import compose
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import umbmark, wander
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.axle import with_axle
from castor_envs.vehicles.presets import preset
from estimators.calibration.maximum_likelihood.calibrate import calibrate
from estimators.likelihood.log_likelihood import Noise, moved_along

SLIP = 3e-4
"""m after 1 m, of each wheel."""


def driven(robot, trajectory, random, slip=SLIP):
    """A log of rolling with slip, rounded counts and true poses."""
    run, geometry = roll(robot, trajectory), Geometry.of(robot)
    radius = np.array([wheel.radius for wheel in robot.wheels])
    way = np.abs(np.diff(run.wheel_angle, axis=0, prepend=run.wheel_angle[:1])) * radius
    slipped = np.cumsum(slip * np.sqrt(way) * random.normal(size=way.shape), axis=0) / radius
    encoders = Encoders(geometry, Encoders.random_phase(geometry, random))
    counts = encoders.wheel(run.wheel_angle + slipped), encoders.pivot(run.castor_angle)
    return Log(run.t, *counts, reference=run.pose)


def taped(log, random, position=1e-3, heading=2e-3):
    """The log with the reference of its first and last row only, as measured with a tape."""
    reference = np.full_like(log.reference, np.nan)
    noise = random.normal(size=(2, 3)) * [position, position, heading]
    reference[[0, -1]] = log.reference[[0, -1]] + noise
    return dataclasses.replace(log, reference=reference)


def squares(robot, random, repeats=1, side=1.0, **measured):
    """Squares both ways."""
    paths = [umbmark(way, side=side) for way in ("cw", "ccw") for _ in range(repeats)]
    return [taped(driven(robot, path, random), random, **measured) for path in paths]


def differential(seed):
    """A robot, sampled at 10 Hz, and its file with a wheel base off by up to 2 %, diameters by up to 1 %."""
    random = np.random.default_rng([seed, 1])
    true = dataclasses.replace(preset("differential"), sample_period=0.1)
    left, right = true.wheels
    base = (left.lateral - right.lateral) * (1 + random.uniform(-0.02, 0.02))
    return with_axle(true, base, *(0.15 * (1 + random.uniform(-0.01, 0.01, 2)))), true


def axle(robot):
    """What closed squares show of a differential robot: wheel base over mean radius, and the ratio of the radii."""
    left, right = robot.wheels
    return np.array([(left.lateral - right.lateral) / (left.radius + right.radius), left.radius / right.radius])


@pytest.mark.parametrize("seed", range(3))
def test_taped_squares_tell_the_axle_and_say_that_the_tracked_point_is_not_seen(seed):
    described, true = differential(seed)
    logs = squares(true, np.random.default_rng(seed))
    found = calibrate(described, logs)
    before, after = (np.abs(axle(robot) / axle(true) - 1) for robot in (described, found.calibrated))
    assert np.all(after < [2e-3, 5e-4])
    assert after.max() < before.max() / 3
    known = calibrate(described, logs, noise=Noise(along=SLIP, across=SLIP, position=1e-3, heading=2e-3))
    assert not known.mount_seen.any()
    assert np.all(np.abs(known.mount) < 3 * known.mount_errors)


def test_taped_squares_tell_a_base_on_castors():
    random = np.random.default_rng(3)
    described = dataclasses.replace(preset("asoc-prototype"), sample_period=0.1)
    castors = tuple(
        dataclasses.replace(
            castor,
            offset=castor.offset * (1 + random.uniform(-0.03, 0.03)),
            pivot_zero=castor.pivot_zero + random.uniform(-0.05, 0.05),
        )
        for castor in described.castors
    )
    true = dataclasses.replace(described, castors=castors)
    found = calibrate(described, squares(true, random))
    for kind, limit in (("offset", 5e-3), ("pivot_zero", 5e-3)):
        rows = [p.kind == kind for p in found.parameters]
        off = found.after[rows] - [getattr(castor, kind) for castor in true.castors]
        scale = np.array([p.scale for p in found.parameters])[rows]
        assert np.abs(off / scale).max() < limit


def test_a_tracked_point_off_the_origin_is_found_where_the_reference_shows_it():
    described, true = differential(4)
    random, mount = np.random.default_rng(4), np.array([0.2, -0.1, 0.3])
    log = driven(true, wander(random, duration=25.0, holonomic=False), random)
    assert log.reference is not None
    noise = random.normal(size=log.reference.shape) * [1e-3, 1e-3, 2e-3]
    found = calibrate(described, [dataclasses.replace(log, reference=compose(log.reference, mount) + noise)])
    assert found.mount_seen.all()
    assert np.all(np.abs(found.mount - mount) < np.minimum(4 * found.mount_errors, [0.02, 0.02, 0.02]))


def test_slip_of_repeated_squares_is_what_went_in():
    """Ends measured exactly: 24 numbers, of which two parameters take two, give it to 15 % (standard deviation)."""
    described, true = differential(5)
    found = calibrate(described, squares(true, np.random.default_rng(5), repeats=4, position=0.0, heading=0.0))
    assert 0.55 * SLIP < found.noise.along < 1.45 * SLIP


def test_a_path_that_turns_as_a_whole_keeps_its_shape():
    random = np.random.default_rng(6)
    state = np.column_stack([np.cumsum(random.normal(size=(30, 3)), axis=0), random.normal(size=(30, 2))])
    x, y = (state[:, :2] - state[0, :2]).T
    turn = 0.3
    step = np.column_stack([-turn * y, turn * x, np.full(30, turn), np.ones((30, 2))])
    moved = moved_along(state, step)
    c, s = np.cos(turn), np.sin(turn)
    np.testing.assert_allclose(moved[:, :2] - state[0, :2], np.column_stack([c * x - s * y, s * x + c * y]), atol=1e-12)
    np.testing.assert_array_equal(moved[:, 2:], (state + step)[:, 2:])
