"""The equations of one sample of any robot: all wheels roll, and none slips to its side.

The equations are those of `castor_envs.motion.kinematics`, integrated over one sample. Where wheels and castors turn
evenly in it, each pivot runs on a circle, and in the body's axes as they stand half-way

    g . t + (g . J p - h cos(d_theta / 2)) a = sinc(turn / 2) rolled + 2 h cos(d_psi / 2) sin(d_theta / 2)

holds exactly, with t the displacement of the body's origin, d_psi its turn and a = 2 sin(d_psi / 2), p the pivot and J
the turn by +90 degrees, d_theta the castor's swivel against the body, turn = d_psi + d_theta its turn in N, and with e
and n the castor's rolling direction half-way and its left:

    rolling        g = e + tan(roller angle) n    h = lateral + tan(roller angle) offset    rolled = radius d_phi
    no side slip   g = n                          h = offset                                rolled = 0

A castor that the floor turns does not turn as evenly as its pivot runs on a circle: its axle follows a tractrix,
h theta' = v sin(phi - theta) with v and phi the speed and direction of its pivot, both angles in N. On a circle that
has a closed form (it is a Riccati equation for the tangent of half the angle between castor and direction). With d_phi
the turn of the pivot's direction against the body and w the way of the pivot, no side slip is then off by

    2 h sin((d_theta - d_phi) / 2) (sinc(d) r coth(r) - cos(d))    d = (d_psi + d_phi) / 2    r^2 = (w / 2 h)^2 - d^2

which is added to the right side (`bent`): w^2 (d_theta - d_phi) / (12 h) in short samples, never more than w + 4 h. A
castor that has settled behind a turning direction turns as that does, and is not off. d_phi is the angle between the
pivot's ways in this sample and the one before, which leaves an error of the fourth order of the sample. Where both ways
are not of a length, as at a start, or where there is a corner, nothing tells it: the castor is taken to swing in behind
a straight way, and the less so the longer that is: of a way of several offsets it has settled.

Straight steps have cosines and sinc 1, angles for their sines, and no tractrix; a motion that cannot be found otherwise
(`LOST`) is one, too. The arithmetic is for one robot at a time and is compiled (`castor_envs.kernels`);
`EquationsOfSamples` and `solve` are for single steps of robots or stacks of robots.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from castor_envs.errors import Declined
from castor_envs.geometry.arrays import Array
from castor_envs.kernels.arguments import INTEGER, array
from castor_envs.kernels.kernel import Kernel
from castor_envs.motion.kinematics import Geometry, constraint_matrix
from castor_envs.motion.mobility import rows_in_use
from estimators.protocol import Observation
from estimators.steps.castor_odometry import displaced, sinc, wrapped
from estimators.steps.stacked import Part, Stack

RADIUS, LATERAL, OFFSET = 4e-4, 4e-4, 9e-4
ANGLE = math.radians(0.01)
"""Relative errors of lengths, and rad, that calibration leaves: means of Doebbler's Table I. Normal driving makes
wheels slip along their rolling direction by about as much as their radii are off, and hardly sideways."""

TURNS, SWIVEL = 4, 1.0
"""Revolutions of a wheel, and rad that a castor swivels, over which errors of equations are compared: those of
dimensions grow on the way, those of wheels' rounded counts do not, and those of pivots' counts average out."""

REFINEMENTS = 6
"""Times that the right sides are computed anew from the motion found, at most: where the body turns by half a radian in
a sample, which is more than any does, an error of 1e-10 is left."""

SETTLED = 1e-9
"""rad and m: where the motion found changes by less, the right sides are not computed anew; a hundredth of it is
left."""

LOST = 0.05
"""rad, and m in a metre: a motion that still changes by more when it was refined for the last time is none, as of a
sample so long that the body turned round in it. The step is then taken as straight."""

SINGULAR = 1e-12
"""Of the normal matrix's trace: below it a motion counts as undetermined, and is taken as small."""

ALIKE = 4.0
"""Ratio of the squares of a pivot's ways in two samples up to which they tell how its direction turns: a robot that
accelerates evenly rolls three times as far in its second sample as in the first, and then less than twice."""

CORNER = 0.5
"""rad in a sample: a direction that turns by more did so at once, between samples. Of 50 ms it is 10 rad/s, at which a
robot of 0.25 m/s needs a quarter of its weight to its side."""

RANK = 1e-6
"""Singular values of all equations below this are 0: rows are numbers near 1 and lengths in m."""

