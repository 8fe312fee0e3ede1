"""Scores of the train finder: its answers on cases against the hidden effects.

Counts of cases with 95 % Wilson intervals, for wheels that yield to each other and wheels held at speed apart. All
sizes count, however small; a name is wrong if no hidden effect is among those that the finder calls possible.
"""

import os
from collections import Counter
from collections.abc import Sequence
from typing import Any, get_args

import numpy as np

from discrepancy.trials.finders import NORMAL, QUIET
from discrepancy.trials.folder import asked_of, judged
from discrepancy.trials.scores import Judged, Rate, Table, as_plain, counted, rates_of
from discrepancy.trials.trains.cases import THIRDS, Drive
from discrepancy.trials.trains.run import TrainPlan

FORMAT = "castor-train-trial/3"


class Trial(Judged):
    """A judged case of a train."""

    @property
    def truth(self) -> set[str]:
        """Names and places of the hidden effects."""
        return {hidden["what"] for hidden in self.label["hidden"]}

    @property
    def exact(self) -> bool:
        """Whether the finder names exactly the hidden effects."""
        return set(self.outcome["named"]) == self.truth and self.outcome["verdict"] in ("named", *QUIET)

    @property
    def in_the_set(self) -> bool:
        """Whether all hidden effects are among the possible effects."""
        return self.truth <= set(self.outcome["possible"])

    @property
    def wrong(self) -> bool:
        """Whether effects are called possible, and none of them was hidden."""
        return bool(self.outcome["possible"]) and not self.truth & set(self.outcome["possible"])

    @property
    def extra(self) -> bool:
        """Whether the finder names an effect that was not hidden."""
        return bool(set(self.outcome["named"]) - self.truth)

    @property
    def alarm(self) -> bool:
        """Whether the finder reports any discrepancy."""
        return self.outcome["verdict"] not in QUIET

    @property
    def flagged(self) -> bool:
        """Whether the finder reports an unexplained or an ambiguous discrepancy."""
        return self.outcome["verdict"] in ("unexplained", "ambiguous")


RATES: Table = (
    ("clean: an effect named (false positive)", "clean", None, "wrong"),
    ("clean: any alarm", "clean", None, "alarm"),
    ("one effect: named exactly", "one", None, "exact"),
    ("one effect: the truth among the names", "one", None, "in_the_set"),
    ("one effect: sure of something that is not there", "one", None, "extra"),
    ("one effect: a wrong name, the truth not among them", "one", None, "wrong"),
    ("two effects: both named exactly", "two", None, "exact"),
    ("two effects: sure of something that is not there", "two", None, "extra"),
    ("outside the catalogue: flagged", "outside", None, "flagged"),
    ("outside the catalogue: a sure name", "outside", None, "extra"),
    ("the finder broke down", None, None, "broken"),
)


def rates(trials: Sequence[Trial]) -> list[Rate]:
    """Return the rates over these cases: those of `RATES`, by thirds of sizes too, and that at which the true size of a
    rightly named effect lies in the 95 % interval."""
    found, alone = rates_of(trials, RATES), [trial for trial in trials if trial.label["stratum"] == "one"]
    for place, third in enumerate(THIRDS, start=1 + [row[-1] for row in RATES].index("exact")):
        of_size = [trial.exact for trial in alone if trial.label["hidden"][0]["third"] == third]
        found.insert(place, Rate.of(f"  of {third} size", of_size))
    inside = [
        abs(found["value"] - hidden["value"]) <= NORMAL * found["error"]
        for trial in trials
        for hidden in trial.label["hidden"]
        for found in trial.outcome["found"]
        if found["what"] == hidden["what"] and found.get("value") is not None and found["error"]
    ]
    return [*found, Rate.of("true size within the 95 % interval", inside)]


def by_effect(trials: Sequence[Trial]) -> list[Rate]:
    """Return for each kind of effect the rate at which it was named exactly where it was hidden alone."""
    found: dict[str, list[bool]] = {}
    for trial in trials:
        if trial.label["stratum"] == "one":
            found.setdefault(trial.label["hidden"][0]["name"], []).append(trial.exact)
    return [Rate.of(name, exact) for name, exact in sorted(found.items())]


def report(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Return all scores of a trial as plain data."""
    trials = [Trial(*case) for case in judged(folder, TrainPlan.answers)]
    drives: dict[str, Any] = {}
    for drive in get_args(Drive):
        driven = [trial for trial in trials if trial.label["drive"] == drive]
        parts = {"rates": rates(driven), "by_effect": by_effect(driven)}
        drives[drive] = {name: [as_plain(rate) for rate in part] for name, part in parts.items()}
    verdicts = Counter(f"{trial.label['stratum']}, {trial.outcome['verdict']}" for trial in trials)
    return {
        "format": FORMAT,
        "plan": asked_of(folder),
        "judged": len(trials),
        "drives": drives,
        "verdicts": dict(sorted(verdicts.items())),
        "seconds": float(np.mean([trial.outcome["seconds"] for trial in trials])),
    }


def lines(scores: dict[str, Any]) -> list[str]:
    """Return the scores of `report` as text."""
    plan = scores["plan"]
    text = [
        f"{scores['judged']} of {plan['cases']} cases, {plan['train']}, seed {plan['seed']}, {plan['duration']:g} s"
    ]
    for drive, found in scores["drives"].items():
        text += ["", "Wheels that yield to each other:" if drive == "yielding" else "Wheels held at speed:"]
        text += [counted(rate, 0) for rate in found["rates"]]
        text += ["named exactly, of one effect alone:", *(counted(rate, 0) for rate in found["by_effect"])]
    text += ["", *(f"{count:4d}  {verdict}" for verdict, count in scores["verdicts"].items())]
    return [*text, "", f"A case takes {scores['seconds']:.1f} s to judge."]
