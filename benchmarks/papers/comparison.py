"""A published table beside ours, value by value."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

from benchmarks.papers.assumptions import Assumptions, Condition, option_name
from benchmarks.progress import RunProgress, SilentProgress
from castor_envs.errors import InputError

#: Tolerance beyond half a last printed digit: rounding errors of the arithmetic.
TOLERANCE = 1e-9


@dataclass(frozen=True)
class Comparison:
    """A printed value and ours, both in the unit of print.

    place: where in the table, such as (("test", 1), ("axle", 2), ("metric", "theta_xy")). row, column: its row and
    column in what people read. quantity: its kind, by which agreement is counted. digits: printed decimals.
    Words ("P", "F") and counts (int) are compared as they are. standard_error: of ours, where ours is a mean over
    random draws; such a value is compared by its ratio to print, and rounding says nothing about it. also: further
    values for programs, by keys that name their units.
    """

    place: tuple[tuple[str, int | str], ...]
    row: str
    column: str
    quantity: str
    unit: str | None
    printed: float | int | str
    ours: float | int | str
    digits: int = 0
    standard_error: float | None = None
    also: tuple[tuple[str, float], ...] = ()

    @property
    def ratio(self) -> float | None:
        """Ours over the printed value, of means over random draws."""
        return None if self.standard_error is None else float(self.ours) / float(self.printed)

    @property
    def agrees(self) -> bool:
        """Whether ours rounds to what is printed; not asked of means over random draws (see `ratio`)."""
        if not isinstance(self.printed, float) or not isinstance(self.ours, float):
            return self.printed == self.ours
        return abs(self.ours - self.printed) <= 0.5 * 10**-self.digits + TOLERANCE


@dataclass(frozen=True, eq=False)
class Appendix:
    """What belongs to several tables and is shown once after them: lines for people, data for programs under `key`."""

    key: str
    title: str
    lines: tuple[str, ...]
    data: Mapping[str, Any]


@dataclass(frozen=True)
class PaperTable:
    """A table of a paper. name: for programs. notes: what a reader must know of the values that differ, and why.

    rows: heading of the column that names the rows. conditions: everything that our values were computed with.
    """

    name: str
    title: str
    comparisons: tuple[Comparison, ...]
    notes: tuple[str, ...] = ()
    rows: str = "test"
    conditions: tuple[Condition, ...] = ()
    appendix: Appendix | None = None


@dataclass(frozen=True)
class Effort:
    """How a table is computed: parameter sets of a simulation, where progress is reported, and what is assumed."""

    sets: int = 1000
    progress: RunProgress = field(default_factory=SilentProgress)
    assumptions: Assumptions = field(default_factory=Assumptions)

    def conditions(self, names: tuple[str, ...]) -> tuple[Condition, ...]:
        """Return the number of sets and the named assumptions."""
        return (Condition("sets", self.sets, Effort.sets), *self.assumptions.used(names))


@dataclass(frozen=True)
class TableSource:
    """A table that is computed when it is asked for. name: the table's. assumes: names of its assumptions."""

    name: str
    compute: Callable[[Effort], PaperTable]
    assumes: tuple[str, ...] = ()


def compute_tables(sources: Iterable[TableSource], effort: Effort) -> tuple[PaperTable, ...]:
    """Compute tables; raises InputError where an assumption was changed that none of them uses."""
    sources = tuple(sources)
    for name in effort.assumptions.changed():
        if not any(name in source.assumes for source in sources):
            chosen = ", ".join(source.name for source in sources)
            raise InputError(
                f"{option_name(name)} changes nothing in {chosen}; castor-bench tables --help says what it is for"
            )
    return tuple(source.compute(effort) for source in sources)


def agreement(comparisons: Iterable[Comparison]) -> dict[str, tuple[int, int]]:
    """Return for every quantity that rounding can judge how many values agree, and how many there are."""
    counts: dict[str, tuple[int, int]] = {}
    for value in comparisons:
        if value.standard_error is not None:
            continue
        agreeing, values = counts.get(value.quantity, (0, 0))
        counts[value.quantity] = (agreeing + value.agrees, values + 1)
    return counts