CASTOR = np.dtype(
    [
        # where its counts stand in an observation (fixed: any); theta, rad, for a count of its pivot and at count 0
        ("pivot", np.int64),
        ("angle_per_count", float),
        ("angle_zero", float),
        # its pivot, m
        ("x", float),
        ("y", float),
        # state: theta at the last sample, NaN before the first; its change in the sample, cosine and sine of half of
        # that, the angle half-way, its cosine and sine
        ("angle", float),
        ("swivel", float),
        ("half_cos", float),
        ("half_sin", float),
        ("half_way", float),
        ("cos", float),
        ("sin", float),
        # the way of its pivot in the sample before, in the body's axes half-way, m (`went`); 0 before the first
        ("way_x", float),
        ("way_y", float),
    ],
    align=True,
)
ROW = np.dtype(
    [
        # the castor, by its place among those in use; the wheel's place in an observation, -1: no side slip
        ("castor", np.int64),
        ("wheel", np.int64),
        # m for a count of the wheel; tangent of the roller angle, NaN of no side slip; h, m; how many wheels have this
        # equation; 1 / variance up to a factor
        ("way_per_count", float),
        ("roller", float),
        ("arm", float),
        # 1 / (2 offset), 1/m, of no side slip of a castor that the floor turns, 0 of others
        ("bend", float),
        ("contacts", float),
        ("weight", float),
    ],
    align=True,
)
NUMBERS = 12
G_X, G_Y, LEVER, ROLLED, SWUNG, SWIVELLED, WEIGHT, BEND, X, Y, WAY_X, WAY_Y = range(NUMBERS)
"""Numbers of an equation, as kernels hold them: the row for (t_x, t_y, a); for the right side rolled, 2 h sin(d_theta /
2) and d_theta; the weight; `bend`; its pivot, and the pivot's way in the sample before."""


def swivelled(castors, robot, pivot, at):
    """Take a sample of the castors (B, n) of a robot by the counts of pivots (B, p).

    at: where in the step angles are taken, 0.5 half-way, 1.0 at its end.
    """
    for i in range(castors.shape[1]):
        castor = castors[robot, i]
        after = castor.angle_zero + castor.angle_per_count * pivot[robot, castor.pivot]
        before = after if math.isnan(castor.angle) else castor.angle
        castor.angle = after
        swivel = after - before
        castor.swivel = swivel if abs(swivel) < math.pi else wrapped(swivel)
        castor.half_cos, castor.half_sin = math.cos(0.5 * castor.swivel), math.sin(0.5 * castor.swivel)
        castor.half_way = after - (1.0 - at) * castor.swivel
        castor.cos, castor.sin = math.cos(castor.half_way), math.sin(castor.half_way)


def equation(equations, k, i, castor, row, x, y, arm, rolled, arc):
    """Write equation i of robot k into equations (B, m, 10): of a row, its castor as `swivelled`, and its pivot x, y.

    arm, rolled: m.
    """
    roller = row.roller
    cos, sin = castor.cos, castor.sin
    if math.isnan(roller):
        g_x, g_y = -sin, cos
    else:
        g_x, g_y = cos - roller * sin, sin + roller * cos
    across, along = (castor.half_cos, 2.0 * castor.half_sin) if arc else (1.0, castor.swivel)
    equations[k, i, G_X], equations[k, i, G_Y] = g_x, g_y
    equations[k, i, LEVER] = x * g_y - y * g_x - arm * across
    equations[k, i, ROLLED], equations[k, i, SWUNG] = rolled, arm * along
    equations[k, i, SWIVELLED], equations[k, i, WEIGHT] = castor.swivel, row.weight
    equations[k, i, BEND] = row.bend if arc else 0.0
    equations[k, i, X], equations[k, i, Y] = x, y
    equations[k, i, WAY_X], equations[k, i, WAY_Y] = castor.way_x, castor.way_y


def set_up(castors, rows, robot, wheel, equations, k, arc):
    """Write the equations of a sample's counts of wheels (B, w) of a robot, rows (B, m), into equations k."""
    for i in range(rows.shape[1]):
        row = rows[robot, i]
        castor = castors[robot, row.castor]
        rolled = row.way_per_count * wheel[robot, row.wheel] if row.wheel >= 0 else 0.0
        equation(equations, k, i, castor, row, castor.x, castor.y, row.arm, rolled, arc)


