"""How far a tracker's axes are turned against the body's: by the ways that both go between the same samples."""

from collections.abc import Sequence

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import relative_pose

TURNED = np.radians(20.0)
"""A tracker whose axes are meant to be along the body's is not turned by more."""

STRAIGHT, LEAST = 2.0, 5e-4
"""A tracker that is not turned may leave so many times what a turned one leaves, or twice this share of squares, and be
taken for straight: on circles, a point elsewhere on the body looks the same."""

AGREED = 0.01
"""The share of squares up to which ways agree well enough to determine how the tracker is turned."""

STEPS = 6
"""Steps of Gauss and Newton's method by which a tracked point and the turns of ways without headings are found."""

FIRM = 1e-3
"""Of the squares of the ways: doubt that a tracked point so far from the origin as `size` costs."""


def turn_of_tracker(ways: Sequence[tuple[Array, Array]], size: float) -> float:
    """Return by how much a tracker's axes are turned to the left of the body's, rad; 0.0 if by no more than `TURNED`,
    or if the ways do not determine it.

    ways: the body's poses (k, 3) and the tracker's (k, 3) at the same samples; each in its own world. size: how far
    from the origin the tracked point may be, m. Between two samples, what moved by o in the axes of the body, and
    turned by phi, is seen to move by a o + b (exp(i phi) - 1), where a = exp(-i turn) and b is of the tracked point.
    """
    ways = [way for way in ways if len(way[0]) > 1]
    if not ways:
        return 0.0
    moved, seen = (np.concatenate([relative_pose(way[k][:-1], way[k][1:]) for way in ways]) for k in (0, 1))
    turn, *errors = fit_mount(moved, seen, size, np.ones(len(moved)))
    straight, turned = (float(np.sum(error)) / max(float(np.sum(seen[:, :2] ** 2)), 1e-12) for error in errors)
    if abs(turn) <= TURNED or turned > AGREED or straight <= STRAIGHT * max(turned, LEAST):
        return 0.0
    return turn


def fit_positions(moved: Array, arm: Array, seen: Array, size: float, weight: Array) -> tuple[Array, Array]:
    """Return the squares (V,) of by how much ways of a point on a body and those seen differ, m2, where it is mounted,
    and each way turned, as fits best: of positions, which show no heading; and those of the point's ways (V,).

    moved, seen (V, L): the L legs of each way, m, as complex numbers, of the body in its axes at the start, and of the
    point. arm (V, L): how far a point 1 m ahead moves by the body's turning. size, weight: see `fit_mount`.
    """
    squares = np.sum(np.abs(seen) ** 2, axis=1)
    doubt = (FIRM * (weight @ squares) / size**2 + 1e-12) * np.eye(2)

    def turned(ways: Array) -> Array:
        return seen * np.exp(-1j * np.angle(np.sum(np.conj(ways) * seen, axis=1, keepdims=True)))

    ways = moved
    for _ in range(STEPS):
        fitting = turned(ways)
        columns = np.stack([arm, 1j * arm, fitting - moved])
        by_turn = np.sum(np.conj(1j * fitting) * columns, axis=-1).real / np.maximum(squares, np.finfo(float).tiny)
        columns -= by_turn[..., None] * 1j * fitting  # what no further turn of each way does
        products = np.einsum("v,avl,bvl->ab", weight, np.conj(columns), columns).real
        ways = moved + arm * (np.linalg.solve(products[:2, :2] + doubt, products[:2, 2]) @ [1, 1j])
    return np.sum(np.abs(ways - turned(ways)) ** 2, axis=1), np.sum(np.abs(ways) ** 2, axis=1)


def fit_mount(moved: Array, seen: Array, size: float, weight: Array) -> tuple[float, Array, Array]:
    """Return the turn of a tracker's axes that fits best, rad, and the squares (V,) of by how much the ways of the body
    and of a tracked point then still differ, m2: without and with that turn.

    moved, seen (V, 3): how far the body moves, and how far the tracker sees it move. weight (V,): of each. Where the
    body does not turn as the tracker does, a tracked point beside the origin goes another way: else one far from a body
    that stands could explain any circle.
    """
    body, tracker = moved[:, :2] @ [1, 1j], seen[:, :2] @ [1, 1j]
    arm = np.exp(1j * seen[:, 2]) - 1
    swung = np.abs(np.exp(1j * moved[:, 2]) - 1 - arm)
    known = weight @ np.abs(arm) ** 2 + FIRM * (weight @ np.abs(tracker) ** 2) / size**2 + 1e-12
    # What no tracked point, near the origin, takes off the ways.
    of_body, of_tracker = (np.vdot(arm, weight * part) / known for part in (body, tracker))
    body, tracker = body - arm * of_body, tracker - arm * of_tracker
    turn = float(np.angle(np.vdot(tracker, weight * body)))

    def left(turned: complex) -> Array:
        return np.abs(body - turned * tracker) ** 2 + np.abs(of_body - turned * of_tracker) ** 2 * swung**2

    return turn, left(1.0), left(np.exp(1j * turn))
