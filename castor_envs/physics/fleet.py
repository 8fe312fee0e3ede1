"""Many vehicles of one structure, advanced side by side in the lanes of vector instructions, by several threads."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from castor_envs.geometry.arrays import Array
from castor_envs.kernels.arguments import aligned, in_lanes
from castor_envs.physics.solver import BODY, INVERSE, JOINT, LOAD, PLACE, solving_order
from castor_envs.physics.stepper import ADVANCE, DRIVES, WORLD, Drive, Simulation
from castor_envs.physics.tyre import WHEEL

WIDTHS = {8: 2.0, 16: 1.3, 32: 1.0}
"""How many lanes worlds have, and what a lane costs there, measured on a base of three castors: more lanes than the
widest register has keep the processor busy while one register waits for another."""
LARGE = 16
"""Bodies beyond which vehicles stand in the narrowest worlds, which the processor's cache holds. Measured on trains."""
WORTH_A_THREAD = 100_000
"""Joints and wheels solved for, substep by substep, in the 0.1 to 0.3 ms that make up for a thread's start."""
STRUCTURE = ("kind", "a", "b"), ("body", "grip")
"""The fields of joints and of wheels that are one for all lanes."""


def structure(one: Simulation) -> tuple[object, ...]:
    """Return what simulations must have in common to be a fleet."""
    return one.layout, one.iterations, one.floor.climbing, *(one.wheels[name].tobytes() for name in STRUCTURE[1])


