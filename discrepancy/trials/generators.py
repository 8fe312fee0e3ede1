"""Generators of a trial's logs: the project's pymunk physics, MuJoCo, or Bullet."""

import math
from collections.abc import Callable, Iterator
from typing import Any, Literal, NamedTuple

import numpy as np

from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.trials import pymunk_generator
from discrepancy.trials.cases import Hidden, Outsiders
from discrepancy.trials.outside import outside_effects

GeneratorName = Literal["pymunk", "mujoco", "bullet"]


class Generator(NamedTuple):
    """drive: makes a log, as `pymunk_generator.drive`. outsiders: draws effects that are not in the catalogue.

    foreign: whether its physics differ from the finder's model, so that more cases have clean logs.
    """

    drive: Callable[..., Log]
    outsiders: Outsiders
    foreign: bool


def generator(name: str) -> Generator:
    """Return a generator; raises InputError for an unknown name, or where its simulator is not installed."""
    # MuJoCo and PyBullet are optional, so modules that need them are imported where they are chosen.
    if name == "pymunk":
        return Generator(pymunk_generator.drive, _own_outsiders, foreign=False)
    if name == "mujoco":
        try:
            import mujoco  # noqa: F401
        except ImportError:
            raise InputError("generator mujoco needs MuJoCo; install castor-envs[trial]") from None
        from discrepancy.trials.mujoco.generator import drive

        return Generator(drive, _mujoco_outsiders, foreign=True)
    if name == "bullet":
        from discrepancy.trials.bullet.generator import drive
        from discrepancy.trials.bullet.model import bullet_module

        bullet_module()
        return Generator(drive, _bullet_outsiders, foreign=True)
    raise InputError(f"unknown generator {name!r}; there are pymunk, mujoco and bullet")


def _own_outsiders(robot: RobotDescription, random: np.random.Generator) -> Iterator[Hidden]:
    for outsider in outside_effects(robot, random):
        yield Hidden(outsider)


def _place(robot: RobotDescription, random: np.random.Generator) -> dict[str, Any]:
    castor = int(random.integers(len(robot.castors))) + 1
    return {"castor": castor, "wheel": int(random.integers(len(robot.castors[castor - 1].wheels))) + 1}


def _mujoco_outsiders(robot: RobotDescription, random: np.random.Generator) -> Iterator[Hidden]:
    from discrepancy.trials.mujoco import outside as foreign

    place = _place(robot, random)
    castor = place["castor"]
    yield Hidden(foreign.WobblingWheel(**place, size=1e-3), "size")
    yield Hidden(foreign.FlatSpot(**place, depth=2e-4, phase=float(random.uniform(-3, 3))), "depth")
    yield Hidden(foreign.WarmingWheel(**place, growth=1e-3), "growth")
    yield Hidden(foreign.PivotPlay(castor=castor, size=5e-4), "size")
    yield Hidden(foreign.StickyPivot(castor=castor, stick=1.0), "stick")
    yield Hidden(foreign.LooseMast(frequency=2.0), "frequency", power=-2.0)
    yield Hidden(foreign.CountGlitches(**place, counts=3), "counts")


def _bullet_outsiders(robot: RobotDescription, random: np.random.Generator) -> Iterator[Hidden]:
    from discrepancy.trials.bullet import outside as foreign

    place = _place(robot, random)
    along = float(random.uniform(-math.pi, math.pi))
    yield Hidden(foreign.StickingCounter(**place, part=2e-3), "part")
    yield Hidden(foreign.ConicalWheel(**place, cone=5e-4, along=along), "cone")
    yield Hidden(foreign.FlexingFork(castor=place["castor"], give=1e-3), "give")
    yield Hidden(foreign.LooseTyre(**place, play=5e-3), "play")
