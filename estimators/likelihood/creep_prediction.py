"""Prediction of how far a robot's contacts creep: under the forces of a motion, and where wheels are driven against
each other.

Creep predicted without the robot's effects on contacts is known up to a factor that logs determine (`fit_states`), and
so is that under the forces of effects, as on a slope; the slip of effects that make contacts yield more or less is
taken as predicted.
"""

import operator
from contextlib import suppress
from dataclasses import replace
from functools import cached_property, reduce

import numpy as np

from castor_envs.effects.catalogue import floor_of
from castor_envs.effects.floor import Bump
from castor_envs.errors import InputError
from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.steps import Motion, Slip
from castor_envs.logs.log import Log
from castor_envs.motion.kinematics import Geometry, castor_rates, inverse
from castor_envs.physics.contact_motion import ContactMotion, ForceBalance
from castor_envs.vehicles.robot import RobotDescription
from estimators.likelihood.channels import AVERAGING, Channels
from estimators.likelihood.log_likelihood import LogLikelihood, Noise

UNEVEN = 0.3
"""Relative standard deviation of each contact's creep about the prediction, where wheels disagree."""

DOUBT = 0.5
"""Prior standard deviation of the factor of creep under forces, about 1, where nothing is known of contacts."""

LEAST_NOISE = Noise(along=3e-5, across=3e-5, position=1e-4, heading=1e-4, gyro=1e-6, turning=3e-6)
"""Lower bounds of the noise of contacts that creep, and of trackers: 0.03 mm after 1 m, as trials declare; 0.1 mm and
0.1 mrad."""


