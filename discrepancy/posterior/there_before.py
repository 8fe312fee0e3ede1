"""Effects that clean logs show as large as the others do: no fault, but how the robot is in good order."""

from collections.abc import Sequence

import numpy as np

from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.posterior.calibrated import LOG_ODDS
from discrepancy.posterior.linearise import Linearised, linearise
from discrepancy.posterior.model.refit import Sized, families_of, fit_with, with_effects


def in_good_order(
    robot: RobotDescription, clean: Sequence[Log], good: Linearised, named: Sequence[Sized]
) -> frozenset[str]:
    """Return the families of effects that clean logs show as large, alone or all together: they were there before.

    Clean logs are likelier with them, and no less so than with half of them. The linear formula about a robot without
    them need not show that: of what passes for noise it sees little. good: clean logs linearised with this robot.
    """

    def log_evidence(effects: Sequence[Sized], part: float = 1.0) -> float:
        sizes = tuple(effect.moved((part - 1) * effect.amplitudes) for effect in effects)
        found = fit_with(
            robot, lambda some, *_: linearise(with_effects(robot, some), clean, start=good, among=()), sizes, good
        )
        return -np.inf if found is None else found.log_evidence

    def shown(effects: Sequence[Sized]) -> bool:
        whole = log_evidence(effects)
        return whole > good.log_evidence + LOG_ODDS and whole > log_evidence(effects, 0.5)

    sized = [effect for effect in named if not effect.candidate.kinds[0].binary]
    if len(sized) > 1 and shown(sized):
        return families_of(sized)
    return families_of([effect for effect in sized if shown([effect])])
