"""Generators of a trial's logs: the project's pymunk physics, MuJoCo, or Bullet."""

from collections.abc import Callable
from typing import NamedTuple

from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from discrepancy.trials import outside, pymunk_generator
from discrepancy.trials.hidden import Outside


class Generator(NamedTuple):
    """drive: makes a log, as `pymunk_generator.drive`. outsiders: kinds of effects that are not in the catalogue.

    foreign: whether its physics differ from the finder's model, so that more cases have clean logs.
    """

    drive: Callable[..., Log]
    outsiders: tuple[type[Outside], ...]
    foreign: bool


def generator(name: str) -> Generator:
    """Return a generator; raises InputError for an unknown name, or where its simulator is not installed."""
    # MuJoCo and PyBullet are optional, so modules that need them are imported where they are chosen.
    if name == "pymunk":
        return Generator(pymunk_generator.drive, outside.KINDS, foreign=False)
    if name == "mujoco":
        from discrepancy.trials.mujoco import outside as mujoco_outside
        from discrepancy.trials.mujoco import world as mujoco_world

        mujoco_world.mujoco_module()
        return Generator(mujoco_world.drive, mujoco_outside.KINDS, foreign=True)
    if name == "bullet":
        from discrepancy.trials.bullet import outside as bullet_outside
        from discrepancy.trials.bullet import world as bullet_world

        bullet_world.bullet_module()
        return Generator(bullet_world.drive, bullet_outside.KINDS, foreign=True)
    raise InputError(f"unknown generator {name!r}; there are pymunk, mujoco and bullet")
