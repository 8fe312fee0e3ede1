"""The Kalman update of a state part of which is measured, moved by unknowns of which hardly anything is known before.

The state is x + G u: x (D,) with covariance P, and u (3,), independent of x, with covariance `FREE` I. Its entries m,
`first` to `first + q`, are measured, with errors of variances R. With S = P_mm + R = L L' the covariance of residuals
r but for u, T = P_:m and A = G_m:, the update is

    V = L^-1 T'    U = L^-1 A    C = (U' U + I / FREE)^-1    w = L^-1 r    v = w - U C U' w
    state         x + V' v + G C U' w
    covariance    P - V' V + (G - V' U) C (G - V' U)'

which is generalised least squares for u. It is exact, and never takes the difference of numbers as large as `FREE`.
Plain Python for one state at a time, which is compiled (`castor_envs.kernels`). Inner loops run along rows, which makes
them vector instructions.
"""

import math

FREE = 2.5e-3
"""m^2 and rad^2: prior variance of unknowns, so large that it says nothing of the motion in a usual sample."""

L, INVERSE = range(2)
U, W, V = 0, 3, 4
"""Rows of `whitened` (5, q): U' (three of them), w and v."""
UW = 3
"""Row of `small` (4, 3) that holds U' w; the first three are C."""


def factored(covariance, first, moves, residual, variance, factor, whitened, small, free=FREE):
    """Write L and its inverse, U', w, v, C and U' w, and return r' S^-1 r and the logarithm of S's determinant, with u.

    covariance (D, D): P. moves (3, D): G'. residual and variance (q,): r and R. free: prior variance of the unknowns.
    """
    q = residual.shape[0]
    logarithm = 0.0
    for i in range(q):
        for j in range(i + 1):
            total = covariance[first + i, first + j]
            for k in range(j):
                total -= factor[L, i, k] * factor[L, j, k]
            if i == j:
                factor[L, i, i] = math.sqrt(total + variance[i])
            else:
                factor[L, i, j] = total / factor[L, j, j]
        logarithm += 2.0 * math.log(factor[L, i, i])
        scale = 1.0 / factor[L, i, i]
        for j in range(q):
            factor[INVERSE, i, j] = 0.0
        for k in range(i):
            part = -scale * factor[L, i, k]
            for j in range(k + 1):
                factor[INVERSE, i, j] += part * factor[INVERSE, k, j]
        factor[INVERSE, i, i] = scale
        for k in range(4):
            whitened[k, i] = 0.0
        for j in range(i + 1):
            part = factor[INVERSE, i, j]
            whitened[W, i] += part * residual[j]
            for k in range(3):
                whitened[U + k, i] += part * moves[k, first + j]
    for k in range(3):
        for other in range(3):
            small[k, other] = 1.0 / free if k == other else 0.0
        small[UW, k] = 0.0
    for i in range(q):
        for k in range(3):
            small[UW, k] += whitened[U + k, i] * whitened[W, i]
            for other in range(3):
                small[k, other] += whitened[U + k, i] * whitened[U + other, i]
    logarithm += inverted(small)
    explained = 0.0
    for i in range(q):
        total = whitened[W, i]
        for k in range(3):
            total -= whitened[U + k, i] * motion(small, k)
        whitened[V, i] = total
        explained += whitened[W, i] * total
    return explained, logarithm


def inverted(small):
    """Invert the first three rows of `small`, symmetric and positive; return the logarithm of their determinant."""
    a, b, c, d, e, f = small[0, 0], small[0, 1], small[0, 2], small[1, 1], small[1, 2], small[2, 2]
    l_b, l_c = b / a, c / a
    d -= l_b * b
    l_e = (e - l_c * b) / d
    f -= l_c * c + l_e * l_e * d
    part = l_b * l_e - l_c
    small[2, 2] = 1.0 / f
    small[1, 2] = small[2, 1] = -l_e / f
    small[0, 2] = small[2, 0] = part / f
    small[1, 1] = 1.0 / d + l_e * l_e / f
    small[0, 1] = small[1, 0] = -l_b / d - l_e * part / f
    small[0, 0] = 1.0 / a + l_b * l_b / d + part * part / f
    return math.log(a * d * f)


