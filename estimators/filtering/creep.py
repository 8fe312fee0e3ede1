"""By how much contacts creep in a sample: under forces, and beyond these until they balance.

A contact that rolls a way w under a force F creeps by D F, D = w / K, K its slip stiffness
(`castor_envs.physics.tyre`). Contacts move by s = G u + a c for motions u of the body and swivels c of the castors that
the floor turns, with a what a castor's swivel does to its contacts. The forces on them, -s / D, bear what accelerates:
f of the body with all that it carries, t about each pivot. As matrices, D diagonal,

    G' s / D = -f        a' s / D = -t for each castor

What forces alone make of that is the creep s = G u + a c that solves it (`forced`):

    N u = b t / H - f    c = -(t + b' u) / H    H = a' a / D    b = G' a / D    N = G' G / D - b b' / H

with sums over castors. Where dimensions are not those described, wheels that motors turn by the description disagree.
Contacts then creep too, until forces on the body and about pivots balance; motors give way by a part of that creep,
which their counts show (`shown`), and no more of it tells about dimensions (`balanced`). What else makes contacts creep
does so by as much as nobody knows; but forces balance again. Of creep of covariance q D there remains (`crept`), with
Q = G - a b' / H,

    q (D - a a' / H - Q Q' / N)

To it comes q G G' / M, M = G' G / D - `ALONG` b b' / H, slip of the whole robot, of which no wheel tells: it changes
how sure the pose is, and no more. Castors swivel with it, but, as their readings would show, not quite: a robot on one
castor would else turn about its pivot against no force at all.
Wheels are taken to carry equal loads. Plain Python for one robot at a time, which is compiled (`castor_envs.kernels`).
"""

import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from castor_envs.floor import Floor
from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from estimators.filtering.kalman import UW, inverted, motion
from estimators.steps.gaps import GAP
from estimators.steps.rolling_equations import SINGULAR

STANDING = 4e-6
"""m: the way for which a contact yields that does not roll."""

HELD = 6.25
"""How much stiffer to their side contacts of castors count that motors hold or nothing turns: their creep is 2e-4 m
after 1 m where that of wheels is 5e-4."""

BURST, AHEAD = 0.1, 10.0
"""Nominal periods: a sample that lasts less, by its stamp, was held back by a line or a bus and sent at once with
others; and by how much the clock then goes ahead of stamps, until the next one that is not. Taken as they are, stamps
that are a millisecond apart would tell of forces a thousand times as large."""

ALONG = 0.9
"""By what part castors that the floor turns swivel freely where the whole robot slips: with all of it, a robot on one
castor turns about its pivot against no force; with none, as pivots' readings would have it, errors of one on three
castors with Table I's dimensions are 1.2 times as large as stated."""

GRIP = 1.0
"""The largest force of a contact, as a part of its load: friction of rubber on dry floors."""

YIELDING, UNSURE = 0.3, 0.2
"""By what part motors give way to wheels that disagree (`shown`), and its standard deviation. Servos hold their speeds
in the end, but disagreements change as castors turn: of simulated drives of robots calibrated as in Table I of Doebbler
et al., counts show 0.2 to 0.5 of it."""

CHASSIS = np.dtype(
    [
        # mass (1/m) and inertia (m) as `inertias` has them; its centre, m; how much stiffer contacts are to their side
        ("mass", float),
        ("inertia", float),
        ("x", float),
        ("y", float),
        ("lateral", float),
        # how long the sample is, in lengths of that before; forces over those of two samples of the nominal length
        ("longer", float),
        ("quicker", float),
        # how long it is, in nominal periods, where it is a gap (`steps.gaps`); else 0
        ("gap", float),
        # the largest force, `GRIP`, over K: by what part of its way a wheel creeps at most
        ("grip", float),
    ],
    align=True,
)

CARRIED = np.dtype(
    [
        # step of a castor's encoder, rad; its kind, `FIXED` to `TRAILING`; offset, m; swivel in the sample before, rad;
        # samples that the reading before lasted, and for which the present one has stayed; what is left of its last
        # swivel: 1 where its reading changes
        ("step", float),
        ("kind", np.int64),
        ("offset", float),
        ("last", float),
        ("lasted", float),
        ("repeated", float),
        ("settling", float),
        # mass and inertia, as `inertias` has them
        ("mass", float),
        ("inertia", float),
    ],
    align=True,
)
FIXED, STEERED, TRAILING = range(3)
"""Whether a castor stands, a motor holds it, or the floor turns it."""

