"""Write the table of effects into docs/effects.md, from the classes. Run: ``python scripts/make_effects_table.py``."""

from pathlib import Path

from castor_envs.effects import table

PAGE = Path(__file__).parents[1] / "docs" / "effects.md"
START, END = "<!-- table: made by scripts/make_effects_table.py -->\n", "<!-- end of table -->\n"


def with_table(page: str) -> str:
    """Return the page with a new table between its marks."""
    before, rest = page.split(START)
    return before + START + "\n" + table() + "\n" + END + rest.split(END)[1]


if __name__ == "__main__":
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
