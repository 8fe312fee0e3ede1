"""What disturbs encoders' readings while a robot drives: wheels that slip, soft floors, encoders that fail.

Each takes true angles of a drive and returns those that encoders read, before they are rounded. The motion is that of
the drive: the other wheels are taken to hold the base.
"""

from typing import Literal

import numpy as np

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
    """Return a drive in which wheels slip in bursts, and one of them on one leg of the way; drawn anew.

    A wheel that slips by a part s of its turning reads 1 + s or 1 - s times as far as it moves.
    """
    rolled = np.diff(true.wheel, axis=0, prepend=true.wheel[:1])
    more = np.zeros_like(rolled)
    wheels, end = robot.driven_wheels, float(true.t[-1])

    def slips(lasts: float, slip: float) -> None:
        began = random.uniform(0.0, end - lasts)
        more[(true.t > began) & (true.t <= began + lasts), random.choice(wheels)] += slip * random.choice((-1.0, 1.0))

    for _ in range(random.poisson(BURSTS * end / 60.0)):
        slips(random.uniform(*BURST_LASTS), float(np.exp(random.uniform(*np.log(BURST_SLIP)))))
    slips(LEG_LASTS, LEG_SLIP)
    return disturbed(true, np.cumsum(rolled * (1.0 + more), axis=0) + true.wheel[0])


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
    """Return a drive in which one encoder fails after a fifth to half of the way, and stays so.

    Dead and frozen ones read on what they read last, noisy ones are off by `FAULT_NOISE`, late ones by
    `FAULT_LATENCY`.
    """
    wheel, castor = true.wheel.copy(), true.castor.copy()
    failed = true.t > random.uniform(0.2, 0.5) * true.t[-1]
    of_wheel = fault.endswith("wheel")
    number = int(random.choice(robot.driven_wheels if of_wheel else robot.pivot_encoders))
    counts = robot.wheels[number].counts_per_rev if of_wheel else robot.castors[number].pivot_counts_per_rev
    angle = (wheel if of_wheel else castor)[:, number]
    match fault.split()[0]:
        case "dead" | "frozen":
            read = np.full_like(angle, angle[~failed][-1])
        case "noisy":
            read = angle + FAULT_NOISE * 2 * np.pi / (counts or 1.0) * random.standard_normal(len(angle))
        case _:
            read = np.interp(true.t - random.uniform(*FAULT_LATENCY), true.t, angle)
    angle[failed] = read[failed]
    return disturbed(true, wheel, castor)
