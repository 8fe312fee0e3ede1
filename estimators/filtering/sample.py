"""One sample of the filter: its equations with the numbers learned so far, what the state becomes, what is measured.

Plain Python for one robot at a time, which is compiled (`castor_envs.kernels`). `calibrating_filter` says what the
state is; its update is in `kalman`.
"""

import math

import numpy as np

from castor_envs.kernels.arguments import REAL, array
from castor_envs.kernels.kernel import Kernel
from estimators.filtering.creep import (
    ARM,
    BY_ANGLE,
    CARRIED,
    CHASSIS,
    CREEP,
    LEFT,
    OF_NUMBERS,
    SCALE,
    SWING,
    TRAILING,
    WAY,
    balanced,
    crept,
    forced,
    timed,
    yields,
)
from estimators.filtering.kalman import FREE, UW, corrected, inverted, motion
from estimators.filtering.release import AGAIN, castors_left_out, released
from estimators.filtering.rounding import kept, repeats
from estimators.steps.castor_odometry import displace, sinc
from estimators.steps.gaps import off_path
from estimators.steps.rolling_equations import (
    CASTOR,
    G_X,
    G_Y,
    LEVER,
    ROLLED,
    ROW,
    SINGULAR,
    SWIVELLED,
    SWUNG,
    WEIGHT,
    bent,
    equation,
    solved,
    swivelled,
    went,
)

SLIP = 5e-4
"""m after 1 m: standard deviation of the random walk of a wheel's creep."""

RELEASED = 2e-2
"""m: standard deviation of the slip of a released measurement in a sample."""

UNREAD = 1.0
"""rad/s: standard deviation of what a released gyro is off: it may be dead, stuck or at the end of its range."""

FAR = 10.0 * RELEASED
"""m: where a wheel rolls farther in a sample, and equations contradict the motion that fits all of them best by more,
the filter, which is linear about it, is begun from one without the worst: a counter that wraps or is reset is off by
metres, and is then released by as much as it is off."""

WEAR = 1e-4
"""After 1 m: random walk of radii, 0.3 % in a kilometre, as of tyres under a payload."""

LEAST = 1e-12
"""m^2: least variance of slip in a sample."""

DRIFT = 1e-4
"""rad/s in a root second: random walk of a gyro's bias where the description says none, 0.04 deg/s in a minute, as of
a chip that warms up."""

WHEEL = np.dtype([("radius", float), ("lateral", float), ("count", float)], align=True)
"""m, m, and rad of a count."""

FILTER = np.dtype([("slip", float), ("unsure", float), ("settles", np.int64)], align=True)
"""A filter of the bank: m after 1 m; standard deviation of `shown`; whether castors that the floor turns go on
swivelling after their last reading, as wheels say. Where dimensions are known to a thousandth, wheels creep by as much,
and what they say of the last part of a count is no better."""

SWIVEL = 3
"""Where castors' angles begin, after the pose; behind n of these what is measured: d wheels, no side slip of c, and a
gyro, if there is one."""
RESIDUAL, VARIANCE, SLIPS, GATES, LEFT_OUT = range(5)


