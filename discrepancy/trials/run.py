"""Runs a trial: makes cases in separate processes, then gives the diagnosis their files and nothing else.

    trial.json                      the settings: cases, seed, generator, robot, duration
    cases/case-0001/                log.csv, holdout.csv and robot.json (without effect): all that is diagnosed
    clean/1.csv ...                 logs without any effect, given as clean logs where the generator is foreign
    labels/case-0001.json, .npz     the hidden effect and its strength; the held-out log with and without it, exact
    outcomes/case-0001.json         the diagnosis
    left/case-0001.json             the part of the effect's change to the held-out log that remains when the
                                    robot as diagnosed is simulated again

Files that are there already are kept, so a trial that was interrupted continues.
"""

import dataclasses
import os
import time
import traceback
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from castor_envs.errors import InputError
from castor_envs.files import read_json, write_json
from castor_envs.geometry.arrays import Array
from castor_envs.logs.csv import read_log, write_log
from castor_envs.logs.log import Log
from castor_envs.vehicles.presets import preset
from castor_envs.vehicles.robot import RobotDescription
from discrepancy.diagnose import Examination, examine
from discrepancy.inference.findings import Diagnosis
from discrepancy.trials.cases import Case, Hidden, draw, motion
from discrepancy.trials.folder import asked_of, begin, each, name_of
from discrepancy.trials.generators import Generator, generator
from discrepancy.trials.noise import EXACT, Noise
from discrepancy.trials.reading import as_recorded
from discrepancy.trials.strength.separation import StrengthMetric, class_of
from discrepancy.trials.strength.solve_size import Strength, TrialRun, solve_size

FORMAT = "castor-trial-case/1"
ROBOT, DURATION = "asoc-prototype", 60.0
CLEAN = 3
"""Logs without any effect."""

ATTEMPTS = 60
"""Draws of a case, until one can be had in the strength wanted."""

OUTSIDE_BELOW = 0.9
"""The largest cosine with a class of the catalogue of what counts as outside of it."""

