"""Logs of simulated trains on random paths, with hidden effects, for trials of the finder."""

from typing import Literal

import numpy as np

from castor_envs.envs.sensed import SensedTrain
from castor_envs.floor import Floor
from castor_envs.logs.log import Log
from castor_envs.motion.controllers import TrainDriver
from castor_envs.motion.paths import random_path
from castor_envs.vehicles.train import TrainDescription
from discrepancy.trials.reading import USUAL


def log_at_random(
    train: TrainDescription, seed: int, length: float = 6.0, drive: Literal["servo", "voltage"] = "voltage"
) -> Log:
    """Return the log of a train, with its effects, that drives a random path of `length` (m) in physics.

    drive: "voltage" lets wheels yield to each other; "servo" holds their speeds.
    """
    path = random_path(np.random.default_rng([seed, 1]), longest=length + 1.0)  # it may be up to 1 m shorter
    sensed = SensedTrain(train, Floor())
    sensed.reset(np.random.default_rng([seed, 2]))
    driver, period = TrainDriver(sensed.described, path), train.sample_period
    fastest = np.repeat([module.max_wheel_speed for module in train.modules], 2)
    seen = sensed.observation
    rows, poses, commands = [seen], [sensed.world.poses.ravel()], []
    for _ in range(int(np.ceil(path.duration / period))):
        command = driver.commands(sensed.world.time, seen["rps"], seen["rps_age"])
        sensed.advance(command if drive == "servo" else command / fastest, drive)
        seen = sensed.observation
        commands.append(command)
        rows.append(seen)
        poses.append(sensed.world.poses.ravel())
    truth = USUAL.sparse(np.array(poses), np.random.default_rng([seed, 3]))
    return Log(
        t=np.array([row["time"][0] for row in rows]),
        wheel=np.cumsum([row["wheel"] for row in rows], axis=0),
        pivot=np.zeros((len(rows), 0)),
        command=np.array([*commands, np.zeros_like(fastest)]),
        reference=truth,
        rps=np.array([row["rps"] for row in rows]),
        rps_age=np.array([row["rps_age"] for row in rows]),
    )
