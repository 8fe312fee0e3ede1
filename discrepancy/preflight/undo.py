"""Gross mistakes undone in logs, before anything else is looked for.

Mistakes of wiring, those of the robot file and those found, are undone in the logs, and stand last in the robot file
that is written: encoders are exchanged after all else that they do. Other mistakes that effects explain are put into
the robot.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from castor_envs.errors import InputError
from castor_envs.logs.log import Log, unwrapped
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight import Preflight, preflight
from discrepancy.preflight.hypotheses import reading_of
from discrepancy.validation.sufficient import check_logs, check_near
from estimators.calibration.maximum_likelihood.tracker import straightened
from estimators.likelihood.channels import Channels

Logs = Mapping[str, Log]


class Undone:
    """Logs with their gross mistakes undone, and what was found in them before.

    described: the robot as it was given. robot, good: of logs and of clean logs, with gross mistakes and effects of the
    robot file, but for those of wiring.
    """

    def __init__(self, robot: RobotDescription, logs: Logs, held_out: Logs, clean: Logs) -> None:
        """Raise InputError for mistakes that cannot be undone."""
        for given in (logs, held_out, clean):
            check_logs(given)
        self.described = robot
        robot, wired = _plain(robot), _wired(robot.effects)
        logs, held_out, clean = (_unwired(robot, wired, given) for given in (logs, held_out, clean))
        found = [
            preflight(robot, list(given.values()), list(given)).serious if given else Preflight()
            for given in (logs, held_out, clean)
        ]
        for result in found:
            if result.fatal:
                raise InputError("; ".join(mistake.what for mistake in result.mistakes))
        for given in (logs, held_out, clean):  # after mistakes of units
            check_near(given)
        self.checked, _, good = found
        self.robot, self.good = _mended(robot, self.checked), _mended(robot, good)
        self.logs, self.held_out = (_straight(robot, self.checked, given) for given in (logs, held_out))
        self.clean = _straight(robot, good, clean)

    def added(self, named: Sequence[Effect]) -> tuple[Effect, ...]:
        """Return what the robot file that is written has more: effects named, and gross mistakes that are certain."""
        sure = [effect for mistake in self.checked.mistakes if not mistake.alternatives for effect in mistake.effects]
        return (*(effect for effect in sure if not effect.wiring), *named, *_wired(sure))

    def found(self, named: Sequence[Effect]) -> RobotDescription | None:
        """Return the robot as its file is written; None if that has nothing more than the one that was given."""
        added, before = self.added(named), _wired(self.described.effects)
        plain = [effect for effect in added if not effect.wiring]
        return _plain(self.described).with_effects(*plain, *_wired(added), *before) if added else None


def _wired(effects: Sequence[Effect]) -> list[Effect]:
    return [effect for effect in effects if effect.wiring]


def _plain(robot: RobotDescription) -> RobotDescription:
    """Return a robot without its effects of wiring."""
    return dataclasses.replace(robot, effects=tuple(effect for effect in robot.effects if not effect.wiring))


def _mended(robot: RobotDescription, checked: Preflight) -> RobotDescription:
    return robot.with_effects(*(effect for effect in checked.effects if not effect.wiring))


def _straight(robot: RobotDescription, checked: Preflight, logs: Logs) -> dict[str, Log]:
    """Return logs with their encoders where they belong, and the axes of their tracker along the body's."""
    unwired, built = _unwired(robot, _wired(checked.effects), logs), Geometry.of(_mended(robot, checked).as_built())
    return dict(zip(unwired, straightened(built, list(unwired.values()))[0], strict=True))


def _unwired(robot: RobotDescription, wiring: Sequence[Effect], logs: Logs) -> dict[str, Log]:
    """Return logs with their encoders where they belong."""
    channels, undo, unwired = Channels(robot), np.linalg.inv(reading_of(robot, wiring)), dict(logs)
    c, s = len(channels.names), len(channels.sensed)
    for name, log in logs.items() if wiring else ():
        counts = np.column_stack([unwrapped(log.pivot, channels.per_rev[:s]), log.wheel])
        counts = np.round(counts @ undo[:c, :c].T + undo[:c, -1], 6)
        undone = (*log.undone, *wiring)
        unwired[name] = dataclasses.replace(log, wheel=counts[:, s:], pivot=counts[:, :s], undone=undone)
    return unwired
