"""Finds estimators and calibration methods by name: built in, installed with other packages, or in a user's file.

The spec of an estimator is one of

- ``NAME`` or ``NAME-N``: a built-in one, or an entry point in the group ``castor.estimators``; its class is constructed
  without argument or with the number N. For the estimators of this package N is a castor, counted from 1: the one used
  (``dead-reckoning-2``) or the one left out (``ipec-3``, ``cast-1``, ``cast-arc-1``; 0 leaves none out: ``cast-0``).
  For those of trains it is the interval between corrections, in samples (``grpec-xy-1``).
- ``module:Class``, where the module is installed or lies in the current folder
- ``path/to/file.py`` or ``path/to/file.py:Class``

Each of these with parameters, ``cast-0?step=euler`` or ``file.py?gain=0.5&robust=true``, gives keyword arguments to the
class, converted by its annotations; the estimator's name then has them too.

That of a calibration method is the same, without numbers; its group is ``castor.calibrations``. Built-in ones are found
in the modules of `estimators.robots`, `estimators.peers`, `estimators.trains` and `estimators.calibration`, by their
constants ``ESTIMATORS`` and ``METHODS`` (names to classes); a new one is a new module.
"""

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from typing import Any

import numpy as np

from castor_envs.errors import Declined, message_of
from castor_envs.vehicles.load import Vehicle
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription
from estimators.calibration.protocol import CalibrationMethod
from estimators.plugins.find import PlugInKind, find
from estimators.protocol import Estimator
from estimators.robots.cast import SmallTurnWarning

ROBOTS, PEERS, TRAINS = "estimators.robots", "estimators.peers", "estimators.trains"
ESTIMATOR = PlugInKind(
    "estimator", "castor.estimators", ("reset", "update"), (ROBOTS, PEERS, TRAINS), "ESTIMATORS", True, ("estimate",)
)
SMOOTHER = " (smoother)"
"""End of the names of estimators that see a whole log, the future too, so that every board tells them apart."""
CALIBRATION = PlugInKind(
    "calibration method", "castor.calibrations", ("calibrate",), ("estimators.calibration",), "METHODS"
)


@dataclass(frozen=True)
class EstimatorEntry:
    """An estimator that a spec names, ready to be made.

    name: for people and results. source_hash: 16 hex digits that change with the code (see `source_files`), the class
    and what it is made with. argument: the number in ``NAME-N``. parameters: those of ``...?parameter=value``. Pickles
    as its spec, so that another process loads a plug-in by itself.
    """

    name: str
    spec: str
    source_hash: str
    kind: type
    argument: int | None = None
    parameters: Mapping[str, Any] = field(default_factory=dict, compare=False)

    @property
    def batched(self) -> bool:
        """Whether the estimator's arithmetic broadcasts over leading axes."""
        return bool(getattr(self.kind, "batched", False)) and not self.smoother

    @property
    def smoother(self) -> bool:
        """Whether it is given whole logs: it has no `update`, by which all others are judged."""
        return not callable(getattr(self.kind, "update", None))

    @property
    def builtin(self) -> bool:
        """Whether the estimator belongs to this package."""
        return self.kind.__module__.startswith("estimators.")

    def factory(self) -> Any:
        """Make a new estimator: an `Estimator`, or a `Smoother` if `smoother`."""
        number = () if self.argument is None else (self.argument,)
        return self.kind(*number, **self.parameters)

    def applicable(self, vehicle: Vehicle) -> str | None:
        """Return None if the estimator serves this robot or train, else the reason why not.

        Asks built-in estimators alone: a plug-in's code, which may hang, is never run here. Its `reset` raises
        `Declined` later.
        """
        return _unserved(self.factory, vehicle) if self.builtin else None

    def __reduce__(self) -> tuple[Callable[[str], "EstimatorEntry"], tuple[str]]:
        return load_estimator, (self.spec,)


