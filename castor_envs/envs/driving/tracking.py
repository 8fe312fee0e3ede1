"""The base of environments whose agent drives: what it commands, what it sees, and when it is lost."""

import pkgutil
from abc import abstractmethod
from collections.abc import Callable
from typing import Any, Literal, Protocol, cast, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from castor_envs.envs.actions import finite
from castor_envs.envs.base import Sensed, VehicleEnv
from castor_envs.envs.driving.followers import Follower
from castor_envs.envs.driving.reference_table import Reference, ReferenceTable
from castor_envs.envs.driving.reward import LOST, quality, tracking_error
from castor_envs.envs.driving.scaling import Scaling
from castor_envs.errors import InputError, did_you_mean, one_line
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose, wrap
from castor_envs.motion.controllers import Commands
from castor_envs.physics.stepper import Drive
from castor_envs.sensors.observation import Observation, copied

AHEAD = (0.0, 0.25, 0.5, 1.0)  # s from now at which the reference is shown
FAR, FAST = 1e3, 1e2  # m, and m/s or rad/s: what is shown of the reference is cut off there

Control = Literal["speed", "voltage", "residual"]


class Believing(Protocol):
    """An estimator (`estimators.protocol`), which tells the agent where the vehicle is."""

    def reset(self, robot: Any, pose: Array, /) -> None:
        """Start at a pose (3,), or at poses (N, 3) of a train."""

    def update(self, observation: Any, /) -> Array:
        """Return the pose (3,), or the poses (N, 3), after what the sensors say."""
        ...


EstimatorClass = Callable[[], Believing]


