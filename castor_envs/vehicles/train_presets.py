"""Trains to start from, and the one home of every number of theirs that no paper gives.

Vogt and Minor print the distance between axles, 0.35 m (Figs. 7 to 10), and no other dimension. Assumptions, and why:

- Module: wheels of 75 mm radius on a track of 320 mm, 5 kg: what a frame of that length can carry and turn against.
  Encoders and contact as those of the differential robot (`castor_envs.vehicles.presets`).
- Frame: E I = 0.5 N m2, so that a bend of 60 deg takes 1.5 N m, a quarter of what the wheels of a module can hold
  against at friction 0.8; 0.5 kg/m, a spring-steel strip with brackets. Damping: a decay within a few swings.
- Gauges: four, evenly. Noise and offsets such that a bent frame's pose is wrong by 1 to 3 cm, as the text says.
"""

import dataclasses

from castor_envs.errors import InputError
from castor_envs.vehicles.presets import differential
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import Frame, TrainDescription

FRAME_LENGTH = 0.35
HALF_TRACK = 0.16


def axle_module(half_track: float = HALF_TRACK) -> RobotDescription:
    """Return one differential axle module."""
    robot = differential(track=2 * half_track)
    return dataclasses.replace(
        robot,
        name="axle module",
        mass=3.0,
        inertia=0.03,
        max_wheel_torque=3.0,
        max_wheel_speed=10.0,
        castors=(dataclasses.replace(robot.castors[0], mass=2.0, inertia=0.03),),
    )


def cfmmr(n: int = 3) -> TrainDescription:
    """Return a train of n axles (2 to 10) like the CFMMR."""
    if not 2 <= n <= 10:
        raise InputError(f"a train has 2 to 10 axles, got {n}")
    return TrainDescription(
        name=f"CFMMR, {n} axles", modules=(axle_module(),) * n, frames=(Frame(length=FRAME_LENGTH),) * (n - 1)
    )


TRAINS = tuple(f"cfmmr-{n}" for n in range(2, 11))


def train_names() -> tuple[str, ...]:
    """Return the names of trains that `castor_envs.vehicles.load.load_vehicle` knows."""
    return TRAINS
