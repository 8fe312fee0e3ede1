"""How a castor's angle goes on beyond its encoder's reading: one law for readings that change and that repeat.

A reading is off by its rounding, evenly within a step s, so with a variance P = s^2 / 12, whatever the castor does.
What differs is for how long it is off by the same: until the castor has turned by about a step. If the last reading
lasted m samples, the castor turned by a step in m samples; if the present one has stayed for n, it turns slower than a
step in n. With nothing else known, no length of time is special, and the error's correlation with that at the last
change is taken to be m / (m + n), the same function of time at any sample rate. So in each sample the error e becomes

    a e + w    a = k / (k + 1)    k = m + n - 1    var w = P (1 - a^2)

which keeps its variance. Where the reading changes, a is 0. A reading that stays then tells 1 / (2 k + 1) of what a new
one tells: a castor that turns evenly tells 1 to 1.35 times as much for each step, at any sample rate, and one that
stands hardly more than its last reading.

Plain Python for one castor at a time, which is compiled (`castor_envs.kernels`).
"""

import math

from estimators.filtering.creep import FIXED, TRAILING

GOES_ON = 3.0
"""Standard deviation of what a castor swivels beyond its reading where that has just changed, in steps: as good as
unknown."""


def repeats(castors, carried, wheels, rows, robot, wheel):
    """Count in `carried` for how many samples readings have stayed, and the ones before lasted, and what is left of
    castors' last swivels: along a tractrix it falls as exp(-way / offset).

    Arguments are those of a sample; wheel: the counts.
    """
    for j in range(carried.shape[1]):
        castor, way = carried[robot, j], 0.0
        for i in range(wheels.shape[1]):
            of_wheel, row = wheels[robot, i], rows[robot, i]
            if row.castor == j:
                way = max(way, abs(of_wheel.radius * of_wheel.count * wheel[robot, row.wheel]))
        if castors[robot, j].swivel != 0.0:
            castor.lasted, castor.repeated, castor.settling = castor.repeated + 1.0, 0.0, 1.0
        else:
            castor.repeated += 1.0
            castor.settling *= math.exp(-way / castor.offset) if castor.offset > 0.0 else 1.0


def kept(castor, settles):
    """Return a, the part of what a castor's reading is off by that it is off by after a sample too.

    settles: whether wheels show how a castor that the floor turns goes on after its last reading (`GOES_ON`): the error
    is then new until that is less than a step.
    """
    if castor.kind == FIXED:
        return 1.0
    time = castor.lasted + castor.repeated
    part = (time - 1.0) / time if castor.repeated > 0.0 else 0.0
    if settles and castor.kind == TRAILING:
        part = min(part, 1.0 / (1.0 + 12.0 * (GOES_ON * castor.settling) ** 2))
    return part