def linearised(castors, carried, wheels, rows, robot, wheel, x, at, gap, equations, found, carry, moves):
    """Set up a sample's equations of a robot with the numbers of a filter's state x (D,), and linearise about their
    solution.

    Writes into `found` (ROWS, m) of each equation its residual, m, or, of rolling, the angle that the wheel turns, rad;
    by how much it changes with the castor's angle, and with a swivel beyond what was read, m/rad; the way of the pivot
    and h, m. Into `carry` (D, R) and `moves` (3, D) its derivatives by the state before and by the motion. Returns the
    motion.
    """
    n, d, m = carried.shape[1], wheels.shape[1], rows.shape[1]
    radius, lateral, offset = at, at + d, at + 2 * d
    zero, to_x, to_y = offset + n, offset + 2 * n, offset + 3 * n
    for j in range(n):
        castor = castors[robot, j]
        angle = castor.half_way + x[SWIVEL + j] - x[zero + j]
        castor.cos, castor.sin = math.cos(angle), math.sin(angle)
    most = 0.0
    for i in range(m):
        row = rows[robot, i]
        j = row.castor
        castor = castors[robot, j]
        arm, rolled = carried[robot, j].offset + x[offset + j], 0.0
        if i < d:
            of_wheel = wheels[robot, i]
            arm = of_wheel.lateral + x[lateral + i] + row.roller * arm
            rolled = of_wheel.radius * math.exp(x[radius + i]) * of_wheel.count * wheel[robot, row.wheel]
        east, north = castor.x + x[to_x + j], castor.y + x[to_y + j]
        equation(equations, 0, i, castor, row, east, north, arm, rolled, 1)
        found[ARM, i], most = arm, max(most, abs(rolled))
    along, across, turn = solved(equations, 0, 1)
    if most > FAR and not gap:
        for _ in range(m - 4):
            if farthest(equations, along, across, turn) < FAR or not left_out(equations):
                break
            along, across, turn = solved(equations, 0, 1)
    a = 2.0 * math.sin(0.5 * turn)
    for i in range(m):
        row = rows[robot, i]
        j, at_row = row.castor, SWIVEL + n + i
        castor, arm = castors[robot, j], found[ARM, i]
        g_x, g_y = equations[0, i, G_X], equations[0, i, G_Y]
        lever = equations[0, i, LEVER] + arm * castor.half_cos
        # The direction turned by +90 degrees, and the pivot's way.
        t_x, t_y = -g_y, g_x
        east, north = castor.x + x[to_x + j], castor.y + x[to_y + j]
        path_x, path_y = along - north * a, across + east * a
        turned = turn + castor.swivel
        left = g_x * along + g_y * across + lever * a - 2.0 * arm * math.sin(0.5 * turned)
        by_angle = t_x * path_x + t_y * path_y
        found[WAY, i] = math.hypot(path_x, path_y)
        found[BY_ANGLE, i], found[SWING, i] = by_angle, 0.5 * by_angle - arm
        moves[0, at_row], moves[1, at_row], moves[2, at_row] = g_x, g_y, lever - arm
        carry[SWIVEL + j, at_row], carry[zero + j, at_row] = by_angle, -by_angle
        carry[to_x + j, at_row], carry[to_y + j, at_row] = a * g_y, -a * g_x
        if i < d:
            way = wheels[robot, i].radius * math.exp(x[radius + i])
            left /= way * sinc(0.5 * turned)
            carry[radius + i, at_row], carry[lateral + i, at_row] = -way * left, -turned
            carry[offset + j, at_row] = -row.roller * turned
        else:
            left -= bent(equations, 0, i, along, across, a, turn)
            carry[offset + j, at_row] = -turned
        found[LEFT, i] = left
    return along, across, turn


def farthest(equations, along, across, turn):
    """Return by how much equations (1, m, 12) of any weight are off a motion, m and rad, at most, m."""
    most, a = 0.0, 2.0 * math.sin(0.5 * turn)
    for i in range(equations.shape[1]):
        if equations[0, i, WEIGHT] > 0.0:
            off = equations[0, i, G_X] * along + equations[0, i, G_Y] * across + equations[0, i, LEVER] * a
            off -= equations[0, i, SWUNG] * math.cos(0.5 * turn) + bent(equations, 0, i, along, across, a, turn)
            off -= equations[0, i, ROLLED] * sinc(0.5 * (turn + equations[0, i, SWIVELLED]))
            most = max(most, abs(off))
    return most


def left_out(equations):
    """Take the weight of that equation of (1, m, 12) without which the others agree best; return whether they do."""
    worst, least = -1, math.inf
    for i in range(equations.shape[1]):
        weight = equations[0, i, WEIGHT]
        if weight == 0.0:
            continue
        equations[0, i, WEIGHT] = 0.0
        most = farthest(equations, *solved(equations, 0, 1))
        equations[0, i, WEIGHT] = weight
        if most < least:
            worst, least = i, most
    if worst >= 0:
        equations[0, worst, WEIGHT] = 0.0
    return worst >= 0


def turn_off_mean(castors, rows, robot, found, first, moves, small):
    """Return by how much the body's turning rate at the end of a sample differs from its mean, times the sample, rad.

    Wheels turn evenly in a sample, as motors are told; as castors swivel meanwhile, the motion that fits the equations
    best changes by that of their derivatives by the angles.
    """
    for k in range(4):
        for other in range(3):
            small[k, other] = 0.0
    for i in range(rows.shape[1]):
        row = rows[robot, i]
        for k in range(3):
            part = row.weight * moves[k, first + i]
            small[UW, k] -= part * found[BY_ANGLE, i] * castors[robot, row.castor].swivel
            for other in range(3):
                small[k, other] += part * moves[other, first + i]
    least = SINGULAR * (small[0, 0] + small[1, 1] + small[2, 2])
    for k in range(3):
        small[k, k] += least
    inverted(small)
    return 0.5 * motion(small, 2)


