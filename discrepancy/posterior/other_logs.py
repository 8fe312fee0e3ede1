"""Effects that logs name, in other logs: in clean ones, which may show them as well, and in held-out ones.

An effect that clean logs show as large is no fault, but how the robot is in good order. A wheel's angle counts from the
start of a run, where it may point anywhere, so that the phase of an eccentric wheel holds for that run only: held-out
logs are given wheels that are turned at the start as those of the logs are, and confirm the size alone.
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
from discrepancy.posterior.calibrated import LOG_ODDS, SIGNATURE
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.model.named_together import by_formula
from discrepancy.posterior.model.refit import Sized, families_of, fit_with, sizes_of, with_effects
from discrepancy.posterior.random_effects import summed
from estimators.likelihood.channels import Channels


def in_good_order(
    robot: RobotDescription, clean: Sequence[Log], good: Linearised, named: Sequence[Sized]
) -> frozenset[str]:
    """Return the families of effects that clean logs show as large, alone or all together: they were there before.

    Clean logs are likelier with them than without them, and than with half of them, by more than the error of their
    signatures lets them be: what wheel creep masks of a large effect makes logs a little likelier or less likely, as
    creep is not as predicted. The linear formula about a robot without them need not show that clean logs have them:
    of what passes for noise it sees little. Where it shows that they have none of that size, nothing is fitted.
    good: clean logs linearised with this robot.
    """
    statistics = summed(good.logs)

    def log_evidence(effects: Sequence[Sized], part: float = 1.0) -> float:
        sizes = tuple(effect.moved((part - 1) * effect.amplitudes) for effect in effects)
        found = fit_with(
            robot, lambda some, *_: linearise(with_effects(robot, some), clean, start=good, among=()), sizes, good
        )
        return -np.inf if found is None else found.log_evidence

    def shown(effects: Sequence[Sized]) -> bool:
        seen = [effect for effect in effects if effect.candidate in good.candidates]
        unmasked = sizes_of(seen, good, masked=0.0)
        least = LOG_ODDS * (1 + SIGNATURE**2 * float(unmasked @ statistics.information @ unmasked))
        if len(seen) == len(effects) and max(statistics.gain(unmasked), statistics.gain(sizes_of(seen, good))) < -least:
            return False
        return log_evidence(effects) > max(good.log_evidence, log_evidence(effects, 0.5)) + least

    sized = [effect for effect in named if not effect.candidate.kinds[0].binary]
    if len(sized) > 1 and shown(sized):
        return families_of(sized)
    return families_of([effect for effect in sized if shown([effect])])


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