class Slipping:
    """A robot's predicted slip in one log with state (K, m)."""

    def __init__(self, robot: RobotDescription, model: LogLikelihood, log: Log, state: Array) -> None:
        self._robot, self._model, self._log, self._state = robot, model, log, state
        self._without = replace(robot, effects=tuple(effect for effect in robot.effects if effect.creep is None))
        self._channels, self._floor = Channels(robot), floor_of(robot, Floor())
        self._over = self._over_cables()

    @property
    def stiffness(self) -> Array:
        """The force, N, per m/s of slip of each of the model's rows (K - 1, rows); of a side row that of all wheels of
        its castor. 1 where the robot cannot stand by itself."""
        return self._balanced[0]

    def sure(self) -> Array:
        """Return the slips (K - 1, rows) that are taken as predicted: the extra roll over the robot's cables, and the
        creep of its effects on how contacts yield."""
        motion = self._channels.motion(self._log, self._state, consistent_wheels=True)
        total = Slip.none(motion) if self._over is None else self._over
        for effect in self._robot.effects:
            if effect.creep == "compliance":
                try:
                    slip = effect.slip(ContactMotion(self._without.as_built(), motion))
                except InputError:  # it cannot stand by itself
                    continue
                total = total if slip is None else total + slip
        return self._rows(total)

    @property
    def forced(self) -> Array:
        """The creep (K - 1, rows) under the forces of the motion and of a slope, which is known up to a factor."""
        return self._balanced[1]

    def columns(self) -> Array:
        """Return the creep (K - 1, rows, 1 + rows) that is known up to factors: under forces, and of each row where
        wheels disagree."""
        _, forced, disagreeing = self._balanced
        return np.concatenate([forced[..., None], disagreeing[..., None] * np.eye(disagreeing.shape[1])], axis=-1)

    @cached_property
    def _balanced(self) -> tuple[Array, Array, Array]:
        """`stiffness`, `forced`, and the creep where wheels disagree, (K - 1, rows) each: all of one balance, which
        holds many times their memory."""
        balance = self._balance(self._without, self._floor)
        changed = len(self._without.effects) < len(self._robot.effects)
        built = self._balance(self._robot, self._floor) if changed else balance
        forced = self._rows(self._creep(balance, agree=True))
        disagreeing = self._rows(self._creep(balance, self._over)) - forced
        if built is None:
            return np.ones_like(forced), forced, disagreeing
        yields = built.yields
        stiffness = np.divide(1.0, yields, out=np.zeros_like(yields), where=yields > 0)
        wheels, of_castor = len(self._robot.wheels), np.array(self._robot.wheel_castors)
        stiffness[:, wheels:] = stiffness[:, wheels:] @ (of_castor[:, None] == of_castor)
        return stiffness[:, self._model.rows], forced, disagreeing

    @cached_property
    def by_effects(self) -> Array:
        """Return the predicted creep (K - 1, rows) that effects on what encoders read cause, and mistakes of wiring
        (`Log`): the difference to that of a robot without them whose encoders read the same."""
        if self._described is None:
            return np.zeros((len(self._log) - 1, len(self._model.rows)))
        return self._rows(self._not_averaged() - Slipping(*self._described)._not_averaged())

    @cached_property
    def disagreement(self) -> Array:
        """The disagreement of wheels (K - 1, rows, 2), m, that the robot's effects cause, and mistakes of wiring, in
        two ways, of which contacts that creep let parts happen; in none, (K - 1, rows, 0), without any.

        The first: castors and wheels turn as encoders read, and contacts slip; it is the difference to the disagreement
        of a robot without the effects whose encoders read the same, as a controller that does not know of them leaves
        none in what it reads. The second: the floor turns castors that trail as they should turn, and their wheels are
        driven as if they stood where encoders read, as within a backlash.
        """
        if self._described is None:
            return np.zeros((len(self._log) - 1, len(self._model.rows), 0))
        robot, model, log, read = self._described
        built, described = self._channels.geometry, Geometry.of(robot)
        as_read = model.disagreement(built, self._state) - model.disagreement(described, read)
        moved, seen = self._channels.motion(log, self._state), Channels(robot).motion(log, read)
        rolling = built.radius * (_turned_by_floor(built, moved, moved) - _turned_by_floor(described, moved, seen))
        slips = self._rows(Slip(rolling, np.zeros((len(rolling), built.n_castors))))
        return np.stack([as_read, slips - model.explained(built, self._state, slips)], axis=-1)

    @cached_property
    def _described(self) -> tuple[RobotDescription, LogLikelihood, Log, Array] | None:
        """The robot without effects whose encoders read the same, and the state that they read; None: it is this."""
        real = self._robot.with_effects(*self._log.undone)
        if not real.effects:
            return None
        read = self._state.copy()
        read[:, 3:] = self._channels.read(real, self._log, read[:, 3:])
        return real.as_described(), self._model, self._log, read

    def _not_averaged(self) -> Slip:
        """Return the creep predicted step by step, on an even floor."""
        return self._creep(self._balance(self._without, Floor(), averaging=0.0), self._over)

    def _balance(self, robot: RobotDescription, floor: Floor, averaging: float = AVERAGING) -> ForceBalance | None:
        """Return the balance of forces on a robot's contacts; None: it cannot stand by itself. averaging: s, over which
        noise goes out, but with it what encoders truly read in a few steps."""
        motion = replace(self._channels.motion(self._log, self._state), averaging=averaging)
        with suppress(InputError):
            return ForceBalance(robot.as_built(), motion, floor)
        return None

    def _creep(self, balance: ForceBalance | None, known: Slip | None = None, agree: bool = False) -> Slip:
        """Return the creep predicted where wheels are known to slip for another reason, or agree."""
        if balance is None:
            return Slip.none(self._channels.motion(self._log, self._state))
        return balance.creep(None if known is None else known.rolling, agree)

    def _over_cables(self) -> Slip | None:
        """Return by how much contacts move further than wheels roll over the robot's cables, if there are any."""
        cables = [effect for effect in self._robot.effects if isinstance(effect, Bump)]
        if not cables:
            return None
        contacts = ContactMotion(self._robot.as_built(), self._channels.motion(self._log, self._state))
        return reduce(operator.add, [cable.slip(contacts) for cable in cables])

    def _rows(self, slip: Slip) -> Array:
        """Return slips as the rows (K - 1, rows) of the model."""
        return self._model.rows_of(slip.rolling, slip.side)


def _turned_by_floor(geometry: Geometry, moved: Motion, seen: Motion) -> Array:
    """Return by which angles wheels turn in each step (K - 1, w), rad, that roll as a body moves (`moved`) where
    castors stand as `seen`; those that trail turn as the floor turns them there."""
    period = moved.period[:, None]
    twist, theta = moved.body / period, seen.half_way
    by_floor = geometry.trailing & ~geometry.driven
    turning = np.where(by_floor, castor_rates(geometry, theta, twist), seen.turned / period)
    return period * inverse(geometry, theta, turning, twist).rate
