"""What disturbs encoders: only what is meant to be disturbed is, by as much as is said."""

import cmath

import numpy as np
import pytest

from benchmarks.tasks.driving.disturbances import FAULTS, faults_of, faulty, slip_bursts, soft_floor, wheel_places
from benchmarks.tasks.driving.drive import Drive
from castor_envs.floor import Patch
from castor_envs.vehicles.presets import preset

PROTOTYPE = preset("asoc-prototype")


def even_drive(robot, seconds=60.0):
    """A made-up drive in which all joints turn evenly; disturbances do not ask whether a robot could do it."""
    t = np.arange(0.0, seconds + 0.025, 0.05)
    n, w = len(robot.castors), len(robot.wheels)
    pose = np.stack([0.3 * t, 0.1 * np.sin(t), 0.2 * t], axis=-1)
    wheel, castor = np.outer(t, np.linspace(2.0, 5.0, w)), np.outer(t, np.linspace(-0.5, 0.7, n))
    commands = np.zeros((len(t), len(robot.driven_wheels))), np.zeros((len(t), len(robot.driven_castors)))
    return Drive(t, pose, wheel, castor, np.full(len(t), 0.2), *commands)


def test_wheels_touch_the_floor_where_complex_numbers_say():
    true = even_drive(PROTOTYPE, 5.0)
    for k in (0, 37, 100):
        x, y, psi = true.pose[k]
        places = []
        for castor, theta in zip(PROTOTYPE.castors, true.castor[k], strict=True):
            for wheel in castor.wheels:
                on_body = complex(*castor.pivot) + cmath.exp(1j * theta) * complex(-castor.offset, wheel.lateral)
                places.append(complex(x, y) + cmath.exp(1j * psi) * on_body)
        found = wheel_places(PROTOTYPE, true)[k]
        np.testing.assert_allclose(found[:, 0] + 1j * found[:, 1], places, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_bursts_of_slip_are_as_long_and_as_strong_as_said(seed):
    true = even_drive(PROTOTYPE)
    read = slip_bursts(PROTOTYPE, true, np.random.default_rng(seed))
    assert read.pose is true.pose
    assert read.castor is true.castor
    more = np.diff(read.wheel, axis=0) / np.diff(true.wheel, axis=0) - 1.0
    slipping = np.abs(more) > 1e-9
    assert 150 <= slipping.sum() <= 160 + 30 * 30  # the leg of 8 s, and bursts of up to 1.5 s
    assert np.abs(more).max() <= 0.55 + 1e-9  # at most a burst on the leg
    assert (np.abs(np.abs(more[slipping]) - 0.05) < 1e-9).any()
    assert slipping.mean() < 0.1


def test_wheels_turn_farther_on_carpets_by_what_their_radius_shrinks():
    true = even_drive(PROTOTYPE, 20.0)
    everywhere = Patch(center=(0.0, 0.0), size=(100.0, 100.0), friction=0.5)
    read = soft_floor(PROTOTYPE, true, [everywhere], [0.01])
    np.testing.assert_allclose(read.wheel, true.wheel / 0.99, rtol=1e-12)
    nowhere = Patch(center=(0.0, 50.0), size=(1.0, 1.0), friction=0.5)
    np.testing.assert_allclose(soft_floor(PROTOTYPE, true, [nowhere], [0.01]).wheel, true.wheel, rtol=1e-12)


def test_only_wheels_on_a_carpet_are_disturbed():
    true = even_drive(PROTOTYPE, 20.0)
    turned = Patch(center=(2.0, 0.1), size=(1.0, 0.3), friction=0.5, angle=0.4)
    read = soft_floor(PROTOTYPE, true, [turned], [0.01])
    place = wheel_places(PROTOTYPE, true)
    local = (place[..., 0] - 2.0 + 1j * (place[..., 1] - 0.1)) * np.exp(-0.4j)
    on = (np.abs(local.real) <= 0.5) & (np.abs(local.imag) <= 0.15)
    more = np.diff(read.wheel, axis=0) / np.diff(true.wheel, axis=0)
    assert 0.02 < on.mean() < 0.5
    np.testing.assert_allclose(more, np.where(on[1:], 1 / 0.99, 1.0), rtol=1e-9)


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("seed", range(3))
def test_one_encoder_fails_and_stays_so(fault, seed):
    true = even_drive(PROTOTYPE)
    read = faulty(PROTOTYPE, true, fault, np.random.default_rng(seed))
    off = np.concatenate([read.wheel - true.wheel, read.castor - true.castor], axis=1)
    (failed,) = np.flatnonzero(np.abs(off).max(axis=0) > 0)
    assert (failed < len(PROTOTYPE.wheels)) == fault.endswith("wheel")
    first = np.flatnonzero(off[:, failed])[0]
    assert 0.2 * len(true.t) <= first + 1 <= 0.5 * len(true.t) + 2
    after = np.concatenate([read.wheel, read.castor], axis=1)[first:, failed]
    rate = np.concatenate([true.wheel, true.castor], axis=1)[1, failed] / true.t[1]
    kind = fault.split()[0]
    if kind in ("dead", "frozen"):
        assert np.ptp(after) == 0.0
    elif kind == "late":
        late = -off[first:, failed] / rate
        assert np.ptp(late) < 1e-9
        assert 0.1 <= late[0] <= 0.4
    else:
        count = 2 * np.pi / (1200 if fault == "noisy wheel" else 5143)
        assert np.std(off[first:, failed]) == pytest.approx(10 * count, rel=0.15)


def test_robots_without_pivot_encoders_have_faults_of_wheels_alone():
    assert all(fault.endswith("wheel") for fault in faults_of(preset("omni3")))
    assert faults_of(preset("swerve")) == FAULTS
