"""Which measurements of a sample contradict all others and are released: one by one, and castors as a whole.

A wheel that slips contradicts alone, for a while. A castor whose encoder froze contradicts with all its equations, but
not with each in every sample: at some angles one agrees by chance, what is left of the castor then outvotes the others,
and these are released. So castors that contradict for a way are left out until they agree for a way.
Plain Python for one robot at a time, which is compiled (`castor_envs.kernels`).
"""

import math

from estimators.filtering.kalman import W, beside, factored

TIE = 2.0
"""Twice the log-likelihood ratio up to which it is not known which of two measurements contradicts: both are released.
With one equation more than needed, as of two wheels and a gyro, it never is."""

RARER = 14.0
"""Twice the logarithm of how much rarer gyros fail than wheels slip, a thousand times: by so much more than any wheel
must a gyro contradict to be released."""

AGAIN = 2.0
"""Standard deviations of a residual beyond which a measurement is released again that was so in the sample before: what
slips goes on slipping for a while."""

CONTRADICTED, AGREED = 0.05, 0.1
"""m: ways for which a castor must contradict all others, so that it is left out, and agree with them, so that it is
trusted again: longer than a wheel is on a cable; a castor whose encoder is frozen agrees while it passes that angle."""

LEFT_IN = 4
"""Equations that must be left where a castor is left out: with three, nothing tells any more that one contradicts."""

LEAST = 1e-12
"""Least part of a residual's variance that is not slip's, against rounding."""


def released(covariance, first, moves, residual, variance, slip, gate, out, trusted, factor, whitened, small, free):
    """Factor the measurements' covariance (see `factored`), with those released that contradict all others; return
    twice the negative log-likelihood.

    Those of castors that are `out` (q,) and, while residuals beside all others exceed their gates (q,), in standard
    deviations, the one that does so by most (in squares), and all that tie with it (`TIE`), get the variance `slip`
    (q,), whose sign then changes; those of which it is 0 stay, and so does measurement `trusted` (q: none) unless it
    does so by `RARER` more than all others. out: becomes the residuals of these, in squares of the standard deviations
    that they would have if they did not slip. free: see `factored`.
    """
    q = residual.shape[0]
    for i in range(q):
        if out[i] > 0.0 and slip[i] > 0.0:
            variance[i] += slip[i]
            slip[i] = -slip[i]
    explained, logarithm = factored(covariance, first, moves, residual, variance, factor, whitened, small, free)
    for _ in range(q):
        most = -math.inf
        for i in range(q):
            whitened[W, i] = -math.inf
            if slip[i] > 0.0:
                beside_others, _ = beside(i, factor, whitened, small)
                whitened[W, i] = beside_others - gate[i] ** 2
                if i != trusted:
                    most = max(most, whitened[W, i])
        if trusted < q:
            if whitened[W, trusted] > max(most, 0.0) + RARER:
                most = whitened[W, trusted]
            else:
                whitened[W, trusted] = -math.inf
        if not most > 0.0:
            break
        for i in range(q):
            if whitened[W, i] > most - TIE:
                variance[i] += slip[i]
                slip[i] = -slip[i]
        explained, logarithm = factored(covariance, first, moves, residual, variance, factor, whitened, small, free)
    for i in range(q):
        if out[i] > 0.0 and slip[i] < 0.0:
            beside_others, inverse = beside(i, factor, whitened, small)
            out[i] = beside_others / max(1.0 + slip[i] * inverse, LEAST)
    return explained + logarithm


def castors_left_out(trust, rows, robot, slips, out, gate, ways):
    """Tell which castors are left out with all their equations: those whose trust (n,), m, is negative.

    One is when two of its equations or more were released for `CONTRADICTED`, m, all the time and more than of any
    other, unless fewer than `LEFT_IN` equations would be left in; until it agreed with all others for `AGREED`. slips
    (q,), out: as `released` leaves them. ways (m,): of pivots in this sample, m.
    """
    m, n = rows.shape[1], trust.shape[0]
    worst, most, alike, of_worst, within = -1, 1, False, 0.0, 0
    for j in range(n):
        number, agrees, way = 0, True, 0.0
        for i in range(m):
            if rows[robot, i].castor == j:
                number, way = number + (1 if slips[i] < 0.0 else 0), ways[i]
                agrees = agrees and out[i] < gate * gate
                within += 1 if trust[j] >= 0.0 else 0
        if trust[j] < 0.0:
            trust[j] = trust[j] + way if agrees else -AGREED
            if trust[j] >= 0.0:
                trust[j] = CONTRADICTED
        elif number > most:
            worst, most, alike, of_worst = j, number, False, way
        elif number == most:
            alike = True
        if trust[j] >= 0.0 and number < 2:
            trust[j] = CONTRADICTED
    if worst >= 0 and not alike:
        trust[worst] -= of_worst
        if trust[worst] < 0.0:
            for i in range(m):
                within -= 1 if rows[robot, i].castor == worst else 0
            trust[worst] = -AGREED if within >= LEFT_IN else 0.0