class Fleet:
    """The states of B simulations of one `structure`, which keep their own: `load` and `give_back` copy them.

    A vehicle's results are those of its simulation alone, to the last bit, whatever its neighbours do and however many
    threads there are. motion (B, b, 6): a copy, as that of `Simulation`. time (B,): s.

    Vehicles stand in the lanes of worlds, (W, L), sorted by their substeps; what is left over is filled with copies of
    the last one.

    threads: among which worlds are divided; None for as many as there are processors and are worth it.
    """

    def __init__(self, simulations: Sequence[Simulation], threads: int | None = None) -> None:
        self.simulations = tuple(simulations)
        first, size = self.simulations[0], len(self.simulations)
        bodies, joints, wheels = len(first.motion), len(first.joints), len(first.wheels)
        width = min(WIDTHS) if bodies > LARGE else min(WIDTHS, key=lambda w: -(-size // w) * w * WIDTHS[w])
        self._shape = worlds, _ = -(-size // width), width
        work = sum(member.substeps for member in self.simulations) * (wheels + joints * first.iterations)
        self._threads = threads or max(1, min(worlds, _processors(), work // WORTH_A_THREAD))
        order = np.argsort([member.substeps for member in self.simulations], kind="stable")
        self._place = np.argsort(order)
        members = order[np.minimum(np.arange(worlds * width), size - 1)].reshape(self._shape)

        # All that changes in a world stands in one block.
        self._joint, self._wheel = _Fields(JOINT, width), _Fields(WHEEL, width)
        ends = np.cumsum([0, 6 * bodies, joints * self._joint.rows, wheels * self._wheel.rows])
        self._state = aligned((worlds, int(ends[-1]), width))
        motion, joint, wheel = (self._state[:, start:end] for start, end in pairwise(ends.tolist()))
        self._motion = motion.reshape(worlds, bodies, 6, width)
        self._joints = joint.reshape(worlds, joints, self._joint.rows, width)
        self._wheels = wheel.reshape(worlds, wheels, self._wheel.rows, width)

        self.motion = np.stack([member.motion for member in self.simulations])
        self.time, self._periods = np.zeros(size), np.array([member.sample_period for member in self.simulations])
        self._runs = [self._bound(world, [self.simulations[m] for m in members[world]]) for world in range(worlds)]

    def __reduce__(self) -> tuple[Any, ...]:
        # What advances worlds is bound to its memory: a copy is made anew, and takes the state.
        return Fleet, (self.simulations, self._threads), (self._state, self.motion, self.time)

    def __setstate__(self, state: tuple[Array, Array, Array]) -> None:
        self._state[:], self.motion, self.time = state

    def _bound(self, world: int, members: Sequence[Simulation]) -> Callable[[], None]:
        """Put members (L,) into a world; return what advances it."""
        first, width = members[0], len(members)
        joints = self._joint.records(self._joints[world])
        wheels = self._wheel.records(self._wheels[world])
        for records, single, names in zip((joints, wheels), (first.joints, first.wheels), STRUCTURE, strict=True):
            for name in names:
                records[name] = single[name]
        for lane, member in enumerate(members):
            self._put(world, lane, member)
        settings = np.zeros(1, dtype=in_lanes(WORLD, width))
        given = np.array([member.settings for member in members], dtype=WORLD)
        for name in WORLD.names or ():
            settings[name] = given[name] if given[name].dtype.kind == "f" else given[name].max()
        settings["fewest"] = given["substeps"].min()
        inverse = _beside([1.0 / member.masses for member in members]).reshape(-1).view(in_lanes(INVERSE, width))
        patches = _floors([member.patches for member in members])
        cables = _floors([member.cables for member in members])
        scratch = [aligned((len(first.motion),), in_lanes(kind, width)) for kind in (LOAD, PLACE, PLACE)]
        state, kept = self._state[world], aligned(self._state[world].shape)
        order, there = solving_order(first.layout, first.iterations), (wheels, patches, cables)
        bodies = self._motion[world].reshape(-1).view(in_lanes(BODY, width))
        return ADVANCE.in_lanes(width).bind(settings, bodies, inverse, joints, order, *there, *scratch, state, kept)

    def load(self, lane: int) -> None:
        """Take the state of a simulation."""
        member = self.simulations[lane]
        self._put(*self._at(lane), member)
        self.motion[lane], self.time[lane] = member.motion, member.time

    def _at(self, lane: int) -> tuple[int, int]:
        return divmod(int(self._place[lane]), self._shape[1])

    def _put(self, world: int, lane: int, member: Simulation) -> None:
        self._motion[world, ..., lane] = member.motion
        self._joint.put(member.joints, self._joints[world, ..., lane])
        self._wheel.put(member.wheels, self._wheels[world, ..., lane])

    def give_back(self, lane: int) -> None:
        """Give a simulation its state."""
        member, (world, at) = self.simulations[lane], self._at(lane)
        joints = self._joint.taken(member.joints, self._joints[world, ..., at])
        wheels = self._wheel.taken(member.wheels, self._wheels[world, ..., at])
        wheels["drive"] = self._wheel.of("drive", self._wheels)[world]
        member.resume(self.motion[lane], wheels, joints, self.time[lane])

    def close(self) -> None:
        """End the threads."""
        if self._threads > 1:
            self._pool.shutdown()

    def wheel_angles(self) -> Array:
        """Return how far the wheels (B, w) have turned, rad."""
        return self._members(self._wheel.of("angle", self._wheels))

    def command(self, wheels: NDArray[np.intp], command: Array, limit: Array, drive: Drive) -> None:
        """Set the mode of some wheels' motors, and their command (B, k) within +-limit."""
        self._wheel.of("drive", self._wheels)[:, wheels] = DRIVES[drive]
        within = np.minimum(np.maximum(command, -limit), limit)
        self._wheel.of("command", self._wheels)[:, wheels] = self._lanes(within)

    def steer(self, motors: NDArray[np.intp], rates: Array, most: Array) -> None:
        """Command motors between bodies: rates (B, m), rad/s, of the second against the first; impulses up to most."""
        self._joint.of("rate", self._joints)[:, motors] = self._lanes(-rates)
        self._joint.of("most", self._joints)[:, motors] = self._lanes(most)

    def advance(self) -> None:
        """Run one sample period of all vehicles."""
        if self._threads == 1:
            _run_all(self._runs)
        else:
            list(self._pool.map(_run_all, [self._runs[k :: self._threads] for k in range(self._threads)]))
        self.motion = self._members(self._motion)
        self.time += self._periods

    @cached_property
    def _pool(self) -> ThreadPoolExecutor:
        return ThreadPoolExecutor(self._threads)

    def _members(self, lanes: Array) -> Array:
        """Return as rows of members (B, ...) what stands in lanes (W, ..., L)."""
        rows = np.moveaxis(lanes, -1, 1)
        return rows.reshape(-1, *rows.shape[2:])[self._place]

    def _lanes(self, members: Array) -> Array:
        """Return in lanes (W, k, L) what stands in rows of members (B, k)."""
        rows = np.zeros((np.prod(self._shape), members.shape[1]))
        rows[self._place] = members
        return np.moveaxis(rows.reshape(*self._shape, -1), -1, 1)


class _Fields:
    """Where the fields of a record stand in rows of lanes (..., rows, L), and in a single record."""

    def __init__(self, dtype: np.dtype, width: int) -> None:
        self.lanes, self._width = in_lanes(dtype, width), dtype.itemsize // 8
        self.rows = self.lanes.itemsize // (8 * width)
        self._place = {name: divmod(field[1] // 8, width) for name, field in (self.lanes.fields or {}).items()}
        single = {name: field for name, field in (dtype.fields or {}).items() if field[0].kind == "f"}
        self._reals = list(single)
        self._single = [field[1] // 8 for field in single.values()]
        self._several = [self._place[name][0] for name in self._reals]

    def records(self, rows: Array) -> NDArray[np.void]:
        """Return rows (n, rows, L) as records (n,)."""
        return rows.reshape(-1).view(self.lanes)

    def of(self, name: str, rows: Array) -> NDArray[Any]:
        """Return a field of all records: reals (..., L), integers (...)."""
        row, slot = self._place[name]
        return rows[..., row, :] if name in self._reals else rows.view(np.int64)[..., row, slot]

    def put(self, single: NDArray[np.void], rows: Array) -> None:
        """Copy the reals of records (n,) into one lane (n, rows)."""
        rows[:, self._several] = single.view(float).reshape(-1, self._width)[:, self._single]

    def taken(self, single: NDArray[np.void], rows: Array) -> NDArray[np.void]:
        """Return records (n,) with the reals of one lane (n, rows)."""
        new = single.copy()
        new.view(float).reshape(-1, self._width)[:, self._single] = rows[:, self._several]
        return new


def _floors(single: Sequence[Array]) -> Array:
    """Return patches or cables (p, ...) of lanes (L,) side by side, as many of each: some are nowhere."""
    most, nowhere = max(map(len, single)), np.zeros((1, single[0].shape[1]))
    nowhere[0, 4] = -1.0  # half their length
    return _beside([np.concatenate([floor, np.repeat(nowhere, most - len(floor), axis=0)]) for floor in single])


def _beside(single: Sequence[Array]) -> Array:
    """Return arrays (n, k) of lanes (L,) side by side, (n, k, L)."""
    joined = aligned((*single[0].shape, len(single)))
    joined[...] = np.stack(single, axis=-1)
    return joined


def _processors() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _run_all(runs: Sequence[Callable[[], None]]) -> None:
    for run in runs:
        run()
