"""Findings of the pre-flight: mistakes, with the effects that explain them, and remarks."""

from dataclasses import dataclass

from castor_envs.vehicles.effect import Effect


@dataclass(frozen=True)
class Mistake:
    """A gross mistake. what: where, evidence in numbers, and what to do, in one sentence.

    effects: of wiring and the like that explain it, for the robot file; empty where the log or the robot file must be
    corrected. alternatives: other mistakes that explain it as well, or nearly. taken: whether logs are accepted in
    spite of it, as a tracker may be mounted in any direction.
    """

    what: str
    effects: tuple[Effect, ...] = ()
    alternatives: tuple[str, ...] = ()
    taken: bool = False


@dataclass(frozen=True)
class Preflight:
    """Gross findings, before any search for small effects.

    remarks: further findings that are no mistakes. slid: whether wheels, driven by wrong readings, slid so much that
    logs tell nothing else.
    """

    mistakes: tuple[Mistake, ...] = ()
    remarks: tuple[str, ...] = ()
    slid: bool = False

    @property
    def fatal(self) -> bool:
        """Whether the log or the robot file must be corrected before any diagnosis, as no effect explains the
        mistake."""
        return any(not mistake.effects and not mistake.taken for mistake in self.mistakes)

    @property
    def serious(self) -> "Preflight":
        """The same findings, with mistakes in spite of which logs are accepted turned into remarks."""
        taken = [mistake for mistake in self.mistakes if mistake.taken]
        reported = ["; or: ".join((mistake.what, *mistake.alternatives)) for mistake in taken]
        serious = tuple(mistake for mistake in self.mistakes if not mistake.taken)
        return Preflight(serious, (*reported, *self.remarks), self.slid)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The effects of all mistakes, in order: with them, the robot's simulation reads like the log."""
        return tuple(effect for mistake in self.mistakes for effect in mistake.effects)
