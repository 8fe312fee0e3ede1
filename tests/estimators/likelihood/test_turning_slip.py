"""Slip of contacts that turn on the floor, beside slip of those that roll: drives made by random numbers alone."""

import numpy as np
import pytest

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.presets import preset
from estimators.calibration.maximum_likelihood.fit import fitted
from estimators.likelihood.log_likelihood import LogLikelihood, Noise

ROBOT = preset("tricycle")
STEP, SIDES, PART = 0.05, 16, 40
"""s; sides that are driven; and samples in which the robot drives along one, or steers, between two reference poses."""


def corners() -> tuple[Array, Array]:
    """Steering angle (K,), rad, and way (K - 1,), m, of a wheel that is steered only where it stands."""
    steering, way, at = [0.0], [], 0.0
    for side in range(SIDES):
        to = np.pi / 2 * (side % 2) if side % 4 < 2 else -np.pi / 2 * (side % 2)
        steered = np.linspace(at, to, PART + 1)[1:]
        steering += [*steered, *[to] * PART]
        way += [0.0] * len(steered) + [0.015 if side % 2 == 0 else 0.01] * PART
        at = to
    return np.array(steering), np.array(way)


def driven(seed: int, along: float, turning: float) -> Log:
    """A log in which the front contact slips, m: along after 1 m of way; turning, both ways, after 1 rad of turning."""
    random, base = np.random.default_rng(seed), ROBOT.castors[0].pivot[0]
    steering, way = corners()
    angle = (steering[1:] + steering[:-1]) / 2
    turned = np.abs(np.diff(steering) + way * np.sin(angle) / base)
    pose = np.zeros((len(steering), 3))
    for k, theta in enumerate(angle):
        rolled = way[k] + along * np.sqrt(way[k]) * random.normal() + turning * np.sqrt(turned[k]) * random.normal()
        side = turning * np.sqrt(turned[k]) * random.normal()
        forward, left = rolled * np.cos(theta) - side * np.sin(theta), rolled * np.sin(theta) + side * np.cos(theta)
        psi = pose[k, 2] + left / base / 2
        pose[k + 1] = pose[k] + [forward * np.cos(psi), forward * np.sin(psi), left / base]
    front = ROBOT.castors[0]
    per_turn = np.array([front.pivot_counts_per_rev, front.wheels[0].counts_per_rev]) / (2 * np.pi)
    wheel = np.concatenate([[0.0], np.cumsum(way)]) / front.wheels[0].radius
    counts = np.round(np.column_stack([steering, wheel]) * per_turn)
    reference = pose + random.normal(size=pose.shape) * 1e-4
    reference[np.arange(len(pose)) % PART > 0] = np.nan
    return Log(t=STEP * np.arange(len(pose)), wheel=counts[:, 1:], pivot=counts[:, :1], reference=reference)


def estimated(along: float, turning: float) -> Noise:
    geometry = Geometry.of(ROBOT)
    models = [LogLikelihood(geometry, driven(seed, along, turning), seed) for seed in range(2)]
    return fitted(models, geometry, (), np.zeros(0), None, probes=16)[1]


@pytest.mark.parametrize(("along", "turning"), [(2e-3, 4e-3), (4e-3, 1e-3)])
def test_both_kinds_of_slip_are_as_large_as_they_were_made(along, turning):
    """Of each kind of motion 32 parts, of three numbers each, determine it: 10 % (standard deviation)."""
    noise = estimated(along, turning)
    assert noise.along == pytest.approx(along, rel=0.4)
    assert noise.turning == pytest.approx(turning, rel=0.4)


def test_a_wheel_that_holds_where_it_is_steered_shows_no_slip_there():
    noise = estimated(2e-3, 0.0)
    assert noise.along == pytest.approx(2e-3, rel=0.4)
    assert noise.turning < 3e-4
