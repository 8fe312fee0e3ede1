"""Write the table of docs/speed.md from docs/speed.json: ``python scripts/make_speed_table.py``.

The figures are those of one machine: ``castor-bench speed --json > docs/speed.json`` measures them again.
"""

import json
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[1] / "docs"
PAGE, FIGURES = DOCS / "speed.md", DOCS / "speed.json"
START, END = "<!-- table: made by scripts/make_speed_table.py -->\n", "<!-- end of table -->\n"


def with_table(page: str, stored: dict[str, Any]) -> str:
    """Return the page with the table of stored figures between its marks."""
    lines = ["| figure | CPU time |", "|---|---|"]
    for group in filter(lambda group: group["figures"], stored["groups"]):
        lines.append(f"| **{group['title']}** | |")
        lines += [f"| {figure['name']} | {figure['value']:.3g} {figure['unit']} |" for figure in group["figures"]]
    before, rest = page.split(START)
    return before + START + "\n".join(lines) + "\n" + END + rest.split(END)[1]


if __name__ == "__main__":
    stored = json.loads(FIGURES.read_text(encoding="utf-8"))
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), stored), encoding="utf-8")
