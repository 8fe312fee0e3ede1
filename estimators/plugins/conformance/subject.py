"""The subject of the check: an estimator, a robot or train, and the noise-free drives that it is given."""

import inspect
import sys
import traceback
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array
from castor_envs.processes import end_if_forked
from castor_envs.sensors.observation import Observations as SampledObservations
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription
from estimators.plugins import drives as robot_drives
from estimators.plugins import train_drives
from estimators.plugins.drives import Drive, Observations
from estimators.plugins.real_numbers import real_numbers
from estimators.plugins.registry import EstimatorEntry

TOLERANCE, SINGLE_TOLERANCE = 1e-9, 1e-4
"""m and rad: largest difference allowed after a change of frame or of batch size, of poses in double precision and of
those in single precision, whose rounding errors on drives of a few metres add up to a tenth of it at most."""

STARTS = np.array([[0.0, 0.0, 0.0], [3.0, -2.0, 0.7], [-1.5, 4.0, -2.5]])


class Wrong(Exception):  # noqa: N818 - a verdict, not an error of this program
    """What is wrong with the estimator and what to do."""


class Subject:
    """An estimator under test, the robot or train, and the drives.

    K samples give poses (K, 3) of a robot and (K, N, 3) of a train.
    """

    def __init__(self, entry: EstimatorEntry, vehicle: Vehicle) -> None:
        self.entry, self.vehicle = entry, vehicle
        self.straight, self.turning, self.winding = drives_of(vehicle)

    @cached_property
    def wound(self) -> Array:
        """The poses of a new estimator on the winding drive from STARTS[1]."""
        return self.estimate(self.winding)

    @cached_property
    def tolerance(self) -> float:
        """The tolerance of the precision in which the estimator gives poses."""
        single = np.array_equal(self.wound, self.wound.astype(np.float32))
        return SINGLE_TOLERANCE if single else TOLERANCE

    def estimate(
        self,
        drive: Drive,
        start: Array = STARTS[1],
        estimator: Any = None,
        vehicle: Vehicle | None = None,
        observations: Observations | None = None,
        after: Callable[[int], None] = lambda k: None,
    ) -> Array:
        """Return the poses of an estimator (None: a new one) on a drive moved to `start` (3,).

        observations: given to it instead of the drive's observations. after: called after update number k.
        """
        estimator = estimator or self.entry.factory()
        first = se2.compose(start, drive.pose[0])
        seen = drive.observations if observations is None else observations
        if self.entry.smoother:
            poses = estimator.estimate(vehicle or self.vehicle, first.copy(), SampledObservations.of(seen))
            return shaped(poses, None, (len(seen), *first.shape))
        estimator.reset(vehicle or self.vehicle, first.copy())
        poses = []
        for k, row in enumerate(seen):
            poses.append(shaped(estimator.update(copied(row)), k, first.shape))
            after(k)
        return np.array(poses)


@lru_cache(maxsize=4)  # the same for every estimator that is checked on a vehicle
def drives_of(vehicle: Vehicle) -> tuple[Drive, Drive, Drive]:
    """Return the straight, the turning and the winding drive of a robot or a train."""
    if isinstance(vehicle, TrainDescription):
        return train_drives.straight(vehicle), train_drives.turning(vehicle), train_drives.winding(vehicle)
    return robot_drives.straight(vehicle), robot_drives.turning(vehicle), robot_drives.winding(vehicle)


def kind_of(vehicle: Vehicle) -> str:
    """Return "robot" or "train"."""
    return "train" if isinstance(vehicle, TrainDescription) else "robot"


def robot_of(subject: Subject) -> RobotDescription:
    """Return the subject's vehicle, in checks that only robots get."""
    assert isinstance(subject.vehicle, RobotDescription)
    return subject.vehicle


def shaped(value: object, k: int | None, shape: tuple[int, ...]) -> Array:
    """Return what update number k, or the whole log if None, returned as an array of this shape; else raises Wrong."""
    end_if_forked()
    did = "estimate" if k is None else f"update {k}"
    try:
        pose = real_numbers(value, shape)
    except ValueError as error:
        of_axles = "" if shape == (3,) else f" for each of {shape[0]} axles"
        if k is None:
            of_axles = f" for each of {shape[0]} samples{' and the axles' if len(shape) == 3 else ''}"
        raise Wrong(f"{did} returns {error}: return an array of three numbers x, y, psi{of_axles}") from None
    if not np.isfinite(pose).all():
        raise Wrong(f"{did} returns {text(pose)}: return finite numbers, from the first update on")
    return pose


def copied(observation: dict[str, Array]) -> dict[str, Array]:
    """Return an observation with arrays of its own."""
    return {key: value.copy() for key, value in observation.items()}


def text(pose: Array) -> str:
    """Return a pose (3,), or the first of several (..., 3), for a message."""
    if pose.ndim > 1:
        return f"[{', '.join(text(row) for row in pose[:3])}{', ...' if len(pose) > 3 else ''}]"
    return f"({', '.join(f'{number:.4g}' for number in pose)})"


def place(entry: EstimatorEntry, error: BaseException) -> str:
    """Return where something was raised: the last line on the way in the file of the estimator's class, else of a class
    that it is made from; its class, if nothing of it ran."""
    frames = traceback.extract_tb(error.__traceback__)
    for file in dict.fromkeys(
        getattr(sys.modules.get(kind.__module__), "__file__", None) for kind in entry.kind.__mro__
    ):
        if inside := [frame for frame in frames if frame.filename == file]:
            return f"({inside[-1].name}, line {inside[-1].lineno} of {inside[-1].filename})"
    try:
        line = inspect.getsourcelines(entry.kind)[1]
    except (OSError, TypeError):
        return f"(class {entry.kind.__name__})"
    return f"(class {entry.kind.__name__}, line {line} of {inspect.getsourcefile(entry.kind)})"