LEFT, BY_ANGLE, SWING, WAY, ARM, YIELD, CREEP, SCALE, FREE_X = range(9)
ROWS = FREE_X + 3
"""Of each equation of a sample (`sample.linearised`), `found` (ROWS, m). ARM: h, m, by which its contact moves back for
a swivel of its castor, -a. YIELD: D, as the way that a wheel would roll, m. CREEP: under forces, m. SCALE: what makes
it an equation of a wheel's angle, rad/m, or 1. From FREE_X on: Q."""
TWIST, HOLD, SWUNG, OF_CASTOR = 3, 4, 5, 6
"""Of castors, `held` (OF_CASTOR, n): b, then t and H, which is 0 of castors that motors hold, and room for moments."""
OF_NUMBERS = 1
"""Row of `slack`, behind the covariance, of creep for the numbers learned (`balanced`)."""


def load_of(geometry: Geometry) -> Array:
    """Return the load (...) of each wheel of robots, N: all bear the same."""
    everything = geometry.mass + np.sum(geometry.castor_mass, axis=-1)
    return everything * Floor().normal_gravity / len(geometry.wheel_castor)


def inertias(geometry: Geometry) -> tuple[NDArray[np.void], Array, Array]:
    """Return the records `CHASSIS` (...) of robots, and masses and inertias (..., n) of their castors.

    All over K of a wheel and the square of the sample period: times what is moved more than in the sample before, m or
    rad, they are a force or moment as a part of K.
    """
    stiffness = geometry.slip_stiffness
    scale = 1.0 / (stiffness[..., 0] * load_of(geometry) * geometry.sample_period**2)
    chassis = np.zeros(np.shape(scale), CHASSIS)
    chassis["mass"], chassis["inertia"] = geometry.mass * scale, geometry.inertia * scale
    chassis["x"], chassis["y"] = np.moveaxis(geometry.center, -1, 0)
    chassis["lateral"] = stiffness[..., 1] / stiffness[..., 0]
    chassis["longer"] = chassis["quicker"] = 1.0
    chassis["grip"] = GRIP / stiffness[..., 0]
    return chassis, geometry.castor_mass * scale[..., None], geometry.castor_inertia * scale[..., None]


def shown(geometry: Geometry, disagreement: float) -> Array:
    """Return by what part (...) motors give way to wheels that disagree, which their counts then show.

    disagreement: its standard deviation, as a part of the way. Motors give way by `YIELDING` where they can bring up
    the force that the creep takes, and by all that is beyond. Of a normal number, what is beyond a bound is as a
    multiple of the number, by least squares, the probability that it is beyond.
    """
    force = geometry.max_wheel_torque / np.mean(geometry.radius, axis=-1)
    most = force / (geometry.slip_stiffness[..., 0] * load_of(geometry))
    return 1.0 - (1.0 - YIELDING) * erf(most / (math.sqrt(2) * disagreement))


def timed(chassis, clock, robot):
    """Write how long a robot's sample is into `chassis`.

    clock (B, 4), s: the time now, that of the sample before, how long this was, and the nominal period, which counts
    where time stamps do not tell; what is of the sample before becomes that of this one. Stamps of a
    burst (`BURST`) are taken to be a period apart.
    """
    lasts, last, period = clock[robot, 0] - clock[robot, 1], clock[robot, 2], clock[robot, 3]
    now = clock[robot, 0]
    if not BURST * period <= lasts < math.inf:
        if -AHEAD * period < lasts < math.inf:
            now = clock[robot, 1] + period
        lasts = period
    chassis[robot, 0].longer = lasts / last
    chassis[robot, 0].gap = lasts / period if lasts > GAP * period else 0.0
    chassis[robot, 0].quicker = 2.0 * period * period / (lasts * (lasts + last))
    clock[robot, 1], clock[robot, 2] = now, lasts


def yields(carried, wheels, rows, robot, wheel, chassis, before, found):
    """Write how much contacts yield, D, into `found`: of a castor's side, all its wheels together.

    A force that accelerates acts between two samples, so ways are means of both: else noise of a sample, of its counts
    or of the time that it takes, would move the contact and bring it back a longer way. before (3 + 2 n + d,): at last
    the ways of wheels in the sample before, m; become those of this one.
    """
    d, first = wheels.shape[1], 3 + 2 * carried.shape[1]
    for i in range(rows.shape[1]):
        row = rows[robot, i]
        if i < d:
            of_wheel = wheels[robot, i]
            way = abs(of_wheel.radius * of_wheel.count * wheel[robot, row.wheel])
            found[YIELD, i] = 0.5 * (way + chassis[robot, 0].longer * before[first + i]) + STANDING
            before[first + i] = way
            continue
        stiffness = 0.0
        for of in range(d):
            if rows[robot, of].castor == row.castor:
                stiffness += 1.0 / found[YIELD, of]
        if stiffness == 0.0:  # wheels without encoders
            stiffness = row.contacts / (found[WAY, i] + STANDING)
        stiffness *= chassis[robot, 0].lateral
        found[YIELD, i] = 1.0 / (stiffness if carried[robot, row.castor].kind == TRAILING else HELD * stiffness)


