"""A base on castors seen as a swerve drive, as the software of swerves sees it: modules whose velocities are vectors.

A module with one wheel under its pivot rolls along its castor's direction e. A split castor is one too: both wheels
together tell how far its centre rolled and how far it turned in N, and its pivot moves by

    rolled e + offset turn n,    n to the left of e

(Doebbler III.B). A single wheel that trails its pivot, as a powered caster's, tells that only with the body's turn.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.errors import Declined
from castor_envs.geometry.arrays import Array, vectors
from castor_envs.geometry.se2 import wrap
from castor_envs.motion.kinematics import Geometry, left_of, unit
from castor_envs.sensors.encoders import castor_angles
from estimators.protocol import Observation


class ModuleSteps(NamedTuple):
    """What n modules did in one sample.

    path (..., n, 2): of their pivots, straight, in the body's axes, m. swivel (..., n): against the body, rad.
    """

    path: Array
    swivel: Array


class Modules:
    """Reads encoders as those of swerve modules, sample by sample. Arithmetic broadcasts.

    at: where in a sample the modules' angles are taken, 1.0 those read last, 0.5 half-way. Raises Declined for bases
    with fewer than two castors, or with castors that are no modules.
    """

    def __init__(self, geometry: Geometry, at: float) -> None:
        wheels: NDArray[np.intp] = np.bincount(geometry.wheel_castor, minlength=geometry.n_castors)
        first = np.searchsorted(geometry.wheel_castor, np.arange(geometry.n_castors))
        last = first + wheels - 1
        self._geometry, self._at = geometry, at
        self._decline_others(first, last)
        self._step = 2 * np.pi * geometry.radius / geometry.counts_per_rev
        self._left, self._right = first, last
        self._lateral = geometry.lateral[..., first]
        track = self._lateral - geometry.lateral[..., last]
        self._per_track = np.where(wheels == 2, 1.0 / np.where(track == 0, 1.0, track), 0.0)
        self._angle: Array | None = None

    def _decline_others(self, first: NDArray[np.intp], last: NDArray[np.intp]) -> None:
        geometry = self._geometry
        if geometry.n_castors < 2:
            raise Declined(f"needs at least two swerve modules; the robot has {geometry.n_castors} castor")
        if np.any(np.isnan(geometry.counts_per_rev)) or not geometry.standard.all():
            raise Declined("needs swerve modules: castors whose wheels all have encoders and no rollers")
        if np.any(np.isnan(geometry.pivot_counts_per_rev) & ~geometry.fixed):
            raise Declined("needs swerve modules: castors with pivot encoders, or fixed ones")
        one = (first == last) & ((geometry.offset != 0) | (geometry.lateral[..., first] != 0))
        if np.any(one) or np.any(last - first > 1):
            raise Declined(
                "needs swerve modules: castors with one wheel under the pivot, or with two; tidybot serves powered "
                "casters, whose single wheel stands beside the pivot"
            )
        pivot = geometry.pivot
        if np.any(np.all(pivot == pivot[..., :1, :], axis=(-1, -2))):
            raise Declined("needs modules that stand apart; here all have the same pivot")

    def read(self, observation: Observation) -> ModuleSteps:
        """Take one sample; the first is taken to have begun at the angles that it shows."""
        angle = castor_angles(self._geometry, observation.get("pivot", np.empty(0)))
        swivel = np.zeros_like(angle) if self._angle is None else wrap(angle - self._angle)
        self._angle = angle
        wheel = observation["wheel"] * self._step
        turn = (wheel[..., self._right] - wheel[..., self._left]) * self._per_track
        rolled = wheel[..., self._left] + self._lateral * turn
        e = unit(angle - (1.0 - self._at) * swivel)
        return ModuleSteps(
            rolled[..., None] * e + (self._geometry.offset * turn)[..., None] * left_of(e), swivel + 0 * rolled
        )


def rigid_motion(pivot: Array, path: Array, weight: Array) -> tuple[Array, Array]:
    """Return the displacement (..., 2) of the body's origin, m, and the turn (...), rad, that fit paths of pivots best.

    Weighted least squares of t + turn J p = path, with pivots p (..., n, 2), paths (..., n, 2), weights (..., n): the
    pseudo-inverse of WPILib's ``SwerveDriveKinematics`` where all weights are 1.
    """
    share = (weight / weight.sum(axis=-1, keepdims=True))[..., None]
    middle, mean = np.sum(share * pivot, axis=-2), np.sum(share * path, axis=-2)
    arm, rest = left_of(pivot - middle[..., None, :]), path - mean[..., None, :]
    turn = np.sum(share * arm * rest, axis=(-1, -2)) / np.sum(share * arm**2, axis=(-1, -2))
    return mean - turn[..., None] * left_of(middle), turn


def rotation_taken_out(pivot: Array, path: Array, turn: Array) -> Array:
    """Return the translational parts (..., n, 2) of the modules' paths, m: all alike where none skids."""
    return path - turn[..., None, None] * left_of(pivot)


def along_arc(displacement: Array, turn: Array) -> Array:
    """Return the chord (..., 2), in the axes half-way, of an arc as long as a displacement (..., 2), m, that turns.

    WPILib's pose exponential: a constant twist, integrated exactly.
    """
    chord = np.sinc(turn / (2 * np.pi))
    return vectors(chord * displacement[..., 0], chord * displacement[..., 1])
