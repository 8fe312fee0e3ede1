"""What may be missing, and what else may look like it: where an encoder jumps, and from when to when it reads too
little, is found in the log."""

import dataclasses
from functools import cache

import numpy as np
import pytest

from castor_envs.effects.catalogue import catalogue
from castor_envs.effects.clocks import EncoderLatency
from castor_envs.effects.dimensions import WheelRadius
from castor_envs.effects.encoders import PivotEccentricity
from castor_envs.motion.trajectories import wander
from castor_envs.vehicles.presets import preset, preset_names
from discrepancy.hypotheses.candidates import candidates_of
from discrepancy.posterior.finder import diagnose
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.random_effects import summed
from discrepancy.trials.cases import motion
from discrepancy.trials.pymunk_generator import drive
from estimators.calibration.drives import DRIVES, log_of
from estimators.likelihood.statistics import least_squares

ROBOT = preset("asoc-prototype")


@cache
def driven():
    return drive(ROBOT, wander(np.random.default_rng([1, 1]), duration=20.0), 1, duration=20.0)


@pytest.mark.parametrize("at", [12.0, 0.3])
def test_a_jump_is_looked_for_where_it_is_and_never_near_the_ends(at):
    """There it is a bias in all but name."""
    log = driven()
    pivot = log.pivot + np.where(log.t >= at, 8.0, 0.0)[:, None] * [0, 1, 0]
    seen = linearise(ROBOT, [dataclasses.replace(log, pivot=pivot)])
    (jump,) = [candidate.what for candidate in seen.candidates if candidate.what.startswith("pivot_2 jumps at ")]
    time = float(jump.split()[3])
    assert time == at if at == 12.0 else 1.0 <= time <= 19.0


@pytest.mark.parametrize("missed", [0.005, 0.05])
@pytest.mark.parametrize(("first", "last"), [(6.0, 9.0), (3.0, 15.0)])
def test_a_stretch_in_which_an_encoder_reads_too_little_is_looked_for_where_it_is(first, last, missed):
    """Windows in which wheels disagree last a second."""
    log = driven()
    missing = missed * np.diff(log.wheel[:, 1], prepend=log.wheel[0, 1]) * ((log.t > first) & (log.t < last))
    wheel = log.wheel - np.cumsum(missing)[:, None] * [0, 1, 0, 0, 0, 0]
    seen = linearise(ROBOT, [dataclasses.replace(log, wheel=wheel)])
    looked_for = [candidate.what for candidate in seen.candidates if candidate.what.startswith("wheel_1r reads in")]
    stretches = [what.partition("too much from ")[2].split() for what in looked_for]
    off = [max(abs(float(start) - first), abs(float(end) - last)) for start, _, end, _ in stretches]
    assert min(off) <= 1.0, looked_for


@pytest.mark.parametrize("name", preset_names())
def test_of_effects_that_no_log_tells_apart_one_is_looked_for(name):
    families = [candidate.family for candidate in candidates_of(preset(name))]
    assert len(set(families)) == len(families)


def test_a_circle_in_which_lost_remainders_come_and_go_with_a_radius_is_diagnosed():
    """Counts a turn hang on lost remainders alone: beside these they were a candidate, and without them not."""
    robot = preset("differential")
    real = robot.with_effects(WheelRadius(castor=1, wheel=1, value=0.01))
    log = drive(real, motion(robot, "circles", 3, 20.0), 3, duration=20.0)
    named = [answer.candidate.family for answer in diagnose(robot, [log]).answers if answer.verdict == "named"]
    assert set(named) <= {"wheel_radius 1 1"}


def test_an_eccentricity_in_the_model_stays_a_candidate_however_little_its_castor_seems_to_sweep():
    """A castor that swivels by half a turn, as a robot goes to and fro, sweeps a little more or less with it."""
    (path,) = DRIVES["a straight line of 2 m"](ROBOT)
    log = log_of(ROBOT, path, "all")
    candidates = {candidate.family: candidate for candidate in candidates_of(ROBOT)}
    first, second = (candidates[f"pivot_eccentricity {castor}"] for castor in (1, 2))
    assert not linearise(ROBOT, [log], among=[first, second]).candidates
    robot = ROBOT.with_effects(PivotEccentricity(castor=2, value=0.01, phase=0.3))
    assert linearise(robot, [log], among=[first, second]).candidates == (second,)


@pytest.mark.parametrize("robot", ["2-castor", "asoc-prototype"])
def test_no_log_is_likelier_with_all_encoders_late_by_half_a_period(robot):
    """Encoders that are late alike contradict each other no more; only contacts creep at other times than predicted.
    Where a delay averages the noise of neighbouring samples, log evidence is higher by 240 to 390."""
    described = preset(robot)
    wanders = wander(np.random.default_rng([3, 1]), duration=30.0, holonomic=False)
    log = drive(described, wanders, 3, duration=30.0)
    seen = linearise(described, [log])
    latencies = [effect for effect in catalogue(described) if isinstance(effect, EncoderLatency)]
    columns = np.concatenate([seen.columns[c] for c in seen.candidates if c.kinds and c.kinds[0] in latencies])
    assert len(columns) == len(latencies)
    told = summed(seen.logs)
    information, score = told.information[np.ix_(columns, columns)], told.score[columns]
    assert score @ least_squares(information, score) / 2 < 2.5 * len(columns)
    for part in (0.3, 0.5):
        late = (dataclasses.replace(effect, value=part * described.sample_period) for effect in latencies)
        beside = linearise(described.with_effects(*late), [log], among=())
        assert beside.log_evidence_of_motion < seen.log_evidence_of_motion
