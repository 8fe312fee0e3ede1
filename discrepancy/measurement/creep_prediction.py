"""Prediction of how far a robot's contacts creep: under the forces of a motion, and where wheels are driven against
each other.

Creep predicted without the robot's effects on contacts is known up to a factor that logs determine (`fit_states`); the
slip of these effects is taken as predicted.
"""

from dataclasses import replace

import numpy as np

from castor_envs.effects.catalogue import floor_of
from castor_envs.effects.floor import Bump
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Slip
from castor_envs.logs.log import Log
from castor_envs.physics.contact_motion import ContactMotion
from castor_envs.vehicles.effect import Effect
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.hypotheses.candidates import Candidate
from estimators.likelihood.channels import Channels
from estimators.likelihood.log_likelihood import LogLikelihood

CREEPS, FORCED, QUICK = 4, 1, slice(2, 4)
"""Kinds of predicted creep: steady disagreement of wheels; forces of the motion; and disagreement that changes from
step to step, along and to the side."""

STEP = 0.05
"""Part of an amplitude by which it is changed for the derivative of predicted creep."""

SLOWEST = 0.02
"""Least rolling speed of a contact, as a part of the fastest wheel's speed."""


class Slipping:
    """A robot's predicted slip in one log with state (K, m). yields (K - 1, rows): compliance of each contact's creep,
    in any unit."""

    def __init__(self, robot: RobotDescription, model: LogLikelihood, log: Log, state: Array) -> None:
        self._robot, self._model, self._log, self._state = robot, model, log, state
        self._without = replace(robot, effects=tuple(effect for effect in robot.effects if effect.creep is None))
        self._channels = Channels(robot)
        contact, geometry = robot.as_built().contact, self._channels.geometry
        rolled = np.abs(model.rolled(geometry, state)) / np.diff(log.t)[:, None]
        rolled = np.maximum(rolled, SLOWEST * rolled.max(axis=1, keepdims=True)) + 1e-6
        along = model.rows < len(geometry.radius)
        self.yields = rolled / np.where(along, contact.slip_stiffness_long, contact.slip_stiffness_lat)
        self._over = self._over_cables()
        self._creep = self._predicted(self._over)

    def sure(self) -> Array:
        """Return the slips (K - 1, rows) that are taken as predicted: the extra roll over the robot's cables, and the
        creep of its effects on contacts."""
        motion, total = self._channels.motion(self._log, self._state, consistent_wheels=True), self._over
        for effect in self._robot.effects:
            if effect.creep is not None:
                try:
                    slip = effect.slip(ContactMotion(self._without.as_built(), motion))
                except InputError:  # it cannot stand by itself
                    continue
                total = total if slip is None else total + slip
        return self._model.rows_of(total.rolling, total.side)

    def known(self) -> Array:
        """Return the slips (K - 1, rows, CREEPS) of each kind of predicted creep, which are known up to factors."""
        slow, forced = self._creep, self._predicted(consistent=True)
        quick, zeros = self._predicted(self._over, quick=True) - slow, np.zeros_like
        kinds = slow - forced, forced, Slip(quick.rolling, zeros(quick.side)), Slip(zeros(quick.rolling), quick.side)
        rows = [self._model.rows_of(kind.rolling, kind.side) for kind in kinds]
        return np.stack(rows, axis=-1)

    def seen_as_creep(self, slip: Slip) -> Array:
        """Return the reduction of predicted creep (K - 1, rows) if wheels are known to slip by `slip`."""
        explained = self._creep - self._predicted(self._over + slip)
        return self._model.rows_of(explained.rolling, explained.side)

    def by_effects(self) -> Array:
        """Return the predicted creep (K - 1, rows) that the robot's effects cause: the difference to that of a robot
        without them whose encoders read the same."""
        if not self._robot.effects:
            return np.zeros_like(self.yields)
        plain, state = replace(self._robot, effects=()), self._state.copy()
        state[:, 3:] = self._channels.read(self._robot, self._log, state[:, 3:])
        caused = self._creep - Slipping(plain, self._model, self._log, state)._creep
        return self._model.rows_of(caused.rolling, caused.side)

    def masking(self, effect: Effect, candidate: Candidate) -> Array:
        """Return the change of predicted creep (K - 1, rows, c) per unit of the amplitudes of one of the robot's
        effects, where encoders read the same."""
        robot, channels, state = self._robot, self._channels, self._state.copy()
        amplitudes, changes = candidate.amplitudes(effect), []
        read, step = channels.read(robot, self._log, state[:, 3:]), STEP * float(np.linalg.norm(amplitudes))
        for unit in np.eye(len(amplitudes)):
            by = -step if amplitudes @ unit > 0 else step  # not beyond a bound that the effect may be at
            changed = candidate.effect(amplitudes + by * unit)
            vehicle = replace(robot, effects=tuple(changed if part is effect else part for part in robot.effects))
            state[:, 3:] = Channels(vehicle).unread(vehicle, self._log, read, self._state[:, 3:])
            more = Slipping(vehicle, self._model, self._log, state)._creep - self._creep
            changes.append(self._model.rows_of(more.rolling, more.side) / by)
        return np.stack(changes, axis=-1)

    def _predicted(self, known: Slip | None = None, consistent: bool = False, quick: bool = False) -> Slip:
        """Return the creep predicted where wheels are known to slip for another reason, or (consistent) agree."""
        robot, motion = self._without, self._channels.motion(self._log, self._state, consistent_wheels=consistent)
        known = Slip.none(motion) if known is None else known
        rolled_more = np.cumsum(known.rolling, axis=0) / self._channels.geometry.radius
        motion = replace(motion, wheel_angle=motion.wheel_angle + np.pad(rolled_more, ((1, 0), (0, 0))))
        try:
            return ContactMotion(robot.as_built(), motion).creep(floor_of(robot, Floor()), quick=quick)
        except InputError:  # it cannot stand by itself
            return Slip.none(motion)

    def _over_cables(self) -> Slip:
        motion = self._channels.motion(self._log, self._state)
        total = Slip.none(motion)
        for effect in self._robot.effects:
            if isinstance(effect, Bump):
                total = total + effect.slip(ContactMotion(self._robot.as_built(), motion))
        return total
