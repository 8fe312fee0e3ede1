"""How encoders of foreign simulators are read: the effects on them see true angles at the simulation's own fine steps.

Angles (m, w + n) are of wheels and castors, rad, at times (m,).
"""

import numpy as np

from castor_envs.effects.clocks import SampleJitter
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.effect import SensorModel
from castor_envs.vehicles.robot import RobotDescription

BY_SAMPLE = ("tick_loss", "lost_remainders")
"""Effects that act on what a wheel turns in a whole sample period."""


class Sensors:
    """The encoders of a robot with its effects, read one sample period after the other."""

    def __init__(self, robot: RobotDescription) -> None:
        built = robot.as_built()
        effects = [effect for effect in robot.effects if not isinstance(effect, SampleJitter)]
        models = [(effect.name in BY_SAMPLE, effect.sensor_model(built)) for effect in effects]
        self._models = [_ByPeriod(model) if by_sample else model for by_sample, model in models if model is not None]
        self._w = len(robot.wheels)

    def push(self, t: Array, angle: Array) -> Array:
        """Return the angles that encoders see in a period, whose sample is in the last row; the first call has the
        start alone."""
        wheel, castor = angle[:, : self._w], angle[:, self._w :]
        for model in self._models:
            wheel, castor = model(t, wheel, castor)
        return np.column_stack([wheel, castor])


class _ByPeriod:
    """A sensor model that sees a period's last row alone: what it changes there shows in the rows up to the next."""

    def __init__(self, model: SensorModel) -> None:
        self._model, self._change = model, (0.0, 0.0)

    def __call__(self, t: Array, wheel: Array, castor: Array) -> tuple[Array, Array]:
        """Return both angles as encoders see them."""
        seen = self._model(t[-1:], wheel[-1:], castor[-1:])
        read = tuple(
            np.vstack([true[:-1] + change, last])
            for true, change, last in zip((wheel, castor), self._change, seen, strict=True)
        )
        self._change = seen[0] - wheel[-1:], seen[1] - castor[-1:]
        return read[0], read[1]


def reading_times(robot: RobotDescription, t: Array) -> Array:
    """Return when (K,) the encoders are read for the rows of times t (K,): uneven with jitter."""
    times = np.array(t, dtype=float)
    for effect in robot.effects:
        if isinstance(effect, SampleJitter):
            half = np.diff(t, prepend=t[0]) / 2
            shift = effect.value * np.random.default_rng(effect.seed).standard_normal(len(t))
            times += np.clip(shift, -half, half)
    return times
