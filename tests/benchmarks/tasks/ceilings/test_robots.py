"""The ceiling of robots: wheels that never slip turn as perfect rolling says, and the filter then knows its way."""

import dataclasses

import numpy as np
import pytest

from benchmarks.scoring.registry import score
from benchmarks.tasks import official_tasks
from benchmarks.tasks.ceilings.robots import with_ceiling, without_slip
from benchmarks.tasks.task import Run
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.motion.rolling import roll
from castor_envs.motion.trajectories import umbmark
from castor_envs.sensors.encoders import Encoders
from castor_envs.vehicles.presets import preset
from estimators import load_estimator

TASKS = {task.name: task for task in official_tasks()}


def rolled(name: str) -> tuple[Log, np.ndarray]:
    """The log of a square that a preset rolls perfectly, and the true turns of its wheels in counts."""
    robot = preset(name)
    geometry, motion = Geometry.of(robot), roll(robot, umbmark("ccw", side=0.5))
    encoders = Encoders(geometry, np.zeros(len(geometry.wheel_castor)))
    wheel, pivot = encoders.wheel(motion.wheel_angle), encoders.pivot(motion.castor_angle)
    return Log(t=motion.t, wheel=wheel, pivot=pivot, reference=motion.pose), wheel


@pytest.mark.parametrize("name", ["asoc-prototype", "swerve", "differential"])
def test_wheels_that_did_not_slip_read_as_they_did(name):
    """Whatever the log's counts are: these come from the motion alone, by an independent integration (`roll`)."""
    log, true = rolled(name)
    slipped = dataclasses.replace(log, wheel=np.round(1.3 * log.wheel))
    found = without_slip(preset(name), slipped)
    assert np.abs(found.wheel - (true - true[0])).max() <= 0.002 * np.ptp(true) + 2


def test_what_does_not_serve_has_no_ceiling():
    log, _ = rolled("differential")
    robot = preset("differential")
    blind = dataclasses.replace(robot.castors[0].wheels[0], counts_per_rev=None)
    castor = dataclasses.replace(robot.castors[0], wheels=(blind, *robot.castors[0].wheels[1:]))
    blinded = dataclasses.replace(robot, castors=(castor, *robot.castors[1:]))
    (run,) = with_ceiling(blinded, [Run(log)])
    assert run.oracle is None


def test_the_ceiling_is_far_above_the_filter_where_wheels_slip():
    episode = TASKS["umbmark-physics-cables"].record(800_000)
    told = [run.oracle for run in episode.runs if run.oracle is not None]
    found = []
    for run in episode.runs:
        estimator = load_estimator("filter").factory()
        estimator.reset(episode.robot, run.start)
        found.append(np.array([estimator.update(seen) for seen in run.log.observations()])[run.samples])
    assert score(episode, told)["ate"] < 0.5 * score(episode, found)["ate"]
