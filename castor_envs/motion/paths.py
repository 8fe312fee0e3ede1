"""Paths for trains: straight, arc, S, random. Every axle follows the same path, each a frame's length behind the next.

A frame bent along the path is exactly as long as the path between its axles, so a train that moves at one speed along a
path of constant curvature bends without any force along it: all axles roll at the same speed v, and turn at v times the
path's curvature where they are.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from castor_envs.errors import InputError, did_you_mean, shortened
from castor_envs.geometry.arrays import Array
from castor_envs.motion.trajectories import Leg, Run, moved

SPEED, ACCELERATION = 0.25, 0.25  # m/s, m/s2: as the ASOC's, but gentler: frames swing
LONGEST_RANDOM = 6.0  # m: no random path is longer


@dataclass(frozen=True)
class TrainPath:
    """A path of legs of constant curvature, driven from rest to rest.

    legs: (length, curvature) each, m and 1/m, from the origin along x. speed, acceleration: of every axle along the
    path, m/s and m/s2. stops: lengths along the path, m, at which the train comes to rest and drives on at once. Behind
    its start and beyond its end the path is straight.
    """

    name: str
    legs: tuple[tuple[float, float], ...]
    speed: float = SPEED
    acceleration: float = ACCELERATION
    stops: tuple[float, ...] = ()

    def __post_init__(self):
        if not _pairs_of_numbers(self.legs):
            raise InputError(
                f"path {self.name!r}: legs are pairs of numbers (length, curvature), not "
                f"{shortened(repr(self.legs), 60)}"
            )
        for length, curvature in self.legs:
            if not (0 < length < np.inf and np.isfinite(curvature)):
                raise InputError(
                    f"path {self.name!r}: a leg needs a length above 0 and a finite curvature, got "
                    f"{(length, curvature)}"
                )
        if not self.legs:
            raise InputError(f"path {self.name!r} has no leg")
        for name in ("speed", "acceleration"):
            value = getattr(self, name)
            if not (isinstance(value, int | float | np.number) and 0 < value < np.inf):
                raise InputError(f"path {self.name!r}: {name} must be a finite number above 0")
        if not (np.diff([0.0, *self.stops, self.length]) > 0).all():
            raise InputError(
                f"path {self.name!r}: stops must increase and lie between 0 and its length of {self.length:g} m, got "
                f"{shortened(repr(self.stops), 60)}"
            )

    @cached_property
    def length(self) -> float:
        """Length of all legs, m."""
        return sum(length for length, _ in self.legs)

    @cached_property
    def _runs(self) -> tuple[Run, ...]:
        """How far and how fast the front axle drives from stop to stop."""
        between = np.diff([0.0, *self.stops, self.length]).tolist()
        return tuple(Run((Leg((1.0, 0.0, 0.0), length),), self.speed, self.acceleration) for length in between)

    @cached_property
    def duration(self) -> float:
        """Time taken, s."""
        return sum(run.duration for run in self._runs)

    def progress(self, t: ArrayLike) -> tuple[Array, Array]:
        """Return the length covered by the front axle, m, and its speed, m/s, at times t (...), s, since the start."""
        t = np.asarray(t, dtype=float)
        covered, speed = np.zeros_like(t), np.zeros_like(t)
        began = 0.0
        for run in self._runs:
            way, fast = run.progress(t - began)
            covered, speed, began = covered + way, speed + fast, began + run.duration
        return covered, speed

    @cached_property
    def _starts(self) -> tuple[Array, Array, Array]:
        """Lengths and poses at which legs begin, and their curvatures, with the straight pieces before and after."""
        lengths, poses = [0.0], [np.zeros(3)]
        for length, curvature in self.legs:
            lengths.append(lengths[-1] + length)
            poses.append(moved(poses[-1], np.array([1.0, 0.0, curvature]) * length))
        curvatures = [0.0, *(curvature for _, curvature in self.legs), 0.0]
        return np.array([0.0, *lengths]), np.array([poses[0], *poses]), np.array(curvatures)

    def at(self, s: ArrayLike) -> tuple[Array, Array]:
        """Return poses (..., 3) and curvatures (...), 1/m, at lengths s (...) along the path."""
        s = np.asarray(s, dtype=float)
        lengths, poses, curvatures = self._starts
        leg = np.searchsorted(lengths[1:], s, side="right")
        curvature = curvatures[leg]
        ahead = (s - lengths[leg])[..., None]
        return moved(poses[leg], np.stack([np.ones_like(s), np.zeros_like(s), curvature], axis=-1) * ahead), curvature


def _pairs_of_numbers(legs: object) -> bool:
    if not isinstance(legs, tuple | list):
        return False
    pairs = [leg for leg in legs if isinstance(leg, tuple | list) and len(leg) == 2]
    return len(pairs) == len(legs) and all(isinstance(x, int | float | np.number) for leg in pairs for x in leg)


def straight(length: float = 3.0) -> TrainPath:
    """Return a straight path."""
    return TrainPath("straight", ((length, 0.0),))


def arc(radius: float = 1.0, angle: float = np.pi) -> TrainPath:
    """Return an arc to the left between two straight pieces of half a metre."""
    return TrainPath("arc", ((0.5, 0.0), (radius * angle, 1.0 / radius), (0.5, 0.0)))


def s_bend(radius: float = 0.8, angle: float = np.pi / 2) -> TrainPath:
    """Return an arc to the left and one to the right, between two straight pieces of half a metre."""
    legs = ((0.5, 0.0), (radius * angle, 1.0 / radius), (radius * angle, -1.0 / radius), (0.5, 0.0))
    return TrainPath("S bend", legs)


def random_path(random: np.random.Generator, sharpest: float = 1.2, longest: float = LONGEST_RANDOM) -> TrainPath:
    """Return random arcs of 0.4 to 1 m, curvatures up to `sharpest` (1/m), together `longest` m or up to 1 m less."""
    legs: list[tuple[float, float]] = []
    while sum(leg[0] for leg in legs) < longest - 1.0:
        legs.append((float(random.uniform(0.4, 1.0)), float(random.uniform(-sharpest, sharpest))))
    return TrainPath("random arcs", tuple(legs))


PATHS = {"straight": straight, "arc": arc, "s-bend": s_bend}


def named_path(path: TrainPath | str, random: np.random.Generator | None = None) -> TrainPath:
    """Return a path given as such or by name; "random" is drawn from `random`. Raises InputError for anything else."""
    if isinstance(path, TrainPath):
        return path
    if path == "random" and random is not None:
        return random_path(random)
    if not isinstance(path, str) or path not in PATHS:
        known: Sequence[str] = [*PATHS, "random"]
        raise InputError(f"unknown path {path!r}{did_you_mean(str(path), known)}")
    return PATHS[path]()


def axles_behind(lengths: ArrayLike) -> Array:
    """Return how far each axle (N,) is behind the front one along the path, m, for frames of `lengths` (F,)."""
    return np.concatenate([[0.0], np.cumsum(lengths)])
