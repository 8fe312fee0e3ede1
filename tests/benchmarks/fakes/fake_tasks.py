"""Small tasks for tests: a differential robot drives arcs, known in closed form."""

import dataclasses
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.tasks.task import Episode, Run
from castor_envs.errors import InputError
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import differential

SPEED, PERIOD = 0.5, 0.05


def arc(turn_rate, samples, robot, gyro=False):
    """Return the exact log of a robot that drives an arc at 0.5 m/s; counts are not rounded."""
    t = np.arange(samples) * PERIOD
    psi = turn_rate * t
    reference = np.column_stack([SPEED / turn_rate * np.sin(psi), SPEED / turn_rate * (1 - np.cos(psi)), psi])
    wheel = np.column_stack(
        [
            (SPEED - turn_rate * w.lateral) * t / w.radius * w.counts_per_rev / (2 * np.pi)
            for w in robot.castors[0].wheels
        ]
    )
    return Log(
        t, wheel, np.empty((samples, 0)), reference=reference, gyro=np.full(samples, turn_rate) if gyro else None
    )


def with_radius_error(robot, fraction):
    (castor,) = robot.castors
    wheels = tuple(dataclasses.replace(wheel, radius=wheel.radius * (1 + fraction)) for wheel in castor.wheels)
    return dataclasses.replace(robot, castors=(dataclasses.replace(castor, wheels=wheels),))


@dataclass(frozen=True)
class Arcs:
    """Arcs both ways; in case k the robot file's wheels are 1 + k mm a metre too large."""

    name: str = "arcs"
    version: int = 1
    title: str = "Arcs"
    description: str = "Arcs both ways."
    metric: str = "E_max_syst"
    group: str = "squares"
    standard: bool = True
    missing: str | None = None
    pause: float = 0.0
    samples: int = 61
    robot = differential()

    def cases(self, n=None):
        return range(8 if n is None else n)

    def record(self, case):
        time.sleep(self.pause)
        described = with_radius_error(self.robot, 1e-3 * (1 + case))
        return Episode(
            described,
            (
                Run(arc(-0.4, self.samples, self.robot), "cw"),
                Run(arc(0.4, self.samples - 10, self.robot), "ccw"),
            ),
        )


@dataclass(frozen=True)
class BadInput(Arcs):
    """bad: the cases whose input is wrong."""

    name: str = "bad-input"
    bad: tuple[int, ...] = (0, 1)

    def record(self, case):
        if case in self.bad:
            raise InputError("run-01.csv, line 3: not a number")
        return super().record(case)


@dataclass(frozen=True)
class OfData(Arcs):
    """Arcs whose robot files depend on what a file says: a number to add to the case."""

    name: str = "of-data"
    data: Path = Path("not-given")

    def source_digest(self, case):
        return self.data.read_text()

    def record(self, case):
        return super().record(case + int(self.data.read_text()))


@dataclass(frozen=True)
class Broken(Arcs):
    name: str = "broken"

    def record(self, case):
        raise ZeroDivisionError("a bug")
