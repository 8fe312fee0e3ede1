"""What logs do not show of a robot's parameters, in words, and the drive that would show it."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from castor_envs.errors import InputError
from castor_envs.geometry.arrays import Array
from castor_envs.motion.trajectories import Trajectory
from castor_envs.vehicles.robot import RobotDescription
from estimators.calibration.drives import DRIVES, REFERENCE, TYPICAL, Poses, log_of
from estimators.calibration.maximum_likelihood import Calibration, information_of
from estimators.calibration.parameters import Parameter

WHOLLY, HARDLY = 0.99, 0.3
"""Lengths of a change's part in the unseen directions, from which on it is one of them and up to which it is none."""

WELL = 0.01
"""Standard error, as `UNSEEN`, of the maximum-likelihood method, that a drive must leave to be proposed."""


class Unseen(NamedTuple):
    """A change of the parameters that the logs do not show. shown_by: the simplest drive that would; None: no drive."""

    what: str
    shown_by: str | None

    def __str__(self) -> str:
        if self.shown_by is None:
            return f"{self.what}: makes no difference to any drive; keeps the robot file's numbers"
        return f"{self.what}: keeps the robot file's numbers; {self.shown_by} would show it"


def unseen_of(calibration: Calibration) -> tuple[Unseen, ...]:
    """Return what the logs of a calibration do not show; empty if they show everything that was sought."""
    left = calibration.unseen
    changes: list[tuple[str, Array]] = []
    for what, change in _known_changes(calibration.parameters, calibration.before):
        part = left @ change
        if len(left) and np.linalg.norm(part) > WHOLLY:
            changes.append((what, change))
            # The rest: all unseen directions at right angles to this one.
            left = np.linalg.svd(part[None])[2][1:] @ left
    drives = _Drives(calibration)
    found = [Unseen(what, drives.showing(change[None])) for what, change in changes]
    if len(left):
        concerned = np.linalg.norm(left, axis=0) > HARDLY
        names = [p.name for p, is_in in zip(calibration.parameters, concerned, strict=True) if is_in]
        what = f"{len(left)} combinations of {', '.join(names)}" if len(left) > 1 else " against ".join(names)
        found.append(Unseen(what, drives.showing(left)))
    return tuple(found)


def scale_rests_on_pivots(calibration: Calibration) -> bool:
    """Whether all lengths are only as good as the pivots' places in the robot file: no pose, no pivot found."""
    kinds = {p.kind for p in calibration.parameters}
    free = any(castor.steering == "free" for castor in calibration.robot.castors)
    return free and not calibration.poses and "pivot_x" not in kinds


def _known_changes(parameters: tuple[Parameter, ...], values: Array) -> Iterator[tuple[str, Array]]:
    """Yield changes that have a name, in parts of the scales, of length 1."""
    scale = np.array([p.scale for p in parameters])
    kind = np.array([p.kind for p in parameters])
    pivot = {(p.castor, p.kind): value for p, value in zip(parameters, values, strict=True)}
    turned = {
        "pivot_x": lambda p: pivot.get((p.castor, "pivot_y"), 0.0),
        "pivot_y": lambda p: -pivot.get((p.castor, "pivot_x"), 0.0),
        "pivot_zero": lambda _: 1.0,
        "angle": lambda _: -1.0,
    }
    lengths = np.array([p.unit == "m" for p in parameters])
    # Without a pivot encoder the axle's middle is where its wheels say.
    sideways = (kind == "lateral") & ("pivot_zero" not in kind)
    named = [
        ("the scale (all lengths together)", np.where(lengths, values, 0.0)),
        ("the direction of the body's axes", np.array([turned.get(p.kind, lambda _: 0.0)(p) for p in parameters])),
        ("the place of the body's origin, x", np.where(kind == "pivot_x", 1.0, 0.0)),
        ("the place of the body's origin, y", np.where(kind == "pivot_y", 1.0, 0.0)),
        ("the place of the body's origin, y", np.where(sideways, 1.0, 0.0)),
        *((p.name, np.where(np.arange(len(parameters)) == i, 1.0, 0.0)) for i, p in enumerate(parameters)),
    ]
    for what, change in named:
        length = np.linalg.norm(change / scale)
        if length > 0:
            yield what, change / scale / length


class _Drives:
    """Drives of the calibrated robot, simple ones first; what each would tell is computed when it is asked for."""

    def __init__(self, calibration: Calibration):
        self._calibration = calibration
        self._robot = calibration.calibrated
        self._told: dict[str, Array | None] = {}

    def showing(self, changes: Array) -> str | None:
        """Return the first drive after which all of some changes (c, P) would be seen."""
        for poses, reference in REFERENCE.items():
            for drive, make in DRIVES.items():
                name = f"{drive} {reference}"
                if name not in self._told:
                    self._told[name] = self._tell(make, poses)
                told = self._told[name]
                if told is None:
                    continue
                strength, way = np.linalg.eigh(self._calibration.information + told)
                if np.linalg.norm(changes @ way[:, strength < WELL**-2], axis=1).max() < HARDLY:
                    return name
        return None

    def _tell(self, make: Callable[[RobotDescription], list[Trajectory]], poses: Poses) -> Array | None:
        """Return the information (P, P) of a drive; None if the robot cannot drive it."""
        try:
            logs = [log_of(self._robot, trajectory, poses) for trajectory in make(self._robot)]
        except InputError:
            return None
        return information_of(self._robot, self._calibration.parameters, logs, TYPICAL)