def solved(equations, k, arc):
    """Return the displacement x, y (m) in the axes half-way and the turn (rad) that fit equations (B, m, 10) of k best.

    Motions that the equations do not determine at these angles are taken as small.
    """
    m = equations.shape[1]
    xx, xy, xa, yy, ya, aa = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    swung_x, swung_y, swung_a = 0.0, 0.0, 0.0
    for i in range(m):
        g_x, g_y, lever = equations[k, i, G_X], equations[k, i, G_Y], equations[k, i, LEVER]
        weight, swung = equations[k, i, WEIGHT], equations[k, i, SWUNG]
        by_x, by_y, by_a = weight * g_x, weight * g_y, weight * lever
        xx += by_x * g_x
        xy += by_x * g_y
        xa += by_x * lever
        yy += by_y * g_y
        ya += by_y * lever
        aa += by_a * lever
        swung_x += by_x * swung
        swung_y += by_y * swung
        swung_a += by_a * swung
    least = SINGULAR * (xx + yy + aa)
    xx += least
    l_y, l_a = xy / xx, xa / xx
    yy += least - l_y * xy
    l_ay = (ya - l_a * xy) / yy
    aa += least - l_a * xa - l_ay * l_ay * yy
    x, y, a, turn, change = 0.0, 0.0, 0.0, 0.0, 0.0
    for refined in range(REFINEMENTS + 1):
        if refined == REFINEMENTS:
            if change < LOST * (1.0 + abs(x) + abs(y)):
                break
            arc = 0  # there is none
        across = math.cos(0.5 * turn) if arc else 1.0
        r_x, r_y, r_a = across * swung_x, across * swung_y, across * swung_a
        chord, of_swivel = 1.0, math.nan
        for i in range(m):
            if equations[k, i, ROLLED] != 0.0:
                swivel = equations[k, i, SWIVELLED]
                if not arc:
                    chord = 1.0
                elif swivel != of_swivel:
                    chord, of_swivel = sinc(0.5 * (turn + swivel)), swivel
                way = equations[k, i, WEIGHT] * chord * equations[k, i, ROLLED]
            elif arc and equations[k, i, BEND] != 0.0:
                way = equations[k, i, WEIGHT] * bent(equations, k, i, x, y, a, turn)
            else:
                continue
            r_x += equations[k, i, G_X] * way
            r_y += equations[k, i, G_Y] * way
            r_a += equations[k, i, LEVER] * way
        r_y -= l_y * r_x
        r_a -= l_a * r_x + l_ay * r_y
        a, x_before, y_before = r_a / aa, x, y
        y = r_y / yy - l_ay * a
        x = r_x / xx - l_y * y - l_a * a
        before, turn = turn, 2.0 * math.asin(min(max(0.5 * a, -1.0), 1.0)) if arc else a
        change = abs(turn - before) + abs(x - x_before) + abs(y - y_before)
        if change < SETTLED or not arc:
            break
    return x, y, turn


def bent(equations, k, i, x, y, a, turn):
    """Return by how much no side slip of a castor, equation i of robot k, is off for a motion x, y, a, m, and its turn,
    rad: see above."""
    bend, swivel = equations[k, i, BEND], equations[k, i, SWIVELLED]
    way_x, way_y = x - equations[k, i, Y] * a, y + equations[k, i, X] * a
    square = way_x * way_x + way_y * way_y
    if bend == 0.0 or square == 0.0:
        return 0.0
    before_x, before_y = equations[k, i, WAY_X], equations[k, i, WAY_Y]
    before, veered = before_x * before_x + before_y * before_y, math.inf
    if square < ALIKE * before and before < ALIKE * square:
        veered = bearing(before_x * way_x + before_y * way_y, before_x * way_y - before_y * way_x)
    reach = bend * bend * square
    if abs(veered) > CORNER:
        veered = swivel * (1.0 - math.exp(-reach))
    left, half = 0.5 * (swivel - veered), 0.5 * (turn + veered)
    return left * sinc(left) / bend * swung(reach, half)


def swung(reach, half):
    """Return sinc(d) r coth(r) - cos(d) by the square of a pivot's chord over 2 h, and d, rad; by its series where both
    are short, to 1e-5 of it."""
    if reach < 0.02 and abs(half) < 0.1:
        return reach / 3.0 * (1.0 + 0.3 * half * half - reach / 15.0 * (1.0 - 2.0 / 21.0 * reach))
    chord = sinc(half)
    square = reach / (chord * chord) - half * half
    root = math.sqrt(abs(square))
    if root < 1e-3:
        return chord * (1.0 + square / 3.0) - math.cos(half)
    return chord * root / (math.tanh(root) if square > 0.0 else math.tan(root)) - math.cos(half)


def bearing(along, left):
    """Return the direction of a vector, rad; within 0.1 by its series, to 1e-9."""
    if abs(left) > 0.1 * along:
        return math.atan2(left, along)
    tangent = left / along
    square = tangent * tangent
    return tangent * (1.0 - square / 3.0 * (1.0 - 0.6 * square * (1.0 - 5.0 / 7.0 * square)))


