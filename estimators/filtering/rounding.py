"""How a castor's angle goes on beyond its encoder's reading: one law for readings that change and that repeat.

A reading is off by its rounding, evenly within a step s, so with a variance P = s^2 / 12, whatever the castor does.
What differs is for how long it is off by the same: until the castor has turned by about a step. If the last reading
lasted m samples, the castor turned by a step in m samples; if the present one has stayed for n, it turns slower than a
step in n. With nothing else known, no length of time is special, and the error's correlation with that at the last
change is taken to be m / (m + n), the same function of time at any sample rate. A first-order process of variance P
with that correlation is, for the filter, a swivel beyond the reading of variance u^2 in each sample, and a measurement
that the angle beyond the reading is 0, of variance R:

    u^2 = P / k    R = P (P + u^2) / u^2 = P (k + 1)    k = m + n - 1

since P is what remains of P + u^2 beside R, and its part R / (P + u^2 + R) of the last error is k / (k + 1). Where the
reading changes, u is as good as unknown, and R is P. A reading that stays then tells 1 / (2 k + 1) of what a new one
tells: a castor that turns evenly tells 1 to 1.35 times as much for each step, at any sample rate, and one that stands
hardly more than its last reading.

Plain Python for one castor at a time, which is compiled (`castor_envs.kernels`).
"""

import math

from estimators.filtering.creep import FIXED, TRAILING

FRESH = 3.0
"""Standard deviation of what a castor swivels beyond its reading where that changes, in steps: as good as unknown."""

STANDS = 1.0
"""rad^2: variance of the measurement of a castor that does not swivel, which has no angle beyond a reading."""


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


def unread(castor, settles):
    """Return the variances u^2 and R, rad^2, of a castor's angle beyond its reading in a sample.

    settles: whether what wheels say of a castor that the floor turns goes on after its last reading.
    """
    if castor.kind == FIXED:
        return 0.0, STANDS
    rounding, fresh = castor.step * castor.step / 12.0, (FRESH * castor.step) ** 2
    swivels = rounding / (castor.lasted + castor.repeated - 1.0) if castor.repeated > 0.0 else fresh
    if settles and castor.kind == TRAILING:
        swivels = max(swivels, fresh * castor.settling**2)
    return swivels, rounding * (rounding + swivels) / swivels
