"""Many vehicles of one layout, advanced in one compiled call."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from castor_envs.geometry.arrays import Array
from castor_envs.physics.solver import solving_order
from castor_envs.physics.stepper import ADVANCE, WORLD, Simulation

TOGETHER = 4
"""How many vehicles are solved side by side: while one's joint waits for the last result, the processor works on the
others'. Measured from 1 to 16."""


class Fleet:
    """The states of simulations with as many bodies, joints and wheels each, in arrays with one row a vehicle.

    motion (B, b, 6), wheels (B, w), joints (B, j): as those of `Simulation`. The simulations keep their own states:
    `load` copies one's state into its row, `give_back` copies the row into it. A vehicle's results are those of its
    simulation alone, to the last bit, whatever its neighbours do.
    """

    def __init__(self, simulations: Sequence[Simulation]) -> None:
        self.simulations = tuple(simulations)
        self.motion = np.stack([member.motion for member in self.simulations])
        self.wheels = np.stack([member.wheels for member in self.simulations])
        self.joints = np.stack([member.joints for member in self.simulations])
        self.time = np.zeros(len(self.simulations))
        self._periods = np.array([member.sample_period for member in self.simulations])
        self._first = np.zeros(len(self.simulations), dtype=np.uint64)
        self._build()

    def _build(self) -> None:
        """Put neighbours with equal floors and substeps into groups that are stepped as one world."""
        bodies, joints, wheels = self.motion.shape[1], self.joints.shape[1], self.wheels.shape[1]
        worlds, orders, patches, cables, lane = [], [], [], [], 0
        for _, alike in groupby(self.simulations, key=_kind):
            members = list(alike)
            for start in range(0, len(members), TOGETHER):
                group = members[start : start + TOGETHER]
                one, size = group[0], len(group)
                self._first[lane : lane + size] = np.arange(size) * bodies
                layout = [(kind, a + i * bodies, b + i * bodies) for i in range(size) for kind, a, b in one.layout]
                orders.append(solving_order(tuple(layout), one.iterations))
                patches.append(one.patches)
                cables.append(one.cables)
                parts = [(lane * n, (lane + size) * n) for n in (bodies, joints)]
                parts += [_end_of(orders), (lane * wheels, (lane + size) * wheels), _end_of(patches), _end_of(cables)]
                worlds.append((*one.settings, *(place for part in parts for place in part)))
                lane += size
        flat = bodies * lane
        inverse = np.concatenate([1.0 / member.masses for member in self.simulations])
        self._run = ADVANCE.bind(
            np.array(worlds, dtype=WORLD),
            self.motion.reshape(flat, 6),
            inverse,
            self.joints.reshape(-1),
            np.concatenate(orders),
            self.wheels.reshape(-1),
            np.concatenate(patches),
            np.concatenate(cables),
            *(np.empty((flat, columns)) for columns in (3, 5, 5)),
        )

    def load(self, lane: int) -> None:
        """Take the state of a simulation."""
        member, first = self.simulations[lane], self._first[lane]
        self.motion[lane], self.wheels[lane], self.joints[lane] = member.motion, member.wheels, member.joints
        self.wheels["body"][lane] += first
        self.joints["a"][lane] += first
        self.joints["b"][lane] += first
        self.time[lane] = member.time

    def give_back(self, lane: int) -> None:
        """Give a simulation its state."""
        member, first = self.simulations[lane], self._first[lane]
        member.resume(self.motion[lane], self.wheels[lane], self.joints[lane], self.time[lane])
        member.wheels["body"] -= first
        member.joints["a"] -= first
        member.joints["b"] -= first

    def advance(self) -> None:
        """Run one sample period of all vehicles."""
        self._run()
        self.time += self._periods


def _kind(member: Simulation) -> tuple[object, ...]:
    """Return what neighbours must have in common to be stepped as one world."""
    return member.settings, member.iterations, member.layout, member.patches.tobytes(), member.cables.tobytes()


def _end_of(parts: Sequence[Array]) -> tuple[int, int]:
    """Return where the last part begins and ends when all are joined."""
    end = sum(len(part) for part in parts)
    return end - len(parts[-1]), end
