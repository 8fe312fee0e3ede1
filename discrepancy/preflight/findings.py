"""What the pre-flight finds: mistakes, with the effects that undo them, and remarks."""

from dataclasses import dataclass

from castor_envs.vehicles.effect import Effect


@dataclass(frozen=True)
class Mistake:
    """A gross mistake. what: where, evidence in numbers, and what to do, in one sentence.

    effects: of wiring and the like that explain it, for the robot file; empty where log or robot file must be mended.
    alternatives: other mistakes that would explain it as well, or nearly. taken: whether logs are taken as they are
    all the same: a tracker may be mounted as it likes.
    """

    what: str
    effects: tuple[Effect, ...] = ()
    alternatives: tuple[str, ...] = ()
    taken: bool = False


@dataclass(frozen=True)
class Preflight:
    """What stands out before any small effect is looked for.

    remarks: no mistakes, but to be told.
    """

    mistakes: tuple[Mistake, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def fatal(self) -> bool:
        """Whether nothing else can be said before log or robot file are mended: effects do not do it."""
        return any(not mistake.effects and not mistake.taken for mistake in self.mistakes)

    @property
    def serious(self) -> "Preflight":
        """The same with mistakes that logs are taken with told as remarks."""
        taken = [mistake for mistake in self.mistakes if mistake.taken]
        told = ["; or: ".join((mistake.what, *mistake.alternatives)) for mistake in taken]
        serious = tuple(mistake for mistake in self.mistakes if not mistake.taken)
        return Preflight(serious, (*told, *self.remarks))

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects of all mistakes, in order: with them, the robot's simulation reads like the log."""
        return tuple(effect for mistake in self.mistakes for effect in mistake.effects)
