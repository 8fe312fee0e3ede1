"""The Gymnasium environments, one in each module, found automatically.

An environment is a class with an ``ID``, as in ``ID = "castor/ASOC-v1"``, in a module of this folder. The IDs are read
from the source: this module stays light, and an environment's own module is imported when it is made.
"""

import ast
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
from gymnasium.envs.registration import load_env_creator
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from gymnasium.wrappers import TimeLimit

from castor_envs.errors import InputError, whole_number


def _declared(folder: Path) -> dict[str, str]:
    """Return the entry points of all environments in a folder's modules, by their IDs."""
    found: dict[str, str] = {}
    for path in sorted(folder.glob("[!_]*.py")):
        kinds = [node for node in ast.parse(path.read_bytes()).body if isinstance(node, ast.ClassDef)]
        for kind in kinds:
            for line in kind.body:
                match line:
                    case ast.Assign(targets=[ast.Name(id="ID")], value=ast.Constant(value=str(name))):
                        if name in found:
                            raise ValueError(f"two environments have the ID {name!r}; change that in {path.name}")
                        found[name] = f"{__name__}.{path.stem}:{kind.name}"
    return found


#: For each ID the entry point, "module:class".
ENVIRONMENTS = _declared(Path(__file__).parent)


def make_many(
    entry_point: str,
    num_envs: int,
    autoreset_mode: str | AutoresetMode = "NextStep",
    threads: int | None = None,
    max_episode_steps: int | None = None,
    **arguments: Any,
) -> Any:
    """Return `num_envs` environments: what ``gymnasium.make_vec`` makes.

    An argument given as a list has one value for each of them; any other is that of all. Environments whose agents
    drive are stepped as one (`castor_envs.envs.driving.vector`) unless they have effects, an estimator or a window, or
    are built differently; others one after the other. Seeds, episodes and numbers are those of single environments, bit
    for bit, also for any number of threads; None takes as many as there are processors, where that pays.
    Episodes end after `max_episode_steps`; None and -1 leave them as long as they are, as in ``gymnasium.make``.
    """
    num_envs = whole_number(num_envs, "num_envs")
    threads = None if threads is None else whole_number(threads, "threads, unless None,")
    unlimited = max_episode_steps is None or max_episode_steps == -1
    limit = None if unlimited else whole_number(max_episode_steps, "max_episode_steps")
    kind: Any = load_env_creator(entry_point)
    several = [name for name, value in arguments.items() if isinstance(value, list)]
    for name in several:
        if len(arguments[name]) != num_envs:
            raise InputError(f"{name}: a list needs a value for each of {num_envs} environments")
    made = [
        kind(**{name: value[i] if name in several else value for name, value in arguments.items()})
        for i in range(num_envs)
    ]
    options: Any = {
        "autoreset_mode": AutoresetMode(autoreset_mode),
        "observation_mode": "different" if several else "same",
    }
    if hasattr(kind, "steps_in_fleet"):
        from castor_envs.envs.driving.vector import TrackingVectorEnv, steps_as_one

        if num_envs > 1 and steps_as_one(made):
            return TrackingVectorEnv([partial(_given, env) for env in made], threads, limit, **options)
    limited = made if limit is None else [TimeLimit(env, limit) for env in made]
    return SyncVectorEnv([partial(_given, env) for env in limited], **options)


def _given(env: Any) -> Any:
    return env


def __getattr__(name: str) -> Any:
    """Return the maker of many environments of an ID: that of entry points like ``castor_envs.envs:castor/ASOC-v1``."""
    if name in ENVIRONMENTS:
        return partial(make_many, ENVIRONMENTS[name])
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def register_envs() -> None:
    """Register all environments with Gymnasium; doing it again changes nothing."""
    for name, entry_point in ENVIRONMENTS.items():
        if name not in gym.registry:
            gym.register(id=name, entry_point=entry_point, vector_entry_point=f"{__name__}:{name}")
