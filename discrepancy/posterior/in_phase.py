"""Held-out logs whose wheels are turned at the start as those of the logs are, by what eccentric wheels show.

A wheel's angle counts from the start of a run, where it may point anywhere, so that the phase of an eccentric wheel
holds for that run only. Only its size can be confirmed by other runs.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from math import atan2, pi

import numpy as np

from castor_envs.effects.encoders import WheelEccentricity
from castor_envs.effects.parts import wheel_channel
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.model.named_together import by_formula
from discrepancy.posterior.model.refit import Sized, with_effects
from estimators.likelihood.channels import Channels


def in_phase(
    robot: RobotDescription, logs: Sequence[Log], named: Sequence[Sized], *, creep: float | None, jitter: float
) -> list[Log]:
    """Return logs with a whole number of counts added to the wheels that named effects say are eccentric, by which
    these have the phases of the effects, where that makes a log likelier. creep, jitter: see `linearise`."""
    look = partial(linearise, creep=creep, jitter=jitter, own_clocks=True)
    return [_in_phase(robot, log, named, look) for log in logs]


def _in_phase(robot: RobotDescription, log: Log, named: Sequence[Sized], look: Callable[..., Linearised]) -> Log:
    channels = Channels(robot)
    for effect in named:
        kind, candidate = effect.effect, effect.candidate
        if not (isinstance(kind, WheelEccentricity) and isinstance(candidate, Candidate)):
            continue
        others = with_effects(robot, [other for other in named if other is not effect])
        along, across = by_formula(candidate, look(others, [log], among=[candidate]))[0].amplitudes.tolist()
        column = int(np.searchsorted(channels.driven, wheel_channel(robot, kind.castor, kind.wheel, kind.name)))
        turns, wheel = (kind.phase - atan2(across, along)) / (2 * pi), log.wheel.astype(np.float64)
        wheel[:, column] += np.round(turns * channels.geometry.counts_per_rev[channels.driven[column]])
        turned, found = replace(log, wheel=wheel), with_effects(robot, named)
        as_is, then = (look(found, [given], among=()).log_evidence for given in (log, turned))
        log = turned if then > as_is + LOG_ODDS else log  # what creep masks, the formula hardly sees
    return log
