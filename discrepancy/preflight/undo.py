"""Gross mistakes undone in logs, before anything else is looked for.

Mistakes of wiring are undone in the logs, and stand in the robot file that is written: encoders are exchanged after all
else that they do. Other mistakes that effects explain are put into the robot.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight import Preflight, preflight
from discrepancy.preflight.hypotheses import reading_of
from discrepancy.validation.sufficient import check_logs
from estimators.calibration.maximum_likelihood.tracker import straightened
from estimators.likelihood.channels import Channels

Logs = Mapping[str, Log]


class Undone:
    """Logs with their gross mistakes undone, and what was found in them before.

    described: the robot as it was given. robot, good: of logs and of clean logs, with gross mistakes that are not of
    wiring.
    """

    def __init__(self, robot: RobotDescription, logs: Logs, held_out: Logs, clean: Logs) -> None:
        """Raise InputError for mistakes that cannot be undone."""
        found = []
        for given in (logs, held_out, clean):
            check_logs(given)
            found.append(preflight(robot, list(given.values()), list(given)).serious if given else Preflight())
        for result in found:
            if result.fatal:
                raise InputError("; ".join(mistake.what for mistake in result.mistakes))
        self.described, (self.checked, _, good) = robot, found
        self.robot, self.good = _mended(robot, self.checked), _mended(robot, good)
        self.logs, self.held_out = (_straight(robot, self.checked, given) for given in (logs, held_out))
        self.clean = _straight(robot, good, clean)

    def found(self, named: Sequence[Effect]) -> RobotDescription | None:
        """Return the robot as its file is written: with gross mistakes that are certain, and the effects named."""
        sure = [effect for mistake in self.checked.mistakes if not mistake.alternatives for effect in mistake.effects]
        wiring = [effect for effect in sure if effect.wiring]
        effects = [*(effect for effect in sure if not effect.wiring), *named, *wiring]
        return self.described.with_effects(*effects) if effects else None


def _mended(robot: RobotDescription, checked: Preflight) -> RobotDescription:
    return robot.with_effects(*(effect for effect in checked.effects if not effect.wiring))


def _straight(robot: RobotDescription, checked: Preflight, logs: Logs) -> dict[str, Log]:
    """Return logs with their encoders where they belong, and the axes of their tracker along the body's."""
    wiring = [effect for effect in checked.effects if effect.wiring]
    channels, undo, unwired = Channels(robot), np.linalg.inv(reading_of(robot, wiring)), list(logs.values())
    c, s = len(channels.names), len(channels.sensed)
    for k, log in enumerate(unwired if wiring else ()):
        turn = channels.per_rev[:s] / (2 * np.pi)
        counts = np.column_stack([np.unwrap(log.pivot / turn, axis=0) * turn, log.wheel])
        counts = np.round(counts @ undo[:c, :c].T + undo[:c, -1], 6)
        unwired[k] = dataclasses.replace(log, wheel=counts[:, s:], pivot=counts[:, :s], undone=tuple(wiring))
    return dict(zip(logs, straightened(Geometry.of(_mended(robot, checked).as_built()), unwired)[0], strict=True))
