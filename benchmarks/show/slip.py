"""Where contacts slipped, and how far the encoders of a drive disagree, castor by castor; of a train axle by axle.

Both are residuals of the rolling constraints (`LogLikelihood.residuals`): wheels roll as far as they move along, and
move to no side. Those that no motion of the body explains are disagreement, which counts alone show. The whole
residuals, with the body where the reference saw it, are slip; they are summed over windows, as a tracker's noise and
the rounding of counts average out in these.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.show.drives import Drive
from castor_envs.geometry.arrays import Array
from castor_envs.geometry.se2 import compose
from castor_envs.logs.log import Log, poses_taken
from castor_envs.logs.reference import interpolated
from castor_envs.motion.kinematics import Geometry
from castor_envs.vehicles.robot import RobotDescription
from castor_envs.vehicles.train import TrainDescription
from estimators.likelihood.log_likelihood import LogLikelihood

WINDOW = 0.5
"""s: long enough that rounding and the jitter of a tracker average out, and short enough to see one cable."""
MOST_PLACES = 5
"""That a page names, the worst ones."""
LEAST, LEAST_METRES = 3.0, 3e-4
"""What a place must have to be named: of the usual slip in a window (the median), below which it is noise, and m, which
the rounding of counts reaches."""


class Place(NamedTuple):
    """Where a castor (or an axle) slipped in a window: by slip (m), at t (s), x and y (m), way (m) from the start."""

    part: str
    slip: float
    t: float
    x: float
    y: float
    way: float


@dataclass(frozen=True, eq=False)
class Slips:
    """By how much parts (n,) of a vehicle missed perfect rolling in windows (W,), m.

    t (W,): middle of each, s. way (W,): driven until then, m. place (W, n, 2): where each part was, m; NaN where nobody
    knows. disagreement (W, n): of encoders among themselves. slip (W, n): against the reference, None without a dense
    one.
    """

    parts: tuple[str, ...]
    t: Array
    way: Array
    place: Array
    disagreement: Array
    slip: Array | None

    def worst(self) -> list[Place]:
        """Return where much more slip was than usual, at most one place for each window, the worst first."""
        if self.slip is None:
            return []
        known = np.nan_to_num(self.slip, nan=-np.inf)
        part = np.argmax(known, axis=1)
        size = known[np.arange(len(part)), part]
        usual = float(np.median(size[np.isfinite(size)]))
        return [
            Place(
                self.parts[part[k]],
                float(size[k]),
                float(self.t[k]),
                float(self.place[k, part[k], 0]),
                float(self.place[k, part[k], 1]),
                float(self.way[k]),
            )
            for k in np.argsort(-size)[:MOST_PLACES].tolist()
            if size[k] > max(LEAST * usual, LEAST_METRES)
        ]


def slips_of(drive: Drive) -> Slips | None:
    """Return the slips of a drive; None where it is too short for a window."""
    log = drive.log
    starts = np.searchsorted(log.t, np.arange(log.t[0], log.t[-1] - WINDOW / 2, WINDOW) - 1e-9)
    edges = np.unique(np.append(starts, len(log) - 1))
    if len(edges) < 3:
        return None
    middle = (log.t[edges[:-1]] + log.t[edges[1:]]) / 2
    of = _of_train(drive, edges) if isinstance(drive.vehicle, TrainDescription) else _of_robot(drive, edges)
    if of is None:
        return None
    parts, places, disagreement, slip = of
    place = np.full((len(middle), len(parts), 2), np.nan)
    if drive.dense:
        assert log.reference is not None
        if len(known := poses_taken(log)):
            poses = np.column_stack([np.interp(middle, log.t[known], column) for column in log.reference[known].T])
            bodies = poses.reshape(len(poses), -1, 3)
            place = compose(bodies, np.pad(places, ((0, 0), (0, 1))))[..., :2]
    way = np.interp(middle, log.t[drive.samples], drive.way)
    return Slips(parts, middle, way, place, disagreement, slip if np.isfinite(slip).any() else None)


_Parts = tuple[tuple[str, ...], Array, Array, Array]
"""Names (n,) of parts, where they are in their body's frame (n, 2), m, and disagreement and slip (W, n), m."""


def _of_robot(drive: Drive, edges: NDArray[np.intp]) -> _Parts | None:
    robot, log = drive.vehicle, drive.log
    assert isinstance(robot, RobotDescription)
    found = _residuals(robot, log, edges)
    if found is None:
        return None
    castors, disagreement, slip = found
    pivots = np.array([robot.castors[i].pivot for i in castors])
    return tuple(f"castor {i + 1}" for i in castors), pivots, disagreement, slip


def _of_train(drive: Drive, edges: NDArray[np.intp]) -> _Parts:
    """Return the same of a train's axles; two wheels on an axle never disagree."""
    train, log, slips = drive.vehicle, drive.log, []
    assert isinstance(train, TrainDescription)
    for i, module in enumerate(train.modules):
        reference = None if log.reference is None else log.reference[:, 3 * i : 3 * i + 3]
        single = Log(log.t, log.wheel[:, 2 * i : 2 * i + 2], np.empty((len(log), 0)), reference=reference)
        found = _residuals(module, single, edges)
        assert found is not None
        slips.append(found[2][:, 0])
    slip = np.column_stack(slips)
    names = tuple(f"axle {i + 1}" for i in range(len(train.modules)))
    return names, np.zeros((len(names), 2)), np.zeros_like(slip), slip


def _residuals(robot: RobotDescription, log: Log, edges: NDArray[np.intp]) -> tuple[list[int], Array, Array] | None:
    """Return castors with known angles, and their disagreement and slip (W, castors), m; None where there are none.

    Of a castor's wheels and its side the root of the sum of squares counts. Slip is NaN in windows in which the
    reference does not show where the body was, and its heading, at every sample.
    """
    geometry = Geometry.of(robot)
    model = LogLikelihood(geometry, log)
    rows = np.array(model.slip_rows)
    if not len(rows):
        return None
    wheels = len(geometry.radius)
    castor_of = np.where(rows < wheels, geometry.wheel_castor[np.minimum(rows, wheels - 1)], rows - wheels)
    castors = np.unique(castor_of).tolist()
    state = model.start(geometry)
    shown = np.zeros(len(log), dtype=bool)
    if log.reference is not None:
        taken = poses_taken(log)
        poses = interpolated(log.t[taken], log.reference[taken], log.t)
        shown = np.isfinite(poses[:, 0])
        state[shown, :3] = poses[shown]
    between = np.logical_and.reduceat(shown, edges[:-1]) & shown[edges[1:]]

    def by_castor(steps: Array) -> Array:
        sums = np.add.reduceat(steps, edges[:-1], axis=0)
        return np.column_stack([np.sqrt(np.sum(sums[:, castor_of == i] ** 2, axis=1)) for i in castors])

    slip, disagreement = model.residuals(geometry, state), model.disagreement(geometry, state)
    return castors, by_castor(disagreement), np.where(between[:, None], by_castor(slip), np.nan)
