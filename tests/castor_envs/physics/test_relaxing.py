"""Creep of contacts whose bristles relax, against the bristle's equation solved by itself."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from castor_envs.physics.contact_motion import relaxed

LENGTH = 0.01
PERIOD = 5e-4


def test_creep_follows_the_bristles_through_a_stop_and_back():
    """Two contacts of which one slips twice as much; they stop for half a second, and go back."""
    t = PERIOD * np.arange(3000)

    def rolling(t):
        return 0.2 * np.abs(np.sin(2 * np.pi * t)) * ((t < 0.5) | (t > 1.0))

    def slipping(t):
        return 0.01 * np.where(t < 0.75, rolling(t), -rolling(t))

    solution = solve_ivp(
        lambda t, z: slipping(t) - rolling(t) * z / LENGTH, (0.0, t[-1]), [0.0], t_eval=t, rtol=1e-9, max_step=1e-3
    )
    middle = t - PERIOD / 2
    speed, period = np.stack([rolling(middle)] * 2, axis=1), np.full(len(t), PERIOD)
    creeping = relaxed(np.stack([slipping(middle), 2 * slipping(middle)], axis=1), speed, period, LENGTH)
    expected = rolling(t) * solution.y[0] / LENGTH
    assert creeping[:, 0] == pytest.approx(expected, abs=0.01 * np.abs(expected).max())
    assert creeping[:, 1] == pytest.approx(2 * creeping[:, 0])


def test_contacts_that_roll_on_creep_as_they_slip():
    """After five relaxation lengths nothing of the bristles' beginning is left, but exp(-5)."""
    steps = round(5 * LENGTH / (0.1 * PERIOD))
    creeping = relaxed(np.full((steps, 1), 1e-3), np.full((steps, 1), 0.1), np.full(steps, PERIOD), LENGTH)
    assert creeping[-1, 0] == pytest.approx(1e-3 * (1 - np.exp(-5.0)), rel=1e-3)


def test_contacts_at_a_stop_hardly_creep():
    """What wheels disagree by less than bristles deflect is no creep: 10 um in all, at a hundredth of the length."""
    steps = 100
    slipping, rolling = np.full((steps, 1), 1e-7 / PERIOD), np.full((steps, 1), 1e-6 / PERIOD)
    crept = np.sum(relaxed(slipping, rolling, np.full(steps, PERIOD), LENGTH)) * PERIOD
    assert crept < 1e-5 * 1e-4 / LENGTH
