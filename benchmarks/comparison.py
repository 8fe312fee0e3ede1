"""A published table beside ours, value by value."""

from collections.abc import Iterable
from dataclasses import dataclass

#: What a value may be off beyond half a last printed digit: rounding errors of the arithmetic.
TOLERANCE = 1e-9


@dataclass(frozen=True)
class Comparison:
    """A printed value and ours, both in the unit of print.

    place: where in the table, such as (("test", 1), ("axle", 2), ("metric", "theta_xy")). row, column: its row and
    column in what people read. quantity: its kind, by which agreement is counted. digits: printed decimals.
    Words ("P", "F") and counts (int) are compared as they are.
    """

    place: tuple[tuple[str, int | str], ...]
    row: str
    column: str
    quantity: str
    unit: str | None
    printed: float | int | str
    ours: float | int | str
    digits: int = 0

    @property
    def agrees(self) -> bool:
        """Whether ours rounds to what is printed."""
        if not isinstance(self.printed, float) or not isinstance(self.ours, float):
            return self.printed == self.ours
        return abs(self.ours - self.printed) <= 0.5 * 10**-self.digits + TOLERANCE


@dataclass(frozen=True)
class PaperTable:
    """A table of a paper. name: for programs. notes: what a reader must know of the values that differ, and why."""

    name: str
    title: str
    comparisons: tuple[Comparison, ...]
    notes: tuple[str, ...] = ()


def agreement(comparisons: Iterable[Comparison]) -> dict[str, tuple[int, int]]:
    """Return for every quantity how many values agree, and how many there are."""
    counts: dict[str, tuple[int, int]] = {}
    for one in comparisons:
        agreeing, values = counts.get(one.quantity, (0, 0))
        counts[one.quantity] = (agreeing + one.agrees, values + 1)
    return counts
