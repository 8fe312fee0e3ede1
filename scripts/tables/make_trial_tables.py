"""Write docs/trials.json from the folders of trials, and from that the tables of docs/diagnosis-trials.md: rates of
robots and of trains, and the cases that count against the finder.

    castor-diagnose trial --out FOLDER && python scripts/tables/make_trial_tables.py FOLDER...

They come before what is stored already, or in the place of the same trials. Without folders, the tables are made anew.
"""

import json
import sys
from pathlib import Path
from typing import Any

from castor_envs.files import write_atomically
from castor_envs.vehicles.presets import train_names
from discrepancy.trials.results.missed import given_of, missed, said_of
from discrepancy.trials.results.scores import calibration_error, report, trials_of, wilson

FORMAT = "castor-trial-figures/1"
DOCS = Path(__file__).parents[2] / "docs"
PAGE, FIGURES = DOCS / "diagnosis-trials.md", DOCS / "trials.json"
START, END = "<!-- table: made by scripts/tables/make_trial_tables.py -->\n", "<!-- end of table -->\n"
GENERATORS = ("pymunk", "mujoco", "bullet")
ENOUGH = 200
"""Cases that the newest trials of a column have together: single trials are too small for a rate."""

OF_TRAINS = "<!-- table of trains: made by scripts/tables/make_trial_tables.py -->\n"
OF_MISSES = "<!-- table of misses: made by scripts/tables/make_trial_tables.py -->\n"
OF_TRAINS_MISSES = "<!-- table of trains' misses: made by scripts/tables/make_trial_tables.py -->\n"

Figures = dict[str, Any]


def figures_of(folders: list[Path]) -> Figures:
    """Return the scores of some trials as plain data."""
    trials = []
    for folder in folders:
        scores = report(folder)
        shown = {key: scores[key] for key in ("plan", "finder", "judged")} | {"missed": missed(trials_of(folder))}
        trials.append(shown | {key: scores["all"][key] for key in ("rates", "reliability", "calibration_error")})
    return {"format": FORMAT, "trials": trials}


def robots_table(figures: Figures) -> str:
    """Return the table of all rates: for each simulator a column for its `newest` trials, and one for all."""
    robots = [trial for trial in figures["trials"] if not _of_train(trial)]
    generators = {name: [trial for trial in robots if trial["plan"]["generator"] == name] for name in GENERATORS}
    columns = {_head(name, "newest", newest(trials)): newest(trials) for name, trials in generators.items()}
    return _table(columns | {_head(name, "all", trials): trials for name, trials in generators.items()})


def trains_table(figures: Figures) -> str:
    """Return the table of trains: a column for the `newest` trials, for all trials of each train, and for all; without
    rates of what no trial has."""
    trials = [trial for trial in figures["trials"] if _of_train(trial)]
    robots = sorted({trial["plan"]["robots"][0] for trial in trials})
    of_each = {robot: [trial for trial in trials if trial["plan"]["robots"][0] == robot] for robot in robots}
    columns = {_head("trains", "newest", newest(trials)): newest(trials)}
    columns |= {_head(name, "all", group): group for name, group in [*of_each.items(), ("trains", trials)]}
    empty = f"{' | '.join(['-'] * len(columns))} |"
    return "".join(row for row in _table(columns).splitlines(keepends=True) if not row.endswith(f"| {empty}\n"))


def newest(trials: list[Figures]) -> list[Figures]:
    """Return the newest trials, as few of them as have `ENOUGH` cases together, or all."""
    cases = [trial["judged"] for trial in trials]
    return trials[: 1 + next((k for k in range(len(cases)) if sum(cases[: k + 1]) >= ENOUGH), len(cases))]


def _head(name: str, which: str, trials: list[Figures]) -> str:
    return f"{name}, {which} {len(trials)} trials, {sum(trial['judged'] for trial in trials)} cases"