@dataclass(frozen=True)
class CalibrationEntry:
    """A calibration method that a spec names, ready to be made; fields and pickling as of `EstimatorEntry`."""

    name: str
    spec: str
    source_hash: str
    kind: type
    batched = False

    @property
    def builtin(self) -> bool:
        """Whether the method belongs to this package."""
        return self.kind.__module__.startswith("estimators.")

    def factory(self) -> CalibrationMethod:
        """Make a new method."""
        return self.kind()

    def applicable(self, vehicle: Vehicle) -> str | None:
        """Return None: what a method serves depends on the recordings, and it declines when it gets them."""
        return None

    def __reduce__(self) -> tuple[Callable[[str], "CalibrationEntry"], tuple[str]]:
        return load_calibration, (self.spec,)


def load_estimator(spec: str) -> EstimatorEntry:
    """Return the estimator that `spec` names (see the module's text); raises InputError with what to do."""
    found = find(spec, ESTIMATOR)
    entry = EstimatorEntry(found.name, spec, found.source_hash, found.kind, found.argument, found.parameters)
    return replace(entry, name=entry.name + SMOOTHER) if entry.smoother else entry


def load_calibration(spec: str) -> CalibrationEntry:
    """Return the calibration method that `spec` names; raises InputError with what to do."""
    found = find(spec, CALIBRATION)
    return CalibrationEntry(found.name, spec, found.source_hash, found.kind)


def reset_at_origin(estimator: Estimator, vehicle: Vehicle) -> None:
    """Reset an estimator on a robot or a train, all poses 0; raises what its `reset` raises, such as `Declined`.

    Its warnings of small turns are not shown: only whether it serves the vehicle matters here.
    """
    shape = (vehicle.n_axles, 3) if isinstance(vehicle, TrainDescription) else (3,)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SmallTurnWarning)
        estimator.reset(vehicle, np.zeros(shape))


def declines(error: BaseException, vehicle: Any) -> str | None:
    """Return the reason if the exception of a `reset` means that it does not serve a vehicle, else None.

    `Declined` means that; so does an AttributeError for what only robots have on a train, or the reverse: the estimator
    was written for the other kind. Any other exception is a fault.
    """
    if isinstance(error, Declined):
        return message_of(error) or "it gives no reason"
    if isinstance(error, AttributeError) and error.obj is vehicle:
        is_train = isinstance(vehicle, TrainDescription)
        other_kind = RobotDescription if is_train else TrainDescription
        name = error.name or ""
        if hasattr(other_kind, name) or name in {part.name for part in fields(other_kind)}:
            return f"is written for {'robots' if is_train else 'trains'}: it asks for {name!r}"
    return None


def builtin_names(vehicle: Vehicle) -> list[str]:
    """Return the specs of this package's estimators that serve a robot or a train, in alphabetical order.

    A class that can be made with several numbers has those that its `variants` names, in that order.
    """
    packages = (TRAINS,) if isinstance(vehicle, TrainDescription) else (ROBOTS, PEERS)
    variants = [
        (name, partial(kind)) if number is None else (f"{name}-{number}", partial(kind, number))
        for name, kind in built_in_of(*packages).items()
        for number in (kind.variants(vehicle) if hasattr(kind, "variants") else (None,))
    ]
    return [spec for spec, factory in variants if _unserved(factory, vehicle) is None]


def _unserved(factory: Callable[[], Estimator], vehicle: Vehicle) -> str | None:
    """Return None if an estimator serves a robot or a train, else why it declines."""
    try:
        reset_at_origin(factory(), vehicle)
    except Declined as error:
        return str(error)
    return None


def built_in_of(*packages: str) -> dict[str, type]:
    """Return the built-in estimators of packages (`ROBOTS`, `PEERS`, `TRAINS`) by their names in alphabetical order."""
    return {name: kind for name, kind in ESTIMATOR.built_in.items() if kind.__module__.rpartition(".")[0] in packages}
