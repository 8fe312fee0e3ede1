"""Gross mistakes undone in logs, before anything else is looked for.

Mistakes of wiring are undone in the logs, and stand in the robot file that is written: encoders are exchanged after all
else that they do. Other mistakes that effects explain are put into the robot.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from castor_envs.effects.catalogue import readings
from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.preflight import Preflight, check_logs, preflight
from discrepancy.preflight.stretches import unwrapped
from estimators.calibration.maximum_likelihood.tracker import straightened

Logs = Mapping[str, Log]


@dataclass(frozen=True)
class Undone:
    """Logs with their wiring undone, and what was found in them before.

    described: the robot as it was given. robot, good: of logs and of clean logs, with gross mistakes that are not of
    wiring.
    """

    described: RobotDescription
    checked: Preflight
    robot: RobotDescription
    good: RobotDescription
    logs: dict[str, Log]
    held_out: dict[str, Log]
    clean: dict[str, Log]

    def found(self, named: Sequence[Effect]) -> RobotDescription | None:
        """Return the robot as its file is written: with gross mistakes that are certain, and the effects named."""
        certain = [
            effect for mistake in self.checked.mistakes if not mistake.alternatives for effect in mistake.effects
        ]
        effects = [*(effect for effect in certain if not effect.wiring), *named]
        effects += [effect for effect in certain if effect.wiring]
        return self.described.with_effects(*effects) if effects else None


def undo(robot: RobotDescription, logs: Logs, held_out: Logs, clean: Logs) -> Undone:
    """Return logs with their gross mistakes undone; raises InputError for such as cannot be undone."""
    for given in (logs, held_out, clean):
        check_logs(given)
    checked, kept, good = (
        preflight(robot, list(log_set.values()), list(log_set)).serious if log_set else Preflight()
        for log_set in (logs, held_out, clean)
    )
    for result in (checked, kept, good):
        if result.fatal:
            raise InputError("; ".join(mistake.what for mistake in result.mistakes))
    of_logs, of_clean = (_with_mistakes(robot, result) for result in (checked, good))
    return Undone(
        robot,
        checked,
        of_logs,
        of_clean,
        _straight(robot, of_logs, checked, logs),
        _straight(robot, of_logs, checked, held_out),
        _straight(robot, of_clean, good, clean),
    )


def _with_mistakes(robot: RobotDescription, checked: Preflight) -> RobotDescription:
    return robot.with_effects(*(effect for effect in checked.effects if not effect.wiring))


def _straight(robot: RobotDescription, mended: RobotDescription, checked: Preflight, logs: Logs) -> dict[str, Log]:
    """Return logs with their encoders where they belong, and the axes of their tracker along the body's.

    mended: the robot with gross mistakes that are not of wiring.
    """
    wiring = [effect for effect in checked.effects if effect.wiring]
    unwired = [_unwired(robot, wiring, log) if wiring else log for log in logs.values()]
    return dict(zip(logs, straightened(Geometry.of(mended.as_built()), unwired)[0], strict=True))


def _unwired(robot: RobotDescription, wiring: Sequence[Effect], log: Log) -> Log:
    """Return the log as it would be with its encoders where they belong; each such mistake undoes itself."""
    geometry, driven, sensed = Geometry.of(robot.as_built()), list(robot.driven_wheels), list(robot.pivot_encoders)
    turn, per_rev, zero = geometry.pivot_counts_per_rev[sensed], geometry.counts_per_rev[driven], geometry.pivot_zero
    wheel, castor = np.zeros((len(log), len(robot.wheels))), np.zeros((len(log), len(robot.castors)))
    wheel[:, driven] = log.wheel * 2 * np.pi / per_rev
    castor[:, sensed] = unwrapped(log.pivot, turn) * 2 * np.pi / turn - zero[sensed]
    for effect in reversed(wiring):
        wheel, castor = readings(robot.with_effects(effect), log.t, wheel, castor)
    counted = np.round(wheel[:, driven] * per_rev / (2 * np.pi), 6)
    pivot = np.round((castor[:, sensed] + zero[sensed]) * turn / (2 * np.pi), 6)
    return dataclasses.replace(log, wheel=counted, pivot=pivot, undone=tuple(wiring))