class TrackingEnv(VehicleEnv[Sensed]):
    """A vehicle whose agent commands all motors and is to be where its course is. Subclasses know its motors.

    follower: the scripted driver.
    """

    def _track(
        self, follower: Follower, control: Control, estimator: EstimatorClass | str | None, scaled: bool
    ) -> None:
        """Take what all constructors share, after that of the vehicle."""
        if control not in get_args(Control):
            raise InputError(f"unknown control {control!r}{did_you_mean(str(control), get_args(Control))}")
        if not isinstance(scaled, bool):
            raise InputError(f"scaled must be True or False, got {scaled!r}")
        self.follower, self.control = follower, control
        self._estimator_class = _estimator_class(estimator)
        size = (follower.corrections if control == "residual" else follower.fastest).shape
        self.action_space = spaces.Box(-1.0, 1.0, size, dtype=np.float32)
        bodies = self.course.target(0.0).size // 3
        far = np.tile([FAR, FAR, np.pi], bodies)
        most = {"reference": np.tile(far, len(AHEAD)), "reference_twist": np.full(3 * bodies, FAST), "goal": far}
        shown = {name: spaces.Box(-bound, bound, dtype=np.float64) for name, bound in most.items()}
        readings: Any = self.observation_space
        self.observation_space = spaces.Dict(readings.spaces | shown)
        self.scaling = Scaling.of(self.vehicle, self._longest, AHEAD) if scaled else None
        if self.scaling is not None:
            self.observation_space = self.scaling.space

    @property
    def drive(self) -> Drive:
        """How motors take commands."""
        return "voltage" if self.control == "voltage" else "servo"

    @property
    def unscaled(self) -> Observation:
        """The newest observation, before it is scaled: a copy."""
        self._need_reset("unscaled")
        return copied(self._unscaled)

    @property
    def steps_in_fleet(self) -> bool:
        """Whether many of it can be stepped as one: no effects, no estimator, no window."""
        return self._estimator_class is None and self.render_mode is None and self.sensed.steps_in_fleet

    def resume(self, sample: int, unscaled: Observation) -> None:
        """Be at a sample of the course with its observation, not scaled, after the vehicle has been moved there."""
        self.sample, self._unscaled = sample, unscaled
        self.sensed.observation = {name: unscaled[name] for name in self.sensed.observation}
        self._believed = self.sensed.pose

    @abstractmethod
    def _advance(self, commands: Commands, drive: Drive) -> None:
        """Drive for one sample period."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Put the vehicle at the start of its course."""
        self._start(seed, options)
        self.table = ReferenceTable(self.course, self.vehicle.sample_period, AHEAD)
        self._estimator = None if self._estimator_class is None else self._estimator_class()
        if self._estimator is not None:
            self._estimator.reset(self.vehicle, self.sensed.pose)
        return self._after(self._commands(np.zeros_like(self.follower.fastest)))

    def step(self, action: NDArray[np.float32]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Command the motors for one sample period."""
        self._need_going()
        fraction = np.minimum(np.maximum(finite(action, self.action_space.shape, "action"), -1.0), 1.0)
        commands = self._commands(self._motors(fraction))
        self._advance(commands, self.drive)
        self.sample += 1
        observation, info = self._after(commands)
        reward = self.vehicle.sample_period * float(quality(info["position_error"], info["heading_error"]))
        lost, over = info["position_error"] > LOST, self.sample >= self.samples
        self._over = lost or over
        return observation, reward, lost, over, info

    def _motors(self, fraction: Array) -> Array:
        """Return what an action tells the motors (m,): speeds, or voltages of wheels as a fraction of the full one."""
        fastest, wheels = self.follower.fastest, self.follower.wheels
        if self.control == "residual":
            return self.follower.corrected(self._unscaled, fraction)
        if self.control == "voltage":
            return np.concatenate([fraction[:wheels], fraction[wheels:] * fastest[wheels:]])
        return fraction * fastest

    def _commands(self, motors: Array) -> Commands:
        if self.sensed.held.size:
            motors = motors.copy()
            motors[self.sensed.held] = 0.0
        return Commands(motors[: self.follower.wheels], motors[self.follower.wheels :])

    def _after(self, commands: Commands) -> tuple[Any, dict[str, Any]]:
        """Return observation and information of the newest sample; in human mode, draw it."""
        pose, reference = self.sensed.pose, self.table.at(self.sample)
        target = reference.places[0].copy()
        self._believed = pose
        if self._estimator is not None:
            self._believed = finite(self._estimator.update(self.readings), pose.shape, "estimator's pose")
        self._show()
        self._unscaled = self.sensed.observation | seen_from(self._believed, reference)
        observation = copied(self._unscaled) if self.scaling is None else self.scaling(self._unscaled)
        position_error, heading_error = map(float, tracking_error(pose, target))
        return observation, {
            "pose": pose,
            "target": target,
            "position_error": position_error,
            "heading_error": heading_error,
            "command": commands.wheel,
            "steering_command": commands.steering,
        }

    def shown_estimate(self) -> ArrayLike | None:
        """Return where the agent believes to be, if an estimator tells it."""
        return None if self._estimator is None else self._believed


def seen_from(believed: Array, reference: Reference, *many: int) -> Observation:
    """Return what is seen of a course from where the agent believes to be, (3,), or (N, 3) of a train.

    many: B for B vehicles; then `believed` and the twist have it as their first axis, and the places as their second.
    """
    seen = relative_pose(believed, reference.places)
    seen[..., :2] = np.minimum(np.maximum(seen[..., :2], -FAR), FAR)
    seen[..., 2] = wrap(seen[..., 2])
    ahead = np.moveaxis(seen[:-1], 0, 1) if many else seen[:-1]
    return {
        "reference": ahead.reshape(*many, -1),
        "reference_twist": np.minimum(np.maximum(reference.twist.reshape(*many, -1), -FAST), FAST),
        "goal": seen[-1].reshape(*many, -1),
    }


def _estimator_class(given: EstimatorClass | str | None) -> EstimatorClass | None:
    """Return what makes estimators: a class, or one given by its name; raises InputError for anything else."""
    if given is None:
        return None
    found: Any = _named(given) if isinstance(given, str) else given
    if not callable(found) or not all(hasattr(found(), method) for method in ("reset", "update")):
        raise InputError(
            f"estimator must be a class with `reset` and `update`, or its name 'module:Class', not {given!r}"
        )
    return cast(EstimatorClass, found)


def _named(name: str) -> Any:
    try:
        return pkgutil.resolve_name(name)
    except (ImportError, AttributeError, ValueError) as error:
        # A ValueError only says that the form is another one, such as that of the commands.
        why = "" if isinstance(error, ValueError) else f" ({one_line(error)})"
        raise InputError(
            f"there is no estimator {name!r}{why}; give 'module:Class', such as 'estimators.robots.cast:CAST', or for "
            f"names and files as in castor-bench, estimators.load_estimator({name!r}).factory"
        ) from error