def unevenness(found, i, castor, swivel, uneven):
    """Return the variance, m^2, of an equation of a castor that swivels in a sample.

    uneven: error of the angle half-way as a part of the change of the swivel, where it begins from zero, of a castor
    that a motor turns: to how far it does so evenly, and whether it follows a tractrix, is in doubt. Where the floor
    turns it (`bent`), an error of the fifth order is left.
    """
    way, offset = found[WAY, i], castor.offset
    tractrix = way * way * swivel / (24.0 * offset) if offset > 0.0 else 0.0
    if castor.kind == TRAILING:
        return (tractrix * way * way / (offset * offset)) ** 2
    change = swivel - castor.last
    off = uneven * change * change / (abs(swivel) + abs(castor.last) + castor.step + 1e-9)
    least = min(off, 1.0)
    return (found[BY_ANGLE, i] * off) ** 2 + (0.5 * way * least * least) ** 2 + tractrix * tractrix


def carried_over(covariance, changed, carry, spread):
    """Let the first R entries of a state become carry' times it: covariance (D, D), carry (D, R).

    spread (R, D): room.
    """
    size = covariance.shape[0]
    for r in range(changed):
        for s in range(size):
            spread[r, s] = 0.0
        for of in range(size):
            part = carry[of, r]
            if part != 0.0:
                for s in range(size):
                    spread[r, s] += part * covariance[of, s]
    for r in range(changed):
        for s in range(changed, size):
            covariance[r, s] = covariance[s, r] = spread[r, s]
        for other in range(changed):
            covariance[r, other] = 0.0
        for s in range(size):
            part = spread[r, s]
            if part != 0.0:
                for other in range(changed):
                    covariance[r, other] += part * carry[s, other]


def read_anew(state, covariance, reading, noise):
    """Let the entry `reading` of a state (D,) be the noise, rad/s, of a reading of which nothing is known yet."""
    state[reading] = 0.0
    for s in range(state.shape[0]):
        covariance[reading, s] = covariance[s, reading] = 0.0
    covariance[reading, reading] = noise * noise


