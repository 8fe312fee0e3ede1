"""Write docs/trials.json from the folders of trials, and the table of docs/diagnosis-trials.md from that.

    castor-diagnose trial --out FOLDER && python scripts/tables/make_trial_tables.py FOLDER...

They come before what is stored already. Without folders, the table is made anew.
"""

import json
import sys
from pathlib import Path
from typing import Any

from castor_envs.files import write_atomically
from discrepancy.trials.scores import report

FORMAT = "castor-trial-figures/1"
DOCS = Path(__file__).parents[2] / "docs"
PAGE, FIGURES = DOCS / "diagnosis-trials.md", DOCS / "trials.json"
START, END = "<!-- table: made by scripts/tables/make_trial_tables.py -->\n", "<!-- end of table -->\n"

Figures = dict[str, Any]


def figures_of(folders: list[Path]) -> Figures:
    """Return the scores of some trials as plain data."""
    trials = []
    for scores in map(report, folders):
        shown = {key: scores[key] for key in ("plan", "finder", "judged")}
        trials.append(shown | {key: scores["all"][key] for key in ("rates", "reliability", "calibration_error")})
    return {"format": FORMAT, "trials": trials}


def table(figures: Figures) -> str:
    """Return the table of all rates, a column for each trial."""
    trials = figures["trials"]
    heads = [f"{trial['plan']['generator']}, seed {trial['plan']['seed']}, {trial['judged']} cases" for trial in trials]
    rows = [["", *heads], ["---"] * (len(heads) + 1)]
    for k, rate in enumerate(trials[0]["rates"]):
        rows.append([rate["what"].replace("  ", "– "), *(_cell(trial["rates"][k]) for trial in trials)])
    errors = ["-" if (off := trial["calibration_error"]) is None else f"{off:.2f}" for trial in trials]
    rows.append(["expected calibration error of reported probabilities", *errors])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _cell(rate: Figures) -> str:
    if not rate["total"]:
        return "-"
    return f"{rate['count']} of {rate['total']} ({100 * rate['low']:.0f} to {100 * rate['high']:.0f} %)"


def with_table(page: str, figures: Figures) -> str:
    """Return the page with a new table between its marks."""
    before, rest = page.split(START)
    return before + START + "\n" + table(figures) + "\n" + END + rest.split(END, 1)[1]


if __name__ == "__main__":
    figures = json.loads(FIGURES.read_text(encoding="utf-8"))
    if sys.argv[1:]:
        figures["trials"] = figures_of([Path(name) for name in sys.argv[1:]])["trials"] + figures["trials"]
        write_atomically(FIGURES, json.dumps(figures, indent=1) + "\n")
    write_atomically(PAGE, with_table(PAGE.read_text(encoding="utf-8"), figures))
