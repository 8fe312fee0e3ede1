"""What disturbs encoders' readings while a robot drives: wheels that slip, soft floors, encoders that fail.

Each takes true angles of a drive and returns those that encoders read, before they are rounded. The motion is that of
the drive: the other wheels are taken to hold the base.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.tasks.driving.drive import Drive, disturbed
from castor_envs.floor import Patch
from castor_envs.geometry import se2
from castor_envs.geometry.arrays import Array, vectors
from castor_envs.vehicles.robot import RobotDescription

BURSTS = 6.0
"""Bursts a minute: a robot whose wheels never slip needs no robust estimator, and one that always slips no odometry."""
BURST_LASTS = (0.2, 1.5)
"""s: from a jolt over an edge to a start on a wet spot."""
BURST_SLIP = (0.03, 0.5)
"""Part of a wheel's turning that slips: from a little more than creep to spinning. Log-uniform, as much too far as not
far enough."""
LEG_SLIP, LEG_LASTS = 0.05, 8.0
"""A wheel that slips steadily, such as a worn or half-lifted one on one leg of the way: 5 % for 8 s."""

Fault = Literal["dead wheel", "frozen pivot", "noisy wheel", "noisy pivot", "late wheel", "late pivot"]
FAULTS: tuple[Fault, ...] = ("dead wheel", "noisy wheel", "late wheel", "frozen pivot", "noisy pivot", "late pivot")
FAULT_NOISE = 10.0
"""Counts, standard deviation: interference on a cable."""
FAULT_LATENCY = (0.1, 0.4)
"""s: a bus under load."""


def slip_bursts(robot: RobotDescription, true: Drive, random: np.random.Generator) -> Drive:
    """Return a drive in which wheels slip in bursts, and one of them on one leg of the way; drawn anew."""
    return disturbed(true, slipping(true.t, true.wheel, robot.driven_wheels, random))


def slipping(t: Array, wheel: Array, wheels: Sequence[int], random: np.random.Generator) -> Array:
    """Return the angles (K, w), rad, that encoders read at times t (K,), s, where `wheels` slip now and then.

    wheel (K, w): by which wheels truly rolled. A wheel that slips by a part s of its turning reads 1 + s or 1 - s times
    as far as it moves.
    """
    rolled = np.diff(wheel, axis=0, prepend=wheel[:1])
    more = np.zeros_like(rolled)
    end = float(t[-1])

    def slips(lasts: float, slip: float) -> None:
        began = random.uniform(0.0, end - lasts)
        more[(t > began) & (t <= began + lasts), random.choice(wheels)] += slip * random.choice((-1.0, 1.0))

    for _ in range(random.poisson(BURSTS * end / 60.0)):
        slips(random.uniform(*BURST_LASTS), float(np.exp(random.uniform(*np.log(BURST_SLIP)))))
    slips(LEG_LASTS, LEG_SLIP)
    return np.cumsum(rolled * (1.0 + more), axis=0) + wheel[0]


def soft_floor(robot: RobotDescription, true: Drive, carpets: list[Patch], shrinking: list[float]) -> Drive:
    """Return a drive in which wheels roll on carpets, in the order given, as if their radius were smaller.

    shrinking: the part by which each carpet makes the rolling radius smaller; a wheel then turns farther on its way.
    """
    rolled = np.diff(true.wheel, axis=0, prepend=true.wheel[:1])
    more = np.zeros_like(rolled)
    place = wheel_places(robot, true)
    for carpet, shrinks in zip(carpets, shrinking, strict=True):
        inside = se2.relative_pose(np.array([*carpet.center, carpet.angle]), place)
        on = (np.abs(inside[..., 0]) <= carpet.size[0] / 2) & (np.abs(inside[..., 1]) <= carpet.size[1] / 2)
        more[on] = shrinks / (1.0 - shrinks)
    return disturbed(true, np.cumsum(rolled * (1.0 + more), axis=0) + true.wheel[0])


def wheel_places(robot: RobotDescription, true: Drive) -> Array:
    """Return where each wheel touches the floor, as poses (K, w, 3) in N."""
    of = np.array(robot.wheel_castors)
    x, y = np.array([castor.pivot for castor in robot.castors])[of].T
    back = -np.array([castor.offset for castor in robot.castors])[of]
    lateral = np.array([wheel.lateral for wheel in robot.wheels])
    castor = vectors(*np.broadcast_arrays(x, y, true.castor[:, of]))
    on_body = se2.compose(castor, vectors(back, lateral, 0.0 * back))
    return se2.compose(true.pose[:, None], on_body)


def faults_of(robot: RobotDescription) -> tuple[Fault, ...]:
    """Return the faults that a robot's encoders can have: without pivot encoders, those of wheels alone."""
    return FAULTS if robot.pivot_encoders else FAULTS[:3]


def faulty(robot: RobotDescription, true: Drive, fault: Fault, random: np.random.Generator) -> Drive:
    """Return a drive in which one encoder fails, as `failing` says, and stays so."""
    wheel, castor = true.wheel.copy(), true.castor.copy()
    failed = fails_when(true.t, random)
    of_wheel = fault.endswith("wheel")
    number = int(random.choice(robot.driven_wheels if of_wheel else robot.pivot_encoders))
    counts = robot.wheels[number].counts_per_rev if of_wheel else robot.castors[number].pivot_counts_per_rev
    angle = (wheel if of_wheel else castor)[:, number]
    angle[:] = failing(fault.split()[0], true.t, angle, failed, counts, random)
    return disturbed(true, wheel, castor)


def fails_when(t: Array, random: np.random.Generator) -> NDArray[np.bool_]:
    """Return at which times (K,) a sensor has failed: from a fifth to half of the way on."""
    return t > random.uniform(0.2, 0.5) * t[-1]


def failing(
    how: str, t: Array, angle: Array, failed: NDArray[np.bool_], counts: float | None, random: np.random.Generator
) -> Array:
    """Return what an encoder of `counts` a turn reads (K,), rad, of angles (K,) at times t (K,), s.

    When it has failed (K,), a dead or frozen one reads on what it read last, a noisy one is off by `FAULT_NOISE`, a
    late one by `FAULT_LATENCY`.
    """
    match how:
        case "dead" | "frozen":
            read = np.full_like(angle, angle[~failed][-1])
        case "noisy":
            read = angle + FAULT_NOISE * 2 * np.pi / (counts or 1.0) * random.standard_normal(len(angle))
        case _:
            read = np.interp(t - random.uniform(*FAULT_LATENCY), t, angle)
    return np.where(failed, read, angle)
