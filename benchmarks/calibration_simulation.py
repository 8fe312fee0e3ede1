"""Doebbler's Table I simulated: what calibration by pivoting leaves of random parameter errors, all sets at once.

The base turns once about each castor's pivot, both ways, in steady rolling: the angles at which castors trail and the
distances that wheels roll are known in closed form, and only the counts are rounded. The paper leaves open how errors
are distributed (taken: uniform, of Table I's uncalibrated mean sizes, "up to 4 %"), how far the base turned (once), and
how well the distance D between pivots is known.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np

from benchmarks.tasks.kinematic import UNCALIBRATED, true_robot
from castor_envs.kinematics import Array
from estimators.calibration.pivoting import CastorParameters, from_turns

#: Table I, uncalibrated: Table II takes beta = 0, Table I 7.98 deg.
ERRORS = dataclasses.replace(UNCALIBRATED, pivot_zero=2 * np.radians(7.98))


@dataclass(frozen=True)
class Left:
    """Mean absolute errors over all sets and castors, each with its standard error: relative, of beta in rad."""

    offset: tuple[float, float]
    pivot_zero: tuple[float, float]
    radius: tuple[float, float]
    half_track: tuple[float, float]


def errors_left(sets: int, distance_error: float = 0.0, seed: int = 0) -> tuple[Left, Left]:
    """Return the errors before and after calibration, over `sets` robots.

    distance_error: mean absolute relative error of the known D (uniform, drawn for each pair of pivots alone).
    """
    random, robot = np.random.default_rng(seed), true_robot()
    pivot = np.array([castor.pivot for castor in robot.castors])
    n = len(pivot)

    def drawn(nominal: Array, half_width: float) -> Array:
        return nominal * (1 + half_width * random.uniform(-1, 1, (sets, *nominal.shape)))

    nominal_offset = np.array([castor.offset for castor in robot.castors])
    nominal_radius = np.array([[wheel.radius for wheel in castor.wheels] for castor in robot.castors])
    nominal_track = np.array([[abs(wheel.lateral) for wheel in castor.wheels] for castor in robot.castors])
    offset, radius = drawn(nominal_offset, ERRORS.offset), drawn(nominal_radius, ERRORS.radius)
    track, zero = drawn(nominal_track, ERRORS.lateral), ERRORS.pivot_zero * random.uniform(-1, 1, (sets, n))
    one_way = np.triu(2 * distance_error * random.uniform(-1, 1, (sets, n, n)))
    known = 1 + one_way + np.swapaxes(one_way, 1, 2)
    per_pivot = float(robot.castors[0].pivot_counts_per_rev or 0) / (2 * np.pi)
    per_wheel = float(robot.wheels[0].counts_per_rev or 0) / (2 * np.pi)

    found = []
    for held in range(n):
        free = [i for i in range(n) if i != held]
        away = pivot[free] - pivot[held]
        distance, perp = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0]) - np.pi / 2
        path = np.arcsin(offset[:, free] / distance)
        arm = (distance * np.cos(path))[..., None]
        gammas, rolled = [], []
        for way in (1.0, -1.0):  # clockwise, counter-clockwise
            theta = perp + path if way > 0 else perp + np.pi - path
            gammas.append(np.round((theta + zero[:, free]) * per_pivot) / per_pivot)
            turned = 2 * np.pi * (arm + way * track[:, free] * [1.0, -1.0]) / radius[:, free]
            phase = random.uniform(size=turned.shape)
            rolled.append((np.round(turned * per_wheel + phase) - np.round(phase)) / per_wheel)
        turn = np.full((sets, len(free)), 2 * np.pi)
        one = from_turns(known[:, held, free] * distance, perp, tuple(gammas), (turn, turn), tuple(rolled))
        found.append((free, one))

    def mean_of(part: str, shape: tuple[int, ...]) -> Array:
        total = np.zeros((sets, *shape))
        for free, one in found:
            total[:, free] += getattr(one, part)
        return total / (n - 1)

    def summed(error: Array) -> tuple[float, float]:
        each = np.abs(error).reshape(sets, -1).mean(axis=1)
        return float(each.mean()), float(each.std(ddof=1) / np.sqrt(sets))

    truth = (offset, zero, radius, track)
    nominal = (nominal_offset, np.zeros(n), nominal_radius, nominal_track)
    shapes = ((n,), (n,), (n, 2), (n, 2))
    estimate = [mean_of(part, shape) for part, shape in zip(CastorParameters._fields, shapes, strict=True)]
    scale = (offset, 1.0, radius, track)
    before, after = (
        Left(*(summed((g - t) / s) for g, t, s in zip(guess, truth, scale, strict=True)))
        for guess in (nominal, estimate)
    )
    return before, after
