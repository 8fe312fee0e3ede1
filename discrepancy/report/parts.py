"""What reports are made of: data that may lack a part, and numbers in units that people read."""

import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

Data = Mapping[str, Any]

MILLI, PERCENT = 1e3, 100
"""mm a metre, mrad a radian, ms a second; and per cent of the whole."""

READ_AS = {"m": ("mm", MILLI), "rad": ("mrad", MILLI), "s": ("ms", MILLI), "1": ("%", PERCENT)}
"""Units of the data, and what people read instead, so many to one."""


def names_apart(paths: Iterable[Any]) -> dict[str, str]:
    """Return what to call files: by their names, and as many of the folders above as distinguish them."""
    parts_of = {str(path): Path(str(path)).parts for path in paths}

    def called(parts: tuple[str, ...]) -> str:
        apart = (n for n in range(1, len(parts)) if sum(rival[-n:] == parts[-n:] for rival in parts_of.values()) == 1)
        return str(Path(*parts[-next(apart, len(parts)) :]))

    return {path: called(parts) for path, parts in parts_of.items()}


def digits_by(error: Any, scale: float) -> int:
    """Return after how many decimals a number with this standard error ends: its second figure."""
    if not isinstance(error, int | float) or not error > 0:
        return 3
    return min(max(1 - math.floor(math.log10(error * scale)), 0), 9)


def number(value: Any, scale: float = 1.0, digits: int = 0, signed: bool = False) -> str:
    """Return a number to so many decimals; a dash for none."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return "\N{EN DASH}"
    shown = f"{value * scale:{'+' if signed else ''}.{digits}f}"
    return shown.replace("-", "\N{MINUS SIGN}")
