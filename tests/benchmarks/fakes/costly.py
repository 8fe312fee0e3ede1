"""Estimators for tests whose updates cost a known time."""

import time

from fake_clock import spend
from followers import Single


class Compiles(Single):
    """In the first episode of a process an update costs 500 us more; the first of every episode costs a millisecond."""

    episodes = 0

    def reset(self, robot, pose):
        super().reset(robot, pose)
        Compiles.episodes += 1
        self.new = Compiles.episodes == 1
        self.k = 0

    def update(self, observation):
        spend(1_000_000 if self.k == 0 else 7_000 + 500_000 * self.new)
        self.k += 1
        return super().update(observation)


class Keeps(Single):
    """Spends 2 ms in an update that it has not seen before, and none in one that it has."""

    seen: set = set()  # noqa: RUF012 - kept as long as the process

    def reset(self, robot, pose):
        super().reset(robot, pose)
        self.k = 0

    def update(self, observation):
        key = (self.k, *observation["wheel"])
        if key not in self.seen:
            self.spend()
        self.seen.add(key)
        self.k += 1
        return super().update(observation)

    def spend(self):
        spend(2_000_000)


class KeepsReally(Keeps):
    """The same with CPU time."""

    seen: set = set()  # noqa: RUF012

    def spend(self):
        until = time.process_time_ns() + 2_000_000
        while time.process_time_ns() < until:
            pass
