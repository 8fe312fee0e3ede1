"""Runs a train's trial: makes cases in separate processes, then gives the finder their files and nothing else.

trial.json                      settings: train, cases, seed, duration
cases/case-0001/                log.csv, holdout.csv and train.json (nominal): the files for the finder
labels/case-0001.json           the hidden effects
outcomes/case-0001.json         the finder's answer
"""

import dataclasses
import os
import time
import traceback
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from castor_envs.errors import InputError
from castor_envs.files import write_json
from castor_envs.logs.csv import read_log, write_log
from castor_envs.logs.log import Log
from castor_envs.motion.paths import SPEED
from castor_envs.vehicles.load import load_train
from castor_envs.vehicles.train import TrainDescription
from discrepancy.posterior.verdicts import Material
from discrepancy.trains.candidates import Candidate, Placed
from discrepancy.trains.posterior import diagnose_train
from discrepancy.trains.trial.cases import Case, draw, plain
from discrepancy.trains.trial.simulate import log_at_random
from discrepancy.trials.folder import asked_of, begin, do_all, name_of

FORMAT = "castor-train-trial-case/1"
STANDING = 0.5
"""m by which a path is shorter than the way at full speed: allows for starting, stopping and whole legs."""

ALL = Material(0.0, 0.0)
"""Materiality in a trial: all sizes matter, however small."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """The settings of a trial."""

    cases: int
    seed: int
    train: str
    duration: float


def make(
    cases: int, seed: int, train: str, folder: str | os.PathLike[str], *, duration: float, jobs: int | None = None
) -> None:
    """Make the cases that are not there yet. train: a preset's name. duration: of a log, s, roughly.

    Raises InputError for a folder that holds another trial.
    """
    folder, plan = Path(folder), Plan(cases, seed, train, duration)
    load_train(train)
    begin(folder, dataclasses.asdict(plan), ("cases", "labels", "outcomes"))
    missing = [k for k in range(1, cases + 1) if not (folder / "labels" / f"{name_of(k)}.json").exists()]
    do_all([(_make_case, (plan, k, folder)) for k in missing], jobs)


def judge(folder: str | os.PathLike[str], *, jobs: int | None = None) -> None:
    """Run the finder on every case that has no answer yet."""
    folder, outcomes = Path(folder), Path(folder) / "outcomes"
    names = [name_of(k) for k in range(1, plan_of(folder).cases + 1)]
    missing = [name for name in names if not (outcomes / f"{name}.json").exists()]
    do_all([(_judge_case, (folder / "cases" / name, outcomes / f"{name}.json")) for name in missing], jobs)


def plan_of(folder: str | os.PathLike[str]) -> Plan:
    """Return the settings of the trial in a folder."""
    return Plan(**asked_of(Path(folder)))


def answer_of(train: TrainDescription, logs: Sequence[Log], held_out: Sequence[Log]) -> dict[str, Any]:
    """Return the finder's answer, with names and places in words.

    verdict, reason; named: the named effects; possible: these, and effects of the catalogue in ambiguous or unexplained
    credible sets; found: the named effects as plain data, with standard errors.
    """
    diagnosis = diagnose_train(train, logs, held_out, material=ALL)
    known = {candidate.what for candidate in diagnosis.before.candidates if candidate.kinds}
    unsure = [answer for answer in diagnosis.answers if answer.verdict in ("ambiguous", "unexplained")]
    sure: list[tuple[Placed, float | None]] = []
    for answer in diagnosis.answers:
        if answer.verdict == "named" and isinstance(answer.candidate, Candidate):
            placed = answer.candidate.sized(answer.amplitudes)
            sure.append((placed, None if placed.effect.binary else answer.error))
    named = [placed.what(train) for placed, _ in sure]
    possible = [name for answer in unsure for name in answer.credible if name in known]
    return {
        "verdict": diagnosis.verdict,
        "reason": "; ".join(f"{answer.verdict}: {answer.reason}" for answer in diagnosis.answers),
        "named": named,
        "possible": list(dict.fromkeys([*named, *possible])),
        "found": [plain(placed, train) | {"error": error} for placed, error in sure],
    }


def _make_case(plan: Plan, number: int, folder: Path) -> None:
    train, name = load_train(plan.train), name_of(number)
    case, case_folder = draw(number, plan.seed, train), folder / "cases" / name
    case_folder.mkdir(exist_ok=True)
    real = train
    for effect in case.hidden:
        real = effect.added(real)
    for file, seed in zip(("log.csv", "holdout.csv"), case.seeds, strict=True):
        drive = "servo" if case.drive == "held" else "voltage"
        log = log_at_random(real, seed, SPEED * plan.duration - STANDING, drive)
        write_log(case_folder / file, log if case.outside is None else case.outside.changed(train, log), train)
    train.save(case_folder / "train.json")
    write_json(folder / "labels" / f"{name}.json", _label(case, train))


def _label(case: Case, train: TrainDescription) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "case": case.number,
        "stratum": case.stratum,
        "drive": case.drive,
        "seeds": case.seeds,
        "hidden": [
            plain(hidden, train) | {"third": third} for hidden, third in zip(case.hidden, case.thirds, strict=True)
        ],
        "outside": None if case.outside is None else dataclasses.asdict(case.outside),
    }


def _judge_case(case: Path, outcome: Path) -> None:
    """Write the finder's answer on a case; it reads the case's files."""
    started = time.perf_counter()
    result: dict[str, Any] = {"format": FORMAT, "case": int(case.name[-4:])}
    nothing = {"named": [], "possible": [], "found": []}
    try:
        train = TrainDescription.load(case / "train.json")
        log, held_out = (read_log(case / name, train) for name in ("log.csv", "holdout.csv"))
        result |= answer_of(train, [log], [held_out])
    except InputError as error:
        result |= nothing | {"verdict": "refused", "reason": str(error)}
    except Exception:  # a finder that breaks fails its own case, no other
        result |= nothing | {"verdict": "broken", "reason": traceback.format_exc()}
    write_json(outcome, result | {"seconds": time.perf_counter() - started})