def _advance(
    castors,
    carried,
    wheels,
    rows,
    start,
    pose,
    state,
    covariance,
    log_likelihood,
    gyro,
    freed,
    before,
    chassis,
    clock,
    shown,
    trust,
    wheel,
    pivot,
    filters,
    equations,
    found,
    carry,
    moves,
    spread,
    measured,
    factor,
    whitened,
    small,
    held,
    bearing,
    slack,
    uneven,
    gate,
):
    """Take one sample of each of B robots.

    castors, carried (B, n), wheels (B, d), rows (B, m): of types `CASTOR`, `CARRIED`, `WHEEL` and `ROW`. start, pose
    (B, 3); state (B, F, D), covariance (B, F, D, D) and log_likelihood (B, F) of all filters (F,). gyro (B, 5): a turn,
    rad, the variance of what it is off but for readings' noise, the sample's duration, s, 0 where there is none, that
    noise, rad/s, and the random walk of the bias, rad/s in a root second. freed (B, F, q): the variances of slip of
    those measurements that are released. before (B, F, 3 + 2 n + d): the motion of the sample before (`forced`,
    `yields`). chassis (B, 1): of type `CHASSIS`. clock (B, 4): see `timed`. wheel and pivot: the counts. Others: room.
    """
    n, d, m, size = carried.shape[1], wheels.shape[1], rows.shape[1], state.shape[2]
    q = measured.shape[1]
    first, at = SWIVEL + n, SWIVEL + n + q
    numbers = 2 * d + 4 * n
    compliance = at + numbers
    for robot in range(castors.shape[0]):
        swivelled(castors, robot, pivot, 0.5)
        timed(chassis, clock, robot)
        gap = chassis[robot, 0].gap
        free = FREE * max(1.0, gap * gap)
        turn_read, turn_variance, duration = gyro[robot, 0], gyro[robot, 1], gyro[robot, 2]
        gyro_noise, drift = gyro[robot, 3], gyro[robot, 4]
        bias, gain, reading = size - 3, size - 2, size - 1
        counts = False
        for j in range(n):
            counts = counts or castors[robot, j].swivel != 0.0
        for i in range(d):
            counts = counts or wheel[robot, rows[robot, i].wheel] != 0.0
        moves_on = counts or duration > 0.0
        if moves_on:
            repeats(castors, carried, wheels, rows, robot, wheel)
        for f in range(filters.shape[0]):
            if at > first + m and not duration > 0.0:
                read_anew(state[robot, f], covariance[robot, f], reading, gyro_noise)
            if not moves_on:
                for k in range(before.shape[2]):
                    before[robot, f, k] = 0.0
                continue
            for i in range(q):
                measured[GATES, i] = gate if freed[robot, f, i] == 0.0 else min(gate, AGAIN)
                freed[robot, f, i] = measured[LEFT_OUT, i] = 0.0
                if i < m and trust[robot, f, rows[robot, i].castor] < 0.0:
                    measured[LEFT_OUT, i] = 1.0
            x, p, shows = state[robot, f], covariance[robot, f], shown[robot, f]
            creeps = shows < 1.0
            for s in range(size):
                for r in range(at):
                    carry[s, r] = 0.0
                for k in range(3):
                    moves[k, s] = 0.0
            last = before[robot, f]
            went(castors, robot, last[0], last[1], last[2])
            along, across, turn = linearised(
                castors, carried, wheels, rows, robot, wheel, x, at, gap > 0.0, equations, found, carry, moves
            )
            motion_of, expected = (along, across, turn), last[2] * chassis[robot, 0].longer
            yields(carried, wheels, rows, robot, wheel, chassis, last, found)
            forced(castors, carried, chassis, rows, robot, *motion_of, last, first, moves, found, held, bearing)
            if creeps:
                balanced(carry, at, at + numbers, rows, robot, first, found, held, bearing, shows, x, p, slack)
                for i in range(m):
                    crept_by = (1.0 - shows) * slack[m + OF_NUMBERS, i]
                    found[LEFT, i] -= crept_by / (wheels[robot, i].radius * math.exp(x[at + i])) if i < d else crept_by

            has_gyro = at > first + m and duration > 0.0
            off_mean = turn_off_mean(castors, rows, robot, found, first, moves, small) if has_gyro else 0.0
            # Equations of rolling become those of the wheels' angles.
            for i in range(m):
                found[SCALE, i] = 1.0
                carry[compliance, first + i] = -found[CREEP, i]
            for i in range(d):
                of_wheel = wheels[robot, i]
                scale = found[SCALE, i] = 1.0 / (of_wheel.radius * math.exp(x[at + i]))
                for s in range(size):
                    carry[s, first + i] *= scale
                for k in range(3):
                    moves[k, first + i] *= scale
                found[SWING, i] *= scale
                carry[first + i, first + i] = 1.0
            for r in range(SWIVEL):
                carry[r, r] = 1.0
            for j in range(n):
                part, at_castor = kept(carried[robot, j], filters[f].settles != 0), SWIVEL + j
                carry[at_castor, at_castor] = part
                for i in range(m):
                    if rows[robot, i].castor == j:
                        by_loss = (part - 1.0) * found[SWING, i]
                        carry[at_castor, first + i] += by_loss
                        found[LEFT, i] += by_loss * x[at_castor]
                x[at_castor] *= part
            # The pose.
            psi = x[2] + 0.5 * turn
            cos, sin = math.cos(psi), math.sin(psi)
            east, north = cos * along - sin * across, sin * along + cos * across
            x[0] += east
            x[1] += north
            x[2] += turn
            carry[2, 0], carry[2, 1] = -north, east
            moves[0, 0], moves[1, 0], moves[2, 0] = cos, -sin, -0.5 * north
            moves[0, 1], moves[1, 1], moves[2, 1] = sin, cos, 0.5 * east
            moves[2, 2] = 1.0
            if has_gyro:
                carry[bias, at - 1], carry[gain, at - 1], carry[reading, at - 1] = duration, turn, 0.5 * duration
                moves[2, at - 1] = 1.0 + x[gain]
            carried_over(p, at, carry, spread)
            if creeps:
                unsure = filters[f].unsure ** 2
                for i in range(m):
                    for k in range(m):
                        p[first + i, first + k] += unsure * slack[i, k] * found[SCALE, i] * found[SCALE, k]
            if at > first + m:
                measured[RESIDUAL, q - 1] = measured[SLIPS, q - 1] = 0.0
                measured[VARIANCE, q - 1] = turn_variance + off_mean * off_mean + LEAST
            if has_gyro:
                # The mean of two readings; that of the sample's end is new, and is half of the next one.
                left = turn_read - (1.0 + x[gain]) * turn - duration * (x[bias] + 0.5 * x[reading])
                measured[RESIDUAL, q - 1], measured[SLIPS, q - 1] = left, (UNREAD * duration) ** 2
                p[bias, bias] += drift * drift * duration
                read_anew(x, p, reading, gyro_noise)
                p[reading, at - 1] = p[at - 1, reading] = 0.5 * duration * gyro_noise**2
                p[at - 1, at - 1] += (0.5 * duration * gyro_noise) ** 2

            # Noise of the sample, and what is measured.
            for j in range(n):
                of_castor, swivel = carried[robot, j], castors[robot, j].swivel
                at_castor, step = SWIVEL + j, of_castor.step
                beyond = step * step / 12.0 * (1.0 - carry[at_castor, at_castor] ** 2)
                p[at_castor, at_castor] += beyond
                for i in range(m):
                    if rows[robot, i].castor != j:
                        continue
                    by_swing = beyond * found[SWING, i]
                    p[at_castor, first + i] += by_swing
                    p[first + i, at_castor] += by_swing
                    for other in range(m):
                        if rows[robot, other].castor == j:
                            p[first + i, first + other] += by_swing * found[SWING, other]
                    variance = unevenness(found, i, of_castor, swivel, uneven)
                    if gap > 0.0:
                        turned, before_it = turn + swivel, expected + of_castor.last * chassis[robot, 0].longer
                        beside_it, short = off_path(found[WAY, i], turned, before_it)
                        variance = 0.0 if i < d else beside_it * beside_it
                        for other in range(d):
                            if i < d and rows[robot, other].castor == j:
                                alike = found[SCALE, i] * found[SCALE, other]
                                p[first + i, first + other] += short * short * alike
                    if i < d:
                        of_wheel = wheels[robot, i]
                        scale = found[SCALE, i]
                        rolled = of_wheel.count * wheel[robot, rows[robot, i].wheel]
                        if equations[0, i, WEIGHT] > 0.0:  # a counter that jumps has not rolled
                            p[at + i, at + i] += WEAR**2 * abs(rolled / scale)
                        p[first + i, first + i] += variance * scale * scale
                        x[first + i] += found[LEFT, i] - scale * found[CREEP, i] * (1.0 + x[compliance]) - rolled
                        measured[RESIDUAL, i] = -x[first + i]
                        measured[VARIANCE, i] = of_wheel.count**2 / 12.0
                        measured[SLIPS, i] = (RELEASED / of_wheel.radius) ** 2
                    else:
                        measured[RESIDUAL, i] = found[CREEP, i] * (1.0 + x[compliance]) - found[LEFT, i]
                        measured[VARIANCE, i] = LEAST + variance
                        measured[SLIPS, i] = RELEASED**2
                    if equations[0, i, WEIGHT] == 0.0:
                        measured[SLIPS, i] += measured[RESIDUAL, i] ** 2
            if not counts:  # the robot stands, and what a gyro reads is its bias
                for i in range(m):
                    measured[SLIPS, i] = 0.0
            crept(p, first, rows, robot, filters[f].slip, moves, found, held, bearing, small)
            residual, variance, slips = measured[RESIDUAL], measured[VARIANCE], measured[SLIPS]
            gates, out = measured[GATES], measured[LEFT_OUT]
            log_likelihood[robot, f] -= 0.5 * released(
                p, first, moves, residual, variance, slips, gates, out, m, factor, whitened, small, free
            )
            for i in range(q):
                if slips[i] < 0.0:
                    freed[robot, f, i] = -slips[i]
                    if i < d:
                        p[first + i, first + i] -= slips[i]
            castors_left_out(trust[robot, f], rows, robot, slips, out, gate, found[WAY])
            corrected(x, p, first, moves, factor, whitened, small, spread)
        for j in range(n):
            carried[robot, j].last = castors[robot, j].swivel
        believed(start, state, log_likelihood, robot, pose)


