"""Cosine and sine by additions and multiplications alone, for single numbers and for lanes of them."""

from typing import Any

from castor_envs.kernels.select import where

_ROUND = 1.5 * 2.0**52
"""Added and taken away again, it leaves the nearest whole number."""
_QUARTERS = 0.6366197723675814  # 2 / pi
# pi / 2 in three parts; the first two have 33 bits each, so that whole multiples of them up to 2^20 are exact (Cody and
# Waite; these are fdlibm's).
_FIRST, _SECOND, _THIRD = 1.57079632673412561417, 6.07710050630396597660e-11, 2.02226624879595063154e-21
# Minimax polynomials of sin and cos within a quarter turn about 0 (fdlibm, k_sin.c and k_cos.c).
_S = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_C = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)


def cosine_and_sine(angle: Any) -> Any:
    """Return the cosine and the sine of an angle (rad) of up to a million turns, within 1.5e-16 of the true ones.

    No library's: results are the same on all machines, and lanes need no branch.
    """
    turns = angle * _QUARTERS + _ROUND - _ROUND
    x = angle - turns * _FIRST - turns * _SECOND - turns * _THIRD
    xx = x * x
    s = x + x * xx * (_S[0] + xx * (_S[1] + xx * (_S[2] + xx * (_S[3] + xx * (_S[4] + xx * _S[5])))))
    half = 0.5 * xx
    c = 1.0 - half
    c += 1.0 - c - half + xx * xx * (_C[0] + xx * (_C[1] + xx * (_C[2] + xx * (_C[3] + xx * (_C[4] + xx * _C[5])))))
    quarter = turns - 4.0 * (0.25 * turns + _ROUND - _ROUND)  # -2, -1, 0, 1 or 2
    odd = abs(quarter) == 1.0
    behind, right = abs(quarter) == 2.0, quarter == -1.0
    cosine, sine = where(odd, s, c), where(odd, c, s)
    cosine = where(behind | (quarter == 1.0), -cosine, cosine)
    return cosine, where(behind | right, -sine, sine)