def forced(castors, carried, chassis, rows, robot, along, across, turn, before, first, moves, found, held, small):
    """Write by how much contacts creep under forces into `found`.

    along, across (m) and turn (rad): the body's motion in the sample. before (3 + 2 n or more,): that of the sample
    before, then the way of each castor's axle (m) and its turn in N (rad) in it; becomes that of this one. moves
    (3, ...): G', columns `first` on. held (OF_CASTOR, n), small (4, 3): room, in which b, t, H and the inverse of N
    are left.
    """
    n, m = carried.shape[1], rows.shape[1]
    for k in range(3 + 2 * n):
        before[k] *= chassis[robot, 0].longer
    body, a, b = chassis[robot, 0], 2.0 * math.sin(0.5 * turn), 2.0 * math.sin(0.5 * before[2])
    c, s = math.cos(0.5 * (turn + before[2])), math.sin(0.5 * (turn + before[2]))
    x, y = before[0] - body.y * b, before[1] + body.x * b
    f_x = body.mass * (along - body.y * a - c * x - s * y)
    f_y = body.mass * (across + body.x * a - c * y + s * x)
    f_turn = body.inertia * (turn - before[2]) + body.x * f_y - body.y * f_x
    before[0], before[1], before[2] = along, across, turn
    for k in range(3):
        for other in range(3):
            small[k, other] = 0.0
        for j in range(n):
            held[k, j] = 0.0
    for j in range(n):
        castor, of_castor, at = castors[robot, j], carried[robot, j], 3 + 2 * j
        way = castor.cos * (along - castor.y * a) + castor.sin * (across + castor.x * a)
        turned = turn + castor.swivel
        c, s = math.cos(0.5 * (turned + before[at + 1])), math.sin(0.5 * (turned + before[at + 1]))
        ahead, left = of_castor.mass * (way - c * before[at]), of_castor.mass * s * before[at]
        moment = of_castor.inertia * (turned - before[at + 1])
        before[at], before[at + 1] = way, turned
        x, y = castor.cos * ahead - castor.sin * left, castor.sin * ahead + castor.cos * left
        f_x += x
        f_y += y
        f_turn += moment - of_castor.offset * left + castor.x * y - castor.y * x
        held[TWIST, j], held[HOLD, j] = moment - of_castor.offset * left, 0.0
    for i in range(m):
        j, stiffness = rows[robot, i].castor, 1.0 / found[YIELD, i]
        if carried[robot, j].kind == TRAILING:
            held[HOLD, j] += stiffness * found[ARM, i] ** 2
        for k in range(3):
            by = stiffness * moves[k, first + i]
            held[k, j] -= by * found[ARM, i]
            for other in range(3):
                small[k, other] += by * moves[other, first + i]
    small[UW, 0], small[UW, 1], small[UW, 2] = -f_x, -f_y, -f_turn
    for j in range(n):
        if held[HOLD, j] > 0.0:
            for k in range(3):
                part = held[k, j] / held[HOLD, j]
                small[UW, k] += part * held[TWIST, j]
                for other in range(3):
                    small[k, other] -= part * held[other, j]
    least = SINGULAR * (small[0, 0] + small[1, 1] + small[2, 2])
    for k in range(3):
        small[k, k] += least
    inverted(small)
    u_x, u_y, u_turn = motion(small, 0), motion(small, 1), motion(small, 2)
    for i in range(m):
        j, swung = rows[robot, i].castor, 0.0
        if held[HOLD, j] > 0.0:
            swung = found[ARM, i] / held[HOLD, j]
        for k in range(3):
            found[FREE_X + k, i] = moves[k, first + i] + swung * held[k, j]
        crept_by = found[FREE_X, i] * u_x + found[FREE_X + 1, i] * u_y + found[FREE_X + 2, i] * u_turn
        most = body.grip * found[YIELD, i] * rows[robot, i].contacts
        found[CREEP, i] = min(max(body.quicker * (crept_by + swung * held[TWIST, j]), -most), most)


