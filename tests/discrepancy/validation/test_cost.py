"""What an effect costs in use, against what is known in closed form."""

# pyright: reportOperatorIssue=false

import numpy as np
import pytest

from castor_envs.effects.dimensions import AllWheelRadius
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import preset
from discrepancy.validation.cost import cost_of

ROBOT = preset("asoc-prototype")


def test_what_an_effect_costs_is_what_odometry_is_off():
    """A straight drive with all wheels 1 % too large: 10 cm in 10 m; nothing for a clean one."""
    t = np.linspace(0, 20, 401)
    counts = np.tile((t * 0.5 / ROBOT.wheels[0].radius * ROBOT.wheels[0].counts_per_rev / (2 * np.pi))[:, None], (1, 6))
    log = Log(t, counts, np.zeros((401, 3)))
    assert cost_of(ROBOT, AllWheelRadius(value=0.01), [log]) == pytest.approx(0.1, rel=1e-3)
    assert cost_of(ROBOT, AllWheelRadius(value=0.0), [log]) == 0.0
    assert cost_of(ROBOT, AllWheelRadius(value=0.01), [Log(t, counts * 0, np.zeros((401, 3)))]) is None