def went(castors, robot, x, y, turn):
    """Keep the ways of pivots of castors (B, n) of a robot in a motion x, y, m, and turn, rad, for the next sample."""
    a = 2.0 * math.sin(0.5 * turn)
    for i in range(castors.shape[1]):
        castor = castors[robot, i]
        castor.way_x, castor.way_y = x - castor.y * a, y + castor.x * a


def _read(castors, rows, equations, wheel, pivot):
    for robot in range(castors.shape[0]):
        swivelled(castors, robot, pivot, 0.5)
        set_up(castors, rows, robot, wheel, equations, robot, 1)
        went(castors, robot, *solved(equations, robot, 1))


def _solve(equations, motion, arc):
    for k in range(equations.shape[0]):
        motion[k, 0], motion[k, 1], motion[k, 2] = solved(equations, k, arc)


_READ = Kernel(__name__, "_read", (array(CASTOR, 2), array(ROW, 2), array(float, 3), array(float, 2), array(float, 2)))
_SOLVE = Kernel(__name__, "_solve", (array(float, 3), array(float, 2), INTEGER))


class Rows(NamedTuple):
    """Which equations a robot has: first the rolling of each wheel with an encoder, then no side slip of each castor
    with a standard wheel. Castors whose angle nobody knows are left out.

    wheels (d,), castors (c,): whose. castor (m,): that of each equation. known: all castors in use. read (d,): places
    of wheels in an observation. contacts (m,): how many wheels have each: two on one axle both forbid its side slip.
    """

    geometry: Geometry
    wheels: NDArray[np.intp]
    castors: NDArray[np.intp]
    castor: NDArray[np.intp]
    known: NDArray[np.intp]
    read: NDArray[np.intp]
    contacts: Array

    @classmethod
    def of(cls, geometry: Geometry) -> "Rows":
        """Return the equations of a robot; raises Declined if at no angles they determine how the body moves."""
        used = rows_in_use(geometry)
        if len(used.castor) == 0:
            raise Declined("needs wheels with encoders or standard wheels, on castors whose angles are known; has none")
        angle = np.where(geometry.fixed, geometry.angle, np.arange(1.0, 1.0 + geometry.n_castors))
        matrix, _ = constraint_matrix(geometry, angle)
        if np.any(np.linalg.matrix_rank(matrix[..., used.place, :], tol=RANK) < 3):
            raise Declined(
                "needs wheels that determine how the body moves; here it may move though no wheel with an encoder "
                "turns, no castor with one swivels and no standard wheel slips sideways"
            )
        standard = np.bincount(geometry.wheel_castor, weights=geometry.standard, minlength=geometry.n_castors)
        driven = np.flatnonzero(~np.isnan(geometry.counts_per_rev))
        return cls(
            geometry=geometry,
            wheels=used.wheels,
            castors=used.castors,
            castor=used.castor,
            known=np.unique(used.castor),
            read=np.searchsorted(driven, used.wheels),
            contacts=np.concatenate([np.ones(len(used.wheels)), standard[used.castors].astype(float)]),
        )

    @property
    def angle_per_count(self) -> Array:
        """What wheels (d,) turn in a count, rad."""
        return 2 * np.pi / self.geometry.counts_per_rev[self.wheels]

    @property
    def way_per_count(self) -> Array:
        """What wheels (..., d) roll in a count, m."""
        return self.geometry.radius[..., self.wheels] * self.angle_per_count

    def variances(self) -> Array:
        """Return the variance (..., m) of each equation, m2, over `TURNS` and `SWIVEL`.

        Wheels' counts are rounded at both ends; dimensions are off by `RADIUS`, `LATERAL`, `OFFSET` and `ANGLE`.
        """
        geometry = self.geometry
        swivel = np.where(geometry.fixed, 0.0, SWIVEL)
        by_lateral = LATERAL * geometry.lateral[..., self.wheels] * swivel[geometry.wheel_castor[self.wheels]]
        by_offset = OFFSET * geometry.offset[..., self.castors] * swivel[self.castors]
        way = 2 * np.pi * TURNS * geometry.radius
        on = geometry.wheel_castor == self.castors[:, None]
        across = way @ (on / on.sum(axis=1, keepdims=True)).T  # mean of each castor's wheels
        rolling = self.way_per_count**2 / 6 + (RADIUS * way[..., self.wheels]) ** 2 + by_lateral**2
        return np.concatenate([rolling, (ANGLE * across) ** 2 + by_offset**2], axis=-1)

    def records(self, weight: Array) -> tuple[NDArray[np.void], NDArray[np.void]]:
        """Return records of the castors in use (..., n), before the first sample, and of the equations (..., m), with
        weights (..., m)."""
        geometry, d = self.geometry, len(self.wheels)
        fixed, lead = geometry.fixed[self.known], geometry.offset.shape[:-1]
        castors = np.zeros((*lead, len(self.known)), CASTOR)
        castors["pivot"] = np.where(fixed, 0, np.searchsorted(geometry.sensed, self.known))
        castors["angle_per_count"] = np.where(fixed, 0.0, 2 * np.pi / geometry.pivot_counts_per_rev[self.known])
        castors["angle_zero"] = np.where(fixed, geometry.angle[..., self.known], -geometry.pivot_zero[..., self.known])
        castors["x"], castors["y"] = np.moveaxis(geometry.pivot[..., self.known, :], -1, 0)
        castors["angle"] = np.nan
        rows = np.zeros((*lead, len(self.castor)), ROW)
        rows["castor"], rows["wheel"], rows["wheel"][..., :d] = np.searchsorted(self.known, self.castor), -1, self.read
        roller = geometry.roller[..., self.wheels]
        rows["roller"], rows["roller"][..., :d] = np.nan, roller
        rows["way_per_count"][..., :d] = self.way_per_count
        rows["arm"] = geometry.offset[..., self.castor]
        rows["arm"][..., :d] = geometry.lateral[..., self.wheels] + roller * rows["arm"][..., :d]
        of_side = self.castors
        turned = np.where(geometry.driven | geometry.fixed, np.nan, geometry.trail)[..., of_side]
        rows["bend"][..., d:] = np.nan_to_num(1 / (2 * turned))
        rows["contacts"], rows["weight"] = self.contacts, weight
        return castors, rows