SLACK = 1.1
"""Part by which z may be beyond the bounds of its stratum."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """What a trial is asked for."""

    cases: int
    seed: int
    generator: str
    robot: str = ROBOT
    duration: float = DURATION


@dataclasses.dataclass(frozen=True)
class Said:
    """What the finder said, in classes (`strength.class_of`).

    verdict: of the whole. named: those it is sure of. possible: those and all that it could not tell apart from others.
    unnamed_rival: whether among these is one without a name.
    """

    verdict: str
    named: tuple[str, ...] = ()
    possible: tuple[str, ...] = ()
    unnamed_rival: bool = False


def make(
    cases: int,
    seed: int,
    generator: str,
    folder: str | os.PathLike[str],
    *,
    robot: str = ROBOT,
    duration: float = DURATION,
    jobs: int | None = None,
) -> None:
    """Make the cases of a trial that are not there yet, `jobs` at a time, each in another process.

    robot: a preset's name. Raises InputError for a folder that holds another trial.
    """
    folder, plan = Path(folder), Plan(cases, seed, generator, robot, duration)
    preset(robot)
    _generator_of(plan)
    begin(folder, dataclasses.asdict(plan), ("cases", "clean", "labels", "outcomes", "left"))
    clean = [k for k in range(1, CLEAN + 1) if not (folder / "clean" / f"{k}.csv").exists()]
    missing = [k for k in range(1, cases + 1) if not (folder / "labels" / f"{name_of(k)}.json").exists()]
    each(
        [*((_make_clean, (plan, k, folder)) for k in clean), *((_make_case, (plan, k, folder)) for k in missing)], jobs
    )


def judge(folder: str | os.PathLike[str], *, jobs: int | None = None) -> None:
    """Let the finder say what is in every case that it has not seen yet."""
    folder = Path(folder)
    plan = plan_of(folder)
    clean = sorted((folder / "clean").glob("*.csv")) if _generator_of(plan).foreign else []
    every = [folder / "cases" / name_of(k) for k in range(1, plan.cases + 1)]
    missing = [case for case in every if case.exists() and not (folder / "outcomes" / f"{case.name}.json").exists()]
    each([(_judge_case, (case, clean, folder / "outcomes" / f"{case.name}.json")) for case in missing], jobs)


def resimulate(folder: str | os.PathLike[str], *, jobs: int | None = None) -> None:
    """Drive the held-out motion of every case with the robot that was found, and measure what is left of the signal."""
    folder = Path(folder)
    plan = plan_of(folder)
    done = [path.stem for path in sorted((folder / "outcomes").glob("case-*.json"))]
    missing = [name for name in done if not (folder / "left" / f"{name}.json").exists()]
    each([(_resimulate_case, (plan, name, folder)) for name in missing], jobs)


def said_by(examined: Examination) -> Said:
    """Return what an examination says."""
    named, possible, unnamed = [], [], False
    for mistake in examined.mistakes:
        (possible if mistake.alternatives else named).extend(map(class_of, mistake.effects))
    for finding in examined.diagnosis.findings:
        kinds = [kind for rank in finding.chosen for kind in rank.candidate.kinds]
        if finding.verdict == "named" and finding.effect is not None:
            named.append(class_of(finding.effect))
        if finding.verdict == "ambiguous":
            possible += [class_of(kind) for kind in kinds]
            unnamed |= any(not rank.candidate.kinds for rank in finding.chosen)
        unnamed |= finding.verdict == "unexplained"
    verdict = examined.data["verdict"]
    return Said(verdict, tuple(named), tuple(dict.fromkeys([*named, *possible])), unnamed or verdict == "unexplained")


def intervals(found: Diagnosis) -> list[dict[str, Any]]:
    """Return the effects named, with their classes and the standard errors of their sizes."""
    return [
        {"class": class_of(finding.effect), "effect": dataclasses.asdict(finding.effect), "error": finding.error}
        for finding in found.findings
        if finding.verdict == "named" and finding.effect is not None
    ]


def plan_of(folder: str | os.PathLike[str]) -> Plan:
    """Return what a trial in a folder was asked for."""
    return Plan(**asked_of(Path(folder)))


def _generator_of(plan: Plan) -> Generator:
    return generator(plan.generator)


def _make_clean(plan: Plan, number: int, folder: Path) -> None:
    robot, seed = preset(plan.robot), 10**12 + 1000 * plan.seed + number  # beyond those of cases
    course = motion("wander", seed, plan.duration)
    log = _generator_of(plan).drive(robot, course, seed, duration=plan.duration)
    write_log(folder / "clean" / f"{number}.csv", log, robot)


def _make_case(plan: Plan, number: int, folder: Path) -> None:
    started, robot, source = time.process_time(), preset(plan.robot), _generator_of(plan)
    for attempt in range(ATTEMPTS):
        drawn = draw(number, attempt, plan.seed, robot, source.outsiders)
        trial_runs = [TrialRun(robot, drawn, which, source, plan.duration) for which in (0, 1)]
        if (case := solve_size(drawn, trial_runs[0])) is None:
            continue
        try:
            first = trial_runs[0].strength(case.hidden, alternatives=True) if case.hidden else None
            if not _accepted(case, first):
                continue
            strengths = [first, trial_runs[1].strength(case.hidden, alternatives=False) if case.hidden else None]
            logs = [trial_run.drive(*case.effects, outside=case.outside) for trial_run in trial_runs]
        except InputError:
            continue
        _write_case(plan, case, trial_runs, logs, strengths, folder, attempt, started)
        return
    raise RuntimeError(f"case {number} could not be had in {ATTEMPTS} attempts")


def _accepted(case: Case, strength: Strength | None) -> bool:
    """Whether a case is as strong as its stratum asks, and, where it should be, outside the catalogue."""
    if strength is None:
        return True
    if any(effect.wiring for effect in case.effects):
        return True
    low, high = case.bounds[0] / SLACK, case.bounds[1] * SLACK
    if case.stratum == "two":
        low = 0.0  # what the other effect hides may be much
    if not all(low <= z <= high and z > 0 for z in strength.z):
        return False
    return case.stratum != "outside" or (strength.cosine is not None and strength.cosine < OUTSIDE_BELOW)


def _write_case(
    plan: Plan,
    case: Case,
    trial_runs: list[TrialRun],
    logs: list[Log],
    strengths: list[Strength | None],
    folder: Path,
    attempt: int,
    started: float,
) -> None:
    robot, name = preset(plan.robot), name_of(case.number)
    real, case_folder = robot.with_effects(*case.effects), folder / "cases" / name
    case_folder.mkdir(exist_ok=True)
    for file, log, seed in zip(("log.csv", "holdout.csv"), logs, case.seeds, strict=True):
        write_log(case_folder / file, as_recorded(real, log, seed, Noise()), robot)
    robot.save(case_folder / "robot.json")
    exact = {"true": logs[1], "nominal": trial_runs[1].nominal}
    arrays = {
        f"{kind}_{part}": getattr(log, part) for kind, log in exact.items() for part in ("wheel", "pivot", "reference")
    }
    np.savez_compressed(folder / "labels" / f"{name}.npz", t=logs[1].t, **arrays)
    label = {
        "format": FORMAT,
        "case": case.number,
        "stratum": case.stratum,
        "course": case.course,
        "seeds": case.seeds,
        "hidden": [_hidden(hidden) for hidden in case.hidden],
        "targets": case.targets,
        "log": None if strengths[0] is None else dataclasses.asdict(strengths[0]),
        "holdout": None if strengths[1] is None else dataclasses.asdict(strengths[1]),
        "attempts": attempt + 1,
        "seconds": time.process_time() - started,
    }
    write_json(folder / "labels" / f"{name}.json", label)


def _hidden(hidden: Hidden) -> dict[str, Any]:
    kind = "catalogue" if hidden.effect is not None else "outside"
    return {"class": hidden.label, "from": kind, "what": dataclasses.asdict(hidden.what)}


def _judge_case(case: Path, clean: list[Path], outcome: Path) -> None:
    """Write what the finder says of one case; it sees the case's files and the clean logs."""
    started = time.perf_counter()
    robot = RobotDescription.load(case / "robot.json")
    result: dict[str, Any] = {"format": FORMAT, "case": int(case.name[-4:])}
    try:
        logs, held_out = ({str(path): read_log(path, robot)} for path in (case / "log.csv", case / "holdout.csv"))
        good = _read_clean(robot, tuple(clean))
        examined = examine(robot, logs, held_out, good, replayed=False)
        result |= dataclasses.asdict(said_by(examined))
        result |= {"reason": examined.data["reason"], "found": intervals(examined.diagnosis)}
        result["robot"] = None if examined.found is None else examined.found.to_dict()
    except InputError as error:
        result |= dataclasses.asdict(Said("refused")) | {"reason": str(error), "found": [], "robot": None}
    except Exception:  # a finder that breaks fails its own case, no other
        result |= dataclasses.asdict(Said("broken")) | {"reason": traceback.format_exc(), "found": [], "robot": None}
    result["seconds"] = time.perf_counter() - started
    write_json(outcome, result)


