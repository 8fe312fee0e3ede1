"""Samples that last so long that how wheels and castors turned in them is not known: gaps of a log.

One law for all that estimates. The likelihood, which knows the pose at both ends, takes nothing of the motion in a gap
from the wheels (`likelihood.rolling`). Filters that have nothing else take the motion of the equations, and doubt it as
far as the path may have been another (`off_path`). Plain Python, which is compiled (`castor_envs.kernels`).
"""

import math

GAP = 3.5
"""Steps longer than this many usual steps are gaps: the motion in them is unknown."""


def off_path(way, turned, expected):
    """Return standard deviations of how far a point ends beside the circle on which it is taken to have run a way, m,
    and of how far short of it.

    turned, expected: rad, by which its direction turned in the gap, and would have at the rate before. It did so at
    another time: all at once, if at any time, as a gyro's rate is taken to change (`steps.gyro`), ends it beside by
    2 sin(turned / 2) way, from one side to the other, and short by what cosine and chord differ.
    """
    angle = min(max(abs(turned), abs(turned - expected)), math.pi)
    return 2.0 * math.sin(0.5 * angle) * way / math.sqrt(12.0), angle * angle * way / 12.0
