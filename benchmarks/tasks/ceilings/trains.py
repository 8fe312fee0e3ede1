"""Oracles of trains, told what nobody can know: yardsticks, no strict bounds.

Of drives: odometry that knows the true train, on wheels that never slip. Each wheel's encoder reads how far the floor
passes beneath it along its rolling direction. What is left are the encoder's steps, and slip to the side, which no
wheel shows. Relative poses are not used: they could only add noise. Of snapshots: the best fit of the axles that
odometry has right, told which they are.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.vehicles.train import TrainDescription
from estimators.trains.grpec import corrected
from estimators.trains.least_squares import gauss_newton
from estimators.trains.odometry import TrainOdometry


def followed_ideally(train: TrainDescription, pose: Array, samples: NDArray[np.intp]) -> Array:
    """Return the ceiling's poses (N, M, 3) at samples (M,) of a drive. train: the true one, moving as pose (K, 3N)."""
    counted = np.round(rolled_angles(train, pose) * counts_per_radian(train))
    oracle = TrainOdometry()
    oracle.reset(train, pose[0].reshape(-1, 3))
    steps = np.diff(counted, axis=0, prepend=counted[:1])
    return np.array([oracle.update({"wheel": step}) for step in steps])[samples].swapaxes(0, 1)


def counts_per_radian(train: TrainDescription) -> Array:
    """Return the counts of all wheels' encoders (2N,) for each radian."""
    wheels = (wheel for module in train.modules for wheel in module.wheels)
    return np.array([wheel.counts_per_rev or 0.0 for wheel in wheels]) / (2 * np.pi)


def rolled_angles(train: TrainDescription, pose: Array) -> Array:
    """Return by which angles (K, 2N), rad, wheels turn that roll without slip on the way of axles with pose (K, 3N).

    Between two samples an axle moves on an arc; what it moves across that arc's chord is slip to the side.
    """
    axles = pose.reshape(len(pose), -1, 3)
    step = se2.relative_pose(axles[:-1], axles[1:])
    turn = step[..., 2]
    chord = np.cos(turn / 2) * step[..., 0] + np.sin(turn / 2) * step[..., 1]
    arc = chord / np.sinc(turn / (2 * np.pi))
    wheels = [module.wheels for module in train.modules]
    lateral = np.array([[wheel.lateral for wheel in pair] for pair in wheels])
    radius = np.array([[wheel.radius for wheel in pair] for pair in wheels])
    angle = (arc[..., None] - lateral * turn[..., None]) / radius
    return np.concatenate([np.zeros((1, pose.shape[1] // 3 * 2)), np.cumsum(angle, axis=0).reshape(len(step), -1)])


def best_configuration(belief: Array, relative: Array, sound: Sequence[int]) -> Array:
    """Return the ceiling's poses (N, 3) of a snapshot: the least-squares fit that is told which axles' belief is right.

    belief (N, 3), relative (N - 1, 3). sound: these axles, from 1 at the front.
    """
    right = np.isin(np.arange(1, len(belief) + 1), sound)
    return gauss_newton(belief, relative, priors=right, start=corrected(belief, relative, int(np.argmax(right)))).poses
