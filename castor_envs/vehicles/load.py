"""Robots and trains alike: what a spec or a file describes."""

import os
from pathlib import Path
from typing import Any, TypeVar

from castor_envs.errors import InputError
from castor_envs.files import read_json
from castor_envs.vehicles import robot, train
from castor_envs.vehicles.presets import any_preset, preset_names
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription

Vehicle = RobotDescription | TrainDescription
Kind = TypeVar("Kind", RobotDescription, TrainDescription)

_WORDS = {RobotDescription: "robot", TrainDescription: "train"}


def vehicle_from_dict(data: Any, source: str = "vehicle") -> Vehicle:
    """Read a robot or a train from plain data, by its ``format``; raises InputError that names `source`."""
    if isinstance(data, dict) and data.get("format") == train.FORMAT:
        return TrainDescription.from_dict(data, source)
    if not isinstance(data, dict):
        raise InputError(f"{source}: expected an object with 'format': {robot.FORMAT!r} or {train.FORMAT!r}")
    if data.get("format") != robot.FORMAT:
        raise InputError(f"{source}: 'format' must be {robot.FORMAT!r} or {train.FORMAT!r}, got {data.get('format')!r}")
    return RobotDescription.from_dict(data, source)


def file_name(vehicle: Vehicle) -> str:
    """Return what the file of a vehicle's description is called beside its logs: ``robot.json`` or ``train.json``."""
    return f"{_WORDS[type(vehicle)]}.json"


def load_vehicle(spec: Vehicle | str | os.PathLike[str]) -> Vehicle:
    """Return a vehicle given as a description, a preset's name, or the path of its file (ending in .json)."""
    if isinstance(spec, RobotDescription | TrainDescription):
        return spec
    spec = os.fspath(spec) if isinstance(spec, os.PathLike) else spec
    if not isinstance(spec, str):
        raise InputError(f"expected a robot or train, a preset's name or a file, got {type(spec).__name__}")
    if spec.endswith(".json"):
        return vehicle_from_dict(read_json(Path(spec)), spec)
    try:
        return any_preset(spec)
    except InputError:
        if os.path.isfile(spec):
            raise InputError(f"{spec}: files of robots and trains end in .json; name one, or a preset") from None
        raise


def check_beside(folder: Path, vehicle: Vehicle, named: str) -> None:
    """Raise InputError, which names what was asked for, where logs in a folder are those of another vehicle."""
    for word in _WORDS.values():
        beside = folder / f"{word}.json"
        if beside.exists() and load_vehicle(str(beside)).hash() != vehicle.hash():
            raise InputError(f"{named}: {beside} is another {word}; name a new folder")


def load_robot(spec: RobotDescription | str | os.PathLike[str]) -> RobotDescription:
    """Return a robot as `load_vehicle` does; raises InputError for anything else."""
    return _of_kind(RobotDescription, spec)


def load_train(spec: TrainDescription | str | os.PathLike[str]) -> TrainDescription:
    """Return a train as `load_vehicle` does; raises InputError for anything else."""
    return _of_kind(TrainDescription, spec)


def _of_kind(kind: type[Kind], spec: Kind | str | os.PathLike[str]) -> Kind:
    vehicle = load_vehicle(spec)
    if not isinstance(vehicle, kind):
        given, needed = _WORDS[type(vehicle)], _WORDS[kind]
        known = ", ".join(preset_names(kind))
        raise InputError(f"{vehicle.name!r} is a {given}, not a {needed}; {needed}s: {known}, or a file")
    return vehicle
