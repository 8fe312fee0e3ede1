"""Robots and trains alike: what a spec or a file describes."""

from pathlib import Path
from typing import Any

from castor_envs.errors import InputError, did_you_mean
from castor_envs.files import read_json
from castor_envs.vehicles import robot, train
from castor_envs.vehicles.presets import preset, preset_names
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription
from castor_envs.vehicles.train_presets import cfmmr, train_names

Vehicle = RobotDescription | TrainDescription


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
    return "train.json" if isinstance(vehicle, TrainDescription) else "robot.json"


def load_vehicle(spec: Vehicle | str) -> Vehicle:
    """Return a vehicle given as a description, a preset's name, or the path of its file (ending in .json)."""
    if isinstance(spec, RobotDescription | TrainDescription):
        return spec
    if not isinstance(spec, str):
        raise InputError(f"expected a robot or train, a preset's name or a file, got {type(spec).__name__}")
    name = spec
    if name.endswith(".json"):
        return vehicle_from_dict(read_json(Path(name)), name)
    if name in train_names():
        return cfmmr(int(name.rpartition("-")[2]))
    if name in preset_names():
        return preset(name)
    raise InputError(f"unknown robot or train {name!r}{did_you_mean(name, (*preset_names(), *train_names()))}")


def load_train(spec: TrainDescription | str) -> TrainDescription:
    """Return a train as `load_vehicle` does; raises InputError for anything else."""
    vehicle = load_vehicle(spec)
    if not isinstance(vehicle, TrainDescription):
        raise InputError(f"{vehicle.name!r} is a robot, not a train; trains: {', '.join(train_names())}, or a file")
    return vehicle
