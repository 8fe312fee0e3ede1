"""Standard deviations of odometry-derived and relative poses of a train: assumptions of all estimators that weigh them.

The paper of Vogt and Minor gives one number: relative poses are right to 1 to 3 cm. Headings are taken to be known as
well as positions are: 1 deg with 1 cm. Odometry between two corrections is taken to be twice as good, unless an axle
slips; finding axles that slip is the estimators' task.
"""

import numpy as np

ODOMETRY_SIGMA = np.array([0.01, 0.01, np.radians(1.0)])
"""Standard deviation of an OD pose (x, y in m, psi in rad) at a correction."""

RELATIVE_SIGMA = np.array([0.02, 0.02, np.radians(2.0)])
"""Standard deviation of a relative pose (x, y in m, phi in rad), front axle in the rear axle's frame."""
