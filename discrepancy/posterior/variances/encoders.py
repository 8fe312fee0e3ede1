"""Encoders that are read late, or lose counts at speed, where no linear signature shows it.

The signature of a latency is right for times in which speeds hardly change. Where a wheel contradicts the others
intermittently (`at_times`), how far the others say that it rolled is compared with what its encoder shows some time
later.

A fitted wheel follows its encoder, so that it seems too slow to lose any counts. How far it rolls by the other wheels,
or, where these do not tell, by the reference, is compared with what it turns if its encoder loses a part. The time, or
the part, with which both agree best is where the whole model is fitted from.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from castor_envs.effects.clocks import EncoderLatency
from castor_envs.effects.encoders import TickLoss
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import candidates_of
from discrepancy.measurement.fit_states import wheel_readings
from discrepancy.posterior.linearise import Linearised
from discrepancy.posterior.model.refit import Sized
from discrepancy.posterior.priors import bounds_of
from discrepancy.posterior.variances.at_times import Faulty
from estimators.likelihood.channels import Channels
from estimators.likelihood.disagreement import slip_of_row

PARTS = np.arange(1, 21) / 20
"""Losses that are tried, as parts of the largest."""


def late_encoders(
    robot: RobotDescription, logs: Sequence[Log], seen: Linearised, faulty: Sequence[Faulty]
) -> list[Sized]:
    """Return a latency of each wheel that contradicts the others, where its encoder agrees better with them some time
    later."""
    found, rows = [], {int(seen.designs[0].model.rows[fault.row]): fault.row for fault in faulty}
    by_place: dict[Any, int] = {place: rows[k] for k, place in enumerate(robot.wheel_places) if k in rows}
    for candidate in candidates_of(robot):
        kind = candidate.kinds[0]
        if isinstance(kind, EncoderLatency) and (row := by_place.get((kind.castor, kind.wheel))) is not None:
            late = _latency(seen, logs, row, bounds_of(kind)[1])
            found += [Sized(candidate, np.array([late]))] if late else []
    return found


def _latency(seen: Linearised, logs: Sequence[Log], row: int, most: float) -> float:
    """Return the time (s), of up to `most`, after which the encoder of a row shows best how far the wheel rolled by the
    other rows."""
    period = float(np.median(np.diff(logs[0].t)))
    tried, squares = period * np.arange(round(most / period) + 1), 0.0
    for design, log in zip(seen.designs, logs, strict=True):
        missed, _ = slip_of_row(design.model, design.geometry, design.state, row)
        shown = design.model.rolled(design.geometry, design.state)[:, row]
        truly, shows = (np.concatenate([[0.0], np.cumsum(steps)]) for steps in (shown + missed, shown))
        since = log.t >= log.t[0] + most
        off = [np.diff(np.interp(log.t[since] - late, log.t, truly) - shows[since]) for late in tried]
        squares = squares + np.sum(np.square(off), axis=1)
    return float(tried[np.argmin(squares)])


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
