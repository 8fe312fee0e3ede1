"""Held-out logs whose wheels are turned at the start as those of the logs are, by what eccentric wheels show.

A wheel's angle counts from the start of a run, where it may point anywhere, so that the phase of an eccentric wheel
holds for that run only. Only its size can be confirmed by other runs.
"""

from collections.abc import Sequence
from dataclasses import replace
from math import atan2, pi

import numpy as np

from castor_envs.effects.encoders import WheelEccentricity
from castor_envs.effects.parts import wheel_channel
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate
from discrepancy.posterior.linearise import linearise
from discrepancy.posterior.model.named_together import by_formula
from discrepancy.posterior.model.refit import Sized, with_effects
from estimators.likelihood.channels import Channels


def in_phase(
    robot: RobotDescription, logs: Sequence[Log], named: Sequence[Sized], *, creep: float | None, jitter: float
) -> list[Log]:
    """Return logs with a whole number of counts added to the wheels that named effects say are eccentric, by which
    these have the phases of the effects. creep, jitter: see `linearise`."""
    return [_in_phase(robot, log, named, creep, jitter) for log in logs]


def _in_phase(robot: RobotDescription, log: Log, named: Sequence[Sized], creep: float | None, jitter: float) -> Log:
    channels, wheel = Channels(robot), log.wheel.astype(np.float64)
    for effect in named:
        kind, candidate = effect.effect, effect.candidate
        if not (isinstance(kind, WheelEccentricity) and isinstance(candidate, Candidate)):
            continue
        others = with_effects(robot, [other for other in named if other is not effect])
        seen = linearise(others, [log], among=[candidate], creep=creep, jitter=jitter, own_clocks=True)
        along, across = by_formula(candidate, seen)[0].amplitudes.tolist()
        column = int(np.searchsorted(channels.driven, wheel_channel(robot, kind.castor, kind.wheel, kind.name)))
        turned = (kind.phase - atan2(across, along)) / (2 * pi)
        wheel[:, column] += np.round(turned * channels.geometry.counts_per_rev[channels.driven[column]])
    return replace(log, wheel=wheel)
