"""Many environments whose agents drive, stepped as one."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from numpy.typing import NDArray

from castor_envs.envs.actions import finite
from castor_envs.envs.driving.followers import Follower
from castor_envs.envs.driving.lanes import RobotLanes, TrainLanes
from castor_envs.envs.driving.reference_table import ROWS, Reference
from castor_envs.envs.driving.reward import LOST, quality, tracking_error
from castor_envs.envs.driving.tracking import AHEAD, TrackingEnv, seen_from
from castor_envs.envs.sensed import SensedRobot
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.physics.fleet import structure
from castor_envs.physics.stepper import FASTEST
from castor_envs.sensors.observation import Observation, copied


class TrackingVectorEnv(SyncVectorEnv):
    """The members of a `SyncVectorEnv`, moved in one compiled call and seen in arrays: the same numbers, bit for bit.

    Members are reset one by one, with their own seeds, courses and random numbers. `call` and `get_attr` find them as
    they are now. Members must have one layout: `steps_as_one`.
    """

    envs: Any  # list[TrackingEnv]

    def __init__(
        self,
        env_fns: Sequence[Any],
        threads: int | None = None,
        max_episode_steps: int | None = None,
        **options: Any,
    ) -> None:
        """Take members. threads: None for as many as pay. max_episode_steps: after which episodes are truncated."""
        super().__init__(env_fns, **options)
        first, sensed = self.envs[0], [env.sensed for env in self.envs]
        self._lanes = (RobotLanes if isinstance(sensed[0], SensedRobot) else TrainLanes)(sensed, threads)
        places = np.asarray(first.course.target(0.0))
        self._period = np.array([env.vehicle.sample_period for env in self.envs])
        self._follower = _one_follower(self.envs) if first.control == "residual" else None
        self._fastest = np.stack([env.follower.fastest for env in self.envs])
        self._most_samples = math.inf if max_episode_steps is None else max_episode_steps
        self._sample, self._samples = np.zeros((2, self.num_envs), dtype=np.intp)
        self._places = np.empty((self.num_envs, ROWS, len(AHEAD) + 1, *places.shape))
        self._twist = np.empty((self.num_envs, ROWS, *places.shape))
        self._current, self._changed = np.zeros((2, self.num_envs), dtype=np.bool_)
        self._unscaled: Observation = {}
        self._all = np.ones(self.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset all members, or those of ``options["reset_mask"]``."""
        given = options.get("reset_mask") if isinstance(options, dict) else None  # members refuse what is none
        if given is not None and not self._unscaled and not np.all(given):
            raise ResetNeeded("some members have not begun an episode; call reset() without a reset_mask first")
        self._keep_observations()
        answer = super().reset(seed=seed, options=options)
        for lane in range(self.num_envs) if given is None else _lanes_of(given):
            self._load(lane)
        return answer

    def step(self, actions: Any) -> tuple[Any, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Step all members; those that have ended are reset, when and if `autoreset_mode` says so."""
        if not self._unscaled:
            raise ResetNeeded("a step needs episodes that have begun; call reset() first")
        first, over = self.envs[0], self._autoreset_envs
        if self.autoreset_mode == AutoresetMode.DISABLED and over.any():
            raise InputError(f"members {np.flatnonzero(over).tolist()} have ended; reset them by options['reset_mask']")
        going = ~over if self.autoreset_mode == AutoresetMode.NEXT_STEP else self._all
        if over.any() and np.shape(actions) == self.action_space.shape:
            # What members that begin again are told is not read.
            actions = np.where(going.reshape(-1, *np.ones(np.ndim(actions) - 1, dtype=int)), actions, 0.0)
        fraction = np.minimum(np.maximum(finite(actions, self.action_space.shape, "actions"), -1.0), 1.0)
        motors, wheels = self._motors(fraction), first.follower.wheels
        motors[:, first.sensed.held] = 0.0
        commands = motors[:, :wheels], motors[:, wheels:]
        self._lanes.advance(*commands, first.drive)
        self._sample += going
        self._changed[:] = True
        self._check(going)
        readings, pose = self._lanes.sense(going)
        for lane in _lanes_of((self._sample % ROWS == 0) & going):
            self._tabulate(lane)
        row = (np.arange(self.num_envs), self._sample % ROWS)
        reference = Reference(np.moveaxis(self._places[row], 1, 0), self._twist[row])
        self._unscaled = readings | seen_from(pose, reference, self.num_envs)
        vehicles = (self.num_envs, -1, 3)  # a robot is a single one
        errors = tracking_error(pose.reshape(vehicles), reference.places[0].reshape(vehicles))
        position_error, heading_error = errors
        self._rewards = np.where(going, self._period * quality(position_error, heading_error), 0.0)
        self._terminations = (position_error > LOST) & going
        self._truncations = (self._sample >= self._samples) & going
        info = {
            "pose": pose,
            "target": reference.places[0].copy(),
            "position_error": position_error,
            "heading_error": heading_error,
            "command": commands[0],
            "steering_command": commands[1],
        }
        shown = self._unscaled if first.scaling is None else first.scaling(self._unscaled)
        self._autoreset_envs = self._terminations | self._truncations
        infos: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            for lane in _lanes_of(self._autoreset_envs):
                final = {name: _own(values[lane]) for name, values in info.items()}
                infos = self._add_info(infos, {"final_obs": _row(shown, lane), "final_info": final}, lane)
        again = {AutoresetMode.SAME_STEP: self._autoreset_envs, AutoresetMode.NEXT_STEP: over}
        for lane in _lanes_of(again.get(self.autoreset_mode, False)):
            self._start_again(lane, shown, info)
        for name, values in info.items():
            infos[name], infos[f"_{name}"] = values, self._all.copy()
        self._observations = shown
        own = copied(shown) if isinstance(shown, dict) else shown.copy()
        return own, self._rewards.copy(), self._terminations.copy(), self._truncations.copy(), infos

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """Return what members answer to a call of a method, or their values of an attribute."""
        self._give_back()
        answer = super().call(name, *args, **kwargs)
        self._load_all()
        return answer

    def set_attr(self, name: str, values: Any) -> None:
        """Set an attribute of the members."""
        self._give_back()
        super().set_attr(name, values)
        self._load_all()

    def close_extras(self, **kwargs: Any) -> None:
        """Close all members, and end the threads."""
        self._lanes.fleet.close()
        super().close_extras(**kwargs)

    def _motors(self, fraction: Array) -> Array:
        """Return what actions (B, ...) tell the motors (B, m), as `TrackingEnv` does for one."""
        first = self.envs[0]
        if self._follower is not None:
            return self._follower.corrected(self._unscaled, fraction)
        if first.control == "voltage":
            wheels = first.follower.wheels
            return np.concatenate([fraction[:, :wheels], fraction[:, wheels:] * self._fastest[:, wheels:]], axis=1)
        return fraction * self._fastest

    def _check(self, going: NDArray[np.bool_]) -> None:
        """Raise InputError where a member's physics has become unstable."""
        fleet = self._lanes.fleet
        sound = (np.abs(fleet.motion[..., 3:]) < FASTEST).all(axis=(1, 2)) | ~going
        if not sound.all():
            lane = int(np.flatnonzero(~sound)[0])
            raise fleet.simulations[lane].unstable(fleet.time[lane])

    def _start_again(self, lane: int, shown: Any, info: dict[str, Array]) -> None:
        """Reset a member, and put what it says then into its rows."""
        observation, said = self.envs[lane].reset()
        self._load(lane)
        for name, value in said.items():
            info[name][lane] = value
        if isinstance(shown, dict):
            for name, value in observation.items():
                shown[name][lane] = value
        else:
            shown[lane] = observation

    def _load(self, lane: int) -> None:
        """Take the state of a member."""
        env = self.envs[lane]
        self._lanes.load(lane)
        self._sample[lane], self._samples[lane] = env.sample, min(env.samples, self._most_samples)
        self._tabulate(lane)
        if not self._unscaled:
            self._unscaled = {name: np.empty((self.num_envs, *values.shape)) for name, values in env.unscaled.items()}
        for name, values in env.unscaled.items():
            self._unscaled[name][lane] = values
        self._changed[lane] = False

    def _load_all(self) -> None:
        """Take the states of all members, once they have any."""
        for lane in range(self.num_envs) if self._unscaled else ():
            self._load(lane)

    def _give_back(self) -> None:
        """Give all members their states."""
        for lane in _lanes_of(self._changed):
            self._lanes.give_back(lane, {})
            self.envs[lane].resume(int(self._sample[lane]), _row(self._unscaled, lane))
        self._changed[:] = False

    def _tabulate(self, lane: int) -> None:
        """Take a member's course at its present samples."""
        places, twist = self.envs[lane].table.block(int(self._sample[lane]))
        self._places[lane], self._twist[lane] = places, twist

    def _keep_observations(self) -> None:
        """Give `SyncVectorEnv` the rows that a partial reset leaves."""
        if self._unscaled:
            self._env_obs = [_row(self._observations, lane) for lane in range(self.num_envs)]


def steps_as_one(envs: Sequence[TrackingEnv[Any]]) -> bool:
    """Return whether environments can be stepped as one: nothing that only one at a time can do, and one layout."""
    layouts = {
        (structure(env.sensed.world.simulation), env.sensed.layout, env.control, env.action_space.shape) for env in envs
    }
    scaled = any(env.scaling is not None for env in envs)
    alike = all(env.vehicle == envs[0].vehicle for env in envs)
    if not all(env.steps_in_fleet for env in envs) or len(layouts) > 1 or (scaled and not alike):
        return False
    return envs[0].control != "residual" or _one_follower(envs) is not None


def _one_follower(envs: Sequence[TrackingEnv[Any]]) -> Follower | None:
    """Return the scripted driver of all members, None for robots whose encoders differ."""
    try:
        kind: Any = type(envs[0].follower)
        return kind([env.vehicle for env in envs])
    except ValueError:
        return None


def _lanes_of(which: Any) -> list[int]:
    """Return the members for which an array (B,) says so."""
    return np.flatnonzero(which).tolist()


def _row(values: Any, lane: int) -> Any:
    """Return one member's part of an observation, copied."""
    if isinstance(values, dict):
        return {name: array[lane].copy() for name, array in values.items()}
    return values[lane].copy()


def _own(value: Any) -> Any:
    return value.copy() if isinstance(value, np.ndarray) else float(value)