def balanced(carry, at, end, rows, robot, first, found, held, small, shown, state, covariance, slack):
    """Leave of disagreements of m contacts what their readings show.

    carry (D, R): disagreements for a unit of each number, rows `at` to `end`, columns `first` on. found, held, small:
    as `forced` leaves them. Readings show all of what remains once contacts crept until no force is left on the body,
    and no moment about pivots that the floor turns, which of d is G u + a c with u = N^-1 Q' d / D and
    c = (a' d / D - b' u) / H; and of the creep the part `shown`, by which motors give way. slack (m + 2, m): becomes
    the covariance of the creep, and then, `OF_NUMBERS` rows on, the creep itself, of numbers of state (D,) and
    covariance (D, D), of which the variances count; its other row is room.
    """
    m, n = rows.shape[1], held.shape[1]
    crept_by, of_number = slack[m + OF_NUMBERS], slack[m]
    for i in range(m):
        crept_by[i] = 0.0
        for k in range(m):
            slack[i, k] = 0.0
    for s in range(at, end):
        for j in range(n):
            held[SWUNG, j] = 0.0
        x, y, turn = 0.0, 0.0, 0.0
        for i in range(m):
            force = carry[s, first + i] / found[YIELD, i]
            x += found[FREE_X, i] * force
            y += found[FREE_X + 1, i] * force
            turn += found[FREE_X + 2, i] * force
            held[SWUNG, rows[robot, i].castor] += found[ARM, i] * force
        x, y, turn = spread(small, x, y, turn)
        for i in range(m):
            j = rows[robot, i].castor
            left = found[FREE_X, i] * x + found[FREE_X + 1, i] * y + found[FREE_X + 2, i] * turn
            if held[HOLD, j] > 0.0:
                left += found[ARM, i] * held[SWUNG, j] / held[HOLD, j]
            of_number[i] = carry[s, first + i] - left
            crept_by[i] += of_number[i] * state[s]
            carry[s, first + i] = left + shown * of_number[i]
        for i in range(m):
            part = covariance[s, s] * of_number[i]
            for k in range(m):
                slack[i, k] += part * of_number[k]


def crept(covariance, first, rows, robot, slip, moves, found, held, small, whole):
    """Add the covariance of creep that nobody knows to covariance (D, D), m equations from entry `first` on.

    slip: standard deviation of a wheel's before forces balance, m after 1 m. moves (3, ...): G', by `SCALE`.
    held, small: as `forced` leaves them. whole (4, 3): room, in which the inverse of M is left.
    """
    m = rows.shape[1]
    stiffness(rows, first, moves, found, held, whole)
    for i in range(m):
        j, scale = rows[robot, i].castor, slip * slip * found[SCALE, i]
        free_x, free_y, free_turn = spread(small, found[FREE_X, i], found[FREE_X + 1, i], found[FREE_X + 2, i])
        at = first + i
        slip_x, slip_y, slip_turn = spread(whole, moves[0, at], moves[1, at], moves[2, at])
        for other in range(i + 1):
            left = -free_x * found[FREE_X, other] - free_y * found[FREE_X + 1, other]
            left -= free_turn * found[FREE_X + 2, other]
            if other == i:
                left += found[YIELD, i]
            if rows[robot, other].castor == j and held[HOLD, j] > 0.0:
                left -= found[ARM, i] * found[ARM, other] / held[HOLD, j]
            to = first + other
            alike = slip_x * moves[0, to] + slip_y * moves[1, to] + slip_turn * moves[2, to]
            left = scale * found[SCALE, other] * left + slip * slip * alike
            covariance[at, to] += left
            if other < i:
                covariance[to, at] += left


def stiffness(rows, first, moves, found, held, whole):
    """Write the inverse of M, the stiffness of the whole robot that slips, into `whole` (4, 3); arguments are those of
    `crept`."""
    for k in range(3):
        for other in range(3):
            whole[k, other] = 0.0
    for i in range(rows.shape[1]):
        part = 1.0 / (found[SCALE, i] * found[SCALE, i] * found[YIELD, i])
        for k in range(3):
            for other in range(k + 1):
                whole[k, other] += part * moves[k, first + i] * moves[other, first + i]
    for j in range(held.shape[1]):
        if held[HOLD, j] > 0.0:
            part = ALONG / held[HOLD, j]
            for k in range(3):
                for other in range(k + 1):
                    whole[k, other] -= part * held[k, j] * held[other, j]
    least = SINGULAR * (whole[0, 0] + whole[1, 1] + whole[2, 2])
    for k in range(3):
        whole[k, k] += least
        for other in range(k):
            whole[other, k] = whole[k, other]
    inverted(whole)


def spread(small, x, y, turn):
    """Return the product of the first three rows of `small` (4, 3) and a vector."""
    return (
        small[0, 0] * x + small[0, 1] * y + small[0, 2] * turn,
        small[1, 0] * x + small[1, 1] * y + small[1, 2] * turn,
        small[2, 0] * x + small[2, 1] * y + small[2, 2] * turn,
    )
