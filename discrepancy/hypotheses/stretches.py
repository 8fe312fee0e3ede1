"""Stretches of a log in which an encoder seems to read in proportion too much: found by box least squares (Kovacs,
Zucker and Mazeh, Astronomy and Astrophysics 391, 2002), by how the robot moves, and by how its wheel disagrees with the
others."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.motion.kinematics import Geometry
from estimators.likelihood.disagreement import FARTHEST, LEAST, MEDIAN, WINDOW, of_row, way_of
from estimators.likelihood.log_likelihood import LogLikelihood

PARTS = 120
"""A log is cut into so many parts, and a stretch is some that follow each other: by motion they are equally long in the
way that the encoder turns; by disagreement they are windows, or in longer logs of equally many windows."""


class Stretch(NamedTuple):
    """The samples between which an encoder seems to read wrongly."""

    first: int
    last: int


def by_motion(turned: Array, by_jump: Array) -> Stretch | None:
    """Return the stretch in which readings in proportion too much would make a log likeliest; None if the encoder
    stands still.

    turned (K - 1,): counts in each step. by_jump (K - 1,): derivative of the log-likelihood by a jump of the reading in
    each step. The noise of slips grows with the way, and so does what a stretch tells.
    """
    way, gain = (np.append(0.0, np.cumsum(part)) for part in (np.abs(turned), turned * by_jump))
    return _likeliest(gain, way, np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], PARTS + 1))))


def by_disagreement(model: LogLikelihood, geometry: Geometry, state: Array, t: Array, row: int) -> Stretch | None:
    """Return the stretch in which a wheel's slips in proportion to its roll explain best how its rolling constraint,
    the number `row`, disagrees with the others; None where it cannot.

    state (K, m), t (K,): of the log's samples. Disagreement and its loss are those of the log-likelihood
    (`Disagreement`).
    """
    seen, by_slip = of_row(model, geometry, state, row)
    rolled = model.rolled(geometry, state)
    starts = np.arange(0, len(seen), max(round(WINDOW / np.median(np.diff(t))), 1))
    way = way_of(np.abs(rolled).max(axis=1), starts)
    off, by_part = (np.add.reduceat(of, starts) / way for of in (seen, by_slip * rolled[:, row]))
    usual = max(float(np.median(np.abs(off))) / MEDIAN, LEAST)
    weight = np.minimum(FARTHEST * usual / np.maximum(np.abs(off), 1e-12), 1.0)
    gain, information = (np.append(0.0, np.cumsum(weight * by_part * of)) for of in (off, by_part))
    windows = np.unique(np.linspace(0, len(starts), min(PARTS, len(starts)) + 1).astype(int))
    found = _likeliest(gain, information, windows)
    return None if found is None else Stretch(*np.append(starts, len(seen))[list(found)].tolist())


def _likeliest(gain: Array, information: Array, edges: NDArray[np.intp]) -> Stretch | None:
    """Return the two of `edges` between which a size explains most; gain, information: sums of a log-likelihood's
    derivative by sizes and of what it tells of them, until each place."""
    first, last = (edges[k] for k in np.triu_indices(len(edges), 1))
    explained = (gain[last] - gain[first]) ** 2 / np.maximum(information[last] - information[first], 1e-12)
    if not np.any(explained > 0):
        return None
    best = int(np.argmax(explained))
    return Stretch(int(first[best]), int(last[best]))
