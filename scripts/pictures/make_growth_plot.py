"""Draw docs/growth.svg and write the table of docs/growth.md: ``python scripts/pictures/make_growth_plot.py``.

The curves are those of one machine: ``castor-bench speed --growth --json > docs/growth.json`` measures them again.
"""

import hashlib
import json
import math
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parents[2] / "docs"
PAGE, PICTURE, CURVES = DOCS / "growth.md", DOCS / "growth.svg", DOCS / "growth.json"
START, END = "<!-- table: made by scripts/pictures/make_growth_plot.py -->\n", "<!-- end of table -->\n"


def steepness(curve: dict[str, Any]) -> float | None:
    """Return the power of its size with which a cost grows between the two largest sizes: 1 on a straight line."""
    (x, following), (y, higher) = curve["sizes"][-2:], curve["costs"][-2:]
    return math.log(higher / y) / math.log(following / x) if x > 0 else None


def with_table(page: str, stored: dict[str, Any]) -> str:
    """Return the page with the table of stored curves between its marks."""
    lines = ["| cost | over | sizes: costs | power at the end |", "|---|---|---|--:|"]
    for curve in stored["curves"]:
        points = ", ".join(f"{size:g}: {cost:.3g}" for size, cost in zip(curve["sizes"], curve["costs"], strict=True))
        lines.append(f"| {curve['title']}, {curve['unit']} | {curve['over']} | {points} | {steepness(curve):.2f} |")
    before, rest = page.split(START)
    return before + START + "\n".join(lines) + "\n" + END + rest.split(END)[1]


def digest(stored: dict[str, Any]) -> str:
    """Return what the picture carries of the curves that it shows."""
    return hashlib.sha256(json.dumps(stored["curves"]).encode()).hexdigest()[:16]


def draw(stored: dict[str, Any]) -> None:
    """Draw a panel for each curve, both axes logarithmic where sizes are above 0."""
    import matplotlib.pyplot as plt

    curves = stored["curves"]
    plt.rcParams["svg.hashsalt"] = "growth"
    figure, axes = plt.subplots(math.ceil(len(curves) / 4), 4, figsize=(13, 2.7 * math.ceil(len(curves) / 4)))
    for axis, curve in zip(axes.flat, curves, strict=False):
        axis.plot(curve["sizes"], curve["costs"], "o-", markersize=3)
        axis.set(title=f"{curve['title']}, {curve['unit']}", xlabel=curve["over"], ylim=(0, 1.1 * max(curve["costs"])))
        axis.title.set_fontsize(9)
    for axis in axes.flat[len(curves) :]:
        axis.axis("off")
    figure.tight_layout()
    figure.savefig(PICTURE, metadata={"Date": None, "Description": f"growth.json {digest(stored)}"})


if __name__ == "__main__":
    stored = json.loads(CURVES.read_text(encoding="utf-8"))
    draw(stored)
    PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), stored), encoding="utf-8")
