"""Creep of wheels that are driven against each other, for calibration.

A controller drives wheels so that they agree by its own numbers. Let these be off by d, in parts of the parameters'
scales: by the true numbers the wheels disagree by J d, where J is the derivative of the rolling constraints. Contacts
then creep until they agree with one motion of the body, with the least loss of power, and slip by M J d (M:
`LogLikelihood.masked_by_creep`). So what wheels roll in disagreement shows the controller's numbers, and only the rest
of what they roll, with reference poses or castors that swing freely, the robot's.

d is fitted beside the parameters. Before logs are seen it is normally distributed about 0, with a spread that the logs
show: where nothing contradicts the controller, numbers stay as without creep, and their intervals tell how far its
numbers may be off.
"""

from collections.abc import Sequence

import numpy as np

from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.physics.contact_motion import yields
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.parameters import Parameter, robot_with, values_of
from estimators.likelihood.channels import Channels
from estimators.likelihood.log_likelihood import Changes, LogLikelihood

USUAL = 0.01
"""Least spread of the errors of a controller's numbers, in parts of the scales: by a ruler and by eye, lengths are good
to a per cent, and angles to half a degree."""


class Creep:
    """How contacts of a robot creep in several logs. spread: standard deviation of the errors of its controller's
    numbers, as a part of the scales of its parameters (P,)."""

    def __init__(
        self, robot: RobotDescription, parameters: tuple[Parameter, ...], logs: Sequence[Log], spread: float = USUAL
    ) -> None:
        self._robot, self._parameters, self._logs, self.spread = robot, parameters, logs, spread
        self._stiffness: list[Array] = []
        self._calls = 0

    def slips(
        self,
        models: Sequence[LogLikelihood],
        geometry: Geometry,
        changed: Geometry,
        change: Array,
        states: Sequence[Array],
    ) -> list[Array]:
        """Return the slips in each log (K - 1, rows, P), m per unit of an error of each of the controller's numbers.

        changed, change: as in `LogLikelihood.reduce`. Contacts beyond the friction circle slide, and how much depends
        on the slips: it is a mean of this call's and, with less weight, earlier ones, as iterations would alternate.
        Raises InputError for a robot that cannot stand by itself.
        """
        robot = robot_with(self._robot, self._parameters, values_of(geometry, self._parameters))
        found = [
            stiffness_of(robot, model, log, state) for model, log, state in zip(models, self._logs, states, strict=True)
        ]
        last, self._calls = self._stiffness or found, self._calls + 1
        weight = 2 / (self._calls + 1)
        self._stiffness = [new**weight * old ** (1 - weight) for new, old in zip(found, last, strict=True)]
        slips = []
        for model, state, stiffness in zip(models, states, self._stiffness, strict=True):
            no_readings, no_slips = np.zeros((*model.counts.shape, 0)), np.zeros((*stiffness.shape, 0))
            changes = Changes(geometry, changed, change, state, no_readings, no_slips)
            by_number = model.masked_by_creep(changes, stiffness)
            slips.append(by_number * [p.scale for p in self._parameters])
        return slips

    def learn(self, errors: Array, variances: Array) -> None:
        """Set the spread to its most likely value (MacKay, Neural Computation 4(3), 1992), but no less than `USUAL`,
        given the errors (P,) of the controller's numbers with their variances."""
        shown = float(np.sum(1 - variances / self.spread**2))
        self.spread = max(USUAL, float(np.sqrt(np.sum(errors**2) / max(shown, 1.0))))


def expect(models: Sequence[LogLikelihood], slips: Sequence[Array], errors: Array) -> None:
    """Make models expect the slips that errors (P,) of the controller's numbers cause."""
    for model, by_number in zip(models, slips, strict=True):
        model.expect(by_number @ errors)


def stiffness_of(robot: RobotDescription, model: LogLikelihood, log: Log, state: Array) -> Array:
    """Return the force, N, per m/s of slip of each of a model's rows (K - 1, rows); of a side row that of all wheels of
    its castor. Raises InputError for a robot that cannot stand by itself."""
    found = yields(robot, Channels(robot).motion(log, state), Floor())
    wheels, of_castor = len(robot.wheels), np.array(robot.wheel_castors)
    stiffness = np.divide(1.0, found, out=np.zeros_like(found), where=found > 0)
    stiffness[:, wheels:] = stiffness[:, wheels:] @ (of_castor[:, None] == of_castor)
    return stiffness[:, model.rows]
