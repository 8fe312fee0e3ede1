"""A gyro against the wheels of the same log: its sign, unit, scale and bias.

    turn by the gyro = scale (turn by the wheels) + bias (time)

by least squares over windows. A scale off 1 is the gyro's or the wheels' (radii over track): without a reference only
their ratio is seen. While the body turns at one rate, a bias looks like a scale: then it is taken to be the file's.
"""

import math
from typing import NamedTuple

import numpy as np

from castor_envs.errors import Declined
from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from estimators.robots.wheel_odometry import WheelOdometry
from estimators.steps.gyro import GyroTurns

WINDOW = 1.0
"""s, over which turns are compared: within it rounded counts and clocks that are apart average out."""

LEAST_TURN = 1.0
"""rad that the wheels turn the body in all, both ways added: below it a scale says little; and rad that they turn it
more or less than at one rate: below it a bias says little."""

FOLLOWS = 0.9
"""Part of the gyro's squares that the wheels explain: below it another thing than this body's turn is read."""

NEAR = 0.05
"""How far the scale may be from a number that it stands for; dimensions of a robot file are rarely off by more."""

_MEANINGS = {
    1.0: "agrees with the wheels",
    -1.0: "turns against the wheels: change its sign",
    math.degrees(1.0): "is in deg/s: give rad/s",
    -math.degrees(1.0): "is in deg/s, and turns against the wheels: give rad/s, and change its sign",
    math.radians(1.0): "was in rad/s and is multiplied by pi/180: multiply it by 180/pi",
    -math.radians(1.0): "was in rad/s, is multiplied by pi/180, and turns against the wheels: multiply it by -180/pi",
}

_MISTAKES = tuple(words for scale, words in _MEANINGS.items() if scale != 1.0)


class GyroCheck(NamedTuple):
    """scale: of the gyro's turn to the wheels'. bias, rad/s. follows: part of the gyro's squares that is explained, 0
    to 1. verdict: one line. mistaken: whether its sign or unit is wrong."""

    scale: float
    bias: float
    follows: float
    verdict: str
    mistaken: bool


def gyro_against_wheels(robot: RobotDescription, log: Log) -> GyroCheck | None:
    """Return what a log shows of its gyro; None without one, where the wheels do not tell how the body turns, and where
    it turns too little."""
    if log.gyro is None:
        return None
    try:
        gyro, wheels, time = _turns(robot, log)  # of the gyro less the file's bias
    except Declined:
        return None
    if np.abs(wheels).sum() < LEAST_TURN or len(time) < 3:
        return None
    rate = (wheels @ time) / (time @ time)
    if np.abs(wheels - rate * time).sum() < LEAST_TURN:
        scale, bias = float(wheels @ gyro / (wheels @ wheels)), 0.0
    else:
        scale, bias = np.linalg.lstsq(np.column_stack([wheels, time]), gyro, rcond=None)[0].tolist()
    left = gyro - scale * wheels - bias * time
    about_bias = gyro - bias * time
    follows = 1.0 - float(left @ left) / max(float(about_bias @ about_bias), 1e-300)
    verdict = _verdict(scale, follows)
    described = 0.0 if robot.gyro is None else robot.gyro.bias
    return GyroCheck(scale, described + bias, follows, verdict, verdict in _MISTAKES)


def _verdict(scale: float, follows: float) -> str:
    if follows < FOLLOWS:
        return "does not follow the wheels: another axis, another clock, or wheels that slip"
    for meaning, words in _MEANINGS.items():
        if abs(scale / meaning - 1) <= NEAR:
            return words
    causes = "its unit or scale, a wheel's sign, or the robot file's radii or track"
    return f"turns {scale:.3g} times as much as the wheels say: {causes}"


def _turns(robot: RobotDescription, log: Log) -> tuple[Array, Array, Array]:
    """Return the turns (W,), rad, by gyro and wheels, and the time (W,), s, of each window: of those of its samples in
    which the gyro was read."""
    odometry, by_gyro = WheelOdometry(), GyroTurns(robot.gyro, robot.sample_period)
    odometry.reset(robot.as_built(), np.zeros(3))
    heading, read = [], []
    for observation in log.observations():
        heading.append(float(odometry.update(observation)[2]))
        read.append(by_gyro.read(observation))
    known = np.array([bool(sample.known) for sample in read])
    samples = (
        np.array([float(sample.turn) for sample in read]),
        known * np.diff(heading, prepend=heading[0]),
        np.array([float(sample.duration) for sample in read]),
    )
    edges = np.unique(np.searchsorted(log.t, np.arange(log.t[0], log.t[-1], WINDOW)))
    gyro, wheels, time = (np.diff(np.cumsum(of)[edges]) for of in samples)
    return gyro[time > 0], wheels[time > 0], time[time > 0]
