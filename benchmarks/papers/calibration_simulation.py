"""Doebbler's Table I simulated: what calibration by pivoting leaves of random parameter errors, all sets at once.

The base turns about each castor's pivot, both ways, in steady rolling: the angles at which castors trail and the
distances that wheels roll are known in closed form, and only the counts are rounded. What the paper leaves open, such
as how far the base turns and how well the distance D between pivots is known, stands in
`benchmarks.papers.assumptions`.
"""

from dataclasses import dataclass

import numpy as np

from benchmarks.papers.assumptions import Assumptions
from benchmarks.tasks.kinematic import NORMAL
from benchmarks.tasks.kinematic import UNCALIBRATED_BETA as ERRORS
from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from estimators.calibration.pivoting import CastorParameters, from_turns


@dataclass(frozen=True)
class Left:
    """Mean absolute errors over all sets and castors, each with its standard error: relative, of beta in rad."""

    offset: tuple[float, float]
    pivot_zero: tuple[float, float]
    radius: tuple[float, float]
    half_track: tuple[float, float]


def errors_left(sets: int, assumed: Assumptions | None = None, exact: bool = False) -> tuple[Left, Left]:
    """Return the errors before and after calibration, over `sets` robots.

    exact: D is known exactly; else with errors of its own for each pair of pivots. Raises InputError where a castor's
    offset is not below the distance between pivots.
    """
    assumed = assumed or Assumptions()
    random, robot = np.random.default_rng(assumed.seed), assumed.base
    pivot = np.array([castor.pivot for castor in robot.castors])
    n = len(pivot)

    def off(half_width: float, *shape: int) -> Array:
        normal = assumed.distribution == "normal"
        number = random.normal(0, NORMAL, (sets, *shape)) if normal else random.uniform(-1, 1, (sets, *shape))
        return half_width * number

    def drawn(nominal: Array, half_width: float) -> Array:
        return nominal * (1 + off(half_width, *nominal.shape))

    nominal_offset = np.array([castor.offset for castor in robot.castors])
    nominal_radius = np.array([[wheel.radius for wheel in castor.wheels] for castor in robot.castors])
    nominal_track = np.array([[abs(wheel.lateral) for wheel in castor.wheels] for castor in robot.castors])
    offset, radius = drawn(nominal_offset, ERRORS.offset), drawn(nominal_radius, ERRORS.radius)
    track, zero = drawn(nominal_track, ERRORS.lateral), off(ERRORS.pivot_zero, n)
    one_way = np.triu(off(0.0 if exact else 2 * (assumed.distance_error / 100), n, n))
    known = 1 + one_way + np.swapaxes(one_way, 1, 2)
    per_pivot = np.array([castor.pivot_counts_per_rev for castor in robot.castors], dtype=float) / (2 * np.pi)
    per_wheel = np.array([[w.counts_per_rev for w in c.wheels] for c in robot.castors], dtype=float) / (2 * np.pi)
    angle = 2 * np.pi * assumed.turns

    found = []
    for held in range(n):
        free = [i for i in range(n) if i != held]
        away = pivot[free] - pivot[held]
        distance, perp = np.hypot(*away.T), np.arctan2(away[:, 1], away[:, 0]) - np.pi / 2
        if np.any(offset[:, free] >= distance):
            raise InputError(f"robot {assumed.robot}: an offset is not below the distance from pivot {held + 1}")
        path = np.arcsin(offset[:, free] / distance)
        arm = (distance * np.cos(path))[..., None]
        gammas, rolled = [], []
        for way in (1.0, -1.0):  # clockwise, counter-clockwise
            theta = perp + path if way > 0 else perp + np.pi - path
            gammas.append(np.round((theta + zero[:, free]) * per_pivot[free]) / per_pivot[free])
            turned = angle * (arm + way * track[:, free] * [1.0, -1.0]) / radius[:, free]
            phase = random.uniform(size=turned.shape)
            rolled.append((np.round(turned * per_wheel[free] + phase) - np.round(phase)) / per_wheel[free])
        turn = np.full((sets, len(free)), angle)
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
