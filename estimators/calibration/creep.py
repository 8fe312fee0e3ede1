"""Creep of contacts in calibration: the measurement model of the diagnosis, with a robot's numbers as unknowns.

Contacts creep freely where their wheels disagree (`LogLikelihood.balance`): how the body moves is known by the balance
of their forces, by the tyres, loads and friction in the robot file. Creep under forces is expected as predicted
(`Slipping`), up to factors that are nuisances with priors.

How far wheels disagree is another measurement (`Disagreement`). A controller drives wheels so that they agree by its
own numbers, so it shows the controller's numbers, not the robot's. These differ by errors that are normal about 0; with
them integrated out, the measurement is information on the robot's numbers (`scattered`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.weight import wheel_loads
from estimators.calibration.parameters import Parameter, robot_with
from estimators.likelihood.creep_prediction import DOUBT, UNEVEN, Slipping
from estimators.likelihood.disagreement import Disagreement
from estimators.likelihood.log_likelihood import LogLikelihood
from estimators.likelihood.rolling import Changes
from estimators.likelihood.statistics import scattered

CONTROLLER = 0.01
"""Standard deviation of the errors of a controller's numbers, in parts of the scales: by a ruler and by eye, lengths
are good to a per cent, and angles to half a degree."""


class Creep:
    """How contacts of a robot creep in several logs.

    expected, deviations (1 + rows,): prior means and standard deviations of the factors of creep (`Slipping.columns`).
    Raises InputError for a robot that cannot stand by itself.
    """

    def __init__(
        self,
        robot: RobotDescription,
        parameters: tuple[Parameter, ...],
        models: Sequence[LogLikelihood],
        logs: Sequence[Log],
        states: Sequence[Array],
    ) -> None:
        self._robot, self._parameters = replace(robot, effects=()), parameters
        self._models, self._logs = models, logs
        wheel_loads(self._robot, Floor().normal_gravity)  # raises what `Slipping` passes over
        rows = len(models[0].rows)
        self.expected, self.deviations = np.eye(1 + rows)[0], np.array([DOUBT] + rows * [UNEVEN])
        self._last: list[tuple[Array, Array]] = []
        self._calls = 0

    def predict(self, values: Array, states: Sequence[Array]) -> list[Array]:
        """Balance contacts by parameters of these values (P,), and return the creep (K - 1, rows, 1 + rows) in each log
        that is known up to factors.

        Contacts beyond the friction circle slide, and how much depends on the state: it is a mean of this call's and,
        with less weight, earlier ones, as iterations would alternate.
        """
        robot = robot_with(self._robot, self._parameters, values)
        slips = [Slipping(robot, *fit) for fit in zip(self._models, self._logs, states, strict=True)]
        found = [(slipping.stiffness, slipping.columns()) for slipping in slips]
        self._calls += 1
        weight = min(2 / self._calls, 1.0)
        self._last = [
            (new[0] ** weight * old[0] ** (1 - weight), weight * new[1] + (1 - weight) * old[1])
            for new, old in zip(found, self._last or found, strict=True)
        ]
        for model, (stiffness, _) in zip(self._models, self._last, strict=True):
            model.balance(stiffness)
        return [columns for _, columns in self._last]

    def expect(self, columns: Sequence[Array], factors: Array) -> None:
        """Make models expect the creep of columns with these factors (1 + rows,)."""
        for model, of_log in zip(self._models, columns, strict=True):
            model.expect(of_log @ factors)

    def disagreement(
        self, geometry: Geometry, changed: Geometry, change: Array, states: Sequence[Array]
    ) -> tuple[Array, Array]:
        """Return information (P, P) and score (P,) by how far wheels disagree, on changes of the parameters in parts of
        their scales; changed, change: as in `LogLikelihood.reduce`."""
        scale, count = np.array([p.scale for p in self._parameters]), len(self._parameters)
        information, score = np.zeros((count, count)), np.zeros(count)
        for model, log, state in zip(self._models, self._logs, states, strict=True):
            steps = len(state) - 1, len(model.rows)
            changes = Changes(
                geometry, changed, change, state, np.zeros((*model.counts.shape, 0)), np.zeros((*steps, 0))
            )
            seen = Disagreement.of(model, changes, log.t, np.zeros((*steps, 0)), np.zeros(steps, dtype=bool))
            by_size, by_score, _ = seen.statistics()
            information += by_size[:count, :count] * np.outer(scale, scale)
            score += by_score[:count] * scale
        return scattered(information, score, CONTROLLER**2 * np.eye(count))