def believed(start, state, log_likelihood, robot, pose):
    """Write the pose (B, 3) of a robot in N: the mean of its filters', by their likelihoods."""
    filters = state.shape[1]
    most = log_likelihood[robot, 0]
    for f in range(1, filters):
        most = max(most, log_likelihood[robot, f])
    x, y, psi, total = 0.0, 0.0, 0.0, 0.0
    for f in range(filters):
        part = math.exp(log_likelihood[robot, f] - most)
        total += part
        x += part * state[robot, f, 0]
        y += part * state[robot, f, 1]
        psi += part * state[robot, f, 2]
    pose[robot, 0], pose[robot, 1], pose[robot, 2] = start[robot, 0], start[robot, 1], start[robot, 2]
    displace(pose, robot, x / total, y / total, psi / total)


ADVANCE = Kernel(
    __name__,
    "_advance",
    (
        *(array(of, 2) for of in (CASTOR, CARRIED, WHEEL, ROW, float, float)),
        *(array(float, axes) for axes in (3, 4, 2, 2, 3, 3)),
        array(CHASSIS, 2),
        *(array(float, axes) for axes in (2, 2, 3, 2, 2)),
        array(FILTER, 1),
        *(array(float, axes) for axes in (3, 2, 2, 2, 2, 2, 3, 2, 2, 2, 2, 2)),
        REAL,
        REAL,
    ),
)
