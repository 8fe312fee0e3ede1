"""What truly happened, how contacts crept, and the noise beside it, against physics that is integrated by itself."""

from functools import cache

import numpy as np
import pytest

from castor_envs.effects.contact import SlipStiffness
from castor_envs.effects.dimensions import WheelRadius
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset
from discrepancy.hypotheses.candidates import candidates_of
from discrepancy.inference import creep_prior as sober
from discrepancy.inference import fit_states as settled
from discrepancy.inference.creep_prediction import FORCED, QUICK
from discrepancy.inference.evidence import evidence_of
from discrepancy.inference.selection import _ahead
from discrepancy.trials.pymunk_generator import drive

ROBOT = preset("asoc-prototype")
"""Its logs are of the physics: whatever creeps there, no formula of the finder's made it."""

RADIUS = WheelRadius(castor=2, wheel=1, value=1e-4)


@cache
def driven(*effects):
    motion = wander(np.random.default_rng([11, 0]), duration=40.0)
    return drive(ROBOT.with_effects(*effects), motion, 11, duration=40.0)


def parts(*effects, robot=ROBOT):
    return np.array(evidence_of(robot, [driven(*effects)], among=()).parts)


def test_contacts_creep_as_predicted_where_wheels_disagree_and_under_forces(monkeypatch):
    monkeypatch.setattr(settled, "AS_DESCRIBED", settled.DOUBT)  # as if nothing was known of it
    assert parts()[: QUICK.start] == pytest.approx([1.0, 1.0], abs=0.08)


def test_steered_wheels_that_disagree_from_one_step_to_the_next_creep_to_their_sides_at_once():
    robot = preset("swerve")
    log = drive(robot, wander(np.random.default_rng([102, 1]), duration=15.0), 102, duration=15.0)
    _, side = np.array(evidence_of(robot, [log], among=()).parts)[QUICK]
    assert side == pytest.approx(1.0, abs=0.25)


def test_softer_contacts_creep_more_under_forces_and_no_more_where_wheels_disagree(monkeypatch):
    """Slip goes as one over stiffness; wheels that disagree have to come to terms whatever the stiffness is."""
    monkeypatch.setattr(settled, "AS_DESCRIBED", settled.DOUBT)
    softer = parts(SlipStiffness(value=-0.4))
    assert softer[FORCED] == pytest.approx(1 / 0.6, rel=0.15)
    assert softer[0] == pytest.approx(1.0, abs=0.15)


def test_contacts_that_hardly_creep_are_taken_for_rigid():
    softest = ROBOT.with_effects(SlipStiffness(value=-0.9))  # described so; the log is of contacts ten times stiffer
    told = np.array(evidence_of(softest.as_built(), [driven()], among=()).parts)
    assert told[FORCED] < settled.RIGID


def test_noise_is_what_the_best_effect_leaves():
    """A small effect makes all else look noisy; its own size is told as well as if it was not there."""
    (radius,) = [one for one in candidates_of(ROBOT) if one.is_of(RADIUS)]
    with_it, without = (evidence_of(ROBOT, [driven(*some)], among=[radius]) for some in ((RADIUS,), ()))
    assert with_it.noise.along > 1.5 * without.noise.along
    errors = [np.sqrt(one.best([(0, 1.0)])[1].item()) for one in (with_it, without)]
    assert errors[0] == pytest.approx(errors[1], rel=0.1)


def test_each_wheel_creeps_by_itself_as_far_as_logs_allow(monkeypatch):
    """Of a good robot hardly at all; of one whose wheels all have other radii, more than two effects can explain."""
    told = []
    monkeypatch.setattr(sober, "_uneven", lambda *some, of=sober._uneven: told.append(of(*some)) or told[-1])
    places = [(i, j) for i in (1, 2, 3) for j in (1, 2)]
    sizes = [2e-4, -1e-4, 3e-4, -2e-4, 1e-4, -3e-4]
    uneven = [WheelRadius(castor=i, wheel=j, value=v) for (i, j), v in zip(places, sizes, strict=True)]
    evidence_of(ROBOT, [driven()])
    evidence_of(ROBOT, [driven(*uneven)])
    assert told[0] < 3e-5
    assert told[1] > 2 * told[0]


@pytest.mark.parametrize("part", [0.2, 0.5])
def test_changes_that_follow_by_and_by_are_made_at_once(part):
    changes = np.array([3.0, -1.0])
    assert _ahead(part * changes, changes) == pytest.approx(part * changes / (1 - part))
    assert _ahead(changes, None) == pytest.approx(changes)
    assert _ahead(-changes, changes) == pytest.approx(-changes)
