"""Adding an environment, a preset or an importer is adding one file, or one function in the file of presets."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import castor_envs

ENVIRONMENT = """
from castor_envs.envs.umbmark import UMBmarkEnv


class HurryEnv(UMBmarkEnv):
    ID = "castor/Hurry-v0"

    def __init__(self, robot="swerve", **arguments):
        super().__init__(robot, speed=0.5, **arguments)
"""

PRESETS = """


@named("small-swerve")
def small_swerve() -> RobotDescription:
    return dataclasses.replace(swerve(), name="small swerve", mass=10.0)


@named("stiff-{}", (2, 4))
def stiff(n: int) -> TrainDescription:
    return dataclasses.replace(cfmmr(n), frames=(Frame(length=0.3, bending_stiffness=2.0),) * (n - 1))
"""

IMPORTER = """
import dataclasses

import numpy as np

from castor_envs.logs.importers import Importer
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import differential
from castor_envs.vehicles.robot import RobotDescription


@dataclasses.dataclass(frozen=True)
class Session:
    vehicle: RobotDescription
    runs: tuple[Log, ...]


def read(path):
    t, left, right = np.loadtxt(path).T
    return Session(differential(), (Log(t, np.column_stack([left, right]), np.empty((len(t), 0))),))


IMPORTER = Importer(
    name="three-columns",
    recognises=lambda folder: any(folder.glob("*.three")),
    find=lambda folder: {path.stem: path for path in sorted(folder.glob("*.three"))},
    read=read,
)
"""

PROGRAM = """
import json
import sys

import gymnasium as gym

from castor_envs.envs import ENVIRONMENTS
from castor_envs.logs.csv import read_log
from castor_envs.logs.importers import import_sessions, importers
from castor_envs.vehicles.load import load_vehicle
from castor_envs.vehicles.presets import preset_names, train_names

env = gym.make("castor_envs:castor/Hurry-v0")
observation, info = env.reset(seed=0)
many = gym.make_vec("castor/Hurry-v0", num_envs=2)
((folder, session),) = import_sessions(sys.argv[1], sys.argv[2])
log = read_log(folder / "run-1.csv", load_vehicle(str(folder / "robot.json")))
print(json.dumps({
    "id": env.spec.id,
    "robot": env.unwrapped.robot.name,
    "known": "castor/Hurry-v0" in ENVIRONMENTS,
    "many": type(many).__name__,
    "mass": load_vehicle("small-swerve").mass,
    "axles": load_vehicle("stiff-4").n_axles,
    "names": ["small-swerve" in preset_names(), "stiff-2" in train_names(), "stiff-2" in preset_names()],
    "importers": list(importers()),
    "wheel": log.wheel.tolist(),
}))
"""


def test_one_file_or_function_is_enough(tmp_path):
    package = tmp_path / "copy" / "castor_envs"
    shutil.copytree(Path(castor_envs.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    (package / "envs" / "hurry.py").write_text(ENVIRONMENT)
    (package / "logs" / "importers" / "three_columns.py").write_text(IMPORTER)
    with (package / "vehicles" / "presets.py").open("a") as presets:
        presets.write(PRESETS)
    data = tmp_path / "data"
    data.mkdir()
    (data / "drive.three").write_text("0.0 0 0\n0.1 5 6\n0.2 9 12\n")
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(data), str(tmp_path / "out")],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(package.parent)},
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == {
        "id": "castor/Hurry-v0",
        "robot": "four swerve modules",
        "known": True,
        "many": "SyncVectorEnv",
        "mass": 10.0,
        "axles": 4,
        "names": [True, True, False],
        "importers": ["optiodom", "three-columns"],
        "wheel": [[0.0, 0.0], [5.0, 6.0], [9.0, 12.0]],
    }