class Equations(NamedTuple):
    """The m equations of one sample, for (t_x, t_y, a): matrix (..., m, 3) and what both right sides are made of.

    rolled (..., m): m. arm (..., m): h, m. swivel (..., m): d_theta, rad. tractrix (..., m, 5): numbers `BEND` to
    `WAY_Y`, of the robot as described.
    """

    matrix: Array
    rolled: Array
    arm: Array
    swivel: Array
    tractrix: Array

    def right(self, turn: Array) -> Array:
        """Return the right sides (..., m), m, where the body turns by `turn` (...), rad, but for tractrices."""
        turn = turn[..., None]
        chord = np.sinc((turn + self.swivel) / (2 * np.pi))
        return chord * self.rolled + 2 * self.arm * np.cos(turn / 2) * np.sin(self.swivel / 2)


class EquationsOfSamples:
    """Sets up the equations of one sample after another from encoder readings, of a robot or a stack of robots."""

    def __init__(self, rows: Rows) -> None:
        records, m = rows.records(1.0 / rows.variances()), len(rows.castor)
        parts = Part(records[0]), Part(records[1]), Part(np.zeros((m, NUMBERS)), axes=2)
        self._stack = Stack(_READ, rows.geometry, parts)

    def read(self, observation: Observation) -> Equations:
        """Take one sample and return its equations; the first is taken to have begun at the angles that it shows."""
        self._stack.advance(observation)
        _, rows, equations = self._stack.parts
        found = equations.copy()
        swivel, tractrix = found[..., SWIVELLED], found[..., BEND:]
        return Equations(found[..., : LEVER + 1], found[..., ROLLED], rows["arm"], swivel, tractrix)


class Motion(NamedTuple):
    """The body's motion in one sample: displacement (..., 2) in the axes half-way, m, and turn (...), rad."""

    displacement: Array
    turn: Array


def solve(equations: Equations, weight: Array) -> Motion:
    """Return the motion that fits equations with weights (..., m), 1 / variance up to a factor, best. See `solved`."""
    matrix, rolled, arm, swivel, tractrix = equations
    parts = np.broadcast_arrays(rolled, 2 * arm * np.sin(swivel / 2), swivel, weight)
    stacked = np.concatenate([matrix, np.stack(parts, axis=-1), tractrix], axis=-1)
    motion = np.empty((*stacked.shape[:-2], 3))
    _SOLVE.bind(stacked.reshape(-1, *stacked.shape[-2:]), motion.reshape(-1, 3), 1)()
    return Motion(motion[..., :2], motion[..., 2])


def moved(pose: Array, motion: Motion) -> Array:
    """Return the pose (..., 3) after a motion."""
    half_way = pose + np.multiply.outer(motion.turn, (0.0, 0.0, 0.5))
    return displaced(half_way, motion.displacement[..., 0], motion.displacement[..., 1], motion.turn / 2)