@lru_cache(maxsize=1)
def _read_clean(robot: RobotDescription, clean: tuple[Path, ...]) -> Mapping[str, Log]:
    """Return the clean logs, which are the same in all cases."""
    return {str(path): read_log(path, robot) for path in clean}


def _resimulate_case(plan: Plan, name: str, folder: Path) -> None:
    label, outcome = read_json(folder / "labels" / f"{name}.json"), read_json(folder / "outcomes" / f"{name}.json")
    result: dict[str, Any] = {"format": FORMAT, "case": label["case"], "left": None, "signal": None}
    if label["holdout"] is not None:
        robot, seed = preset(plan.robot), label["seeds"][1]
        with np.load(folder / "labels" / f"{name}.npz") as kept:
            true, nominal = (
                Log(
                    kept["t"],
                    *(kept[f"{kind}_{part}"] for part in ("wheel", "pivot")),
                    reference=kept[f"{kind}_reference"],
                )
                for kind in ("true", "nominal")
            )
        metric, floor = StrengthMetric(robot, nominal), label["holdout"]["floor"]
        signal = _above(metric.signal(true), floor)
        left = signal
        if outcome["robot"] is not None:
            found = RobotDescription.from_dict(outcome["robot"])
            course = motion(label["course"], seed, plan.duration)
            try:
                again = _generator_of(plan).drive(
                    found, course, seed, duration=plan.duration, rounded=False, noise=EXACT
                )
                left = _above(metric.signal(true, again), floor)
            except InputError as error:
                result["reason"] = str(error)
        result |= {"signal": signal, "left": left / signal if signal > 0 else None}
    write_json(folder / "left" / f"{name}.json", result)


def _above(signal: Array, floor: float) -> float:
    """Return the norm of a signal less the floor, in quadrature."""
    return float(np.sqrt(max(float(signal @ signal) - floor**2, 0.0)))
