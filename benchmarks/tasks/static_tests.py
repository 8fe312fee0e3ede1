"""The four static tests of Vogt and Minor, section IV: what odometry says, what the frames say, which axle is right.

Odometry is printed in the captions of Figs. 7 to 10 (those of Figs. 8 and 9 are swapped: test 2 bends both frames to
the same side, test 3 to opposite sides; Table 1 calls the four "Fig 5" to "Fig 8"). The strain data were never
published: the relative poses here are fits to the 60 printed values of Table 1, which they reproduce to its rounding.
Other relative poses do so as well.
"""

from dataclasses import dataclass

import numpy as np

from castor_envs.geometry.arrays import Array
from estimators.trains.grpec import corrected

ALIGNED = ((0.80, 0.1, 0.0), (0.45, 0.1, 0.0), (0.10, 0.1, 0.0))


@dataclass(frozen=True, eq=False)
class StaticTest:
    """A snapshot of a train on three axles, front first.

    odometry: poses of the axles by odometry (3, 3), x, y (m), psi (rad) in N. relative: what the frames' sensors
    report (2, 3), each front axle in its rear axle's frame. true_axle: from 1, the axle where odometry is right.
    """

    number: int
    description: str
    odometry: Array
    relative: Array
    true_axle: int

    @property
    def truth(self) -> Array:
        """True poses of the axles (3, 3): the relative poses attached to the true axle, as the paper takes them."""
        return corrected(self.odometry, self.relative, self.true_axle - 1)


def _test(number: int, description: str, odometry: object, relative: object, true_axle: int) -> StaticTest:
    return StaticTest(number, description, np.array(odometry), np.array(relative), true_axle)


STATIC_TESTS = (
    _test(
        1,
        "frame A in pure bending, frame B straight, odometry aligned",
        ALIGNED,
        ((0.337108, 0.135908, 0.599245), (0.349879, 0.000125, -0.004680)),
        true_axle=3,
    ),
    _test(
        2,
        "both frames bent to the same side, unequally, odometry aligned",
        ALIGNED,
        ((0.282757, 0.177806, 1.060820), (0.333602, 0.096219, 0.530209)),
        true_axle=2,
    ),
    _test(
        3,
        "frames bent to opposite sides, unequally, odometry aligned",
        ALIGNED,
        ((0.321156, 0.127013, 0.710536), (0.282268, -0.177438, -1.060578)),
        true_axle=2,
    ),
    _test(
        4,
        "both frames straight, odometry puts axle 1 where pure bending would",
        ((0.70, 0.3, np.pi / 3), (0.45, 0.1, 0.0), (0.10, 0.1, 0.0)),
        ((0.349491, -0.000754, -0.004857), (0.350572, -0.001016, -0.004903)),
        true_axle=2,
    ),
)
