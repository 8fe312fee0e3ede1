"""Counts that a wheel's encoder loses at speed, where no linear signature shows it.

The fitted wheel follows its encoder, so that it seems too slow to lose any. How far it rolls by the other wheels, or,
where these do not tell, by the reference, is compared with what it turns if its encoder loses a part; the part with
which both agree best is where the whole model is fitted from.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from castor_envs.effects.encoders import TickLoss
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import candidates_of
from discrepancy.measurement.fit_states import wheel_readings
from discrepancy.posterior.linearise import Linearised
from discrepancy.posterior.model.refit import Sized
from discrepancy.posterior.priors import bounds_of
from estimators.likelihood.channels import Channels

PARTS = np.arange(1, 21) / 20
"""Losses that are tried, as parts of the largest."""


def lossy_encoders(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, least: float, besides: Collection[str] = ()
) -> list[Sized]:
    """Return the loss of a wheel's encoder with which it agrees better with the other wheels or the reference, by a log
    likelihood ratio of more than `least` and the most of all; besides: families that are not considered."""
    channels, found = Channels(robot), list[Sized]()
    for candidate in candidates_of(robot):
        kind = candidate.kinds[0]
        if not isinstance(kind, TickLoss) or candidate.family in besides:
            continue
        sizes = PARTS * bounds_of(kind)[1]
        losses = [replace(kind, value=size) for size in sizes.tolist()]
        before, after, count = 0.0, np.zeros(len(sizes)), 0
        for design, log in zip(seen.designs, logs, strict=True):
            read, likely, per_count = wheel_readings(
                robot, channels, design.model, design.state, kind, design.model.counts
            )
            turned = [loss.turned(np.diff(log.t), read, likely, per_count) for loss in losses]
            before += float(np.sum((likely - read) ** 2))
            after += np.sum((likely - turned) ** 2, axis=1)
            count += len(read)
        best = int(np.argmin(after))
        if (likelier := count / 2 * float(np.log(before / after[best]))) > least:
            found, least = [Sized(candidate, sizes[best : best + 1])], likelier
    return found
