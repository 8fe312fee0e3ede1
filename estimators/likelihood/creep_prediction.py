"""Prediction of how far a robot's contacts creep: under the forces of a motion, and where wheels are driven against
each other.

Creep predicted without the robot's effects on contacts is known up to a factor that logs determine (`fit_states`); the
slip of these effects is taken as predicted.
"""

from dataclasses import replace
from functools import cached_property

import numpy as np

from castor_envs.effects.catalogue import floor_of
from castor_envs.effects.floor import Bump
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Slip
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.physics.contact_motion import ContactMotion, yields
from castor_envs.vehicles.robot import RobotDescription
from estimators.likelihood.channels import Channels
from estimators.likelihood.log_likelihood import LogLikelihood, Noise

UNEVEN = 0.3
"""Relative standard deviation of each contact's creep about the prediction, where wheels disagree."""

DOUBT = 0.5
"""Prior standard deviation of the factor of creep under forces, about 1, where nothing is known of contacts."""

LEAST_NOISE = Noise(along=3e-5, across=3e-5, position=1e-4, heading=1e-4, gyro=1e-6, turning=3e-6)
"""Lower bounds of the noise of contacts that creep, and of trackers: 0.03 mm after 1 m, as trials declare; 0.1 mm and
0.1 mrad."""


class Slipping:
    """A robot's predicted slip in one log with state (K, m). stiffness (K - 1, rows): of each contact's creep, in any
    unit."""

    def __init__(self, robot: RobotDescription, model: LogLikelihood, log: Log, state: Array) -> None:
        self._robot, self._model, self._log, self._state = robot, model, log, state
        self._without = replace(robot, effects=tuple(effect for effect in robot.effects if effect.creep is None))
        self._channels = Channels(robot)
        try:
            self.stiffness = stiffness_of(robot.as_built(), model, log, state)
        except InputError:  # it cannot stand by itself
            self.stiffness = np.ones((len(log) - 1, len(model.rows)))
        self._over = self._over_cables()

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
        return self._rows(total)

    @cached_property
    def forced(self) -> Array:
        """The creep (K - 1, rows) under the forces of the motion, which is known up to a factor."""
        return self._rows(self._predicted(consistent=True))

    def columns(self) -> Array:
        """Return the creep (K - 1, rows, 1 + rows) that is known up to factors: under forces, and of each row where
        wheels disagree."""
        disagreeing = self._rows(self._predicted(self._over)) - self.forced
        return np.concatenate([self.forced[..., None], disagreeing[..., None] * np.eye(disagreeing.shape[1])], axis=-1)

    @cached_property
    def by_effects(self) -> Array:
        """Return the predicted creep (K - 1, rows) that the robot's effects cause, and mistakes of wiring (`Log`): the
        difference to that of a robot without them whose encoders read the same."""
        if self._described is None:
            return np.zeros_like(self.stiffness)
        without = Slipping(*self._described)
        return self._rows(self._predicted(self._over, averaged=False) - without._predicted(averaged=False))

    @cached_property
    def disagreement(self) -> Array:
        """The disagreement of wheels (K - 1, rows), m, that the robot's effects cause, and mistakes of wiring: the
        difference to that of a robot without them whose encoders read the same. A controller that does not know of them
        leaves none in what it reads."""
        if self._described is None:
            return np.zeros_like(self.stiffness)
        robot, model, _, read = self._described
        return model.disagreement(self._channels.geometry, self._state) - model.disagreement(Geometry.of(robot), read)

    @cached_property
    def _described(self) -> tuple[RobotDescription, LogLikelihood, Log, Array] | None:
        """The robot without effects whose encoders read the same, and the state that they read; None: it is this."""
        real = self._robot.with_effects(*self._log.undone)
        if not real.effects:
            return None
        read = self._state.copy()
        read[:, 3:] = self._channels.read(real, self._log, read[:, 3:])
        return real.as_described(), self._model, self._log, read

    def _predicted(self, known: Slip | None = None, consistent: bool = False, averaged: bool = True) -> Slip:
        """Return the creep predicted where wheels are known to slip for another reason, or (consistent) agree.

        averaged: over times in which noise goes out, but with it what encoders truly read in a few steps.
        """
        robot, motion = self._without, self._channels.motion(self._log, self._state, consistent_wheels=consistent)
        motion = motion if averaged else replace(motion, averaging=0.0)
        known = Slip.none(motion) if known is None else known
        rolled_more = np.cumsum(known.rolling, axis=0) / self._channels.geometry.radius
        motion = replace(motion, wheel_angle=motion.wheel_angle + np.pad(rolled_more, ((1, 0), (0, 0))))
        try:
            return ContactMotion(robot.as_built(), motion).creep(floor_of(robot, Floor()))
        except InputError:  # it cannot stand by itself
            return Slip.none(motion)

    def _over_cables(self) -> Slip:
        motion = self._channels.motion(self._log, self._state)
        total = Slip.none(motion)
        for effect in self._robot.effects:
            if isinstance(effect, Bump):
                total = total + effect.slip(ContactMotion(self._robot.as_built(), motion))
        return total

    def _rows(self, slip: Slip) -> Array:
        """Return slips as the rows (K - 1, rows) of the model."""
        return self._model.rows_of(slip.rolling, slip.side)


def stiffness_of(robot: RobotDescription, model: LogLikelihood, log: Log, state: Array) -> Array:
    """Return the force, N, per m/s of slip of each of a model's rows (K - 1, rows); of a side row that of all wheels of
    its castor. Raises InputError for a robot that cannot stand by itself."""
    found = yields(robot, Channels(robot).motion(log, state), Floor())
    wheels, of_castor = len(robot.wheels), np.array(robot.wheel_castors)
    stiffness = np.divide(1.0, found, out=np.zeros_like(found), where=found > 0)
    stiffness[:, wheels:] = stiffness[:, wheels:] @ (of_castor[:, None] == of_castor)
    return stiffness[:, model.rows]
