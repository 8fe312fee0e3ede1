"""Observations as vectors whose numbers are of one size, for networks to learn from."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from castor_envs.envs.driving.reward import LOST
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from castor_envs.sensors.encoders import castor_angles
from castor_envs.sensors.observation import Observation
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription

LIMIT = 5.0
"""Where scaled numbers are cut off."""

# What becomes 1. Speeds: twice those of the named courses. Errors: so that `LOST` becomes `LIMIT`. The reference a
# second ahead. The circle that random trajectories stay in. A frame's bend, and the age of its reading.
SPEED, TURN = 0.5, 1.0  # m/s, rad/s
ERROR, HEADING_ERROR = LOST / LIMIT, 0.2  # m, rad
NEAR, TURNED = 0.5, 1.0  # m, rad
ACROSS = 4.0  # m
BENT, OLD = 1.0, 1.0  # rad, s


@dataclass(frozen=True, eq=False)
class Scaling:
    """Turns observations into vectors, float32, mostly within [-1, 1] and always within `LIMIT`.

    In order: what `scales` names, divided by its scale, a missing reading 0; then cosines and sines of the angles of
    the castors with an encoder (`geometry`, of robots).
    """

    scales: dict[str, Array]
    geometry: Geometry | None

    @classmethod
    def of(cls, vehicle: Vehicle, longest: float, ahead: Sequence[float]) -> "Scaling":
        """Return the scaling for a vehicle as described. longest: an episode, s. ahead: when references are seen, s."""
        bodies = vehicle.modules if isinstance(vehicle, TrainDescription) else (vehicle,)
        now, later = (ERROR, ERROR, HEADING_ERROR), (NEAR, NEAR, TURNED)
        scales = {
            "wheel": np.concatenate([_counts_at_speed(body) for body in bodies]),
            "time": np.array([longest]),
            "reference": np.concatenate([np.tile(later if t > 0 else now, len(bodies)) for t in ahead]),
            "reference_twist": np.tile((SPEED, SPEED, TURN), len(bodies)),
            "goal": np.tile((ACROSS, ACROSS, np.pi), len(bodies)),
        }
        if isinstance(vehicle, TrainDescription):
            scales["rps"] = np.concatenate([(frame.length, frame.length, BENT) for frame in vehicle.frames])
            scales["rps_age"] = np.full(len(vehicle.frames), OLD)
            return cls(scales, None)
        return cls(scales if vehicle.gyro is None else scales | {"gyro": np.array([TURN])}, Geometry.of(vehicle))

    @property
    def space(self) -> spaces.Box:
        """The space of the vectors."""
        castors = 0 if self.geometry is None else len(self.geometry.sensed)
        size = sum(len(scale) for scale in self.scales.values()) + 2 * castors
        return spaces.Box(-LIMIT, LIMIT, (size,), dtype=np.float32)

    def __call__(self, observation: Observation) -> NDArray[np.float32]:
        """Return an observation, or a stack of them, as a vector (...)."""
        parts = [observation[name] / scale for name, scale in self.scales.items()]
        if self.geometry is not None:
            theta = castor_angles(self.geometry, observation["pivot"])[..., self.geometry.sensed]
            parts += [np.cos(theta), np.sin(theta)]
        vector = np.minimum(np.maximum(np.concatenate(parts, axis=-1), -LIMIT), LIMIT)
        return np.nan_to_num(vector, copy=False, nan=0.0).astype(np.float32)


def _counts_at_speed(body: RobotDescription) -> Array:
    """Return the counts a sample period of driven wheels that roll at `SPEED`."""
    geometry, driven = Geometry.of(body), np.array(body.driven_wheels, dtype=np.intp)
    turns = SPEED * body.sample_period / (2 * np.pi * geometry.radius[driven])
    return turns * geometry.counts_per_rev[driven]
