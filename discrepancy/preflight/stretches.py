"""Logs cut into stretches: enough of a log for a quick check, in steps long enough that rounding of counts is small."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.logs.log import Log

STEP = 0.05
"""s: samples closer together are left out."""

WINDOW = 8
"""Steps whose residuals are added up."""

STRETCH = 4.0
"""s."""

STEPS = 1600
"""About the most steps that are used, spread over all motion."""

REFERENCE_WINDOW = 1.5
"""s: the least time between two poses that are compared."""

SPARSE = 2.5
"""s: between poses further apart than this, headings are too uncertain."""


class Stretches(NamedTuple):
    """S steps, in windows of `WINDOW`.

    counted (S, driven wheels): counts. start, end (S, pivot encoders): of each step, counts. reference: None where
    there are no poses to compare.
    """

    counted: Array
    start: Array
    end: Array
    reference: "Poses | None"


class Poses(NamedTuple):
    """Reference poses of `Stretches`.

    heading (S,): halfway through each step. first, last (V,): the steps, last exclusive, of each of V windows between
    two poses; before, after (V, 3): the poses; log, rows (V,), (V, 2): whose they are.
    """

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
    starts = np.cumsum([0, *(len(piece.counted) for piece in moving)])
    with_poses = [(at, piece.poses) for at, piece in zip(starts[:-1], moving, strict=True) if piece.poses is not None]
    poses = None
    if with_poses:
        heading = np.zeros(starts[-1])
        for at, piece_poses in with_poses:
            heading[at : at + len(piece_poses.heading)] = piece_poses.heading
        poses = Poses(
            heading,
            np.concatenate([at + piece_poses.first for at, piece_poses in with_poses]),
            np.concatenate([at + piece_poses.last for at, piece_poses in with_poses]),
            *(
                np.concatenate([getattr(piece_poses, name) for _, piece_poses in with_poses])
                for name in ("before", "after", "log", "rows")
            ),
        )
        if not len(poses.first):
            poses = None
    counted, start, end = (np.concatenate([getattr(piece, name) for piece in moving]) for name in _COUNTS)
    return Stretches(counted, start, end, poses)


_COUNTS = ("counted", "start", "end")


class _Piece(NamedTuple):
    counted: Array
    start: Array
    end: Array
    poses: Poses | None


def _pieces(number: int, log: Log, turn: Array) -> list[_Piece]:
    """Return the stretches of one log."""
    period = float(np.median(np.diff(log.t)))
    stride = max(1, round(STEP / period)) if period < STEP else 1
    at = np.arange(0, len(log), stride)
    taken = np.empty(0, dtype=np.intp)
    if log.reference is not None:
        taken = np.flatnonzero(np.isfinite(log.reference).all(axis=1))
        if len(taken) > 1 and np.median(np.diff(log.t[taken])) > SPARSE:
            taken = taken[:0]
    pivots = np.array([np.unwrap(column, period=counts) for column, counts in zip(log.pivot.T, turn, strict=True)])
    pivots = pivots.reshape(len(turn), len(log)).T
    size = max(WINDOW, int(STRETCH / (period * stride)) // WINDOW * WINDOW)
    pieces = []
    for begin in range(0, len(at) - 1, size):
        rows = at[begin : begin + size + 1]
        n = (len(rows) - 1) // WINDOW * WINDOW
        rows = rows[: n + 1]
        if n == 0:
            continue
        poses = _poses(number, log, rows, taken) if len(taken) > 1 else None
        wheel, pivot = log.wheel[rows], pivots[rows]
        pieces.append(_Piece(np.diff(wheel, axis=0), pivot[:-1], pivot[1:], poses))
    return pieces


def _poses(number: int, log: Log, rows: NDArray[np.intp], taken: NDArray[np.intp]) -> Poses | None:
    """Return the reference poses within these rows of a log that are far enough apart."""
    assert log.reference is not None
    inside = taken[(taken >= rows[0]) & (taken <= rows[-1])]
    chosen: list[int] = []
    for row in inside:
        if not chosen or log.t[row] - log.t[chosen[-1]] >= REFERENCE_WINDOW - 1e-9:
            chosen.append(int(row))
    if len(chosen) < 2:
        return None
    ends = np.array(chosen)
    step = np.clip(np.searchsorted(rows, ends), 0, len(rows) - 1)
    half_way = (log.t[rows[:-1]] + log.t[rows[1:]]) / 2
    heading = np.interp(half_way, log.t[taken], log.reference[taken, 2])
    keep = np.diff(step) > 0
    pair = np.stack([ends[:-1], ends[1:]], axis=-1)[keep]
    return Poses(
        heading,
        step[:-1][keep],
        step[1:][keep],
        log.reference[pair[:, 0]],
        log.reference[pair[:, 1]],
        np.full(len(pair), number),
        pair,
    )
