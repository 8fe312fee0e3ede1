"""Write the table of docs/speed.md and the figures of docs/clusters.md: ``python scripts/tables/make_speed_table.py``.

The figures are those of one machine: ``castor-bench speed --json > docs/speed.json`` measures them again.
"""

import json
from pathlib import Path
from typing import Any

from benchmarks.speed.figures import Figure

DOCS = Path(__file__).parents[2] / "docs"
PAGE, CLUSTERS, FIGURES = DOCS / "speed.md", DOCS / "clusters.md", DOCS / "speed.json"
START, END = "<!-- table: made by scripts/tables/make_speed_table.py -->\n", "<!-- end of table -->\n"
BEGUN, ENDED = "<!-- figures: made by scripts/tables/make_speed_table.py -->\n", "<!-- end of figures -->\n"


def with_table(page: str, stored: dict[str, Any]) -> str:
    """Return the page with the table of stored figures between its marks."""
    lines = ["| figure | CPU time, rate or ratio |", "|---|---|"]
    for group in filter(lambda group: group["figures"], stored["groups"]):
        lines.append(f"| **{group['title']}** | |")
        lines += [f"| {figure['name']} | {Figure(**figure).text} |" for figure in group["figures"]]
    before, rest = page.split(START)
    return before + START + "\n".join(lines) + "\n" + END + rest.split(END)[1]


def with_million(page: str, stored: dict[str, Any]) -> str:
    """Return the page of clusters with what a million rows cost."""
    found = {figure["name"]: figure["value"] for group in stored["groups"] for figure in group["figures"]}
    row, sent = found["row of an episode, in the parent"], found["job through dask, in the parent"]
    text = (
        f"A million rows of simulated squares, ten runs each, take {1e6 * row / 3.6e6:.1f} h of CPU in the parent, "
        f"which so keeps up with {1e3 / row:.0f} rows a second.\nA job sent by Dask adds {sent:.1f} ms there.\n"
    )
    before, rest = page.split(BEGUN)
    return before + BEGUN + text + ENDED + rest.split(ENDED)[1]


if __name__ == "__main__":
    stored = json.loads(FIGURES.read_text(encoding="utf-8"))
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), stored), encoding="utf-8")
    CLUSTERS.write_text(with_million(CLUSTERS.read_text(encoding="utf-8"), stored), encoding="utf-8")
