"""A published table beside ours, value by value."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from benchmarks.progress import RunProgress, SilentProgress

#: What a value may be off beyond half a last printed digit: rounding errors of the arithmetic.
TOLERANCE = 1e-9


@dataclass(frozen=True)
class Comparison:
    """A printed value and ours, both in the unit of print.

    place: where in the table, such as (("test", 1), ("axle", 2), ("metric", "theta_xy")). row, column: its row and
    column in what people read. quantity: its kind, by which agreement is counted. digits: printed decimals.
    Words ("P", "F") and counts (int) are compared as they are. standard_error: of ours, where ours is a mean over
    random draws; such a value is compared by its ratio to print, and rounding says nothing about it.
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


@dataclass(frozen=True)
class PaperTable:
    """A table of a paper. name: for programs. notes: what a reader must know of the values that differ, and why.

    rows: what the rows are, the heading of their column.
    """

    name: str
    title: str
    comparisons: tuple[Comparison, ...]
    notes: tuple[str, ...] = ()
    rows: str = "test"


@dataclass(frozen=True)
class Effort:
    """How much a table may compute: parameter sets of a simulation, and who is told of it."""

    sets: int = 1000
    progress: RunProgress = field(default_factory=SilentProgress)


@dataclass(frozen=True)
class TableSource:
    """A table that is computed when it is asked for. name: the table's."""

    name: str
    compute: Callable[[Effort], PaperTable]


def agreement(comparisons: Iterable[Comparison]) -> dict[str, tuple[int, int]]:
    """Return for every quantity that rounding can judge how many values agree, and how many there are."""
    counts: dict[str, tuple[int, int]] = {}
    for one in comparisons:
        if one.standard_error is not None:
            continue
        agreeing, values = counts.get(one.quantity, (0, 0))
        counts[one.quantity] = (agreeing + one.agrees, values + 1)
    return counts