def motion(small, k):
    """Return entry k of the unknowns found, C U' w."""
    return small[k, 0] * small[UW, 0] + small[k, 1] * small[UW, 1] + small[k, 2] * small[UW, 2]


def beside(i, factor, whitened, small):
    """Return the square of the residual of measurement i beside all others over its variance, and one over that.

    It is (S^-1 r)_i^2 / (S^-1)_ii, and (S^-1)_ii, S with the unknowns.
    """
    pulled, inverse, u_x, u_y, u_z = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(i, factor.shape[1]):
        part = factor[INVERSE, k, i]
        pulled += part * whitened[V, k]
        inverse += part * part
        u_x += part * whitened[U, k]
        u_y += part * whitened[U + 1, k]
        u_z += part * whitened[U + 2, k]
    inverse -= u_x * (small[0, 0] * u_x + small[0, 1] * u_y + small[0, 2] * u_z)
    inverse -= u_y * (small[1, 0] * u_x + small[1, 1] * u_y + small[1, 2] * u_z)
    inverse -= u_z * (small[2, 0] * u_x + small[2, 1] * u_y + small[2, 2] * u_z)
    return pulled * pulled / inverse, inverse


def corrected(state, covariance, first, moves, factor, whitened, small, rows):
    """Update the state (D,) and covariance (D, D) by what `factored` found; rows (q + 3, D): room."""
    q, size = factor.shape[1], state.shape[0]
    for i in range(q):
        for s in range(size):
            rows[i, s] = 0.0
        for j in range(i + 1):
            part = factor[INVERSE, i, j]
            for s in range(size):
                rows[i, s] += part * covariance[first + j, s]
    for k in range(3):
        found = motion(small, k)
        for s in range(size):
            state[s] += moves[k, s] * found
            rows[q + k, s] = moves[k, s]
        for i in range(q):
            part = whitened[U + k, i]
            for s in range(size):
                rows[q + k, s] -= part * rows[i, s]
    for i in range(q):
        for s in range(size):
            state[s] += whitened[V, i] * rows[i, s]
    # the root of C, lower triangular: its columns times G - V' U, from the last on
    xx = math.sqrt(small[0, 0])
    xy, xz = small[1, 0] / xx, small[2, 0] / xx
    yy = math.sqrt(small[1, 1] - xy * xy)
    yz = (small[2, 1] - xy * xz) / yy
    zz = math.sqrt(small[2, 2] - xz * xz - yz * yz)
    for s in range(size):
        x, y, z = rows[q, s], rows[q + 1, s], rows[q + 2, s]
        rows[q, s], rows[q + 1, s], rows[q + 2, s] = xx * x + xy * y + xz * z, yy * y + yz * z, zz * z
    whole = q - q % 4
    for s in range(size):
        for i in range(0, whole, 4):  # four rows at a time, which halves the time
            a, b, c, d = rows[i, s], rows[i + 1, s], rows[i + 2, s], rows[i + 3, s]
            for o in range(s + 1):
                taken = a * rows[i, o] + b * rows[i + 1, o] + c * rows[i + 2, o] + d * rows[i + 3, o]
                covariance[s, o] -= taken
        for i in range(whole, q):
            for o in range(s + 1):
                covariance[s, o] -= rows[i, s] * rows[i, o]
        x, y, z = rows[q, s], rows[q + 1, s], rows[q + 2, s]
        for o in range(s + 1):
            covariance[s, o] += x * rows[q, o] + y * rows[q + 1, o] + z * rows[q + 2, o]
    for s in range(size):
        for o in range(s):
            covariance[o, s] = covariance[s, o]
