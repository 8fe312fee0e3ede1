"""What commands say of the encoders' wiring: a motor turns its own wheel or castor, whatever its encoder shows."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from castor_envs.effects.wiring import CastorOrder, EncoderReversed, EncodersSwapped
from castor_envs.motion.mobility import moves_sideways
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.diagnose import diagnosed
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.preflight import preflight
from discrepancy.preflight.hypotheses import Table
from discrepancy.preflight.likelihood import WiringLikelihood
from discrepancy.preflight.undo import Undone
from discrepancy.trials.cases import motion
from discrepancy.trials.pymunk_generator import drive

WRONG = (
    ("differential", EncodersSwapped(castor=1)),
    ("tricycle", EncoderReversed(castor=1, wheel=1)),
    ("swerve", CastorOrder(castor=2, exchanged_with=3)),
    ("powered-caster", EncoderReversed(castor=1)),
)


@cache
def driven(name, effect=None):
    """A log, with commands, of a robot whose controller reads its encoders as they are connected."""
    robot = preset(name).with_effects(*([] if effect is None else [effect]))
    sideways = moves_sideways(robot)
    return drive(robot, wander(np.random.default_rng(7), duration=12.0, holonomic=sideways), 1, duration=12.0)


@pytest.mark.parametrize(("name", "effect"), WRONG)
def test_commands_tell_wrong_wiring_where_encoders_and_reference_leave_it_open(name, effect):
    found = preflight(preset(name), [driven(name, effect)])
    (mistake,) = found.mistakes
    assert (mistake.effects, mistake.alternatives) == ((effect,), ())
    without = dataclasses.replace(driven(name, effect), command=None, steering_command=None)
    told = preflight(preset(name), [without]).mistakes
    assert not any(mistake.effects == (effect,) and not mistake.alternatives for mistake in told)


@pytest.mark.parametrize("name", [name for name, _ in WRONG])
def test_motors_of_a_robot_in_good_order_obey_best_as_it_is_connected(name):
    table, likelihood = Table(preset(name)), WiringLikelihood(preset(name), [driven(name)])
    nominal = likelihood.of(table.nominal)
    assert nominal.commands == pytest.approx(0.0, abs=1e-6)
    for column in range(len(table.nominal) - 4):
        reversed_misfit = likelihood.of(table.multiplied((column,), -1.0))
        assert reversed_misfit.commands > 0.2
        assert reversed_misfit.cost > nominal.cost + LOG_ODDS  # by its command alone: the rest costs no more


@pytest.mark.parametrize("name", ["swerve", "powered-caster"])
def test_motors_that_hardly_turn_say_nothing(name):
    """On circles castors keep their angles, and what their encoders show of a command is chance."""
    robot = preset(name)
    assert preflight(robot, [drive(robot, motion(robot, "circles", 3, 30.0), 3, duration=30.0)]).mistakes == ()


def test_commands_may_be_in_any_unit_and_be_missing_at_times():
    log = driven("swerve", WRONG[2][1])
    assert log.command is not None
    robot, faster = preset("swerve"), log.command * 1000.0
    gaps = faster.copy()
    gaps[50:80] = np.nan
    nominal = Table(robot).nominal
    parts = [
        WiringLikelihood(robot, [each]).of(nominal).commands
        for each in (log, dataclasses.replace(log, command=faster), dataclasses.replace(log, command=gaps))
    ]
    assert parts[1] == pytest.approx(parts[0], rel=1e-6)
    assert parts[2] == pytest.approx(parts[0], rel=0.15)
    silent = dataclasses.replace(log, command=None, steering_command=None)
    assert WiringLikelihood(robot, [silent]).of(nominal).commands == 0.0


def test_nothing_else_is_looked_for_where_wheels_slid_by_wrong_wiring():
    name, effect = WRONG[2]
    undone = Undone(preset(name), {"log": driven(name, effect)}, {}, {})
    (mistake,) = undone.checked.mistakes
    assert mistake.effects == (effect,)
    assert "the commands by" in mistake.what
    assert diagnosed(undone).answers == ()
    assert any("record again" in remark for remark in preflight(preset(name), [driven(name, effect)]).remarks)
