"""Write the tables of effects of docs/effects.md, from the classes: ``python scripts/tables/make_effects_table.py``."""

from pathlib import Path
from typing import get_args

from castor_envs.effects.catalogue import table
from castor_envs.vehicles.effect import Scope

PAGE = Path(__file__).parents[2] / "docs" / "effects.md"
START, END = "<!-- tables: made by scripts/tables/make_effects_table.py -->\n", "<!-- end of tables -->\n"


def with_tables(page: str) -> str:
    """Return the page with new tables between its marks."""
    before, rest = page.split(START)
    tables = "".join(f"\nEffects of {scope}s:\n\n{table(scope)}" for scope in get_args(Scope))
    return before + START + tables + "\n" + END + rest.split(END)[1]


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
