"""Logs cut into stretches: enough of a log for a quick check, in steps long enough that rounding of counts is small."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log

STEP = 0.05
"""s: samples closer together are left out."""

WINDOW = 8
"""Steps whose residuals are added up."""

STRETCH, STEPS = 4.0, 1600
"""s, and about the most steps that are used, spread over all motion."""

REFERENCE_WINDOW, SPARSE = 1.5, 2.5
"""s: the least time between two poses that are compared; between poses further apart than the second, headings are too
uncertain."""


class Stretches(NamedTuple):
    """S steps, in windows of `WINDOW`, and V windows between two reference poses.

    counted (S, driven wheels): counts. start, end (S, pivot encoders): of each step, counts. heading (S,): by the
    reference, halfway through each step, rad. first, last (V,): the steps, last exclusive, of each window between
    poses; before, after (V, 3): the poses; log, rows (V,), (V, 2): whose they are.
    """

    counted: Array
    start: Array
    end: Array
    heading: Array
    first: NDArray[np.intp]
    last: NDArray[np.intp]
    before: Array
    after: Array
    log: NDArray[np.intp]
    rows: NDArray[np.intp]


def stretches_of(logs: Sequence[Log], turn: Array) -> Stretches | None:
    """Return the stretches of logs that are used; None where logs are too short or nothing moves.

    turn (s,): counts after which pivot encoders begin again.
    """
    pieces = [piece for number, log in enumerate(logs) for piece in _pieces(number, log, turn)]
    moving = [piece for piece in pieces if np.abs(piece.counted).sum() > 0]
    if not moving:
        return None
    limit = max(1, round(STEPS / np.mean([len(piece.counted) for piece in moving])))
    if len(moving) > limit:
        moving = [moving[k] for k in np.unique(np.linspace(0, len(moving) - 1, limit).astype(int))]
    joined = Stretches(*(np.concatenate(parts) for parts in zip(*moving, strict=True)))
    begins = np.cumsum([0, *(len(piece.counted) for piece in moving[:-1])])
    begin = np.repeat(begins, [len(piece.first) for piece in moving])
    return joined._replace(first=begin + joined.first, last=begin + joined.last)


def unwrapped(pivot: Array, turn: Array) -> Array:
    """Return pivot counts (N, s) that go on where encoders begin again after `turn` (s,) counts."""
    columns = [np.unwrap(column, period=float(counts)) for column, counts in zip(pivot.T, turn, strict=True)]
    return np.array(columns).reshape(pivot.T.shape).T


def poses_taken(log: Log) -> NDArray[np.intp]:
    """Return the rows of a log in which there is a whole reference pose."""
    return np.flatnonzero(np.zeros(0) if log.reference is None else np.isfinite(log.reference).all(axis=1))


def _pieces(number: int, log: Log, turn: Array) -> Iterator[Stretches]:
    """Yield the stretches of one log."""
    period = float(np.median(np.diff(log.t)))
    stride = max(1, round(STEP / period))
    size = max(WINDOW, int(STRETCH / (period * stride)) // WINDOW * WINDOW)
    pivots, taken = unwrapped(log.pivot, turn), poses_taken(log)
    if len(taken) > 1 and np.median(np.diff(log.t[taken])) > SPARSE:
        taken = taken[:0]
    at = np.arange(0, len(log), stride)
    for begin in range(0, len(at) - 1, size):
        rows = at[begin : begin + size + 1]
        rows = rows[: (len(rows) - 1) // WINDOW * WINDOW + 1]
        if len(rows) > 1:
            pivot = pivots[rows]
            yield Stretches(np.diff(log.wheel[rows], axis=0), pivot[:-1], pivot[1:], *_poses(number, log, rows, taken))


def _poses(number: int, log: Log, rows: NDArray[np.intp], taken: NDArray[np.intp]) -> tuple[Any, ...]:
    """Return the headings in these rows of a log, and the reference poses within them that are far enough apart, as the
    last fields of `Stretches`."""
    chosen: list[int] = []
    for row in taken[(taken >= rows[0]) & (taken <= rows[-1])].tolist():
        if not chosen or log.t[row] - log.t[chosen[-1]] >= REFERENCE_WINDOW - 1e-9:
            chosen.append(row)
    step = np.searchsorted(rows, chosen).clip(0, len(rows) - 1)
    keep = np.diff(step) > 0
    pair = np.column_stack([chosen[:-1], chosen[1:]]).astype(np.intp)[keep]
    heading, poses = np.zeros(len(rows) - 1), np.zeros((len(log), 3)) if log.reference is None else log.reference
    if len(chosen) > 1:
        heading = np.interp((log.t[rows[:-1]] + log.t[rows[1:]]) / 2, log.t[taken], poses[taken, 2])
    of = np.full(len(pair), number)
    return heading, step[:-1][keep], step[1:][keep], poses[pair[:, 0]], poses[pair[:, 1]], of, pair
