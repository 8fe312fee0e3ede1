"""Runs a train's trial: makes cases in processes of their own, then hands the finder files and nothing else.

    trial.json                      what was asked for: train, cases, seed, duration
    cases/case-0001/                log.csv, holdout.csv and train.json (nominal): all that the finder gets
    labels/case-0001.json           what was hidden
    outcomes/case-0001.json         what the finder said

Whatever is there already is kept, so a trial that was stopped goes on.
"""

import dataclasses
import json
import os
import time
import traceback
from pathlib import Path
from typing import Any

from castor_envs.errors import InputError
from castor_envs.files import write_atomically
from castor_envs.logs import read_log, write_log
from castor_envs.train import TrainDescription
from castor_envs.train_paths import SPEED
from castor_envs.vehicles import load_train
from discrepancy.trains.cases import Case, draw, plain
from discrepancy.trains.diagnosis import TrainDiagnosis, diagnose_train
from discrepancy.trains.trial import log_at_random
from discrepancy.trials import run

FORMAT = "castor-train-trial-case/1"
STANDING = 0.5
"""m by which a path is shorter than its time would let it be at full speed: for starting, stopping and whole legs."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a trial is asked for."""

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
    path, asked = folder / "trial.json", dataclasses.asdict(plan)
    if path.exists() and {**_read(path), "cases": 0} != {**asked, "cases": 0}:
        raise InputError(f"{folder}: holds another trial, {_read(path)}; give another folder")
    for part in ("cases", "labels", "outcomes"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    _write(path, asked)
    missing = [k for k in range(1, cases + 1) if not (folder / "labels" / f"case-{k:04}.json").exists()]
    run.each([(_make_case, (plan, k, folder)) for k in missing], jobs)


def judge(folder: str | os.PathLike[str], *, jobs: int | None = None) -> None:
    """Let the finder say what is in every case that it has not seen yet."""
    folder = Path(folder)
    names = [f"case-{k:04}" for k in range(1, plan_of(folder).cases + 1)]
    missing = [name for name in names if not (folder / "outcomes" / f"{name}.json").exists()]
    run.each([(_judge_case, (folder / "cases" / name, folder / "outcomes" / f"{name}.json")) for name in missing], jobs)


def plan_of(folder: str | os.PathLike[str]) -> Plan:
    """Return what a trial in a folder was asked for."""
    path = Path(folder) / "trial.json"
    if not path.exists():
        raise InputError(f"{path}: no trial there; make one first")
    return Plan(**_read(path))


def said_by(found: TrainDiagnosis) -> dict[str, Any]:
    """Return what a diagnosis says, by names and places in words: those it is sure of, and all that it may be."""
    named = [one.what(found.train) for one in found.effects]
    sure = [one for one in found.findings if one.verdict == "named" and one.placed is not None]
    return {
        "verdict": found.verdict,
        "reason": found.reason,
        "named": named,
        "possible": list(dict.fromkeys([*named, *found.families])),
        "found": [plain(one.placed, found.train) | {"error": one.error} for one in sure if one.placed is not None],
    }


def _make_case(plan: Plan, number: int, folder: Path) -> None:
    train, name = load_train(plan.train), f"case-{number:04}"
    case, own = draw(number, plan.seed, train), folder / "cases" / name
    own.mkdir(exist_ok=True)
    real = train
    for effect in case.hidden:
        real = effect.added(real)
    for file, seed in zip(("log.csv", "holdout.csv"), case.seeds, strict=True):
        drive = "servo" if case.drive == "held" else "voltage"
        write_log(own / file, log_at_random(real, seed, SPEED * plan.duration - STANDING, drive), train)
    train.save(own / "train.json")
    _write(folder / "labels" / f"{name}.json", _label(case, train))


def _label(case: Case, train: TrainDescription) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "case": case.number,
        "stratum": case.stratum,
        "drive": case.drive,
        "seeds": case.seeds,
        "hidden": [plain(one, train) | {"third": third} for one, third in zip(case.hidden, case.thirds, strict=True)],
    }


def _judge_case(case: Path, outcome: Path) -> None:
    """Write what the finder says of one case; it sees the case's files."""
    started = time.perf_counter()
    result: dict[str, Any] = {"format": FORMAT, "case": int(case.name[-4:])}
    nothing = {"named": [], "possible": [], "found": []}
    try:
        train = TrainDescription.load(case / "train.json")
        log, held_out = (read_log(case / name, train) for name in ("log.csv", "holdout.csv"))
        result |= said_by(diagnose_train(train, [log], [held_out]))
    except InputError as error:
        result |= nothing | {"verdict": "refused", "reason": str(error)}
    except Exception:  # a finder that breaks fails its own case, no other
        result |= nothing | {"verdict": "broken", "reason": traceback.format_exc()}
    _write(outcome, result | {"seconds": time.perf_counter() - started})


def _write(path: Path, data: dict[str, Any]) -> None:
    write_atomically(path, json.dumps(data, indent=1) + "\n")


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))