def with_new(figures: Figures, new: list[Figures]) -> list[Figures]:
    """Return new trials before those that are stored, or in the place of the same ones."""
    by_plan = {json.dumps(trial["plan"], sort_keys=True): trial for trial in new}
    stored = [by_plan.pop(json.dumps(trial["plan"], sort_keys=True), trial) for trial in figures["trials"]]
    return [*by_plan.values(), *stored]


def misses_table(figures: Figures, trains: bool) -> str:
    """Return the table of cases that count against the finder, of the newest trials, as far as they are stored."""
    rows = [["case", "robot", "hidden, with its cost in 10 m", "answer", "counts as"], ["---"] * 5]
    for trial in figures["trials"]:
        if _of_train(trial) == trains:
            for miss in trial.get("missed", []):
                said = f"{miss['verdict']}: {said_of(miss)}" if said_of(miss) else miss["verdict"]
                where = f"{miss['robot']}, {given_of(miss)}"
                hidden = "; ".join(miss["hidden"]) or "nothing"
                rows.append(
                    [f"{trial['plan']['seed']}, {miss['case']}", where, hidden, said, ", ".join(miss["missed"])]
                )
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _of_train(trial: Figures) -> bool:
    return trial["plan"]["robots"][0] in train_names()


def _table(columns: dict[str, list[Figures]]) -> str:
    """Return the table of rates; columns: the trials that each sums, by its head."""
    rows = [["", *columns], ["---"] * (len(columns) + 1)]
    newest_of_all = next(iter(columns.values()))[0]
    for heading, what in _rates(newest_of_all):
        counted = [
            [of for trial in trials if (of := _rates(trial).get((heading, what)))] for trials in columns.values()
        ]
        rows.append([what.replace("  ", "– "), *map(_cell, counted)])
    rows.append(["expected calibration error of reported probabilities", *map(_error, columns.values())])
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)


def _rates(trial: Figures) -> dict[tuple[str, str], Figures]:
    """Return the rates of a trial by their statements, each after the statement that it is a part of. Older trials have
    fewer."""
    by_statement, heading = {}, ""
    for rate in trial["rates"]:
        heading = heading if rate["what"].startswith("  ") else rate["what"]
        by_statement[heading, rate["what"]] = rate
    return by_statement


def _cell(rates: list[Figures]) -> str:
    """Return a rate, over several trials, with its interval."""
    count, total = (sum(rate[key] for rate in rates) for key in ("count", "total"))
    if not total:
        return "-"
    low, high = wilson(count, total)
    return f"{count} of {total} ({100 * low:.0f} to {100 * high:.0f} %)"


def _error(trials: list[Figures]) -> str:
    """Return the expected calibration error over the names of several trials."""
    bins: dict[str, list[Figures]] = {}
    for part in (part for trial in trials for part in trial["reliability"]):
        bins.setdefault(part["what"], []).append(part)
    off = calibration_error([_joined(parts) for parts in bins.values()])
    return "-" if off is None else f"{off:.2f}"


def _joined(parts: list[Figures]) -> Figures:
    """Return a bin of the reliability diagram over several trials."""
    count, total = (sum(part[key] for part in parts) for key in ("count", "total"))
    probability = sum(part["probability"] * part["total"] for part in parts) / total
    return {"total": total, "share": count / total, "probability": probability}


def with_tables(page: str, figures: Figures) -> str:
    """Return the page with new tables between their marks."""
    tables = robots_table(figures), trains_table(figures), misses_table(figures, False), misses_table(figures, True)
    for start, table in zip((START, OF_TRAINS, OF_MISSES, OF_TRAINS_MISSES), tables, strict=True):
        before, rest = page.split(start)
        page = before + start + "\n" + table + "\n" + END + rest.split(END, 1)[1]
    return page


if __name__ == "__main__":
    figures = json.loads(FIGURES.read_text(encoding="utf-8"))
    if sys.argv[1:]:
        figures["trials"] = with_new(figures, figures_of([Path(name) for name in sys.argv[1:]])["trials"])
        write_atomically(FIGURES, json.dumps(figures, indent=1) + "\n")
    write_atomically(PAGE, with_tables(PAGE.read_text(encoding="utf-8"), figures))
